/* Vectors of eight doubles, f64x8, and of sixteen floats, f32x16, in one instruction set.
 *
 * Each header defines both types, their masks, mask8 and mask16, and the same functions. All
 * operations are exact or correctly rounded, and f64x8_sum adds in one order, so that all
 * instruction sets give the same bits.
 */
#ifndef PHOTONRELAX_SIMD_VECTOR_H
#define PHOTONRELAX_SIMD_VECTOR_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "kernels.h"

/* Vectors stay in registers only in functions that are inlined. */
#define INLINE static inline __attribute__((always_inline))

#if defined(SIMD_AVX512)
#include "avx512.h"
#elif defined(SIMD_AVX2)
#include "avx2.h"
#else
#include "portable.h"
#endif

INLINE f64x8 f64x8_abs(f64x8 a) { return f64x8_max(a, f64x8_sub(f64x8_set1(0.0), a)); }

#endif
