//! What bundles of every width of x86-64 processors have in common, over the names of a width's intrinsics.
//!
//! The types are private to the module that calls [`bundles`]: only its `run` brings them into being, after the processor was asked, and every method is
//! inlined into it.

/// Calls intrinsics.
macro_rules! intrinsic {
    ($call:expr) => {{
        // SAFETY: bundles exist only inside the functions that have the processor's features turned on; no pointer is involved.
        unsafe { $call }
    }};
}

/// Two operators' traits, methods and intrinsics, for single and double precision.
macro_rules! operators {
    ($Single:ident $Double:ident: $($Trait:ident $method:ident $single:ident $double:ident;)*) => {$(
        impl $Trait for $Single {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(intrinsic!($single(self.0, other.0)))
            }
        }

        impl $Trait for $Double {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(intrinsic!($double(self.0, other.0)), intrinsic!($double(self.1, other.1)))
            }
        }
    )*};
}

/// The bundles of one width: their types with the names of intrinsics, and what is written for this width alone.
macro_rules! bundles {
    (
        $lanes:literal elements;
        single $Single:ident($single:ty) {
            $add:ident, $sub:ident, $mul:ident, $div:ident, $xor:ident, $splat:ident, $mul_add:ident, $sqrt:ident, $max:ident, $min:ident,
            $load:ident, $store:ident
        }
        double $Double:ident($double:ty) {
            $add2:ident, $sub2:ident, $mul2:ident, $div2:ident, $xor2:ident, $splat2:ident, $mul_add2:ident, $sqrt2:ident, $load2:ident
        }
        whole($whole:ty) {
            $add_whole:ident, $sub_whole:ident, $splat_whole:ident, $left:ident, $right:ident, $bits:ident, $of_bits:ident,
            $to_whole:ident, $of_whole:ident
        }
        impl Wide { $($wide:tt)* }
        impl Exponents { $($exponents:tt)* }
        impl Lanes { $($own:tt)* }
    ) => {
        #[derive(Clone, Copy)]
        struct $Single($single);

        /// The first half of the elements, and the second.
        #[derive(Clone, Copy)]
        struct $Double($double, $double);

        impl Sealed for $Single {}
        impl Sealed for $Double {}

        operators! {
            $Single $Double:
            Add add $add $add2;
            Sub sub $sub $sub2;
            Mul mul $mul $mul2;
            Div div $div $div2;
        }

        impl Neg for $Single {
            type Output = Self;

            #[inline(always)]
            fn neg(self) -> Self {
                Self(intrinsic!($xor(self.0, $splat(-0.0))))
            }
        }

        impl Neg for $Double {
            type Output = Self;

            #[inline(always)]
            fn neg(self) -> Self {
                let sign = intrinsic!($splat2(-0.0));
                Self(intrinsic!($xor2(self.0, sign)), intrinsic!($xor2(self.1, sign)))
            }
        }

        impl Arithmetic for $Single {
            const FUSED: bool = true;

            #[inline(always)]
            fn splat(value: f64) -> Self {
                Self(intrinsic!($splat(value as f32)))
            }

            #[inline(always)]
            fn mul_add(self, factor: Self, term: Self) -> Self {
                Self(intrinsic!($mul_add(self.0, factor.0, term.0)))
            }

            #[inline(always)]
            fn sqrt(self) -> Self {
                Self(intrinsic!($sqrt(self.0)))
            }
        }

        impl Arithmetic for $Double {
            const FUSED: bool = true;

            #[inline(always)]
            fn splat(value: f64) -> Self {
                let value = intrinsic!($splat2(value));
                Self(value, value)
            }

            #[inline(always)]
            fn mul_add(self, factor: Self, term: Self) -> Self {
                Self(intrinsic!($mul_add2(self.0, factor.0, term.0)), intrinsic!($mul_add2(self.1, factor.1, term.1)))
            }

            #[inline(always)]
            fn sqrt(self) -> Self {
                Self(intrinsic!($sqrt2(self.0)), intrinsic!($sqrt2(self.1)))
            }
        }

        impl Wide for $Double {
            #[inline(always)]
            fn load(values: &[f64]) -> Self {
                let all = first::<_, $lanes>(values);
                // SAFETY: `all` holds as many values as the bundle; the features are those of its `run`.
                unsafe { Self($load2(all.as_ptr()), $load2(all.as_ptr().add($lanes / 2))) }
            }

            $($wide)*
        }

        /// `2^exponent` for integers from -127 (which gives 0) to 128 (infinity).
        #[inline(always)]
        fn power_of_two(exponent: $whole) -> $Single {
            let biased = intrinsic!($add_whole(exponent, $splat_whole(127)));
            $Single(intrinsic!($of_bits($left::<23>(biased))))
        }

        impl Exponents for $Single {
            #[inline(always)]
            fn power_of_two(self) -> Self {
                power_of_two(intrinsic!($to_whole(self.0)))
            }

            #[inline(always)]
            fn split(self) -> (Self, Self) {
                let bits = intrinsic!($bits(self.0));
                let exponent = intrinsic!($right::<23>($sub_whole(bits, $splat_whole(SQRT_HALF))));
                let mantissa = intrinsic!($sub_whole(bits, $left::<23>(exponent)));
                (Self(intrinsic!($of_whole(exponent))), Self(intrinsic!($of_bits(mantissa))))
            }

            $($exponents)*
        }

        impl Lanes for $Single {
            type Scalar = f32;
            type Wide = $Double;
            type Mask = Mask;
            const LANES: usize = $lanes;
            const NORMAL_RANGE: [f64; 2] = f32::NORMAL_RANGE;

            #[inline(always)]
            fn load(values: &[f32]) -> Self {
                let all = first::<_, $lanes>(values);
                // SAFETY: `all` holds as many values as the bundle; the features are those of its `run`.
                Self(unsafe { $load(all.as_ptr()) })
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
                let mut all = [0.0; $lanes];
                // SAFETY: `all` has room for as many values as the bundle has; the features are those of its `run`.
                unsafe { $store(all.as_mut_ptr(), self.0) };
                match values.first_chunk_mut::<$lanes>() {
                    Some(values) => *values = all,
                    None => values.copy_from_slice(&all[..values.len()]),
                }
            }

            #[inline(always)]
            fn max(self, other: Self) -> Self {
                Self(intrinsic!($max(self.0, other.0)))
            }

            #[inline(always)]
            fn min(self, other: Self) -> Self {
                Self(intrinsic!($min(self.0, other.0)))
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

            $($own)*
        }
    };
}
