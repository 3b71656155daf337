//! Every kind of bundle that the processor computes on, against single numbers.

use super::{Arithmetic, Kernel, LANES_MAX, Lanes, Wide, avx2, avx512};

/// Applies a function to every value of a slice, in bundles.
struct Apply {
    function: Function,
    values: Vec<f32>,
}

#[derive(Clone, Copy, Debug)]
enum Function {
    Exp2,
    Log2,
    Pow(f64),
    Arithmetic,
}

impl Kernel<f32> for Apply {
    type Output = Vec<f32>;

    #[inline(always)]
    fn run<L: Lanes<Scalar = f32>>(mut self) -> Vec<f32> {
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
        self.values
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

/// What each kind of bundle gives.
fn run<K: Kernel<f32>>(kernel: impl Fn() -> K) -> Vec<K::Output> {
    [avx512::run(kernel()).ok(), avx2::run(kernel()).ok()].into_iter().flatten().collect()
}

fn in_bundles(function: Function, values: &[f32]) -> Vec<Vec<f32>> {
    run(|| Apply { function, values: values.to_vec() })
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
    for got in in_bundles(Function::Arithmetic, &values) {
        for (&x, got) in values.iter().zip(got) {
            let expected = arithmetic(x);
            assert!(got.to_bits() == expected.to_bits() || got.is_nan() && expected.is_nan(), "{x} {got} {expected}");
        }
    }
}

#[test]
fn loads_fill_up_and_stores_stop() {
    for len in 0..40 {
        let values: Vec<f32> = (0..len).map(|i| i as f32 + 1.0).collect();
        for got in in_bundles(Function::Exp2, &values) {
            for (x, got) in values.iter().zip(&got) {
                assert_eq!(x.exp2(), *got);
            }
            assert_eq!(got.len(), len);
        }
    }
}

struct Bits<'a> {
    bytes: &'a [u8],
    bit: u32,
}

impl Kernel<f32> for Bits<'_> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn run<L: Lanes<Scalar = f32>>(self) -> Vec<f32> {
        let mut out = vec![0.0; L::LANES];
        L::select(L::bits_set(self.bytes, self.bit), L::splat(1.0), L::splat(0.0)).store(&mut out);
        out
    }
}

#[test]
fn bits_of_bytes_become_masks() {
    let bytes = [0, 1, 2, 3, 0x80, 0xff, 7, 4, 0x40, 0x12, 0xaa, 0x55, 9, 0, 0x80, 1];
    for len in 0..=LANES_MAX {
        for bit in 0..8 {
            for got in run(|| Bits { bytes: &bytes[..len], bit }) {
                let set = |i: usize| i < len && bytes[i] >> bit & 1 == 1;
                assert!((0..got.len()).all(|i| got[i] == f32::from(u8::from(set(i)))), "{len} {bit} {got:?}");
            }
        }
    }
}

#[test]
fn wide_values_load_and_sum() {
    /// The sum, and how many are summed.
    struct Sum<'a>(&'a [f64]);
    impl Kernel<f32> for Sum<'_> {
        type Output = (f64, usize);
        #[inline(always)]
        fn run<L: Lanes<Scalar = f32>>(self) -> (f64, usize) {
            (L::Wide::load(self.0).sum(), L::LANES)
        }
    }
    let powers: Vec<f64> = (0..=LANES_MAX as i32).map(|i| 2f64.powi(i)).collect();
    for (sum, lanes) in run(|| Sum(&powers)) {
        assert_eq!(sum, 2f64.powi(lanes as i32) - 1.0);
    }
    for (sum, _) in run(|| Sum(&[1.0, 2.0, 4.0])) {
        assert_eq!(sum, 7.0);
    }
}

/// The largest relative error over `values`, against double precision, of each kind of bundle.
fn worst(function: Function, values: &[f32], exact: impl Fn(f64) -> f64) -> Vec<f64> {
    let error = |(&x, got): (&f32, f32)| (f64::from(got) / exact(f64::from(x)) - 1.0).abs();
    let of_all = |got: Vec<f32>| values.iter().zip(got).map(error).fold(0.0, f64::max);
    in_bundles(function, values).into_iter().map(of_all).collect()
}

#[test]
fn powers_are_accurate() {
    let (all, middle) = (spread(1e-30, 1e30, 1_000_000), spread(1e-5, 1e5, 1_000_000));
    // The larger exponents are what albedos and roughness are decoded with; above 0 they have to be, here far above the smallest result.
    let cases =
        [(1.0 / 2.2, &all), (0.1, &all), (0.97, &all), (1.2, &all), (2.2, &middle), (2.4, &middle), (7.3, &middle)];
    for (exponent, values) in cases {
        for worst in worst(Function::Pow(exponent), values, |x| x.powf(exponent)) {
            eprintln!("pow {exponent}: {worst:e}");
            assert!(worst < 2e-7 * exponent.max(1.0), "{exponent} {worst:e}");
        }
    }
}

#[test]
fn powers_are_right_at_the_ends() {
    let values = [0.0, -0.0, -1.0, 1e-44, f32::INFINITY, 1.0, f32::MIN_POSITIVE, f32::MAX];
    for got in in_bundles(Function::Pow(2.2), &values) {
        assert_eq!(got, [0.0, 0.0, 0.0, 0.0, f32::INFINITY, 1.0, 0.0, f32::INFINITY]);
    }
    for got in in_bundles(Function::Pow(1.0 / 2.2), &values) {
        assert_eq!(got[..6], [0.0, 0.0, 0.0, 0.0, f32::INFINITY, 1.0]);
    }
    for got in in_bundles(Function::Pow(1.5), &[f32::NAN]) {
        assert!(got[0].is_nan());
    }
    // The scalar forms agree.
    for exponent in [2.2, 1.0 / 2.2] {
        for got in in_bundles(Function::Pow(exponent), &values) {
            for (x, bundled) in values.into_iter().zip(got) {
                let scalar = Lanes::pow(x, exponent);
                let close = bundled == scalar || (bundled / scalar - 1.0).abs() < 2e-7;
                assert!(close, "{x} {exponent} {bundled} {scalar}");
            }
        }
    }
}

#[test]
fn exponentials_are_accurate() {
    let mut values = spread(1e-30, 127.99, 500_000);
    values.extend(spread(1e-30, 126.0, 500_000).iter().map(|x| -x));
    for worst in worst(Function::Exp2, &values, f64::exp2) {
        eprintln!("exp2: {worst:e}");
        assert!(worst < 1.5e-7, "{worst:e}");
    }
    for got in in_bundles(Function::Exp2, &[128.0, 1e30, f32::INFINITY, -150.0, -1e30, f32::NEG_INFINITY]) {
        assert_eq!(got, [f32::INFINITY, f32::INFINITY, f32::INFINITY, 0.0, 0.0, 0.0]);
    }
    for got in in_bundles(Function::Exp2, &[f32::NAN, -140.0]) {
        assert!(got[0].is_nan() && got[1] == 2.0_f32.powi(-140), "{got:?}");
    }
}

#[test]
fn logarithms_are_accurate() {
    let values = spread(f32::MIN_POSITIVE, f32::MAX, 1_000_000);
    for got in in_bundles(Function::Log2, &values) {
        for (&x, got) in values.iter().zip(got) {
            let exact = f64::from(x).log2();
            assert!((f64::from(got) - exact).abs() < (2e-7 * exact.abs()).max(1e-7), "{x} {got} {exact}");
        }
    }
    for got in in_bundles(Function::Log2, &[1.0]) {
        assert_eq!(got, [0.0]);
    }
}
