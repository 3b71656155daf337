//! The float types the kernels are written for, and how a kernel is compiled for the CPU at hand.

use dfdx::dtypes::Dtype;

/// `f32` for users, `f64` for gradient checks.
pub(crate) trait Scalar: Dtype {
    /// The nearest value of this type.
    fn of(value: f64) -> Self;
    /// As `f64`.
    fn wide(self) -> f64;
    /// `self * a + b`, rounded once; only fast where the CPU has the instruction.
    fn fused(self, a: Self, b: Self) -> Self;
    /// Square root.
    fn root(self) -> Self;
    /// Hyperbolic tangent.
    fn tanh(self) -> Self;
    /// e to the power of `self`.
    fn exp(self) -> Self;
}

macro_rules! scalar {
    ($float:ty) => {
        impl Scalar for $float {
            #[inline(always)]
            fn of(value: f64) -> Self {
                value as $float
            }
            #[inline(always)]
            fn wide(self) -> f64 {
                f64::from(self)
            }
            #[inline(always)]
            fn fused(self, a: Self, b: Self) -> Self {
                self.mul_add(a, b)
            }
            #[inline(always)]
            fn root(self) -> Self {
                self.sqrt()
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

/// `a * b + c`, fused where the kernel is compiled for a CPU that can.
#[inline(always)]
pub(crate) fn multiply_add<E: Scalar, const FUSED: bool>(a: E, b: E, c: E) -> E {
    if FUSED { a.fused(b, c) } else { a * b + c }
}

/// Compiles a kernel twice, for any CPU and for AVX2 with FMA, and calls the one the CPU can run.
///
/// In the body `FUSED` says which of the two it is, to be handed to [`multiply_add`].
macro_rules! kernel {
    ($(#[$attribute:meta])* $visible:vis fn $name:ident<$scalar:ident>($($argument:ident: $type:ty),* $(,)?) $(-> $result:ty)? $body:block) => {
        $(#[$attribute])*
        #[allow(clippy::too_many_arguments, unsafe_code)]
        $visible fn $name<$scalar: $crate::nn::scalar::Scalar>($($argument: $type),*) $(-> $result)? {
            #[inline(always)]
            #[allow(clippy::extra_unused_type_parameters)]
            fn body<$scalar: $crate::nn::scalar::Scalar, const FUSED: bool>($($argument: $type),*) $(-> $result)? $body

            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,fma")]
                fn avx2<$scalar: $crate::nn::scalar::Scalar>($($argument: $type),*) $(-> $result)? {
                    body::<$scalar, true>($($argument),*)
                }
                if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
                    // SAFETY: the CPU has both features the function is compiled for.
                    return unsafe { avx2::<$scalar>($($argument),*) };
                }
            }
            body::<$scalar, false>($($argument),*)
        }
    };
}
pub(crate) use kernel;
