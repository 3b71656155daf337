//! Bundles of eight numbers for x86-64 processors with AVX2 and FMA.
//!
//! Only [`run`] brings the types into being, after the processor was asked.
#![allow(unsafe_code)]

use std::arch::x86_64::*;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

use super::powers::{self, Exponents, SQRT_HALF};
use super::{Arithmetic, Kernel, Lanes, Sealed, Wide, first};

/// Runs `kernel` on bundles of eight, or gives it back where the processor cannot.
#[inline]
pub(super) fn run<K: Kernel<f32>>(kernel: K) -> Result<K::Output, K> {
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        // SAFETY: the processor has both features.
        Ok(unsafe { run_avx2(kernel) })
    } else {
        Err(kernel)
    }
}

#[target_feature(enable = "avx2,fma")]
fn run_avx2<K: Kernel<f32>>(kernel: K) -> K::Output {
    kernel.run::<F32x8>()
}

/// All bits of an element are set, or none.
#[derive(Clone, Copy)]
struct Mask(__m256);

impl BitAnd for Mask {
    type Output = Self;

    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Self(intrinsic!(_mm256_and_ps(self.0, other.0)))
    }
}

impl BitOr for Mask {
    type Output = Self;

    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        Self(intrinsic!(_mm256_or_ps(self.0, other.0)))
    }
}

impl Not for Mask {
    type Output = Self;

    #[inline(always)]
    fn not(self) -> Self {
        Self(intrinsic!(_mm256_xor_ps(self.0, _mm256_castsi256_ps(_mm256_set1_epi32(-1)))))
    }
}

bundles! {
    8 elements;
    single F32x8(__m256) {
        _mm256_add_ps, _mm256_sub_ps, _mm256_mul_ps, _mm256_div_ps, _mm256_xor_ps,
        _mm256_set1_ps, _mm256_fmadd_ps, _mm256_sqrt_ps, _mm256_max_ps, _mm256_min_ps,
        _mm256_loadu_ps, _mm256_storeu_ps
    }
    double F64x8(__m256d) {
        _mm256_add_pd, _mm256_sub_pd, _mm256_mul_pd, _mm256_div_pd, _mm256_xor_pd,
        _mm256_set1_pd, _mm256_fmadd_pd, _mm256_sqrt_pd, _mm256_loadu_pd
    }
    whole(__m256i) {
        _mm256_add_epi32, _mm256_sub_epi32, _mm256_set1_epi32, _mm256_slli_epi32, _mm256_srai_epi32,
        _mm256_castps_si256, _mm256_castsi256_ps, _mm256_cvtps_epi32, _mm256_cvtepi32_ps
    }
    impl Wide {
        #[inline(always)]
        fn sum(self) -> f64 {
            let mut four = [0.0; 4];
            // SAFETY: `four` has room for four values; the features are those of `run_avx2`.
            unsafe { _mm256_storeu_pd(four.as_mut_ptr(), _mm256_add_pd(self.0, self.1)) };
            (four[0] + four[2]) + (four[1] + four[3])
        }
    }
    impl Exponents {
        #[inline(always)]
        fn round(self) -> Self {
            Self(intrinsic!(_mm256_round_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(self.0)))
        }

        #[inline(always)]
        fn scale(self, exponent: Self) -> Self {
            // Two steps, because one factor reaches neither the ends of the range nor beyond.
            let exponent = intrinsic!(_mm256_cvtps_epi32(exponent.0));
            let half = intrinsic!(_mm256_srai_epi32::<1>(exponent));
            let rest = intrinsic!(_mm256_sub_epi32(exponent, half));
            self * power_of_two(half) * power_of_two(rest)
        }
    }
    impl Lanes {
        #[inline(always)]
        fn widen(self) -> F64x8 {
            F64x8(
                intrinsic!(_mm256_cvtps_pd(_mm256_castps256_ps128(self.0))),
                intrinsic!(_mm256_cvtps_pd(_mm256_extractf128_ps::<1>(self.0))),
            )
        }

        #[inline(always)]
        fn narrow(wide: F64x8) -> Self {
            Self(intrinsic!(_mm256_set_m128(_mm256_cvtpd_ps(wide.1), _mm256_cvtpd_ps(wide.0))))
        }

        #[inline(always)]
        fn abs(self) -> Self {
            Self(intrinsic!(_mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0)))
        }

        #[inline(always)]
        fn gt(self, other: Self) -> Mask {
            Mask(intrinsic!(_mm256_cmp_ps::<_CMP_GT_OQ>(self.0, other.0)))
        }

        #[inline(always)]
        fn ge(self, other: Self) -> Mask {
            Mask(intrinsic!(_mm256_cmp_ps::<_CMP_GE_OQ>(self.0, other.0)))
        }

        #[inline(always)]
        fn bits_set(bytes: &[u8], bit: u32) -> Mask {
            let bytes = i64::from_le_bytes(first(bytes)) >> bit;
            let ones = intrinsic!(_mm256_set1_epi32(1));
            let set = intrinsic!(_mm256_and_si256(_mm256_cvtepu8_epi32(_mm_cvtsi64_si128(bytes)), ones));
            Mask(intrinsic!(_mm256_castsi256_ps(_mm256_cmpeq_epi32(set, ones))))
        }

        #[inline(always)]
        fn select(mask: Mask, yes: Self, no: Self) -> Self {
            Self(intrinsic!(_mm256_blendv_ps(no.0, yes.0, mask.0)))
        }

        #[inline(always)]
        fn any(mask: Mask) -> bool {
            intrinsic!(_mm256_movemask_ps(mask.0)) != 0
        }
    }
}
