//! The inner loops of the adapters. Each works on rows of pixels, one row per channel, a bundle of pixels at a time.
//!
//! Rows are given as a slice and the offset of each row in it, and `len` pixels of each are used, a multiple of [`LANES_MAX`]. Register blocks are small
//! arrays with loops of constant length over them, which the compiler unrolls; an index says more there than an iterator. There are no closures over
//! bundles: one that is not inlined is compiled without the processor's instructions.

#![allow(clippy::needless_range_loop)]

use crate::nn::kernels::NORM_EPSILON;
use crate::nn::scalar::kernel;
use crate::real::{LANES_MAX, Lanes};

/// Output rows a register block of [`dense`] and [`outer`] has at most.
const BLOCK: usize = 3;

/// Bundles of pixels a register block of [`dense`] has, where so many are left.
const BUNDLES: usize = 4;

/// Rows of pixels: a slice, and where in it each row begins.
#[derive(Clone, Copy)]
pub(super) struct Rows<'a> {
    pub(super) values: &'a [f32],
    pub(super) offsets: &'a [usize],
}

impl<'a> Rows<'a> {
    /// `len` values of the rows from `first` on, as many as there is room for.
    #[inline(always)]
    fn pick<const N: usize>(self, first: usize, len: usize) -> [&'a [f32]; N] {
        let mut rows = [&[][..]; N];
        for row in 0..N {
            rows[row] = &self.values[self.offsets[first + row]..][..len];
        }
        rows
    }
}

/// The bundle of `values` that begins at `at`: a whole one, so that no way for the last few is compiled into the loop.
#[inline(always)]
fn bundle<L: Lanes<Scalar = f32>>(values: &[f32], at: usize) -> L {
    L::load(&values[at..][..L::LANES])
}

kernel! {
    /// Asks for rows that are needed soon: short pieces of rows far apart are what the hardware does not foresee.
    pub(super) fn prefetch<'a>(rows: Rows<'a>, len: usize) {
        for &offset in rows.offsets {
            for line in rows.values.get(offset..offset + len).unwrap_or_default().chunks(LANES_MAX) {
                L::prefetch(line);
            }
        }
    }
}

/// A dense layer over channels with its weights in the order in which [`dense`] reads them.
#[derive(Clone, Debug, Default)]
pub(super) struct Dense {
    inputs: usize,
    /// Blocks of [`BLOCK`] outputs (the last may be smaller): input by input the weights of the block's outputs.
    weights: Vec<f32>,
    bias: Vec<f32>,
}

impl Dense {
    /// A layer from its entries.
    pub(super) fn new(
        outputs: usize,
        inputs: usize,
        weight: impl Fn(usize, usize) -> f32,
        bias: impl Fn(usize) -> f32,
    ) -> Self {
        let mut weights = Vec::with_capacity(outputs * inputs);
        for start in (0..outputs).step_by(BLOCK) {
            for input in 0..inputs {
                weights.extend((start..outputs.min(start + BLOCK)).map(|output| weight(output, input)));
            }
        }
        Self { inputs, weights, bias: (0..outputs).map(bias).collect() }
    }
}

kernel! {
    /// `target[o] = layer.bias[o] + sum over i of layer.weight[o][i] * source[i] (+ residual[o])`,
    /// with the rows of `target` and `residual` `stride` and `residual.1` values apart.
    pub(super) fn dense<'a>(
        layer: &'a Dense, source: Rows<'a>, residual: Option<(&'a [f32], usize)>, target: &'a mut [f32], stride: usize, len: usize,
    ) {
        assert_eq!(source.offsets.len(), layer.inputs, "rows of a layer's input");
        let mut at = 0;
        while at < len {
            let wide = len - at >= BUNDLES * L::LANES;
            for first in (0..layer.bias.len()).step_by(BLOCK) {
                let weights = &layer.weights[first * layer.inputs..];
                let bias = &layer.bias[first..];
                let to = &mut target[first * stride + at..];
                let base = residual.map(|(values, apart)| (&values[first * apart + at..], apart));
                match (bias.len(), wide) {
                    (1, true) => dense_block::<L, 1, BUNDLES>(weights, bias, source, at, base, to, stride),
                    (2, true) => dense_block::<L, 2, BUNDLES>(weights, bias, source, at, base, to, stride),
                    (_, true) => dense_block::<L, BLOCK, BUNDLES>(weights, bias, source, at, base, to, stride),
                    (1, false) => dense_block::<L, 1, 1>(weights, bias, source, at, base, to, stride),
                    (2, false) => dense_block::<L, 2, 1>(weights, bias, source, at, base, to, stride),
                    (_, false) => dense_block::<L, BLOCK, 1>(weights, bias, source, at, base, to, stride),
                }
            }
            at += if wide { BUNDLES * L::LANES } else { L::LANES };
        }
    }
}

/// `O` outputs of a dense layer at the `V` bundles of pixels from `at` on; `residual` and `target` begin there.
#[inline(always)]
fn dense_block<L: Lanes<Scalar = f32>, const O: usize, const V: usize>(
    weights: &[f32],
    bias: &[f32],
    source: Rows<'_>,
    at: usize,
    residual: Option<(&[f32], usize)>,
    target: &mut [f32],
    stride: usize,
) {
    let mut sums = [[L::splat(0.0); V]; O];
    for o in 0..O {
        sums[o] = [L::splat(f64::from(bias[o])); V];
        if let Some((values, apart)) = residual {
            let values = &values[o * apart..][..V * L::LANES];
            for v in 0..V {
                sums[o][v] = sums[o][v] + bundle(values, v * L::LANES);
            }
        }
    }
    for (weights, &offset) in weights.chunks_exact(O).zip(source.offsets) {
        let values = &source.values[offset + at..][..V * L::LANES];
        let mut factors = [L::splat(0.0); O];
        for o in 0..O {
            factors[o] = L::splat(f64::from(weights[o]));
        }
        for v in 0..V {
            let value: L = bundle(values, v * L::LANES);
            for o in 0..O {
                sums[o][v] = value.mul_add(factors[o], sums[o][v]);
            }
        }
    }
    for o in 0..O {
        let target = &mut target[o * stride..][..V * L::LANES];
        for v in 0..V {
            sums[o][v].store(&mut target[v * L::LANES..][..L::LANES]);
        }
    }
}

/// Adds `value` to the lanes of a sum.
#[inline(always)]
fn add_to<L: Lanes<Scalar = f32>>(sums: &mut [f32], which: usize, value: L) {
    let sum = &mut sums[which * LANES_MAX..][..L::LANES];
    (L::load(sum) + value).store(sum);
}

kernel! {
    /// `sums[(a, b)] += left[a] * right[b]` for every pair of rows, and behind these `sums[a] += left[a]` for every row of `left`,
    /// summed over pixels lane by lane: [`LANES_MAX`] values per pair and per row.
    pub(super) fn outer<'a>(sums: &'a mut [f32], left: Rows<'a>, right: Rows<'a>, len: usize) {
        let (rows, columns) = (left.offsets.len(), right.offsets.len());
        for a in (0..rows).step_by(BLOCK) {
            for b in (0..columns).step_by(BLOCK) {
                let at = Block { a, b, columns, totals: (b == 0).then_some(rows * columns), len };
                match (rows - a, columns - b) {
                    (1, 1) => outer_block::<L, 1, 1>(sums, left, right, at),
                    (1, 2) => outer_block::<L, 1, 2>(sums, left, right, at),
                    (1, _) => outer_block::<L, 1, BLOCK>(sums, left, right, at),
                    (2, 1) => outer_block::<L, 2, 1>(sums, left, right, at),
                    (2, 2) => outer_block::<L, 2, 2>(sums, left, right, at),
                    (2, _) => outer_block::<L, 2, BLOCK>(sums, left, right, at),
                    (_, 1) => outer_block::<L, BLOCK, 1>(sums, left, right, at),
                    (_, 2) => outer_block::<L, BLOCK, 2>(sums, left, right, at),
                    (_, _) => outer_block::<L, BLOCK, BLOCK>(sums, left, right, at),
                }
            }
        }
    }
}

/// Which pairs of [`outer`] a block is: the first rows of both sides, how many rows `right` has, where the totals of `left` are if they are asked for,
/// and how many pixels there are.
#[derive(Clone, Copy)]
struct Block {
    a: usize,
    b: usize,
    columns: usize,
    totals: Option<usize>,
    len: usize,
}

/// `A` by `B` pairs of [`outer`], and the totals of the `A` rows if asked for.
#[inline(always)]
fn outer_block<L: Lanes<Scalar = f32>, const A: usize, const B: usize>(
    sums: &mut [f32],
    left: Rows<'_>,
    right: Rows<'_>,
    at: Block,
) {
    let (left, right) = (left.pick(at.a, at.len), right.pick(at.b, at.len));
    let pairs = match at.totals {
        Some(first) => {
            let (pairs, totals) = outer_sums::<L, A, B, true>(left, right, at.len);
            for a in 0..A {
                add_to(sums, first + at.a + a, totals[a]);
            }
            pairs
        }
        None => outer_sums::<L, A, B, false>(left, right, at.len).0,
    };
    for a in 0..A {
        for b in 0..B {
            add_to(sums, (at.a + a) * at.columns + at.b + b, pairs[a][b]);
        }
    }
}

/// The sums of `A` by `B` pairs, and the totals of the `A` rows if `TOTALS`.
#[inline(always)]
fn outer_sums<L: Lanes<Scalar = f32>, const A: usize, const B: usize, const TOTALS: bool>(
    left: [&[f32]; A],
    right: [&[f32]; B],
    len: usize,
) -> ([[L; B]; A], [L; A]) {
    let mut pairs = [[L::splat(0.0); B]; A];
    let mut totals = [L::splat(0.0); A];
    for at in (0..len).step_by(L::LANES) {
        let mut factors = [L::splat(0.0); B];
        for b in 0..B {
            factors[b] = bundle(right[b], at);
        }
        for a in 0..A {
            let left: L = bundle(left[a], at);
            for b in 0..B {
                pairs[a][b] = left.mul_add(factors[b], pairs[a][b]);
            }
            if TOTALS {
                totals[a] = totals[a] + left;
            }
        }
    }
    (pairs, totals)
}

kernel! {
    /// `sums[a] += rows[a]`, summed over pixels lane by lane.
    pub(super) fn sum<'a>(sums: &'a mut [f32], rows: Rows<'a>, len: usize) {
        for (row, &offset) in rows.offsets.iter().enumerate() {
            let mut total = [L::splat(0.0); 2];
            for (bundle, values) in rows.values[offset..][..len].chunks_exact(L::LANES).enumerate() {
                total[bundle % 2] = total[bundle % 2] + L::load(values);
            }
            add_to(sums, row, total[0] + total[1]);
        }
    }
}

/// Rows of several channels that lie next to each other, with the rows of the picture above and below elsewhere in the same slice:
/// `rows[j]` is where picture row `j` of the first channel begins, the next channel is `stride` further on.
/// One value to the left and one behind each row belong to it: the zero padding of a 3x3 convolution.
#[derive(Clone, Copy)]
pub(super) struct Window<'a> {
    pub(super) values: &'a [f32],
    pub(super) rows: &'a [usize],
    pub(super) stride: usize,
}

impl<'a> Window<'a> {
    /// All rows of a channel, each with the value to its left and the one behind its `len` values.
    #[inline(always)]
    fn padded<const N: usize>(self, channel: usize, len: usize) -> [&'a [f32]; N] {
        let mut rows = [&[][..]; N];
        for n in 0..N {
            rows[n] = &self.values[self.rows[n] + channel * self.stride - 1..][..len + 2];
        }
        rows
    }
}

/// The values of [`Window::padded`] rows around the pixels at `at`: of each row those to the left, in the middle and to the right.
#[inline(always)]
fn neighbours<L: Lanes<Scalar = f32>, const N: usize>(rows: [&[f32]; N], at: usize) -> [[L; 3]; N] {
    let mut values = [[L::splat(0.0); 3]; N];
    for n in 0..N {
        let row = &rows[n][at..][..L::LANES + 2];
        for x in 0..3 {
            values[n][x] = bundle(row, x);
        }
    }
    values
}

kernel! {
    /// Depthwise 3x3 convolution: `target[j][c] = weights[c][9] + sum over taps of weights[c][tap] * source` for one or two picture rows
    /// `j`, from the three or four rows of `source`. `targets[j]` is where row `j` begins in `target`, channels are `stride` apart.
    pub(super) fn depthwise<'a>(
        weights: &'a [[f32; 10]], source: Window<'a>, target: &'a mut [f32], targets: &'a [usize], stride: usize, len: usize,
    ) {
        match *targets {
            [first] => depthwise_rows::<L, 1, 3>(weights, source, target, [first], stride, len),
            [first, second] => depthwise_rows::<L, 2, 4>(weights, source, target, [first, second], stride, len),
            _ => unreachable!("one row or two"),
        }
    }
}

/// `R` rows of [`depthwise`] from `N = R + 2`.
#[inline(always)]
fn depthwise_rows<L: Lanes<Scalar = f32>, const R: usize, const N: usize>(
    weights: &[[f32; 10]],
    source: Window<'_>,
    target: &mut [f32],
    targets: [usize; R],
    stride: usize,
    len: usize,
) {
    for (channel, weights) in weights.iter().enumerate() {
        let mut taps = [L::splat(0.0); 10];
        for tap in 0..10 {
            taps[tap] = L::splat(f64::from(weights[tap]));
        }
        let rows = source.padded::<N>(channel, len);
        for at in (0..len).step_by(L::LANES) {
            let mut sums = [taps[9]; R];
            let values = neighbours::<L, N>(rows, at);
            for row in 0..R {
                for tap in 0..9 {
                    sums[row] = values[row + tap / 3][tap % 3].mul_add(taps[tap], sums[row]);
                }
                sums[row].store(&mut target[targets[row] + channel * stride + at..][..L::LANES]);
            }
        }
    }
}

kernel! {
    /// The gradient of [`depthwise`] with respect to its weights, summed over pixels lane by lane, [`LANES_MAX`] values for each of a channel's ten.
    /// `gradient` holds the rows of the gradient of the result, one or two.
    pub(super) fn depthwise_weights<'a>(
        sums: &'a mut [f32], gradient: Window<'a>, source: Window<'a>, channels: usize, len: usize,
    ) {
        match gradient.rows.len() {
            1 => depthwise_weights_rows::<L, 1, 3>(sums, gradient, source, channels, len),
            2 => depthwise_weights_rows::<L, 2, 4>(sums, gradient, source, channels, len),
            _ => unreachable!("one row or two"),
        }
    }
}

/// `R` rows of [`depthwise_weights`] from `N = R + 2`.
#[inline(always)]
fn depthwise_weights_rows<L: Lanes<Scalar = f32>, const R: usize, const N: usize>(
    sums: &mut [f32],
    gradient: Window<'_>,
    source: Window<'_>,
    channels: usize,
    len: usize,
) {
    for channel in 0..channels {
        let (slopes, rows) = (gradient.padded::<R>(channel, len), source.padded::<N>(channel, len));
        let mut totals = [L::splat(0.0); 10];
        for at in (0..len).step_by(L::LANES) {
            let mut slope = [L::splat(0.0); R];
            for row in 0..R {
                slope[row] = bundle(slopes[row], at + 1);
                totals[9] = totals[9] + slope[row];
            }
            let values = neighbours::<L, N>(rows, at);
            for row in 0..R {
                for tap in 0..9 {
                    totals[tap] = values[row + tap / 3][tap % 3].mul_add(slope[row], totals[tap]);
                }
            }
        }
        for (tap, total) in totals.into_iter().enumerate() {
            add_to(sums, channel * 10 + tap, total);
        }
    }
}

kernel! {
    /// `target = (left + offset) * right`, value by value.
    pub(super) fn product<'a>(left: &'a [f32], offset: f32, right: &'a [f32], target: &'a mut [f32]) {
        let offset = L::splat(f64::from(offset));
        let pairs = left.chunks_exact(L::LANES).zip(right.chunks_exact(L::LANES));
        for (target, (left, right)) in target.chunks_exact_mut(L::LANES).zip(pairs) {
            ((L::load(left) + offset) * L::load(right)).store(target);
        }
    }
}

kernel! {
    /// Layer norm without weights: per pixel over the `channels` rows of `source`. `scale` receives 1 / standard deviation.
    pub(super) fn normalize<'a>(
        channels: usize, source: &'a [f32], target: &'a mut [f32], stride: usize, scale: &'a mut [f32], len: usize,
    ) {
        let share = L::splat(1.0 / channels as f64);
        for at in (0..len).step_by(L::LANES) {
            let mut total = L::splat(0.0);
            for channel in 0..channels {
                total = total + bundle::<L>(source, channel * stride + at);
            }
            let mean = total * share;
            let mut squares = L::splat(0.0);
            for channel in 0..channels {
                let difference = bundle::<L>(source, channel * stride + at) - mean;
                squares = difference.mul_add(difference, squares);
            }
            let factor = L::splat(1.0) / squares.mul_add(share, L::splat(NORM_EPSILON)).sqrt();
            factor.store(&mut scale[at..][..L::LANES]);
            for channel in 0..channels {
                let normal = (bundle::<L>(source, channel * stride + at) - mean) * factor;
                normal.store(&mut target[channel * stride + at..][..L::LANES]);
            }
        }
    }
}

kernel! {
    /// Adds to `target` the gradient of [`normalize`]'s input, given the gradient of its result, its result and its `scale`.
    pub(super) fn normalize_backward<'a>(
        channels: usize, gradient: &'a [f32], normal: &'a [f32], scale: &'a [f32], target: &'a mut [f32], stride: usize, len: usize,
    ) {
        let share = L::splat(1.0 / channels as f64);
        for at in (0..len).step_by(L::LANES) {
            let (mut mean, mut along) = (L::splat(0.0), L::splat(0.0));
            for channel in 0..channels {
                let slope = bundle::<L>(gradient, channel * stride + at);
                mean = mean + slope;
                along = slope.mul_add(bundle(normal, channel * stride + at), along);
            }
            let (mean, along) = (mean * share, along * share);
            let scale = bundle::<L>(scale, at);
            for channel in 0..channels {
                let first = channel * stride + at;
                let inner = bundle::<L>(gradient, first) - mean - bundle::<L>(normal, first) * along;
                let target = &mut target[first..][..L::LANES];
                inner.mul_add(scale, L::load(target)).store(target);
            }
        }
    }
}
