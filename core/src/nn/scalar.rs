//! The float types that the networks' kernels are written for, and how a kernel is compiled for the CPU at hand.

use dfdx::dtypes::Dtype;

use crate::real::{Lanes, Real};

/// `f32` for users, `f64` for gradient checks.
pub(crate) trait Scalar: Dtype + Real {
    /// As `f64`.
    fn wide(self) -> f64;
    /// `self * a + b`, rounded once; only fast where the CPU has the instruction.
    fn fused(self, a: Self, b: Self) -> Self;
    /// Hyperbolic tangent.
    fn tanh(self) -> Self;
    /// e to the power of `self`.
    fn exp(self) -> Self;
}

macro_rules! scalar {
    ($float:ty) => {
        impl Scalar for $float {
            #[inline(always)]
            fn wide(self) -> f64 {
                f64::from(self)
            }
            #[inline(always)]
            fn fused(self, a: Self, b: Self) -> Self {
                self.mul_add(a, b)
            }
            fn tanh(self) -> Self {
                self.tanh()
            }
            fn exp(self) -> Self {
                self.exp()
            }
        }
    };
}
scalar!(f32);
scalar!(f64);

/// `a * b + c`, fused where the kernel is compiled for bundles `L` that are.
#[inline(always)]
pub(crate) fn multiply_add<E: Scalar, L: Lanes<Scalar = E>>(a: E, b: E, c: E) -> E {
    if L::FUSED { a.fused(b, c) } else { a * b + c }
}

/// A loop over plain values, compiled once for each bundle of [`Real::run`], which calls the one that the CPU can run: what is simple enough for the
/// compiler to make bundles of.
///
/// In the body `L` is the bundle, to be handed to [`multiply_add`].
macro_rules! kernel {
    ($(#[$attribute:meta])* $visible:vis fn $name:ident<$life:lifetime>($($argument:ident: $type:ty),* $(,)?) $body:block) => {
        kernel!(@of f32, [$life], [$life], $(#[$attribute])* $visible fn $name($($argument: $type),*) -> () $body);
    };
    ($(#[$attribute:meta])* $visible:vis fn $name:ident<$life:lifetime, $scalar:ident>($($argument:ident: $type:ty),* $(,)?) $body:block) => {
        kernel!(@of $scalar, [$life, $scalar: $crate::nn::scalar::Scalar], [$life, $scalar], $(#[$attribute])* $visible fn $name($($argument: $type),*) -> () $body);
    };
    ($(#[$attribute:meta])* $visible:vis fn $name:ident<$life:lifetime, $scalar:ident>($($argument:ident: $type:ty),* $(,)?) -> $result:ty $body:block) => {
        kernel!(@of $scalar, [$life, $scalar: $crate::nn::scalar::Scalar], [$life, $scalar], $(#[$attribute])* $visible fn $name($($argument: $type),*) -> $result $body);
    };
    (@of $scalar:ty, [$($generics:tt)*], [$($names:tt)*], $(#[$attribute:meta])* $visible:vis fn $name:ident($($argument:ident: $type:ty),*) -> $result:ty $body:block) => {
        $(#[$attribute])*
        #[allow(clippy::too_many_arguments)]
        $visible fn $name<$($generics)*>($($argument: $type),*) -> $result {
            struct Loop<$($names)*> {
                $($argument: $type,)*
            }

            impl<$($generics)*> $crate::real::Kernel<$scalar> for Loop<$($names)*> {
                type Output = $result;

                #[inline(always)]
                fn run<L: $crate::real::Lanes<Scalar = $scalar>>(self) -> $result {
                    let Self { $($argument,)* } = self;
                    $body
                }
            }

            <$scalar as $crate::real::Real>::run(Loop { $($argument,)* })
        }
    };
}
pub(crate) use kernel;
