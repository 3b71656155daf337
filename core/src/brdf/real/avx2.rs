//! Bundles of eight numbers for x86-64 processors with AVX2 and FMA.
//!
//! The types are private: only [`run`] brings them into being, after the processor was asked, and every method is inlined into it.
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

/// Calls intrinsics of AVX2 and FMA.
macro_rules! avx2 {
    ($call:expr) => {{
        // SAFETY: bundles exist only inside `run_avx2`, which runs only on processors with AVX2 and FMA; no pointer is involved.
        unsafe { $call }
    }};
}

#[derive(Clone, Copy)]
struct F32x8(__m256);

/// Elements 0 to 3, and 4 to 7.
#[derive(Clone, Copy)]
struct F64x8(__m256d, __m256d);

/// All bits of an element are set, or none.
#[derive(Clone, Copy)]
struct Mask(__m256);

impl Sealed for F32x8 {}
impl Sealed for F64x8 {}

macro_rules! operators {
    ($($trait:ident $method:ident $single:ident $double:ident;)*) => {$(
        impl $trait for F32x8 {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(avx2!($single(self.0, other.0)))
            }
        }

        impl $trait for F64x8 {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(avx2!($double(self.0, other.0)), avx2!($double(self.1, other.1)))
            }
        }
    )*};
}

operators! {
    Add add _mm256_add_ps _mm256_add_pd;
    Sub sub _mm256_sub_ps _mm256_sub_pd;
    Mul mul _mm256_mul_ps _mm256_mul_pd;
    Div div _mm256_div_ps _mm256_div_pd;
}

impl Neg for F32x8 {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self(avx2!(_mm256_xor_ps(self.0, _mm256_set1_ps(-0.0))))
    }
}

impl Neg for F64x8 {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        let sign = avx2!(_mm256_set1_pd(-0.0));
        Self(avx2!(_mm256_xor_pd(self.0, sign)), avx2!(_mm256_xor_pd(self.1, sign)))
    }
}

impl BitAnd for Mask {
    type Output = Self;

    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Self(avx2!(_mm256_and_ps(self.0, other.0)))
    }
}

impl BitOr for Mask {
    type Output = Self;

    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        Self(avx2!(_mm256_or_ps(self.0, other.0)))
    }
}

impl Not for Mask {
    type Output = Self;

    #[inline(always)]
    fn not(self) -> Self {
        Self(avx2!(_mm256_xor_ps(self.0, _mm256_castsi256_ps(_mm256_set1_epi32(-1)))))
    }
}

impl Arithmetic for F32x8 {
    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self(avx2!(_mm256_set1_ps(value as f32)))
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        Self(avx2!(_mm256_fmadd_ps(self.0, factor.0, term.0)))
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(avx2!(_mm256_sqrt_ps(self.0)))
    }
}

impl Arithmetic for F64x8 {
    #[inline(always)]
    fn splat(value: f64) -> Self {
        let value = avx2!(_mm256_set1_pd(value));
        Self(value, value)
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, term: Self) -> Self {
        Self(avx2!(_mm256_fmadd_pd(self.0, factor.0, term.0)), avx2!(_mm256_fmadd_pd(self.1, factor.1, term.1)))
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(avx2!(_mm256_sqrt_pd(self.0)), avx2!(_mm256_sqrt_pd(self.1)))
    }
}

impl Wide for F64x8 {
    #[inline(always)]
    fn load(values: &[f64]) -> Self {
        let eight = first::<_, 8>(values);
        // SAFETY: `eight` holds eight values; the features are those of `run_avx2`.
        unsafe { Self(_mm256_loadu_pd(eight.as_ptr()), _mm256_loadu_pd(eight.as_ptr().add(4))) }
    }

    #[inline(always)]
    fn sum(self) -> f64 {
        let mut four = [0.0; 4];
        // SAFETY: `four` has room for four values; the features are those of `run_avx2`.
        unsafe { _mm256_storeu_pd(four.as_mut_ptr(), _mm256_add_pd(self.0, self.1)) };
        (four[0] + four[2]) + (four[1] + four[3])
    }
}

/// `2^exponent` for integers from -127 (which gives 0) to 128 (infinity).
#[inline(always)]
fn power_of_two(exponent: __m256i) -> F32x8 {
    let biased = avx2!(_mm256_add_epi32(exponent, _mm256_set1_epi32(127)));
    F32x8(avx2!(_mm256_castsi256_ps(_mm256_slli_epi32::<23>(biased))))
}

impl Exponents for F32x8 {
    #[inline(always)]
    fn round(self) -> Self {
        Self(avx2!(_mm256_round_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(self.0)))
    }

    #[inline(always)]
    fn power_of_two(self) -> Self {
        power_of_two(avx2!(_mm256_cvtps_epi32(self.0)))
    }

    #[inline(always)]
    fn scale(self, exponent: Self) -> Self {
        // Two steps, because one factor reaches neither the ends of the range nor beyond.
        let exponent = avx2!(_mm256_cvtps_epi32(exponent.0));
        let half = avx2!(_mm256_srai_epi32::<1>(exponent));
        let rest = avx2!(_mm256_sub_epi32(exponent, half));
        self * power_of_two(half) * power_of_two(rest)
    }

    #[inline(always)]
    fn split(self) -> (Self, Self) {
        let bits = avx2!(_mm256_castps_si256(self.0));
        let exponent = avx2!(_mm256_srai_epi32::<23>(_mm256_sub_epi32(bits, _mm256_set1_epi32(SQRT_HALF))));
        let mantissa = avx2!(_mm256_sub_epi32(bits, _mm256_slli_epi32::<23>(exponent)));
        (Self(avx2!(_mm256_cvtepi32_ps(exponent))), Self(avx2!(_mm256_castsi256_ps(mantissa))))
    }
}

impl Lanes for F32x8 {
    type Scalar = f32;
    type Wide = F64x8;
    type Mask = Mask;
    const LANES: usize = 8;
    const NORMAL_RANGE: [f64; 2] = f32::NORMAL_RANGE;

    #[inline(always)]
    fn load(values: &[f32]) -> Self {
        let eight = first::<_, 8>(values);
        // SAFETY: `eight` holds eight values; the features are those of `run_avx2`.
        Self(unsafe { _mm256_loadu_ps(eight.as_ptr()) })
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
        let mut eight = [0.0; 8];
        // SAFETY: `eight` has room for eight values; the features are those of `run_avx2`.
        unsafe { _mm256_storeu_ps(eight.as_mut_ptr(), self.0) };
        match values.first_chunk_mut::<8>() {
            Some(values) => *values = eight,
            None => values.copy_from_slice(&eight[..values.len()]),
        }
    }

    #[inline(always)]
    fn widen(self) -> F64x8 {
        F64x8(
            avx2!(_mm256_cvtps_pd(_mm256_castps256_ps128(self.0))),
            avx2!(_mm256_cvtps_pd(_mm256_extractf128_ps::<1>(self.0))),
        )
    }

    #[inline(always)]
    fn narrow(wide: F64x8) -> Self {
        Self(avx2!(_mm256_set_m128(_mm256_cvtpd_ps(wide.1), _mm256_cvtpd_ps(wide.0))))
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(avx2!(_mm256_max_ps(self.0, other.0)))
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(avx2!(_mm256_min_ps(self.0, other.0)))
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Self(avx2!(_mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0)))
    }

    #[inline(always)]
    fn gt(self, other: Self) -> Mask {
        Mask(avx2!(_mm256_cmp_ps::<_CMP_GT_OQ>(self.0, other.0)))
    }

    #[inline(always)]
    fn ge(self, other: Self) -> Mask {
        Mask(avx2!(_mm256_cmp_ps::<_CMP_GE_OQ>(self.0, other.0)))
    }

    #[inline(always)]
    fn bits_set(bytes: &[u8], bit: u32) -> Mask {
        let bytes = i64::from_le_bytes(first(bytes)) >> bit;
        let ones = avx2!(_mm256_set1_epi32(1));
        let set = avx2!(_mm256_and_si256(_mm256_cvtepu8_epi32(_mm_cvtsi64_si128(bytes)), ones));
        Mask(avx2!(_mm256_castsi256_ps(_mm256_cmpeq_epi32(set, ones))))
    }

    #[inline(always)]
    fn select(mask: Mask, yes: Self, no: Self) -> Self {
        Self(avx2!(_mm256_blendv_ps(no.0, yes.0, mask.0)))
    }

    #[inline(always)]
    fn any(mask: Mask) -> bool {
        avx2!(_mm256_movemask_ps(mask.0)) != 0
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
