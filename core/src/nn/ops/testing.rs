//! Gradient checks by central differences in f64.

use dfdx::tensor::{Cpu, OwnedTape};

use crate::error::Result;
use crate::nn::kernels::dot;
use crate::nn::layout::Layout;
use crate::nn::tape::{Param, Planes};

/// `len` fixed numbers in (-1, 1) without pattern.
pub(crate) fn numbers(len: usize, seed: u64) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(1);
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    (0..len).map(|_| next()).collect()
}

type Traced = Planes<f64, OwnedTape<f64, Cpu>>;

/// Compares every gradient of a weighted sum of `operation`'s result with central differences, with all gradients asked for, only
/// that with respect to the input, and only those with respect to the parameters; without any, nothing must be recorded.
pub(crate) fn check(layout: Layout, params: &[usize], operation: impl Fn(Traced, &[Param<f64>]) -> Result<Traced>) {
    let x = numbers(layout.len(), 11);
    let params: Vec<Vec<f64>> = params.iter().enumerate().map(|(i, &len)| numbers(len, 20 + i as u64)).collect();
    let constant = |params: &[Vec<f64>]| params.iter().map(|p| Param::constant(p.clone().into())).collect::<Vec<_>>();
    let planes = |x: &[f64]| Planes::constant(x.to_vec(), layout).unwrap();

    let out = operation(planes(&x).traced_constant(), &constant(&params)).unwrap();
    assert!(!out.records(), "nobody asked for a gradient");
    let seed = numbers(out.layout.len(), 5);
    let loss = |x: &[f64], params: &[Vec<f64>]| {
        dot(operation(planes(x).traced_constant(), &constant(params)).unwrap().values(), &seed)
    };
    let tracked: Vec<_> = params.iter().map(|p| Param::tracked(p.clone())).collect();
    let all = planes(&x);
    let mut pullback = operation(all.traced(), &tracked).unwrap().cut().1.pull_back(seed.clone()).unwrap();
    let dx = pullback.of(&all.slot()).unwrap();
    let dparams: Vec<_> = tracked.iter().map(|p| pullback.of_param(p).unwrap()).collect();

    let input_only = planes(&x);
    let mut pullback =
        operation(input_only.traced(), &constant(&params)).unwrap().cut().1.pull_back(seed.clone()).unwrap();
    compare(&pullback.of(&input_only.slot()).unwrap(), &dx, 1e-12, "input alone");
    if !params.is_empty() {
        let out = operation(planes(&x).traced_constant(), &tracked).unwrap();
        let mut pullback = out.cut().1.pull_back(seed.clone()).unwrap();
        for (param, expected) in tracked.iter().zip(&dparams) {
            compare(&pullback.of_param(param).unwrap(), expected, 1e-12, "parameters alone");
        }
    }

    // Differences of fourth order.
    const STEP: f64 = 1e-4;
    let slope = |i: usize, values: &[f64], loss: &dyn Fn(&[f64]) -> f64| {
        let difference = |step: f64| {
            let mut moved = values.to_vec();
            moved[i] = values[i] + step;
            let up = loss(&moved);
            moved[i] = values[i] - step;
            (up - loss(&moved)) / (2.0 * step)
        };
        (4.0 * difference(STEP) - difference(2.0 * STEP)) / 3.0
    };
    // Some places, the corners among them.
    let places = |len: usize| (0..len).step_by(len.div_ceil(60)).chain([len - 1]);
    let scale = |values: &[f64]| values.iter().fold(0.0, |a: f64, v| a.max(v.abs())).max(1e-3);
    for i in places(x.len()) {
        let expected = slope(i, &x, &|x| loss(x, &params));
        assert!((dx[i] - expected).abs() < 1e-8 * scale(&dx), "input {i}: {} {expected}", dx[i]);
    }
    for (which, gradient) in dparams.iter().enumerate() {
        for i in places(gradient.len()) {
            let expected = slope(i, &params[which], &|values| {
                let mut params = params.clone();
                params[which] = values.to_vec();
                loss(&x, &params)
            });
            let got = gradient[i];
            assert!((got - expected).abs() < 1e-8 * scale(gradient), "parameter {which}, {i}: {got} {expected}");
        }
    }
}

/// Fails where two vectors differ by more than `tolerance` of the second's largest value.
pub(crate) fn compare(got: &[f64], expected: &[f64], tolerance: f64, what: &str) {
    assert_eq!(got.len(), expected.len(), "{what}");
    let scale = expected.iter().fold(0.0, |a: f64, v| a.max(v.abs()));
    for (i, (got, expected)) in got.iter().zip(expected).enumerate() {
        assert!((got - expected).abs() <= tolerance * scale, "{what}, {i}: {got} {expected}");
    }
}
