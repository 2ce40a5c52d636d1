/* Choice of the SIMD kernels at run time. setup.py says which were compiled. */
#include "kernels.h"

#include <string.h>

extern const SimdKernels simd_kernels_portable;
#if defined(HAVE_AVX2)
extern const SimdKernels simd_kernels_avx2;
#endif
#if defined(HAVE_AVX512)
extern const SimdKernels simd_kernels_avx512;
#endif

/* Kernels that the processor has, widest first; NULL behind the last. */
typedef struct {
    const SimdKernels *kernels[4];
} Available;

static Available available(void)
{
    Available out = {{NULL}};
    int n = 0;
#if defined(HAVE_AVX2) || defined(HAVE_AVX512)
    __builtin_cpu_init();
    const int has_bits = __builtin_cpu_supports("popcnt") && __builtin_cpu_supports("bmi");
#endif
#if defined(HAVE_AVX512)
    if (has_bits && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
        __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
        out.kernels[n++] = &simd_kernels_avx512;
#endif
#if defined(HAVE_AVX2)
    if (has_bits && __builtin_cpu_supports("avx2")) out.kernels[n++] = &simd_kernels_avx2;
#endif
    out.kernels[n] = &simd_kernels_portable;
    return out;
}

const SimdKernels *simd_kernels_named(const char *name)
{
    const Available known = available();
    for (int i = 0; known.kernels[i]; ++i)
        if (name[0] == '\0' || strcmp(name, known.kernels[i]->name) == 0) return known.kernels[i];
    return NULL;
}
