//! The inner loops of the adapters. Each works on rows of pixels, one row per channel, [`LANES`] pixels at a time.
//!
//! Register blocks are small arrays with loops of constant length over them, which the compiler unrolls; an index says more there than
//! an iterator. Rows are given as a slice and the offset of each row in it. Every kernel checks its offsets once, then reads and writes unchecked.

#![allow(clippy::needless_range_loop)]

use super::lanes::{Isa, LANES, Lanes, Portable};

#[cfg(target_arch = "x86_64")]
use super::lanes::Avx2;

/// Output rows a register block of [`dense`] and [`outer`] has at most.
const BLOCK: usize = 3;

/// Values of a cache line.
#[cfg(target_arch = "x86_64")]
const CACHE_LINE: usize = 16;

/// Floor under the variance of a layer norm.
const EPSILON: f32 = 1e-6;

/// Defines `$name`, which runs `$generic` with the vectors that `isa` allows.
macro_rules! dispatch {
    ($(#[$meta:meta])* $name:ident => $generic:ident($($arg:ident: $ty:ty),* $(,)?)) => {
        $(#[$meta])*
        #[allow(clippy::too_many_arguments)]
        pub(super) fn $name(isa: Isa, $($arg: $ty),*) {
            #[cfg(target_arch = "x86_64")]
            if isa.avx2() {
                #[target_feature(enable = "avx2,fma")]
                #[allow(clippy::too_many_arguments)]
                fn avx2($($arg: $ty),*) {
                    // SAFETY: this function runs only where AVX2 and FMA are there.
                    unsafe { $generic::<Avx2>($($arg),*) }
                }
                // SAFETY: `isa` says that the CPU has both features.
                return unsafe { avx2($($arg),*) };
            }
            #[cfg(not(target_arch = "x86_64"))]
            let Isa {} = isa;
            // SAFETY: plain arrays need no instruction that is not always there.
            unsafe { $generic::<Portable>($($arg),*) }
        }
    };
}

/// Rows of pixels: a slice, and where in it each row begins.
#[derive(Clone, Copy)]
pub(super) struct Rows<'a> {
    pub(super) values: &'a [f32],
    pub(super) offsets: &'a [usize],
}

impl Rows<'_> {
    /// Panics unless every row has `vectors` vectors.
    fn check(&self, vectors: usize) {
        assert!(self.offsets.iter().all(|&offset| offset + vectors * LANES <= self.values.len()), "a row ends early");
    }
}

/// Asks for rows that are needed soon: short pieces of rows far apart are what the hardware does not foresee.
pub(super) fn prefetch(rows: Rows<'_>, vectors: usize) {
    #[cfg(target_arch = "x86_64")]
    for &offset in rows.offsets {
        let Some(row) = rows.values.get(offset..offset + vectors * LANES) else { continue };
        for line in row.chunks(CACHE_LINE) {
            // SAFETY: SSE is part of x86-64, and a prefetch neither faults nor changes anything.
            unsafe { std::arch::x86_64::_mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T0 }>(line.as_ptr().cast()) };
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (rows, vectors);
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

dispatch! {
    /// `target[o] = layer.bias[o] + sum over i of layer.weight[o][i] * source[i] (+ residual[o])`,
    /// with the rows of `target` and `residual` `stride` and `residual.1` values apart.
    dense => dense_lanes(
        layer: &Dense, source: Rows<'_>, residual: Option<(&[f32], usize)>, target: &mut [f32], stride: usize, vectors: usize,
    )
}

/// # Safety
/// The CPU has the instructions of `S`.
#[inline(always)]
unsafe fn dense_lanes<S: Lanes>(
    layer: &Dense,
    source: Rows<'_>,
    residual: Option<(&[f32], usize)>,
    target: &mut [f32],
    stride: usize,
    vectors: usize,
) {
    let outputs = layer.bias.len();
    let reach = |stride: usize| (outputs - 1) * stride + vectors * LANES;
    source.check(vectors);
    assert!(source.offsets.len() == layer.inputs && reach(stride) <= target.len(), "rows do not fit the layer");
    assert!(
        residual.is_none_or(|(values, stride)| reach(stride) <= values.len()),
        "residual rows do not fit the layer"
    );
    let mut vector = 0;
    while vector < vectors {
        let wide = vectors - vector >= 4;
        let mut first = 0;
        while first < outputs {
            let weights = layer.weights[first * layer.inputs..].as_ptr();
            let bias = layer.bias[first..].as_ptr();
            let rows = BLOCK.min(outputs - first);
            // SAFETY: the rows from `first` on, `vector` vectors in, are inside the slices by the checks above: a wide block
            // touches 4 vectors and there are as many left; the block has `rows` outputs with `inputs` weights each.
            unsafe {
                let from = source.values.as_ptr().add(vector * LANES);
                let to = target.as_mut_ptr().add(first * stride + vector * LANES);
                let base = residual.map(|(values, s)| (values.as_ptr().add(first * s + vector * LANES), s));
                match (rows, wide) {
                    (3, true) => dense_block::<S, 3, 4>(weights, bias, from, source.offsets, base, to, stride),
                    (2, true) => dense_block::<S, 2, 4>(weights, bias, from, source.offsets, base, to, stride),
                    (_, true) => dense_block::<S, 1, 4>(weights, bias, from, source.offsets, base, to, stride),
                    (3, false) => dense_block::<S, 3, 1>(weights, bias, from, source.offsets, base, to, stride),
                    (2, false) => dense_block::<S, 2, 1>(weights, bias, from, source.offsets, base, to, stride),
                    (_, false) => dense_block::<S, 1, 1>(weights, bias, from, source.offsets, base, to, stride),
                }
            }
            first += rows;
        }
        vector += if wide { 4 } else { 1 };
    }
}

/// `O` outputs of a dense layer at `V` vectors of pixels.
///
/// # Safety
/// The CPU has the instructions of `S`; `weights` holds `O` values per offset, `bias` `O`; `from` plus each offset, `to` plus `O` strides
/// and the residual likewise point to `V` vectors.
#[inline(always)]
unsafe fn dense_block<S: Lanes, const O: usize, const V: usize>(
    weights: *const f32,
    bias: *const f32,
    from: *const f32,
    offsets: &[usize],
    residual: Option<(*const f32, usize)>,
    to: *mut f32,
    stride: usize,
) {
    // SAFETY: by the contract of this function every pointer below is in bounds.
    unsafe {
        let mut sums = [[S::splat(0.0); V]; O];
        for o in 0..O {
            let bias = S::splat(*bias.add(o));
            for v in 0..V {
                sums[o][v] = match residual {
                    Some((base, stride)) => S::load(base.add(o * stride + v * LANES)).add(bias),
                    None => bias,
                };
            }
        }
        let mut weights = weights;
        for &offset in offsets {
            let mut factors = [S::splat(0.0); O];
            for o in 0..O {
                factors[o] = S::splat(*weights.add(o));
            }
            for v in 0..V {
                let value = S::load(from.add(offset + v * LANES));
                for o in 0..O {
                    sums[o][v] = value.mul_add(factors[o], sums[o][v]);
                }
            }
            weights = weights.add(O);
        }
        for o in 0..O {
            for v in 0..V {
                sums[o][v].store(to.add(o * stride + v * LANES));
            }
        }
    }
}

dispatch! {
    /// `sums[(a, b)] += left[a] * right[b]` for every pair of rows, and behind these `sums[a] += left[a]` for every row of `left`,
    /// summed over pixels lane by lane: one vector per pair and per row.
    outer => outer_lanes(sums: &mut [f32], left: Rows<'_>, right: Rows<'_>, vectors: usize)
}

/// # Safety
/// The CPU has the instructions of `S`.
#[inline(always)]
unsafe fn outer_lanes<S: Lanes>(sums: &mut [f32], left: Rows<'_>, right: Rows<'_>, vectors: usize) {
    let (rows, columns) = (left.offsets.len(), right.offsets.len());
    left.check(vectors);
    right.check(vectors);
    assert!(rows * (columns + 1) * LANES <= sums.len(), "a sum per pair and per row is needed");
    let mut row = 0;
    while row < rows {
        let height = BLOCK.min(rows - row);
        let mut column = 0;
        while column < columns {
            let width = BLOCK.min(columns - column);
            let a = &left.offsets[row..row + height];
            let b = &right.offsets[column..column + width];
            // SAFETY: the offsets were checked above; the block's sums lie before `rows * columns` vectors, its totals before `rows` more.
            unsafe {
                let (x, y) = (left.values.as_ptr(), right.values.as_ptr());
                let to = sums.as_mut_ptr().add((row * columns + column) * LANES);
                let totals = (column == 0).then(|| sums.as_mut_ptr().add((rows * columns + row) * LANES));
                match (height, width) {
                    (3, 3) => outer_block::<S, 3, 3>(to, columns, totals, x, a, y, b, vectors),
                    (3, 2) => outer_block::<S, 3, 2>(to, columns, totals, x, a, y, b, vectors),
                    (3, _) => outer_block::<S, 3, 1>(to, columns, totals, x, a, y, b, vectors),
                    (2, 3) => outer_block::<S, 2, 3>(to, columns, totals, x, a, y, b, vectors),
                    (2, 2) => outer_block::<S, 2, 2>(to, columns, totals, x, a, y, b, vectors),
                    (2, _) => outer_block::<S, 2, 1>(to, columns, totals, x, a, y, b, vectors),
                    (_, 3) => outer_block::<S, 1, 3>(to, columns, totals, x, a, y, b, vectors),
                    (_, 2) => outer_block::<S, 1, 2>(to, columns, totals, x, a, y, b, vectors),
                    (_, _) => outer_block::<S, 1, 1>(to, columns, totals, x, a, y, b, vectors),
                }
            }
            column += width;
        }
        row += height;
    }
}

/// `A` by `B` pairs of [`outer`], and the totals of the `A` rows if asked for.
///
/// # Safety
/// As [`outer_loop`].
#[inline(always)]
#[allow(clippy::too_many_arguments)]
unsafe fn outer_block<S: Lanes, const A: usize, const B: usize>(
    sums: *mut f32,
    columns: usize,
    totals: Option<*mut f32>,
    left: *const f32,
    left_offsets: &[usize],
    right: *const f32,
    right_offsets: &[usize],
    vectors: usize,
) {
    // SAFETY: the contract is the same.
    unsafe {
        match totals {
            Some(totals) => {
                let row = outer_loop::<S, A, B, true>(sums, columns, left, left_offsets, right, right_offsets, vectors);
                for a in 0..A {
                    let to = totals.add(a * LANES);
                    S::load(to).add(row[a]).store(to);
                }
            }
            None => {
                outer_loop::<S, A, B, false>(sums, columns, left, left_offsets, right, right_offsets, vectors);
            }
        }
    }
}

/// The sums of `A` by `B` pairs; returns the totals of the `A` rows if `TOTALS`.
///
/// # Safety
/// The CPU has the instructions of `S`; `left` has `A` offsets, `right` `B`, each with `vectors` vectors behind it;
/// `sums` points to `A` rows of `columns` vectors, of which `B` are used.
#[inline(always)]
unsafe fn outer_loop<S: Lanes, const A: usize, const B: usize, const TOTALS: bool>(
    sums: *mut f32,
    columns: usize,
    left: *const f32,
    left_offsets: &[usize],
    right: *const f32,
    right_offsets: &[usize],
    vectors: usize,
) -> [S; A] {
    // SAFETY: by the contract of this function every pointer below is in bounds.
    unsafe {
        let mut pairs = [[S::splat(0.0); B]; A];
        let mut totals = [S::splat(0.0); A];
        let left: [*const f32; A] = std::array::from_fn(|a| left.add(left_offsets[a]));
        let right: [*const f32; B] = std::array::from_fn(|b| right.add(right_offsets[b]));
        for vector in 0..vectors {
            let mut y = [S::splat(0.0); B];
            for b in 0..B {
                y[b] = S::load(right[b].add(vector * LANES));
            }
            for a in 0..A {
                let x = S::load(left[a].add(vector * LANES));
                for b in 0..B {
                    pairs[a][b] = x.mul_add(y[b], pairs[a][b]);
                }
                if TOTALS {
                    totals[a] = totals[a].add(x);
                }
            }
        }
        for a in 0..A {
            for b in 0..B {
                let to = sums.add((a * columns + b) * LANES);
                S::load(to).add(pairs[a][b]).store(to);
            }
        }
        totals
    }
}

dispatch! {
    /// `sums[a] += rows[a]`, summed over pixels lane by lane.
    sum => sum_lanes(sums: &mut [f32], rows: Rows<'_>, vectors: usize)
}

/// # Safety
/// The CPU has the instructions of `S`.
#[inline(always)]
unsafe fn sum_lanes<S: Lanes>(sums: &mut [f32], rows: Rows<'_>, vectors: usize) {
    rows.check(vectors);
    assert!(rows.offsets.len() * LANES <= sums.len(), "a sum per row is needed");
    for (row, &offset) in rows.offsets.iter().enumerate() {
        // SAFETY: checked above.
        unsafe {
            let from = rows.values.as_ptr().add(offset);
            let to = sums.as_mut_ptr().add(row * LANES);
            let mut total = [S::load(to), S::splat(0.0)];
            for vector in 0..vectors {
                let value = S::load(from.add(vector * LANES));
                total[vector % 2] = total[vector % 2].add(value);
            }
            total[0].add(total[1]).store(to);
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

impl Window<'_> {
    /// Panics unless all 3x3 neighbourhoods of `vectors` vectors in `channels` channels are inside.
    fn check(&self, channels: usize, vectors: usize) {
        let reach = (channels - 1) * self.stride + vectors * LANES + 1;
        assert!(
            self.rows.iter().all(|&row| row >= 1 && row + reach <= self.values.len()),
            "a neighbourhood reaches beyond the rows"
        );
    }
}

dispatch! {
    /// Depthwise 3x3 convolution: `target[j][c] = weights[c][9] + sum over taps of weights[c][tap] * source` for one or two picture rows
    /// `j`, from the three or four rows of `source`. `targets[j]` is where row `j` begins in `target`, channels are `stride` apart.
    depthwise => depthwise_lanes(
        weights: &[[f32; 10]], source: Window<'_>, target: &mut [f32], targets: &[usize], stride: usize, vectors: usize,
    )
}

/// # Safety
/// The CPU has the instructions of `S`.
#[inline(always)]
unsafe fn depthwise_lanes<S: Lanes>(
    weights: &[[f32; 10]],
    source: Window<'_>,
    target: &mut [f32],
    targets: &[usize],
    stride: usize,
    vectors: usize,
) {
    source.check(weights.len(), vectors);
    let reach = (weights.len() - 1) * stride + vectors * LANES;
    assert!(source.rows.len() == targets.len() + 2, "a 3x3 convolution needs a row above and below");
    assert!(targets.iter().all(|&row| row + reach <= target.len()), "a target row ends early");
    // SAFETY: the checks above cover every row of every channel.
    unsafe {
        match *targets {
            [first] => depthwise_rows::<S, 1, 3>(weights, source, target.as_mut_ptr(), [first], stride, vectors),
            [first, second] => {
                depthwise_rows::<S, 2, 4>(weights, source, target.as_mut_ptr(), [first, second], stride, vectors);
            }
            _ => {}
        }
    }
}

/// `R` rows of [`depthwise`] from `N = R + 2`.
///
/// # Safety
/// The CPU has the instructions of `S`; `source` was checked and has `N` rows; the target rows of all channels are in bounds.
#[inline(always)]
unsafe fn depthwise_rows<S: Lanes, const R: usize, const N: usize>(
    weights: &[[f32; 10]],
    source: Window<'_>,
    target: *mut f32,
    targets: [usize; R],
    stride: usize,
    vectors: usize,
) {
    // SAFETY: by the contract of this function every pointer below is in bounds.
    unsafe {
        for (channel, weights) in weights.iter().enumerate() {
            let taps: [S; 9] = std::array::from_fn(|tap| S::splat(weights[tap]));
            let bias = S::splat(weights[9]);
            let from: [*const f32; N] =
                std::array::from_fn(|n| source.values.as_ptr().add(source.rows[n] + channel * source.stride - 1));
            for vector in 0..vectors {
                let mut sums = [bias; R];
                for n in 0..N {
                    for x in 0..3 {
                        let value = S::load(from[n].add(vector * LANES + x));
                        for r in 0..R {
                            if r <= n && n < r + 3 {
                                sums[r] = value.mul_add(taps[(n - r) * 3 + x], sums[r]);
                            }
                        }
                    }
                }
                for r in 0..R {
                    sums[r].store(target.add(targets[r] + channel * stride + vector * LANES));
                }
            }
        }
    }
}

dispatch! {
    /// The gradient of [`depthwise`] with respect to its weights, summed over pixels lane by lane into ten vectors per channel.
    /// `gradient` holds the rows of the gradient of the result, one or two.
    depthwise_weights => depthwise_weights_lanes(
        sums: &mut [f32], gradient: Window<'_>, source: Window<'_>, channels: usize, vectors: usize,
    )
}

/// # Safety
/// The CPU has the instructions of `S`.
#[inline(always)]
unsafe fn depthwise_weights_lanes<S: Lanes>(
    sums: &mut [f32],
    gradient: Window<'_>,
    source: Window<'_>,
    channels: usize,
    vectors: usize,
) {
    source.check(channels, vectors);
    gradient.check(channels, vectors);
    assert!(source.rows.len() == gradient.rows.len() + 2, "a 3x3 convolution needs a row above and below");
    assert!(channels * 10 * LANES <= sums.len(), "ten sums per channel are needed");
    // SAFETY: the checks above cover every row of every channel.
    unsafe {
        match gradient.rows.len() {
            1 => depthwise_weights_rows::<S, 1, 3>(sums.as_mut_ptr(), gradient, source, channels, vectors),
            2 => depthwise_weights_rows::<S, 2, 4>(sums.as_mut_ptr(), gradient, source, channels, vectors),
            _ => {}
        }
    }
}

/// `R` rows of [`depthwise_weights`] from `N = R + 2`.
///
/// # Safety
/// The CPU has the instructions of `S`; both windows were checked and have `R` and `N` rows; `sums` holds ten vectors per channel.
#[inline(always)]
unsafe fn depthwise_weights_rows<S: Lanes, const R: usize, const N: usize>(
    sums: *mut f32,
    gradient: Window<'_>,
    source: Window<'_>,
    channels: usize,
    vectors: usize,
) {
    // SAFETY: by the contract of this function every pointer below is in bounds.
    unsafe {
        for channel in 0..channels {
            let above: [*const f32; R] =
                std::array::from_fn(|r| gradient.values.as_ptr().add(gradient.rows[r] + channel * gradient.stride));
            let from: [*const f32; N] =
                std::array::from_fn(|n| source.values.as_ptr().add(source.rows[n] + channel * source.stride - 1));
            let mut total = [S::splat(0.0); 10];
            for vector in 0..vectors {
                let mut slope = [S::splat(0.0); R];
                for r in 0..R {
                    slope[r] = S::load(above[r].add(vector * LANES));
                    total[9] = total[9].add(slope[r]);
                }
                for n in 0..N {
                    for x in 0..3 {
                        let value = S::load(from[n].add(vector * LANES + x));
                        for r in 0..R {
                            if r <= n && n < r + 3 {
                                let tap = (n - r) * 3 + x;
                                total[tap] = value.mul_add(slope[r], total[tap]);
                            }
                        }
                    }
                }
            }
            for (tap, total) in total.into_iter().enumerate() {
                let to = sums.add((channel * 10 + tap) * LANES);
                S::load(to).add(total).store(to);
            }
        }
    }
}

dispatch! {
    /// `target = left * right`, value by value.
    product => product_lanes(left: &[f32], right: &[f32], target: &mut [f32])
}

/// # Safety
/// The CPU has the instructions of `S`.
#[inline(always)]
unsafe fn product_lanes<S: Lanes>(left: &[f32], right: &[f32], target: &mut [f32]) {
    assert!(
        left.len() == target.len() && right.len() == target.len() && target.len().is_multiple_of(LANES),
        "lengths differ"
    );
    for at in (0..target.len()).step_by(LANES) {
        // SAFETY: all three slices have whole vectors and the same length.
        unsafe {
            S::load(left.as_ptr().add(at)).mul(S::load(right.as_ptr().add(at))).store(target.as_mut_ptr().add(at))
        }
    }
}

dispatch! {
    /// `target = (left + offset) * right`, value by value.
    offset_product => offset_product_lanes(left: &[f32], offset: f32, right: &[f32], target: &mut [f32])
}

/// # Safety
/// The CPU has the instructions of `S`.
#[inline(always)]
unsafe fn offset_product_lanes<S: Lanes>(left: &[f32], offset: f32, right: &[f32], target: &mut [f32]) {
    assert!(
        left.len() == target.len() && right.len() == target.len() && target.len().is_multiple_of(LANES),
        "lengths differ"
    );
    for at in (0..target.len()).step_by(LANES) {
        // SAFETY: all three slices have whole vectors and the same length.
        unsafe {
            let sum = S::load(left.as_ptr().add(at)).add(S::splat(offset));
            sum.mul(S::load(right.as_ptr().add(at))).store(target.as_mut_ptr().add(at));
        }
    }
}

dispatch! {
    /// Layer norm without weights: per pixel over the `channels` rows of `source`. `scale` receives 1 / standard deviation.
    normalize => normalize_lanes(
        channels: usize, source: &[f32], source_stride: usize, target: &mut [f32], stride: usize, scale: &mut [f32], vectors: usize,
    )
}

/// # Safety
/// The CPU has the instructions of `S`.
#[inline(always)]
unsafe fn normalize_lanes<S: Lanes>(
    channels: usize,
    source: &[f32],
    source_stride: usize,
    target: &mut [f32],
    stride: usize,
    scale: &mut [f32],
    vectors: usize,
) {
    let reach = |stride: usize| (channels - 1) * stride + vectors * LANES;
    assert!(reach(source_stride) <= source.len() && reach(stride) <= target.len(), "a row ends early");
    assert!(vectors * LANES <= scale.len(), "a row ends early");
    for at in (0..vectors * LANES).step_by(LANES) {
        // SAFETY: checked above.
        unsafe {
            let share = S::splat(1.0 / channels as f32);
            let value = |channel: usize| S::load(source.as_ptr().add(channel * source_stride + at));
            let mut total = S::splat(0.0);
            for channel in 0..channels {
                total = total.add(value(channel));
            }
            let mean = total.mul(share);
            let mut squares = S::splat(0.0);
            for channel in 0..channels {
                let difference = value(channel).sub(mean);
                squares = difference.mul_add(difference, squares);
            }
            let factor = squares.mul_add(share, S::splat(EPSILON)).recip_sqrt();
            factor.store(scale.as_mut_ptr().add(at));
            for channel in 0..channels {
                value(channel).sub(mean).mul(factor).store(target.as_mut_ptr().add(channel * stride + at));
            }
        }
    }
}

dispatch! {
    /// Adds to `target` the gradient of [`normalize`]'s input, given the gradient of its result, its result and its `scale`.
    normalize_backward => normalize_backward_lanes(
        channels: usize, gradient: &[f32], gradient_stride: usize, normal: &[f32], normal_stride: usize, scale: &[f32],
        target: &mut [f32], stride: usize, vectors: usize,
    )
}

/// # Safety
/// The CPU has the instructions of `S`.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
unsafe fn normalize_backward_lanes<S: Lanes>(
    channels: usize,
    gradient: &[f32],
    gradient_stride: usize,
    normal: &[f32],
    normal_stride: usize,
    scale: &[f32],
    target: &mut [f32],
    stride: usize,
    vectors: usize,
) {
    let reach = |stride: usize| (channels - 1) * stride + vectors * LANES;
    assert!(reach(gradient_stride) <= gradient.len() && reach(normal_stride) <= normal.len(), "a row ends early");
    assert!(reach(stride) <= target.len() && vectors * LANES <= scale.len(), "a row ends early");
    for at in (0..vectors * LANES).step_by(LANES) {
        // SAFETY: checked above.
        unsafe {
            let share = S::splat(1.0 / channels as f32);
            let (mut mean, mut along) = (S::splat(0.0), S::splat(0.0));
            for channel in 0..channels {
                let slope = S::load(gradient.as_ptr().add(channel * gradient_stride + at));
                mean = mean.add(slope);
                along = slope.mul_add(S::load(normal.as_ptr().add(channel * normal_stride + at)), along);
            }
            let (mean, along) = (mean.mul(share), along.mul(share));
            let scale = S::load(scale.as_ptr().add(at));
            for channel in 0..channels {
                let slope = S::load(gradient.as_ptr().add(channel * gradient_stride + at));
                let normal = S::load(normal.as_ptr().add(channel * normal_stride + at));
                let to = target.as_mut_ptr().add(channel * stride + at);
                let inner = slope.sub(mean).sub(normal.mul(along));
                inner.mul_add(scale, S::load(to)).store(to);
            }
        }
    }
}
