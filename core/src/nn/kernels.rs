//! Loops over one band: channels x pixels, channel after channel. No allocation, no threads; callers share the bands out.

use super::scalar::{Scalar, kernel, multiply_add};
use crate::real::Lanes;

/// Added to the variance by the layer norm.
pub(crate) const NORM_EPSILON: f64 = 1e-6;
/// Pixels that a loop over channels keeps sums for.
const LANES: usize = 32;

/// Mean and reciprocal standard deviation over channels of the pixels `start..start + LANES` of `x`, or of as many as there are.
#[inline(always)]
fn moments<E: Scalar, L: Lanes<Scalar = E>>(x: &[E], channels: usize, start: usize) -> ([E; LANES], [E; LANES]) {
    let pixels = x.len() / channels;
    let lanes = LANES.min(pixels - start);
    let (mut mean, mut scale) = ([E::default(); LANES], [E::default(); LANES]);
    let share = E::splat(1.0 / channels as f64);
    for row in x.chunks_exact(pixels) {
        for (mean, &value) in mean.iter_mut().zip(&row[start..start + lanes]) {
            *mean += value;
        }
    }
    for mean in &mut mean {
        *mean *= share;
    }
    for row in x.chunks_exact(pixels) {
        for ((scale, &mean), &value) in scale.iter_mut().zip(&mean).zip(&row[start..start + lanes]) {
            let off = value - mean;
            *scale = multiply_add::<E, L>(off, off, *scale);
        }
    }
    for scale in &mut scale {
        *scale = E::ONE / multiply_add::<E, L>(*scale, share, E::splat(NORM_EPSILON)).sqrt();
    }
    (mean, scale)
}

kernel! {
    /// Layer norm over channels: `out[c] = (x[c] - mean) / deviation * weight[c] + bias[c]` at every pixel.
    pub(crate) fn norm<'a, E>(out: &'a mut [E], x: &'a [E], weight: &'a [E], bias: &'a [E]) {
        let pixels = x.len() / weight.len();
        for start in (0..pixels).step_by(LANES) {
            let (mean, scale) = moments::<E, L>(x, weight.len(), start);
            let lanes = LANES.min(pixels - start);
            for (c, (row, to)) in x.chunks_exact(pixels).zip(out.chunks_exact_mut(pixels)).enumerate() {
                let from = &row[start..start + lanes];
                for (i, (to, &value)) in to[start..start + lanes].iter_mut().zip(from).enumerate() {
                    *to = multiply_add::<E, L>((value - mean[i]) * scale[i], weight[c], bias[c]);
                }
            }
        }
    }
}

kernel! {
    /// Adds the gradient of [`norm`] with respect to `x` to `dx`.
    pub(crate) fn norm_backward<'a, E>(dx: &'a mut [E], dy: &'a [E], x: &'a [E], weight: &'a [E]) {
        let pixels = x.len() / weight.len();
        let share = E::splat(1.0 / weight.len() as f64);
        for start in (0..pixels).step_by(LANES) {
            let (mean, scale) = moments::<E, L>(x, weight.len(), start);
            let lanes = LANES.min(pixels - start);
            let (mut along_one, mut along_x) = ([E::default(); LANES], [E::default(); LANES]);
            for ((x, dy), &weight) in x.chunks_exact(pixels).zip(dy.chunks_exact(pixels)).zip(weight) {
                for (i, (&x, &dy)) in x[start..start + lanes].iter().zip(&dy[start..start + lanes]).enumerate() {
                    let slope = dy * weight;
                    along_one[i] += slope;
                    along_x[i] = multiply_add::<E, L>(slope, (x - mean[i]) * scale[i], along_x[i]);
                }
            }
            for i in 0..LANES {
                along_one[i] *= share;
                along_x[i] *= share;
            }
            let rows = x.chunks_exact(pixels).zip(dy.chunks_exact(pixels)).zip(dx.chunks_exact_mut(pixels));
            for (((x, dy), dx), &weight) in rows.zip(weight) {
                let (x, dy) = (&x[start..start + lanes], &dy[start..start + lanes]);
                for (i, dx) in dx[start..start + lanes].iter_mut().enumerate() {
                    let normal = (x[i] - mean[i]) * scale[i];
                    *dx += scale[i] * (dy[i] * weight - along_one[i] - normal * along_x[i]);
                }
            }
        }
    }
}

kernel! {
    /// Adds the gradients of [`norm`] with respect to its weight and bias.
    pub(crate) fn norm_backward_params<'a, E>(dweight: &'a mut [E], dbias: &'a mut [E], dy: &'a [E], x: &'a [E]) {
        let pixels = x.len() / dweight.len();
        for start in (0..pixels).step_by(LANES) {
            let (mean, scale) = moments::<E, L>(x, dweight.len(), start);
            let lanes = LANES.min(pixels - start);
            for (c, (x, dy)) in x.chunks_exact(pixels).zip(dy.chunks_exact(pixels)).enumerate() {
                let (x, dy) = (&x[start..start + lanes], &dy[start..start + lanes]);
                let mut along_x = [E::default(); LANES];
                for (i, (&x, &dy)) in x.iter().zip(dy).enumerate() {
                    along_x[i] = dy * ((x - mean[i]) * scale[i]);
                }
                dweight[c] += sum::<E>(&along_x);
                dbias[c] += sum::<E>(dy);
            }
        }
    }
}

kernel! {
    /// 3x3 convolution with zero padding of one channel's rows of a band: `rows`, with the row above and the row below them if there are any.
    pub(crate) fn depthwise<'a, E>(out: &'a mut [E], above: Option<&'a [E]>, rows: &'a [E], below: Option<&'a [E]>, width: usize, weight: &'a [E; 9], bias: E) {
        out.fill(bias);
        let count = rows.len() / width;
        for (r, out) in out.chunks_exact_mut(width).enumerate() {
            let lines = [
                if r == 0 { above } else { Some(&rows[(r - 1) * width..r * width]) },
                Some(&rows[r * width..(r + 1) * width]),
                if r + 1 == count { below } else { Some(&rows[(r + 1) * width..(r + 2) * width]) },
            ];
            for (line, taps) in lines.into_iter().zip(weight.chunks_exact(3)) {
                let Some(line) = line else { continue };
                let (left, middle, right) = (taps[0], taps[1], taps[2]);
                if width == 1 {
                    out[0] = multiply_add::<E, L>(line[0], middle, out[0]);
                    continue;
                }
                let last = width - 1;
                out[0] += line[0] * middle + line[1] * right;
                out[last] += line[last - 1] * left + line[last] * middle;
                let inner = line[..last - 1].iter().zip(&line[1..last]).zip(&line[2..]);
                for (out, ((&a, &b), &c)) in out[1..last].iter_mut().zip(inner) {
                    let sum = multiply_add::<E, L>(a, left, *out);
                    *out = multiply_add::<E, L>(c, right, multiply_add::<E, L>(b, middle, sum));
                }
            }
        }
    }
}

kernel! {
    /// Adds the gradient of [`depthwise`] with respect to its nine weights.
    pub(crate) fn depthwise_backward_weight<'a, E>(dweight: &'a mut [E], dy: &'a [E], above: Option<&'a [E]>, rows: &'a [E], below: Option<&'a [E]>, width: usize) {
        let count = rows.len() / width;
        let mut sums = [[E::default(); 16]; 9];
        for (r, dy) in dy.chunks_exact(width).enumerate() {
            let lines = [
                if r == 0 { above } else { Some(&rows[(r - 1) * width..r * width]) },
                Some(&rows[r * width..(r + 1) * width]),
                if r + 1 == count { below } else { Some(&rows[(r + 1) * width..(r + 2) * width]) },
            ];
            for (line, sums) in lines.into_iter().zip(sums.chunks_exact_mut(3)) {
                let Some(line) = line else { continue };
                add_products_in_lanes::<E, L>(&mut sums[0], &dy[1..], &line[..width - 1]);
                add_products_in_lanes::<E, L>(&mut sums[1], dy, line);
                add_products_in_lanes::<E, L>(&mut sums[2], &dy[..width - 1], &line[1..]);
            }
        }
        for (dweight, sums) in dweight.iter_mut().zip(sums) {
            *dweight += sums.into_iter().fold(E::default(), |total, sum| total + sum);
        }
    }
}

/// Adds products to sums in turn, for as many pairs as both have.
#[inline(always)]
fn add_products_in_lanes<E: Scalar, L: Lanes<Scalar = E>>(sums: &mut [E; 16], a: &[E], b: &[E]) {
    let len = a.len().min(b.len());
    for (a, b) in a.chunks_exact(16).zip(b.chunks_exact(16)) {
        for ((sum, &a), &b) in sums.iter_mut().zip(a).zip(b) {
            *sum = multiply_add::<E, L>(a, b, *sum);
        }
    }
    let start = len / 16 * 16;
    for (sum, (&a, &b)) in sums.iter_mut().zip(a[start..len].iter().zip(&b[start..len])) {
        *sum += a * b;
    }
}

kernel! {
    /// Sum of products, over as many pairs as both have.
    pub(crate) fn dot<'a, E>(a: &'a [E], b: &'a [E]) -> E {
        let mut sums = [E::default(); 16];
        add_products_in_lanes::<E, L>(&mut sums, a, b);
        sums.into_iter().fold(E::default(), |total, sum| total + sum)
    }
}

kernel! {
    /// Sum.
    pub(crate) fn sum<'a, E>(values: &'a [E]) -> E {
        let mut sums = [E::default(); 16];
        for values in values.chunks(16) {
            for (sum, &value) in sums.iter_mut().zip(values) {
                *sum += value;
            }
        }
        sums.into_iter().fold(E::default(), |total, sum| total + sum)
    }
}

kernel! {
    /// Simple gate: the first half of `x` times its second half.
    pub(crate) fn gate<'a, E>(out: &'a mut [E], x: &'a [E]) {
        let (a, b) = x.split_at(x.len() / 2);
        for ((out, &a), &b) in out.iter_mut().zip(a).zip(b) {
            *out = a * b;
        }
    }
}

kernel! {
    /// Turns `x`, the input of [`gate`], into the gradient with respect to it.
    pub(crate) fn gate_backward<'a, E>(x: &'a mut [E], dy: &'a [E]) {
        let (a, b) = x.split_at_mut(x.len() / 2);
        for ((a, b), &dy) in a.iter_mut().zip(b).zip(dy) {
            (*a, *b) = (dy * *b, dy * *a);
        }
    }
}

kernel! {
    /// `out[c] = x[c] * scale[c]` at every pixel.
    pub(crate) fn scale<'a, E>(out: &'a mut [E], x: &'a [E], scale: &'a [E]) {
        let pixels = x.len() / scale.len();
        for ((out, x), &scale) in out.chunks_exact_mut(pixels).zip(x.chunks_exact(pixels)).zip(scale) {
            for (out, &x) in out.iter_mut().zip(x) {
                *out = x * scale;
            }
        }
    }
}

kernel! {
    /// `out[c] += x[c] * scale[c]` at every pixel.
    pub(crate) fn add_scaled<'a, E>(out: &'a mut [E], x: &'a [E], scale: &'a [E]) {
        let pixels = x.len() / scale.len();
        for ((out, x), &scale) in out.chunks_exact_mut(pixels).zip(x.chunks_exact(pixels)).zip(scale) {
            for (out, &x) in out.iter_mut().zip(x) {
                *out = multiply_add::<E, L>(x, scale, *out);
            }
        }
    }
}

kernel! {
    /// `x[c] = x[c] * scale[c] + shift[c]` at every pixel.
    pub(crate) fn scale_shift<'a, E>(x: &'a mut [E], scale: &'a [E], shift: &'a [E]) {
        let pixels = x.len() / scale.len();
        for ((x, &scale), &shift) in x.chunks_exact_mut(pixels).zip(scale).zip(shift) {
            for x in x.iter_mut() {
                *x = multiply_add::<E, L>(*x, scale, shift);
            }
        }
    }
}

kernel! {
    /// `out += x`.
    pub(crate) fn add<'a, E>(out: &'a mut [E], x: &'a [E]) {
        for (out, &x) in out.iter_mut().zip(x) {
            *out += x;
        }
    }
}

kernel! {
    /// `out *= x`.
    pub(crate) fn times<'a, E>(out: &'a mut [E], x: &'a [E]) {
        for (out, &x) in out.iter_mut().zip(x) {
            *out *= x;
        }
    }
}

kernel! {
    /// `sums += x`.
    pub(crate) fn add_wide<'a, E>(sums: &'a mut [f64], x: &'a [E]) {
        for (sum, x) in sums.iter_mut().zip(x) {
            *sum += x.wide();
        }
    }
}

kernel! {
    /// `sums += new - old`.
    pub(crate) fn exchange_wide<'a, E>(sums: &'a mut [f64], new: &'a [E], old: &'a [E]) {
        for (sum, (new, old)) in sums.iter_mut().zip(new.iter().zip(old)) {
            *sum += new.wide() - old.wide();
        }
    }
}

kernel! {
    /// `share` times the sums of `values` over `span` places around each, moved inwards at the ends; `prefix` has room for one more than there are values.
    pub(crate) fn running_means<'a, E>(out: &'a mut [E], values: &'a [f64], prefix: &'a mut [f64], span: usize, share: f64) {
        let mut sum = 0.0;
        prefix[0] = 0.0;
        for (prefix, &value) in prefix[1..].iter_mut().zip(values) {
            sum += value;
            *prefix = sum;
        }
        let (before, inner) = (span / 2, values.len() - span + 1);
        out[..before].fill(E::splat((prefix[span] - prefix[0]) * share));
        for ((out, &low), &high) in out[before..before + inner].iter_mut().zip(&prefix[..inner]).zip(&prefix[span..]) {
            *out = E::splat((high - low) * share);
        }
        out[before + inner..].fill(E::splat((prefix[values.len()] - prefix[inner - 1]) * share));
    }
}

kernel! {
    /// `out[p] += factor` times the sum over channels of `a[c][p] b[c][p]`.
    pub(crate) fn add_products<'a, E>(out: &'a mut [E], a: &'a [E], b: &'a [E], factor: E) {
        let pixels = out.len();
        for (a, b) in a.chunks_exact(pixels).zip(b.chunks_exact(pixels)) {
            for (out, (&a, &b)) in out.iter_mut().zip(a.iter().zip(b)) {
                *out = multiply_add::<E, L>(factor * a, b, *out);
            }
        }
    }
}

kernel! {
    /// `out[c][p] += x[c][p] weight[p]`.
    pub(crate) fn add_weighted<'a, E>(out: &'a mut [E], x: &'a [E], weight: &'a [E]) {
        let pixels = weight.len();
        for (out, x) in out.chunks_exact_mut(pixels).zip(x.chunks_exact(pixels)) {
            for (out, (&x, &weight)) in out.iter_mut().zip(x.iter().zip(weight)) {
                *out = multiply_add::<E, L>(x, weight, *out);
            }
        }
    }
}

kernel! {
    /// Softmax over the rows of `x`, each of as many pixels as `largest` and `sums` have room for.
    pub(crate) fn softmax<'a, E>(x: &'a mut [E], largest: &'a mut [E], sums: &'a mut [E]) {
        let pixels = largest.len();
        largest.copy_from_slice(&x[..pixels]);
        for row in x.chunks_exact(pixels).skip(1) {
            for (largest, &x) in largest.iter_mut().zip(row) {
                *largest = if x > *largest { x } else { *largest };
            }
        }
        sums.fill(E::default());
        for row in x.chunks_exact_mut(pixels) {
            for ((x, &largest), sum) in row.iter_mut().zip(&*largest).zip(&mut *sums) {
                *x = (*x - largest).exp();
                *sum += *x;
            }
        }
        for sum in &mut *sums {
            *sum = E::ONE / *sum;
        }
        for row in x.chunks_exact_mut(pixels) {
            for (x, &share) in row.iter_mut().zip(&*sums) {
                *x *= share;
            }
        }
    }
}

kernel! {
    /// Takes one more `x` into a mean, a maximum and a sum of squared deviations (Welford, "Note on a Method for Calculating Corrected Sums of Squares
    /// and Products", 1962); `share` is the reciprocal of how many there are with it.
    pub(crate) fn take_in<'a, E>(mean: &'a mut [E], largest: &'a mut [E], squares: &'a mut [E], x: &'a [E], share: E) {
        for (((mean, largest), squares), &x) in mean.iter_mut().zip(largest).zip(squares).zip(x) {
            let off = x - *mean;
            *mean = multiply_add::<E, L>(off, share, *mean);
            *squares = multiply_add::<E, L>(off, x - *mean, *squares);
            *largest = if x > *largest { x } else { *largest };
        }
    }
}

kernel! {
    /// `x = sqrt(x share + added)`.
    pub(crate) fn deviation<'a, E>(x: &'a mut [E], share: E, added: E) {
        for x in x.iter_mut() {
            *x = multiply_add::<E, L>(*x, share, added).sqrt();
        }
    }
}

/// Sets every pixel of channel `c` to `values[c]`, or to zero where there are none.
pub(crate) fn fill<E: Scalar>(out: &mut [E], channels: usize, values: Option<&[E]>) {
    let pixels = out.len() / channels;
    for (c, row) in out.chunks_exact_mut(pixels).enumerate() {
        row.fill(values.map_or(E::default(), |values| values[c]));
    }
}
