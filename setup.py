"""Build of the compiled kernels; everything else is in pyproject.toml.

Two environment variables change the build:

PHOTONRELAX_BOUNDSCHECK=1
    Kernels check every array access (slow; for tests).
PHOTONRELAX_OPENMP=0
    Build without OpenMP even where the compiler has it: kernels run on one thread.
"""

import os
import tempfile
from pathlib import Path

from Cython.Build import cythonize
from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext
from setuptools.errors import CompileError, LinkError

BOUNDS_CHECK = os.environ.get("PHOTONRELAX_BOUNDSCHECK", "0") == "1"
WANT_OPENMP = os.environ.get("PHOTONRELAX_OPENMP", "1") != "0"
# Kinds of build keep apart: each would take the other's objects for its own, up to date.
BUILD_DIR = "build/" + ("checked" if BOUNDS_CHECK else "plain") + ("" if WANT_OPENMP else "-serial")
OPENMP_FLAGS = {
    "msvc": (["/openmp"], []),
    "unix": (["-fopenmp"], ["-fopenmp"]),
}
# Contraction into fused multiply-adds would make results depend on the processor. Debug symbols
# would make wheels five times as large.
UNIX_FLAGS = ["-O3", "-ffp-contract=off", "-g0"]
PROBE = "#include <omp.h>\nint main(void) { return omp_get_max_threads() < 1; }\n"


class BuildKernels(build_ext):
    """Compile with OpenMP where the compiler has it, and say so where it has not."""

    def build_extensions(self):
        kind = self.compiler.compiler_type
        compile_flags, link_flags = self._openmp_flags(kind)
        for extension in self.extensions:
            extension.extra_compile_args = compile_flags + (UNIX_FLAGS if kind == "unix" else [])
            extension.extra_link_args = link_flags
        super().build_extensions()

    def _openmp_flags(self, kind):
        flags = OPENMP_FLAGS.get(kind, ([], []))
        if WANT_OPENMP and self._can_link(*flags):
            return flags
        why = "the compiler cannot link it" if WANT_OPENMP else "PHOTONRELAX_OPENMP=0"
        self.warn(f"photonrelax is built WITHOUT OpenMP ({why}): kernels will use one thread")
        return [], []

    def _can_link(self, compile_flags, link_flags):
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder, "probe.c")
            source.write_text(PROBE)
            try:
                objects = self.compiler.compile(
                    [str(source)], output_dir=folder, extra_postargs=compile_flags
                )
                self.compiler.link_executable(
                    objects, str(Path(folder, "probe")), extra_postargs=link_flags
                )
            except (CompileError, LinkError):
                return False
        return True


def kernels():
    """One extension per ``.pyx`` below ``_ext``."""
    source = Path("src")
    folder = source / "photonrelax" / "_ext"
    simd = folder / "spatial" / "simd"
    return [
        Extension(
            ".".join(kernel.relative_to(source).with_suffix("").parts),
            [str(kernel)],
            include_dirs=[str(simd)],
            depends=[str(header) for header in simd.glob("*.h")],
        )
        for kernel in sorted(folder.rglob("*.pyx"))
    ]


setup(
    cmdclass={"build_ext": BuildKernels},
    options={"build": {"build_base": BUILD_DIR}, "build_ext": {"parallel": os.cpu_count()}},
    ext_modules=cythonize(
        kernels(),
        build_dir=BUILD_DIR,
        nthreads=os.cpu_count(),
        compiler_directives={
            "language_level": 3,
            "boundscheck": BOUNDS_CHECK,
            "wraparound": False,
            "initializedcheck": False,
            "cdivision": True,
        },
    ),
)
