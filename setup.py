"""Build of the compiled kernels; everything else is in pyproject.toml.

The compiler has to be GCC or Clang. Two environment variables change the build:

PHOTONRELAX_BOUNDSCHECK=1
    Kernels check every array access (slow; for tests).
PHOTONRELAX_OPENMP=0
    Build without OpenMP even where the compiler has it: kernels run on one thread.

CYTHON_CACHE_DIR names a folder for the C of kernels, to be used again.
"""

import os
import tempfile
from pathlib import Path

from Cython.Build import cythonize
from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext
from setuptools.errors import CompileError, LinkError
from setuptools.modified import newer_group

BOUNDS_CHECK = os.environ.get("PHOTONRELAX_BOUNDSCHECK", "0") == "1"
WANT_OPENMP = os.environ.get("PHOTONRELAX_OPENMP", "1") != "0"
# One folder per kind of build, as objects of the other kinds would count as up to date.
BUILD_DIR = "build/" + ("checked" if BOUNDS_CHECK else "plain") + ("" if WANT_OPENMP else "-serial")
# Contraction into fused multiply-adds would make results depend on the processor. Square roots that
# need not set errno can be vectorised: results are the same. Debug symbols
# would make wheels five times as large.
FLAGS = ["-fno-math-errno", "-ffp-contract=off", "-g0"]
OPENMP = ["-fopenmp"]
OPENMP_PROBE = "#include <omp.h>\nint main(void) { return omp_get_max_threads() < 1; }\n"

EXT = Path("src/photonrelax/_ext")
# Extension with Cython's code for memoryviews. Without it each kernel compiles its own copy, which
# is most of its C.
UTILITIES = "photonrelax._ext._cyutility"
SIMD = EXT / "spatial" / "simd"
SIMD_HEADERS = [str(path) for path in SIMD.glob("*.h")]
SIMD_SOURCES = [*SIMD_HEADERS, *(str(path) for path in SIMD.glob("*.c"))]
# kernels.c is compiled once without and once for each of these sets that the compiler has: a macro
# that it then defines, and flags.
INSTRUCTION_SETS = {
    "AVX2": ("__AVX2__", ["-mavx2", "-mpopcnt", "-mbmi"]),
    "AVX512": (
        "__AVX512VL__",
        ["-mavx512f", "-mavx512bw", "-mavx512dq", "-mavx512vl", "-mpopcnt", "-mbmi"],
    ),
}
SIMD_PROBE = "#if !defined(__x86_64__) || !defined({})\n#error\n#endif\n"


class BuildKernels(build_ext):
    """Build with OpenMP and with the instruction sets that the compiler has."""

    def build_extensions(self):
        openmp = self._openmp_flags()
        for extension in self.extensions:
            # Checks spend most of a kernel's time: compiling matters more.
            optimisation = "-O1" if BOUNDS_CHECK else "-O3"
            extension.extra_compile_args = [*openmp, *FLAGS, optimisation]
            extension.extra_link_args = openmp
        super().build_extensions()

    def build_extension(self, ext):
        if ext.name.endswith(".spatial.tree"):
            ext.depends = SIMD_SOURCES
            ext.extra_objects.append(self._simd_object("PORTABLE", []))
            for name, (macro, flags) in INSTRUCTION_SETS.items():
                if self._can_build(SIMD_PROBE.format(macro), flags):
                    ext.extra_objects.append(self._simd_object(name, flags))
                    ext.define_macros.append((f"HAVE_{name}", None))
        super().build_extension(ext)

    def _openmp_flags(self):
        if WANT_OPENMP and self._can_build(OPENMP_PROBE, OPENMP, link=True):
            return OPENMP
        why = "the compiler cannot link it" if WANT_OPENMP else "PHOTONRELAX_OPENMP=0"
        self.warn(f"photonrelax is built WITHOUT OpenMP ({why}): kernels will use one thread")
        return []

    def _can_build(self, source, flags, *, link=False):
        with tempfile.TemporaryDirectory() as folder:
            probe = Path(folder, "probe.c")
            probe.write_text(source)
            try:
                objects = self.compiler.compile(
                    [str(probe)], output_dir=folder, extra_postargs=flags
                )
                if link:
                    self.compiler.link_executable(
                        objects, str(Path(folder, "probe")), extra_postargs=flags
                    )
            except (CompileError, LinkError):
                return False
        return True

    def _simd_object(self, name, flags):
        """Compile kernels.c with the flags of an instruction set; return the object's path."""
        source, folder = SIMD / "kernels.c", Path(self.build_temp, name.lower())
        target = folder / source.with_suffix(".o")
        if self.force or newer_group(SIMD_SOURCES, str(target)):
            self.compiler.compile(
                [str(source)],
                output_dir=str(folder),
                macros=[(f"SIMD_{name}", None)],
                extra_postargs=[*FLAGS, "-O3", *flags],
            )
        return str(target)


def extensions():
    """One extension per ``.pyx`` below ``_ext``, and the code of Cython that they share."""
    utilities = Extension(UTILITIES, [UTILITIES.replace(".", "/") + ".c"])
    kernels = [
        Extension(
            ".".join(kernel.relative_to("src").with_suffix("").parts),
            [str(kernel)],
            include_dirs=[str(SIMD)],
            depends=SIMD_HEADERS,
        )
        for kernel in sorted(EXT.rglob("*.pyx"))
    ]
    return [utilities, *kernels]


# Processes that Cython starts may import this file.
if __name__ == "__main__":
    setup(
        cmdclass={"build_ext": BuildKernels},
        options={"build": {"build_base": BUILD_DIR}, "build_ext": {"parallel": os.cpu_count()}},
        ext_modules=cythonize(
            extensions(),
            build_dir=BUILD_DIR,
            shared_utility_qualified_name=UTILITIES,
            nthreads=os.cpu_count(),
            cache="CYTHON_CACHE_DIR" in os.environ,
            compiler_directives={
                "language_level": 3,
                "boundscheck": BOUNDS_CHECK,
                "wraparound": False,
                "initializedcheck": False,
                "cdivision": True,
            },
        ),
    )
