//! Bundles of sixteen numbers for x86-64 processors with AVX-512 (F, DQ and VL).
//!
//! Only [`run`] brings the types into being, after the processor was asked.
#![allow(unsafe_code)]

use std::arch::x86_64::*;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

use super::powers::{self, Exponents, SQRT_HALF};
use super::{Arithmetic, Kernel, Lanes, Sealed, Wide, first};

/// Runs `kernel` on bundles of sixteen, or gives it back where the processor cannot.
#[inline]
pub(super) fn run<K: Kernel<f32>>(kernel: K) -> Result<K::Output, K> {
    let foundation = is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512dq");
    if foundation && is_x86_feature_detected!("avx512vl") && is_x86_feature_detected!("fma") {
        // SAFETY: the processor has all these features.
        Ok(unsafe { run_avx512(kernel) })
    } else {
        Err(kernel)
    }
}

#[target_feature(enable = "avx512f,avx512dq,avx512vl,fma")]
fn run_avx512<K: Kernel<f32>>(kernel: K) -> K::Output {
    kernel.run::<F32x16>()
}

/// One bit an element.
#[derive(Clone, Copy)]
struct Mask(__mmask16);

impl BitAnd for Mask {
    type Output = Self;

    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }
}

impl BitOr for Mask {
    type Output = Self;

    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl Not for Mask {
    type Output = Self;

    #[inline(always)]
    fn not(self) -> Self {
        Self(!self.0)
    }
}

bundles! {
    16 elements;
    single F32x16(__m512) {
        _mm512_add_ps, _mm512_sub_ps, _mm512_mul_ps, _mm512_div_ps, _mm512_xor_ps,
        _mm512_set1_ps, _mm512_fmadd_ps, _mm512_sqrt_ps, _mm512_max_ps, _mm512_min_ps,
        _mm512_loadu_ps, _mm512_storeu_ps
    }
    double F64x16(__m512d) {
        _mm512_add_pd, _mm512_sub_pd, _mm512_mul_pd, _mm512_div_pd, _mm512_xor_pd,
        _mm512_set1_pd, _mm512_fmadd_pd, _mm512_sqrt_pd, _mm512_loadu_pd
    }
    whole(__m512i) {
        _mm512_add_epi32, _mm512_sub_epi32, _mm512_set1_epi32, _mm512_slli_epi32, _mm512_srai_epi32,
        _mm512_castps_si512, _mm512_castsi512_ps, _mm512_cvtps_epi32, _mm512_cvtepi32_ps
    }
    impl Wide {
        #[inline(always)]
        fn sum(self) -> f64 {
            let mut eight = [0.0; 8];
            // SAFETY: `eight` has room for eight values; the features are those of `run_avx512`.
            unsafe { _mm512_storeu_pd(eight.as_mut_ptr(), _mm512_add_pd(self.0, self.1)) };
            let four: [f64; 4] = std::array::from_fn(|i| eight[i] + eight[i + 4]);
            (four[0] + four[2]) + (four[1] + four[3])
        }
    }
    impl Exponents {
        #[inline(always)]
        fn round(self) -> Self {
            const NEAREST: i32 = _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC;
            Self(intrinsic!(_mm512_roundscale_ps::<NEAREST>(self.0)))
        }

        #[inline(always)]
        fn scale(self, exponent: Self) -> Self {
            Self(intrinsic!(_mm512_scalef_ps(self.0, exponent.0)))
        }
    }
    impl Lanes {
        #[inline(always)]
        fn widen(self) -> F64x16 {
            F64x16(
                intrinsic!(_mm512_cvtps_pd(_mm512_castps512_ps256(self.0))),
                intrinsic!(_mm512_cvtps_pd(_mm512_extractf32x8_ps::<1>(self.0))),
            )
        }

        #[inline(always)]
        fn narrow(wide: F64x16) -> Self {
            let low = intrinsic!(_mm512_castps256_ps512(_mm512_cvtpd_ps(wide.0)));
            Self(intrinsic!(_mm512_insertf32x8::<1>(low, _mm512_cvtpd_ps(wide.1))))
        }

        #[inline(always)]
        fn abs(self) -> Self {
            Self(intrinsic!(_mm512_abs_ps(self.0)))
        }

        #[inline(always)]
        fn gt(self, other: Self) -> Mask {
            Mask(intrinsic!(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(self.0, other.0)))
        }

        #[inline(always)]
        fn ge(self, other: Self) -> Mask {
            Mask(intrinsic!(_mm512_cmp_ps_mask::<_CMP_GE_OQ>(self.0, other.0)))
        }

        #[inline(always)]
        fn bits_set(bytes: &[u8], bit: u32) -> Mask {
            let all = first::<_, 16>(bytes);
            // SAFETY: `all` holds sixteen bytes; the features are those of `run_avx512`.
            let wide = unsafe { _mm512_cvtepu8_epi32(_mm_loadu_si128(all.as_ptr().cast())) };
            Mask(intrinsic!(_mm512_test_epi32_mask(wide, _mm512_set1_epi32(1 << bit))))
        }

        #[inline(always)]
        fn select(mask: Mask, yes: Self, no: Self) -> Self {
            Self(intrinsic!(_mm512_mask_blend_ps(mask.0, no.0, yes.0)))
        }

        #[inline(always)]
        fn any(mask: Mask) -> bool {
            mask.0 != 0
        }
    }
}
