//! Exponential, logarithm and power of bundles of single precision, by polynomials and the bits of the exponent.

use super::{Arithmetic, Lanes};

/// What the functions here need of a bundle.
pub(super) trait Exponents: Lanes {
    /// The nearest whole numbers.
    fn round(self) -> Self;

    /// `2^self` for whole numbers from -127 (which gives 0) to 128 (infinity).
    fn power_of_two(self) -> Self;

    /// `self * 2^exponent` for whole exponents from -252 to 254, with gradual underflow.
    fn scale(self, exponent: Self) -> Self;

    /// Exponent and mantissa, which is taken from [sqrt(0.5), sqrt(2)), of positive normal numbers.
    fn split(self) -> (Self, Self);
}

/// The bits of the single precision number sqrt(0.5), where mantissas are cut.
pub(super) const SQRT_HALF: i32 = 0x3f35_04f3;

/// `slope * x + offset`.
#[inline(always)]
fn line<A: Arithmetic>(x: A, slope: f64, offset: f64) -> A {
    x.mul_add(A::splat(slope), A::splat(offset))
}

/// `2^x` for `x` in [-0.5, 0.5].
#[inline(always)]
fn exp2_near_zero<A: Arithmetic>(x: A) -> A {
    // Minimax fit, relative error 2e-9.
    let x2 = x * x;
    let low = line(x, 6.931_472_057_374_309e-1, 1.0);
    let middle = line(x, 5.550_328_776_609_117e-2, 2.402_264_689_061_157_4e-1);
    let high = line(x, 1.339_993_136_355_667_5e-3, 9.618_488_958_207_992e-3);
    let top = A::splat(1.534_581_205_748_890_5e-4);
    x2.mul_add(top, high).mul_add(x2, middle).mul_add(x2, low)
}

/// Exponent and base-2 logarithm of the mantissa, which is taken from [sqrt(0.5), sqrt(2)).
#[inline(always)]
fn log2_split<L: Exponents>(x: L) -> (L, L) {
    let (exponent, mantissa) = x.split();
    let excess = mantissa - L::splat(1.0);
    // Minimax fit of log2(1 + x) / x over the mantissas' range, relative error 3e-8.
    let x2 = excess * excess;
    let x4 = x2 * x2;
    let lowest = line(excess, -7.213_473_468_007_872e-1, 1.442_695_003_652_135_8);
    let low = line(excess, -3.607_036_830_925_409e-1, 4.809_106_430_163_323e-1);
    let high = line(excess, -2.389_448_129_596_26e-1, 2.879_162_456_599_158e-1);
    let highest = line(excess, -2.072_698_179_049_967e-1, 2.157_156_238_685_305_8e-1);
    let top = L::splat(1.258_370_589_772_112e-1);
    let polynomial = x4.mul_add(top, x2.mul_add(highest, high)).mul_add(x4, x2.mul_add(low, lowest));
    (exponent, excess * polynomial)
}

/// See [`Lanes::exp2`].
#[inline(always)]
pub(super) fn exp2<L: Exponents>(x: L) -> L {
    let limit = L::splat(160.0);
    // NaN passes: min and max give their second operand where one is NaN.
    let exponent = (-limit).max(limit.min(x));
    let whole = exponent.round();
    exp2_near_zero(exponent - whole).scale(whole)
}

/// See [`Lanes::log2`].
#[inline(always)]
pub(super) fn log2<L: Exponents>(x: L) -> L {
    let (exponent, mantissa) = log2_split(x);
    exponent + mantissa
}

/// See [`Lanes::pow_normal`].
#[inline(always)]
pub(super) fn pow_normal<L: Exponents>(x: L, exponent: f64) -> L {
    // The exponent's leading bits times a float's exponent are exact.
    let leading = f64::from(f32::from_bits((exponent as f32).to_bits() & !0xfff));
    let (own_exponent, mantissa) = log2_split(x);
    let small = own_exponent.mul_add(L::splat(exponent - leading), mantissa * L::splat(exponent));
    let whole = own_exponent.mul_add(L::splat(leading), small).round();
    let rest = own_exponent.mul_add(L::splat(leading), -whole) + small;
    let value = exp2_near_zero(rest);
    if exponent.abs() < 0.98 {
        // No power of a normal number leaves the normal range.
        return value * whole.power_of_two();
    }
    let limit = L::splat(250.0);
    value.scale((-limit).max(limit.min(whole)))
}
