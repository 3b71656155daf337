//! The arithmetic that the shading model, the renderer and other vectorised kernels are written in, once.
//!
//! A kernel is generic over [`Lanes`]: a bundle of one (`f32`, `f64`) or several numbers on which all operations work element
//! by element. [`Real`] are the two element types of maps, and [`Real::run`] picks the widest bundle that the processor at hand
//! computes on. Everything is `#[inline(always)]`, so that a kernel becomes one straight piece of code.

#[cfg(target_arch = "x86_64")]
#[macro_use]
mod bundles;
#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
#[cfg(target_arch = "x86_64")]
mod powers;
#[cfg(all(test, target_arch = "x86_64"))]
mod tests;

use std::fmt::Debug;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

mod sealed {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
}
use sealed::Sealed;

/// What single and double precision bundles have in common.
pub trait Arithmetic:
    Sealed + Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Neg<Output = Self>
{
    /// Whether [`Arithmetic::mul_add`] rounds once.
    const FUSED: bool;

    /// `value`, rounded to this precision, in every element.
    fn splat(value: f64) -> Self;

    /// `self * factor + term`; with one rounding where the processor has such an instruction.
    fn mul_add(self, factor: Self, term: Self) -> Self;

    /// Square root.
    fn sqrt(self) -> Self;
}

/// The double precision twin of a [`Lanes`] bundle: for the few steps of a kernel in which single precision would cancel.
pub trait Wide: Arithmetic {
    /// The first elements of `values`; missing ones are 0.
    fn load(values: &[f64]) -> Self;

    /// Sum of the elements, in a fixed order.
    fn sum(self) -> f64;
}

/// Most elements of a bundle: padding to multiples of it lets a kernel read whole bundles only.
pub const LANES_MAX: usize = 16;

/// One or several numbers of one precision, computed on element by element.
pub trait Lanes: Arithmetic + Div<Output = Self> {
    /// The type of the elements in memory.
    type Scalar: Copy;
    /// As many elements in double precision.
    type Wide: Wide;
    /// One truth value for each element.
    type Mask: Copy + BitAnd<Output = Self::Mask> + BitOr<Output = Self::Mask> + Not<Output = Self::Mask>;
    /// Elements of a bundle; a power of two, at most [`LANES_MAX`].
    const LANES: usize;
    /// Smallest positive number of the full precision, and the largest finite one.
    const NORMAL_RANGE: [f64; 2];

    /// The first elements of `values`; missing ones are 0.
    fn load(values: &[Self::Scalar]) -> Self;

    /// As [`Lanes::load`], from single precision.
    fn load_f32(values: &[f32]) -> Self;

    /// Tells the processor that the first of `values` will be read soon; changes nothing but time.
    #[inline(always)]
    fn prefetch(_values: &[Self::Scalar]) {}

    /// Writes the first elements to `values`, as many as it holds.
    fn store(self, values: &mut [Self::Scalar]);

    /// The elements in double precision.
    fn widen(self) -> Self::Wide;

    /// The elements of `wide`, rounded.
    fn narrow(wide: Self::Wide) -> Self;

    /// The larger of two; `other` where an element of `self` is NaN.
    fn max(self, other: Self) -> Self;

    /// The smaller of two; `other` where an element of `self` is NaN.
    fn min(self, other: Self) -> Self;

    /// Absolute value.
    fn abs(self) -> Self;

    /// Where `self > other`; nowhere if one is NaN.
    fn gt(self, other: Self) -> Self::Mask;

    /// Where `self >= other`; nowhere if one is NaN.
    fn ge(self, other: Self) -> Self::Mask;

    /// Where bit `bit` of an element's byte is set; missing bytes are 0.
    fn bits_set(bytes: &[u8], bit: u32) -> Self::Mask;

    /// `yes` where `mask` holds, else `no`.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;

    /// Whether `mask` holds anywhere.
    fn any(mask: Self::Mask) -> bool;

    /// `2^self`, relative error below 2e-7 in single precision; 0 below the normal range and infinity above it.
    fn exp2(self) -> Self;

    /// Base-2 logarithm of a positive normal number: in single precision within 2e-7 relative or 1e-7 absolute, whichever is more.
    fn log2(self) -> Self;

    /// `self^exponent` for positive normal `self` and a constant exponent of magnitude below 16; any value for others.
    /// Relative error below 2e-7, times the exponent where that is above 1, in single precision.
    fn pow_normal(self, exponent: f64) -> Self;

    /// `self^exponent` for a constant positive exponent below 16. What is below the normal range, negative numbers among it, gives 0.
    /// Relative error below 2e-7, times the exponent where that is above 1, in single precision.
    #[inline(always)]
    fn pow(self, exponent: f64) -> Self {
        let [smallest, largest] = [Self::splat(Self::NORMAL_RANGE[0]), Self::splat(Self::NORMAL_RANGE[1])];
        let value = Self::select(self.ge(smallest), self.pow_normal(exponent), Self::splat(0.0));
        // Infinity and NaN stay what they are.
        Self::select(largest.ge(self), value, self)
    }
}

/// The element types of maps: `f32`, on which users run, and `f64`, on which gradients are checked.
pub trait Real: Lanes<Scalar = Self> + Debug + Default + PartialOrd + Send + Sync + 'static {
    /// Runs `kernel` on the widest bundle of this type that the processor computes on.
    fn run<K: Kernel<Self>>(kernel: K) -> K::Output;

    /// The value in double precision.
    fn to_f64(self) -> f64;
}

/// Work written once for every bundle of `R`.
pub trait Kernel<R: Real> {
    /// What the work gives.
    type Output;

    /// Does the work; to be `#[inline(always)]`.
    fn run<L: Lanes<Scalar = R>>(self) -> Self::Output;
}

macro_rules! scalar {
    ($type:ident) => {
        impl Arithmetic for $type {
            const FUSED: bool = cfg!(any(target_arch = "aarch64", target_feature = "fma"));

            #[inline(always)]
            fn splat(value: f64) -> Self {
                value as $type
            }

            // The library function would be a call on processors without the instruction, and slower than all the rest.
            #[inline(always)]
            fn mul_add(self, factor: Self, term: Self) -> Self {
                if Self::FUSED { $type::mul_add(self, factor, term) } else { self * factor + term }
            }

            #[inline(always)]
            fn sqrt(self) -> Self {
                $type::sqrt(self)
            }
        }

        impl Lanes for $type {
            type Scalar = $type;
            type Wide = f64;
            type Mask = bool;
            const LANES: usize = 1;
            const NORMAL_RANGE: [f64; 2] = [$type::MIN_POSITIVE as f64, $type::MAX as f64];

            #[inline(always)]
            fn load(values: &[$type]) -> Self {
                values.first().copied().unwrap_or(0.0)
            }

            #[inline(always)]
            fn load_f32(values: &[f32]) -> Self {
                values.first().map_or(0.0, |&value| value as $type)
            }

            #[inline(always)]
            fn store(self, values: &mut [$type]) {
                if let Some(value) = values.first_mut() {
                    *value = self;
                }
            }

            #[inline(always)]
            fn widen(self) -> f64 {
                self as f64
            }

            #[inline(always)]
            fn narrow(wide: f64) -> Self {
                wide as $type
            }

            #[inline(always)]
            fn max(self, other: Self) -> Self {
                if self > other { self } else { other }
            }

            #[inline(always)]
            fn min(self, other: Self) -> Self {
                if self < other { self } else { other }
            }

            #[inline(always)]
            fn abs(self) -> Self {
                $type::abs(self)
            }

            #[inline(always)]
            fn gt(self, other: Self) -> bool {
                self > other
            }

            #[inline(always)]
            fn ge(self, other: Self) -> bool {
                self >= other
            }

            #[inline(always)]
            fn bits_set(bytes: &[u8], bit: u32) -> bool {
                bytes.first().is_some_and(|byte| byte >> bit & 1 == 1)
            }

            #[inline(always)]
            fn select(mask: bool, yes: Self, no: Self) -> Self {
                if mask { yes } else { no }
            }

            #[inline(always)]
            fn any(mask: bool) -> bool {
                mask
            }

            #[inline(always)]
            fn exp2(self) -> Self {
                $type::exp2(self)
            }

            #[inline(always)]
            fn log2(self) -> Self {
                $type::log2(self)
            }

            #[inline(always)]
            fn pow_normal(self, exponent: f64) -> Self {
                (self as f64).powf(exponent) as $type
            }
        }
    };
}

scalar!(f32);
scalar!(f64);

impl Wide for f64 {
    #[inline(always)]
    fn load(values: &[f64]) -> Self {
        values.first().copied().unwrap_or(0.0)
    }

    #[inline(always)]
    fn sum(self) -> f64 {
        self
    }
}

#[cfg(test)]
thread_local! {
    /// Whether kernels compute on single numbers on this thread, as on a processor without lanes.
    pub(crate) static SINGLE: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

impl Real for f32 {
    fn run<K: Kernel<f32>>(kernel: K) -> K::Output {
        #[cfg(test)]
        if SINGLE.get() {
            return kernel.run::<f32>();
        }
        #[cfg(target_arch = "x86_64")]
        let kernel = match avx512::run(kernel).or_else(avx2::run) {
            Ok(output) => return output,
            Err(kernel) => kernel,
        };
        kernel.run::<f32>()
    }

    fn to_f64(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    fn run<K: Kernel<f64>>(kernel: K) -> K::Output {
        kernel.run::<f64>()
    }

    fn to_f64(self) -> f64 {
        self
    }
}

/// The first `N` of `values`, filled up with `T::default()`.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn first<T: Copy + Default, const N: usize>(values: &[T]) -> [T; N] {
    match values.first_chunk() {
        Some(all) => *all,
        None => std::array::from_fn(|i| values.get(i).copied().unwrap_or_default()),
    }
}

/// Scalar product.
#[inline(always)]
pub(crate) fn dot<A: Arithmetic>(a: [A; 3], b: [A; 3]) -> A {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

/// Cross product.
#[inline(always)]
pub(crate) fn cross<A: Arithmetic>(a: [A; 3], b: [A; 3]) -> [A; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `vector * factor`.
#[inline(always)]
pub(crate) fn scale<A: Arithmetic>(vector: [A; 3], factor: A) -> [A; 3] {
    [vector[0] * factor, vector[1] * factor, vector[2] * factor]
}

/// `a * factor + b`.
#[inline(always)]
pub(crate) fn add_scaled<A: Arithmetic>(a: [A; 3], factor: A, b: [A; 3]) -> [A; 3] {
    [a[0].mul_add(factor, b[0]), a[1].mul_add(factor, b[1]), a[2].mul_add(factor, b[2])]
}
