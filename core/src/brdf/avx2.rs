//! Bundles of eight numbers for x86-64 processors with AVX2 and FMA.
//!
//! The types are private: only [`run`] brings them into being, after the processor was asked, and every method is inlined into it.
#![allow(unsafe_code)]

use std::arch::x86_64::*;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

use super::real::{Arithmetic, Kernel, Lanes, Sealed, Wide};

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

/// The first eight of `values`, filled up with `T::default()`.
#[inline(always)]
fn first_eight<T: Copy + Default>(values: &[T]) -> [T; 8] {
    match values.first_chunk::<8>() {
        Some(eight) => *eight,
        None => std::array::from_fn(|i| values.get(i).copied().unwrap_or_default()),
    }
}

impl Wide for F64x8 {
    #[inline(always)]
    fn load(values: &[f64]) -> Self {
        let eight = first_eight(values);
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

impl F32x8 {
    /// `2^exponent` for integers from -127 (which gives 0) to 128 (infinity).
    #[inline(always)]
    fn power_of_two(exponent: __m256i) -> Self {
        let biased = avx2!(_mm256_add_epi32(exponent, _mm256_set1_epi32(127)));
        Self(avx2!(_mm256_castsi256_ps(_mm256_slli_epi32::<23>(biased))))
    }

    /// `self * 2^exponent` for integers from -252 to 254, with gradual underflow.
    #[inline(always)]
    fn scale(self, exponent: __m256i) -> Self {
        // Two steps, because one factor reaches neither the ends of the range nor beyond.
        let half = avx2!(_mm256_srai_epi32::<1>(exponent));
        let rest = avx2!(_mm256_sub_epi32(exponent, half));
        self * Self::power_of_two(half) * Self::power_of_two(rest)
    }

    /// `slope * self + offset`.
    #[inline(always)]
    fn line(self, slope: f64, offset: f64) -> Self {
        self.mul_add(Self::splat(slope), Self::splat(offset))
    }

    #[inline(always)]
    fn round(self) -> Self {
        Self(avx2!(_mm256_round_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(self.0)))
    }

    /// `2^x` for `x` in [-0.5, 0.5].
    #[inline(always)]
    fn exp2_near_zero(self) -> Self {
        // Minimax fit, relative error 2e-9.
        let x2 = self * self;
        let low = self.line(6.931_472_057_374_309e-1, 1.0);
        let middle = self.line(5.550_328_776_609_117e-2, 2.402_264_689_061_157_4e-1);
        let high = self.line(1.339_993_136_355_667_5e-3, 9.618_488_958_207_992e-3);
        let top = Self::splat(1.534_581_205_748_890_5e-4);
        x2.mul_add(top, high).mul_add(x2, middle).mul_add(x2, low)
    }

    /// Exponent and base-2 logarithm of the mantissa, which is taken from [sqrt(0.5), sqrt(2)).
    #[inline(always)]
    fn log2_split(self) -> (Self, Self) {
        const SQRT_HALF: i32 = 0x3f35_04f3;
        let bits = avx2!(_mm256_castps_si256(self.0));
        let exponent = avx2!(_mm256_srai_epi32::<23>(_mm256_sub_epi32(bits, _mm256_set1_epi32(SQRT_HALF))));
        let mantissa = Self(avx2!(_mm256_castsi256_ps(_mm256_sub_epi32(bits, _mm256_slli_epi32::<23>(exponent)))));
        let excess = mantissa - Self::splat(1.0);
        // Minimax fit of log2(1 + x) / x over the mantissas' range, relative error 3e-8.
        let x2 = excess * excess;
        let x4 = x2 * x2;
        let lowest = excess.line(-7.213_473_468_007_872e-1, 1.442_695_003_652_135_8);
        let low = excess.line(-3.607_036_830_925_409e-1, 4.809_106_430_163_323e-1);
        let high = excess.line(-2.389_448_129_596_26e-1, 2.879_162_456_599_158e-1);
        let highest = excess.line(-2.072_698_179_049_967e-1, 2.157_156_238_685_305_8e-1);
        let top = Self::splat(1.258_370_589_772_112e-1);
        let polynomial = x4.mul_add(top, x2.mul_add(highest, high)).mul_add(x4, x2.mul_add(low, lowest));
        (Self(avx2!(_mm256_cvtepi32_ps(exponent))), excess * polynomial)
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
        let eight = first_eight(values);
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
        let bytes = i64::from_le_bytes(first_eight(bytes)) >> bit;
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
        let limit = Self::splat(160.0);
        // NaN passes: min and max give their second operand where one is NaN.
        let exponent = (-limit).max(limit.min(self));
        let whole = exponent.round();
        (exponent - whole).exp2_near_zero().scale(avx2!(_mm256_cvtps_epi32(whole.0)))
    }

    #[inline(always)]
    fn log2(self) -> Self {
        let (exponent, mantissa) = self.log2_split();
        exponent + mantissa
    }

    #[inline(always)]
    fn pow_normal(self, exponent: f64) -> Self {
        // The exponent's leading bits times a float's exponent are exact.
        let leading = f64::from(f32::from_bits((exponent as f32).to_bits() & !0xfff));
        let (self_exponent, self_mantissa) = self.log2_split();
        let small = self_exponent.mul_add(Self::splat(exponent - leading), self_mantissa * Self::splat(exponent));
        let whole = self_exponent.mul_add(Self::splat(leading), small).round();
        let rest = self_exponent.mul_add(Self::splat(leading), -whole) + small;
        let value = rest.exp2_near_zero();
        if exponent.abs() < 0.98 {
            // No power of a normal number leaves the normal range.
            return value * Self::power_of_two(avx2!(_mm256_cvtps_epi32(whole.0)));
        }
        let limit = Self::splat(250.0);
        let whole = (-limit).max(limit.min(whole));
        value.scale(avx2!(_mm256_cvtps_epi32(whole.0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Applies a function to every value of a slice, in bundles.
    struct Apply<'a> {
        function: Function,
        values: &'a mut [f32],
    }

    #[derive(Clone, Copy, Debug)]
    enum Function {
        Exp2,
        Log2,
        Pow(f64),
        Arithmetic,
    }

    impl Kernel<f32> for Apply<'_> {
        type Output = ();

        #[inline(always)]
        fn run<L: Lanes<Scalar = f32>>(self) {
            for values in self.values.chunks_mut(L::LANES) {
                let x = L::load(values);
                let result = match self.function {
                    Function::Exp2 => x.exp2(),
                    Function::Log2 => x.log2(),
                    Function::Pow(exponent) => x.pow(exponent),
                    Function::Arithmetic => arithmetic(x),
                };
                result.store(values);
            }
        }
    }

    /// Every operation whose result must be the scalar's to the last bit.
    #[inline(always)]
    fn arithmetic<L: Lanes>(x: L) -> L {
        let two = L::splat(2.0);
        let y = (x + two) * x - two / (x.abs() + L::splat(0.5)).sqrt();
        let z = L::select(x.gt(y) | !y.ge(two), -y, y).max(L::splat(-3.0)).min(L::splat(1e30));
        let wide = (z.widen() * L::Wide::splat(1.1) + -x.widen()).sqrt();
        L::narrow(wide + x.widen() - L::Wide::splat(0.1))
    }

    fn in_bundles(function: Function, values: &[f32]) -> Option<Vec<f32>> {
        let mut values = values.to_vec();
        run(Apply { function, values: &mut values }).ok().map(|()| values)
    }

    /// Values that fill the range of floats, with their neighbours.
    fn spread(low: f32, high: f32, count: u32) -> Vec<f32> {
        let (low, high) = (u64::from(low.to_bits()), u64::from(high.to_bits()));
        (0..=u64::from(count)).map(|i| f32::from_bits((low + (high - low) * i / u64::from(count)) as u32)).collect()
    }

    #[test]
    fn arithmetic_is_that_of_scalars() {
        let mut values = spread(1e-30, 1e30, 100_000);
        values.extend(values.clone().iter().map(|x| -x));
        values.extend([0.0, -0.0, f32::INFINITY, f32::NEG_INFINITY, f32::NAN]);
        let Some(got) = in_bundles(Function::Arithmetic, &values) else { return };
        for (x, got) in values.into_iter().zip(got) {
            let expected = arithmetic(x);
            assert!(got.to_bits() == expected.to_bits() || got.is_nan() && expected.is_nan(), "{x} {got} {expected}");
        }
    }

    #[test]
    fn loads_fill_up_and_stores_stop() {
        for len in 0..20 {
            let values: Vec<f32> = (0..len).map(|i| i as f32 + 1.0).collect();
            let Some(got) = in_bundles(Function::Exp2, &values) else { return };
            for (x, got) in values.iter().zip(&got) {
                assert_eq!(x.exp2(), *got);
            }
            assert_eq!(got.len(), len);
        }
    }

    struct Bits<'a> {
        bytes: &'a [u8],
        bit: u32,
    }

    impl Kernel<f32> for Bits<'_> {
        type Output = [f32; 8];

        #[inline(always)]
        fn run<L: Lanes<Scalar = f32>>(self) -> [f32; 8] {
            let mut out = [0.0; 8];
            L::select(L::bits_set(self.bytes, self.bit), L::splat(1.0), L::splat(0.0)).store(&mut out);
            out
        }
    }

    #[test]
    fn bits_of_bytes_become_masks() {
        let bytes = [0, 1, 2, 3, 0x80, 0xff, 7, 4];
        for len in 0..=8 {
            for bit in 0..8 {
                let Ok(got) = run(Bits { bytes: &bytes[..len], bit }) else { return };
                let expected: [f32; 8] =
                    std::array::from_fn(|i| if i < len && bytes[i] >> bit & 1 == 1 { 1.0 } else { 0.0 });
                assert_eq!(got, expected);
            }
        }
    }

    #[test]
    fn wide_values_load_and_sum_in_order() {
        struct Sum<'a>(&'a [f64]);
        impl Kernel<f32> for Sum<'_> {
            type Output = f64;
            #[inline(always)]
            fn run<L: Lanes<Scalar = f32>>(self) -> f64 {
                L::Wide::load(self.0).sum()
            }
        }
        let Ok(sum) = run(Sum(&[1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 1e9])) else { return };
        assert_eq!(sum, 255.0);
        assert!(matches!(run(Sum(&[1.0, 2.0, 4.0])), Ok(7.0)));
    }

    /// Largest relative error over `values`, against double precision.
    fn worst(function: Function, values: &[f32], exact: impl Fn(f64) -> f64) -> Option<f64> {
        let got = in_bundles(function, values)?;
        let error = |(&x, got): (&f32, f32)| (f64::from(got) / exact(f64::from(x)) - 1.0).abs();
        Some(values.iter().zip(got).map(error).fold(0.0, f64::max))
    }

    #[test]
    fn powers_are_accurate() {
        let values = spread(1e-30, 1e30, 1_000_000);
        for exponent in [1.0 / 2.2, 0.1, 0.97, 1.2] {
            let Some(worst) = worst(Function::Pow(exponent), &values, |x| x.powf(exponent)) else { return };
            eprintln!("pow {exponent}: {worst:e}");
            assert!(worst < 2e-7 * exponent.max(1.0), "{exponent} {worst:e}");
        }
        // What albedos and roughness are decoded with; above 0 they have to be, here far above the smallest result.
        for exponent in [2.2, 2.4, 7.3] {
            let Some(worst) = worst(Function::Pow(exponent), &spread(1e-5, 1e5, 1_000_000), |x| x.powf(exponent))
            else {
                return;
            };
            eprintln!("pow {exponent}: {worst:e}");
            assert!(worst < 2e-7 * exponent.max(1.0), "{exponent} {worst:e}");
        }
    }

    #[test]
    fn powers_are_right_at_the_ends() {
        let values = [0.0, -0.0, -1.0, 1e-44, f32::INFINITY, 1.0, f32::MIN_POSITIVE, f32::MAX];
        let Some(got) = in_bundles(Function::Pow(2.2), &values) else { return };
        assert_eq!(got, [0.0, 0.0, 0.0, 0.0, f32::INFINITY, 1.0, 0.0, f32::INFINITY]);
        let got = in_bundles(Function::Pow(1.0 / 2.2), &values).unwrap();
        assert_eq!(got[..6], [0.0, 0.0, 0.0, 0.0, f32::INFINITY, 1.0]);
        assert!(in_bundles(Function::Pow(1.5), &[f32::NAN]).unwrap()[0].is_nan());
        // The scalar forms agree.
        for (x, exponent) in values.into_iter().flat_map(|x| [(x, 2.2), (x, 1.0 / 2.2)]) {
            let bundled = in_bundles(Function::Pow(exponent), &[x]).unwrap()[0];
            let scalar = Lanes::pow(x, exponent);
            assert!(bundled == scalar || (bundled / scalar - 1.0).abs() < 2e-7, "{x} {exponent} {bundled} {scalar}");
        }
    }

    #[test]
    fn exponentials_are_accurate() {
        let mut values = spread(1e-30, 127.99, 500_000);
        values.extend(spread(1e-30, 126.0, 500_000).iter().map(|x| -x));
        let Some(worst) = worst(Function::Exp2, &values, f64::exp2) else { return };
        eprintln!("exp2: {worst:e}");
        assert!(worst < 1.5e-7, "{worst:e}");
        let got = in_bundles(Function::Exp2, &[128.0, 1e30, f32::INFINITY, -150.0, -1e30, f32::NEG_INFINITY]).unwrap();
        assert_eq!(got, [f32::INFINITY, f32::INFINITY, f32::INFINITY, 0.0, 0.0, 0.0]);
        assert!(in_bundles(Function::Exp2, &[f32::NAN]).unwrap()[0].is_nan());
        assert_eq!(in_bundles(Function::Exp2, &[-140.0]).unwrap(), [2.0_f32.powi(-140)]);
    }

    #[test]
    fn logarithms_are_accurate() {
        let values = spread(f32::MIN_POSITIVE, f32::MAX, 1_000_000);
        let Some(got) = in_bundles(Function::Log2, &values) else { return };
        for (x, got) in values.into_iter().zip(got) {
            let exact = f64::from(x).log2();
            assert!((f64::from(got) - exact).abs() < (2e-7 * exact.abs()).max(1e-7), "{x} {got} {exact}");
        }
        assert_eq!(in_bundles(Function::Log2, &[1.0]).unwrap(), [0.0]);
    }
}
