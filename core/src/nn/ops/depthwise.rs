//! Depthwise 3x3 convolution with zero padding.

use dfdx::tensor::{Cpu, Tape};
use rayon::prelude::*;

use super::{expect, sum_over_bands};
use crate::error::Result;
use crate::nn::kernels::{depthwise, depthwise_backward_weight, sum};
use crate::nn::layout::Layout;
use crate::nn::scalar::Scalar;
use crate::nn::tape::{Param, Planes, record};

/// Depthwise 3x3 convolution with zero padding 1: every channel with its own nine weights. `weight` (C, 1, 3, 3), `bias` (C).
pub(crate) fn depthwise3x3<E: Scalar, T: Tape<E, Cpu>>(
    x: Planes<E, T>,
    weight: &Param<E>,
    bias: &Param<E>,
) -> Result<Planes<E, T>> {
    let layout = x.layout;
    expect("depthwise weight", weight, 9 * layout.channels)?;
    expect("depthwise bias", bias, layout.channels)?;
    let mut out = x.pool().take(layout.len());
    let values = x.values();
    out.par_chunks_mut(layout.band_len()).enumerate().for_each(|(band, out)| {
        depthwise_band(out, values, layout, band, |c| (taps(weight.values(), c), bias.values()[c]));
    });

    let (x, tape) = x.split();
    let (weight, bias) = (weight.clone(), bias.clone());
    let wanted = T::OWNS_TAPE && (x.is_wanted() || weight.is_tracked() || bias.is_tracked());
    record(out, layout, tape, wanted, move |dy, grads| {
        x.add_gradient(grads, || {
            let mut dx = x.pool().take(layout.len());
            dx.par_chunks_mut(layout.band_len()).enumerate().for_each(|(band, dx)| {
                depthwise_band(dx, &dy, layout, band, |c| (turned(weight.values(), c), E::default()));
            });
            dx
        })?;
        weight.add_gradient(grads, |dweight| {
            sum_over_bands(dweight, layout.bands(), |dweight, band| {
                let dy = &dy[layout.band(band)];
                let pixels = dy.len() / layout.channels;
                for (c, (dy, dweight)) in dy.chunks_exact(pixels).zip(dweight.chunks_exact_mut(9)).enumerate() {
                    let (above, rows, below) = channel_rows(x.values(), layout, band, c);
                    depthwise_backward_weight(dweight, dy, above, rows, below, layout.width);
                }
            });
        })?;
        bias.add_gradient(grads, |dbias| {
            sum_over_bands(dbias, layout.bands(), |dbias, band| {
                let dy = &dy[layout.band(band)];
                for (dbias, dy) in dbias.iter_mut().zip(dy.chunks_exact(dy.len() / layout.channels)) {
                    *dbias += sum(dy);
                }
            });
        })
    })
}

/// The nine weights of channel `c`.
pub(crate) fn taps<E: Scalar>(weight: &[E], c: usize) -> [E; 9] {
    std::array::from_fn(|tap| weight[9 * c + tap])
}

/// The nine weights of channel `c` turned by half a turn: those that take gradients back.
pub(crate) fn turned<E: Scalar>(weight: &[E], c: usize) -> [E; 9] {
    std::array::from_fn(|tap| weight[9 * c + 8 - tap])
}

/// The rows of channel `c` in band `band`, with the row above and the row below where the image goes on.
pub(crate) fn channel_rows<E: Scalar>(
    x: &[E],
    layout: Layout,
    band: usize,
    c: usize,
) -> (Option<&[E]>, &[E], Option<&[E]>) {
    let rows = layout.band_rows(band);
    let above = rows.start.checked_sub(1).map(|row| &x[layout.row(c, row)]);
    let below = (rows.end < layout.height).then(|| &x[layout.row(c, rows.end)]);
    (above, &x[layout.row(c, rows.start).start..][..rows.len() * layout.width], below)
}

/// Band `band` of the depthwise convolution of `x`, with the weights and the bias that `weight` gives for each channel.
pub(crate) fn depthwise_band<E: Scalar>(
    out: &mut [E],
    x: &[E],
    layout: Layout,
    band: usize,
    weight: impl Fn(usize) -> ([E; 9], E),
) {
    let pixels = out.len() / layout.channels;
    for (c, out) in out.chunks_exact_mut(pixels).enumerate() {
        let (above, rows, below) = channel_rows(x, layout, band, c);
        let (taps, bias) = weight(c);
        depthwise(out, above, rows, below, layout.width, &taps, bias);
    }
}

#[cfg(test)]
mod tests {
    use super::depthwise3x3;
    use crate::nn::layout::Layout;
    use crate::nn::ops::conv3x3;
    use crate::nn::ops::testing::{check, compare, numbers};
    use crate::nn::tape::{Param, Planes};

    #[test]
    fn is_a_convolution_with_a_diagonal_weight() {
        for (height, width) in [(20, 40), (5, 1), (1, 5), (2, 2), (300, 3)] {
            let layout = Layout { channels: 3, height, width };
            let x = Planes::constant(numbers(layout.len(), 1), layout).unwrap();
            let (weight, bias) = (numbers(27, 2), Param::constant(numbers(3, 3).into()));
            let mut full = vec![0.0; 81];
            for c in 0..3 {
                full[(c * 3 + c) * 9..][..9].copy_from_slice(&weight[c * 9..][..9]);
            }
            let expected = conv3x3(x.branch(), 1, &Param::constant(full.into()), &bias).unwrap();
            let got = depthwise3x3(x, &Param::constant(weight.into()), &bias).unwrap();
            compare(got.values(), expected.values(), 1e-14, "depthwise");
        }
    }

    #[test]
    fn gradients() {
        for (height, width) in [(20, 40), (5, 1), (1, 5), (2, 2), (300, 3)] {
            check(Layout { channels: 2, height, width }, &[18, 2], |x, p| depthwise3x3(x, &p[0], &p[1]));
        }
    }
}
