//! Bundles of sixteen numbers for x86-64 processors with AVX-512 (F, DQ and VL).
//!
//! The types are private: only [`run`] brings them into being, after the processor was asked, and every method is inlined into it.
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

/// Calls intrinsics of AVX-512.
macro_rules! avx512 {
    ($call:expr) => {{
        // SAFETY: bundles exist only inside `run_avx512`, which runs only on processors with these features; no pointer is involved.
        unsafe { $call }
    }};
}

#[derive(Clone, Copy)]
struct F32x16(__m512);

/// Elements 0 to 7, and 8 to 15.
#[derive(Clone, Copy)]
struct F64x16(__m512d, __m512d);

/// One bit an element.
#[derive(Clone, Copy)]
struct Mask(__mmask16);

impl Sealed for F32x16 {}
impl Sealed for F64x16 {}

macro_rules! operators {
    ($($trait:ident $method:ident $single:ident $double:ident;)*) => {$(
        impl $trait for F32x16 {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(avx512!($single(self.0, other.0)))
            }
        }

        impl $trait for F64x16 {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(avx512!($double(self.0, other.0)), avx512!($double(self.1, other.1)))
            }
        }
    )*};
}

operators! {
    Add add _mm512_add_ps _mm512_add_pd;
    Sub sub _mm512_sub_ps _mm512_sub_pd;
    Mul mul _mm512_mul_ps _mm512_mul_pd;
    Div div _mm512_div_ps _mm512_div_pd;
}

impl Neg for F32x16 {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self(avx512!(_mm512_xor_ps(self.0, _mm512_set1_ps(-0.0))))
    }
}

impl Neg for F64x16 {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        let sign = avx512!(_mm512_set1_pd(-0.0));
        Self(avx512!(_mm512_xor_pd(self.0, sign)), avx512!(_mm512_xor_pd(self.1, sign)))
    }
}

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

impl Arithmetic for F32x16 {
    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self(avx512!(_mm512_set1_ps(value as f32)))
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        Self(avx512!(_mm512_fmadd_ps(self.0, factor.0, term.0)))
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(avx512!(_mm512_sqrt_ps(self.0)))
    }
}

impl Arithmetic for F64x16 {
    #[inline(always)]
    fn splat(value: f64) -> Self {
        let value = avx512!(_mm512_set1_pd(value));
        Self(value, value)
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        Self(avx512!(_mm512_fmadd_pd(self.0, factor.0, term.0)), avx512!(_mm512_fmadd_pd(self.1, factor.1, term.1)))
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(avx512!(_mm512_sqrt_pd(self.0)), avx512!(_mm512_sqrt_pd(self.1)))
    }
}

impl Wide for F64x16 {
    #[inline(always)]
    fn load(values: &[f64]) -> Self {
        let all = first::<_, 16>(values);
        // SAFETY: `all` holds sixteen values; the features are those of `run_avx512`.
        unsafe { Self(_mm512_loadu_pd(all.as_ptr()), _mm512_loadu_pd(all.as_ptr().add(8))) }
    }

    #[inline(always)]
    fn sum(self) -> f64 {
        let mut eight = [0.0; 8];
        // SAFETY: `eight` has room for eight values; the features are those of `run_avx512`.
        unsafe { _mm512_storeu_pd(eight.as_mut_ptr(), _mm512_add_pd(self.0, self.1)) };
        let four: [f64; 4] = std::array::from_fn(|i| eight[i] + eight[i + 4]);
        (four[0] + four[2]) + (four[1] + four[3])
    }
}

/// `2^exponent` for integers from -127 (which gives 0) to 128 (infinity).
#[inline(always)]
fn power_of_two(exponent: __m512i) -> F32x16 {
    let biased = avx512!(_mm512_add_epi32(exponent, _mm512_set1_epi32(127)));
    F32x16(avx512!(_mm512_castsi512_ps(_mm512_slli_epi32::<23>(biased))))
}

impl Exponents for F32x16 {
    #[inline(always)]
    fn round(self) -> Self {
        const NEAREST: i32 = _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC;
        Self(avx512!(_mm512_roundscale_ps::<NEAREST>(self.0)))
    }

    #[inline(always)]
    fn power_of_two(self) -> Self {
        power_of_two(avx512!(_mm512_cvtps_epi32(self.0)))
    }

    #[inline(always)]
    fn scale(self, exponent: Self) -> Self {
        Self(avx512!(_mm512_scalef_ps(self.0, exponent.0)))
    }

    #[inline(always)]
    fn split(self) -> (Self, Self) {
        let bits = avx512!(_mm512_castps_si512(self.0));
        let exponent = avx512!(_mm512_srai_epi32::<23>(_mm512_sub_epi32(bits, _mm512_set1_epi32(SQRT_HALF))));
        let mantissa = avx512!(_mm512_sub_epi32(bits, _mm512_slli_epi32::<23>(exponent)));
        (Self(avx512!(_mm512_cvtepi32_ps(exponent))), Self(avx512!(_mm512_castsi512_ps(mantissa))))
    }
}

impl Lanes for F32x16 {
    type Scalar = f32;
    type Wide = F64x16;
    type Mask = Mask;
    const LANES: usize = 16;
    const NORMAL_RANGE: [f64; 2] = f32::NORMAL_RANGE;

    #[inline(always)]
    fn load(values: &[f32]) -> Self {
        let all = first::<_, 16>(values);
        // SAFETY: `all` holds sixteen values; the features are those of `run_avx512`.
        Self(unsafe { _mm512_loadu_ps(all.as_ptr()) })
    }

    #[inline(always)]
    fn load_f32(values: &[f32]) -> Self {
        Self::load(values)
    }

    #[inline(always)]
    fn prefetch(values: &[f32]) {
        // SAFETY: a prefetch reads nothing that the program sees, whatever the address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(values.as_ptr().cast()) };
    }

    #[inline(always)]
    fn store(self, values: &mut [f32]) {
        let mut all = [0.0; 16];
        // SAFETY: `all` has room for sixteen values; the features are those of `run_avx512`.
        unsafe { _mm512_storeu_ps(all.as_mut_ptr(), self.0) };
        match values.first_chunk_mut::<16>() {
            Some(values) => *values = all,
            None => values.copy_from_slice(&all[..values.len()]),
        }
    }

    #[inline(always)]
    fn widen(self) -> F64x16 {
        F64x16(
            avx512!(_mm512_cvtps_pd(_mm512_castps512_ps256(self.0))),
            avx512!(_mm512_cvtps_pd(_mm512_extractf32x8_ps::<1>(self.0))),
        )
    }

    #[inline(always)]
    fn narrow(wide: F64x16) -> Self {
        let low = avx512!(_mm512_castps256_ps512(_mm512_cvtpd_ps(wide.0)));
        Self(avx512!(_mm512_insertf32x8::<1>(low, _mm512_cvtpd_ps(wide.1))))
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(avx512!(_mm512_max_ps(self.0, other.0)))
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(avx512!(_mm512_min_ps(self.0, other.0)))
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Self(avx512!(_mm512_abs_ps(self.0)))
    }

    #[inline(always)]
    fn gt(self, other: Self) -> Mask {
        Mask(avx512!(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(self.0, other.0)))
    }

    #[inline(always)]
    fn ge(self, other: Self) -> Mask {
        Mask(avx512!(_mm512_cmp_ps_mask::<_CMP_GE_OQ>(self.0, other.0)))
    }

    #[inline(always)]
    fn bits_set(bytes: &[u8], bit: u32) -> Mask {
        let all = first::<_, 16>(bytes);
        // SAFETY: `all` holds sixteen bytes; the features are those of `run_avx512`.
        let wide = unsafe { _mm512_cvtepu8_epi32(_mm_loadu_si128(all.as_ptr().cast())) };
        Mask(avx512!(_mm512_test_epi32_mask(wide, _mm512_set1_epi32(1 << bit))))
    }

    #[inline(always)]
    fn select(mask: Mask, yes: Self, no: Self) -> Self {
        Self(avx512!(_mm512_mask_blend_ps(mask.0, no.0, yes.0)))
    }

    #[inline(always)]
    fn any(mask: Mask) -> bool {
        mask.0 != 0
    }

    #[inline(always)]
    fn exp2(self) -> Self {
        powers::exp2(self)
    }

    #[inline(always)]
    fn log2(self) -> Self {
        powers::log2(self)
    }

    #[inline(always)]
    fn pow_normal(self, exponent: f64) -> Self {
        powers::pow_normal(self, exponent)
    }
}
