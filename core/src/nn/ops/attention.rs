//! Simplified channel attention.

use dfdx::tensor::{Cpu, Tape};
use rayon::prelude::*;

use super::expect;
use crate::error::Result;
use crate::nn::kernels::{add, dot, scale, scale_shift, sum};
use crate::nn::layout::Layout;
use crate::nn::matrix::{Matrix, multiply};
use crate::nn::scalar::Scalar;
use crate::nn::tape::{Param, Planes, record};

/// Every channel times `weight mean(x) + bias`, the mean over all pixels. `weight` (C, C), `bias` (C).
///
/// # Source
/// Chen et al., "Simple Baselines for Image Restoration", ECCV 2022, eq. 6.
pub(crate) fn channel_attention<E: Scalar, T: Tape<E, Cpu>>(
    x: Planes<E, T>,
    weight: &Param<E>,
    bias: &Param<E>,
) -> Result<Planes<E, T>> {
    let (layout, channels) = (x.layout, x.layout.channels);
    expect("attention weight", weight, channels * channels)?;
    expect("attention bias", bias, channels)?;
    let mut mean = channel_sums(x.values(), layout, |row, _| sum(row));
    mean.iter_mut().for_each(|mean| *mean *= E::splat(1.0 / layout.pixels() as f64));
    let factor = affine(weight.values(), &mean, bias.values());
    let mut out = x.pool().take(layout.len());
    let bands = out.par_chunks_mut(layout.band_len()).zip(x.values().par_chunks(layout.band_len()));
    bands.for_each(|(out, x)| scale(out, x, &factor));

    let (x, tape) = x.split();
    let (weight, bias) = (weight.clone(), bias.clone());
    let wanted = T::OWNS_TAPE && (x.is_wanted() || weight.is_tracked() || bias.is_tracked());
    record(out, layout, tape, wanted, move |mut dy, grads| {
        let dfactor = channel_sums(&dy, layout, |row, place| dot(row, &x.values()[place..]));
        weight.add_gradient(grads, |dweight| {
            multiply(dweight, true, Matrix::new(&dfactor, channels, 1), Matrix::new(&mean, 1, channels));
        })?;
        bias.add_gradient(grads, |dbias| add(dbias, &dfactor))?;
        x.add_gradient(grads, || {
            let share = pooled_gradient(weight.values(), &dfactor, layout.pixels());
            dy.par_chunks_mut(layout.band_len()).for_each(|dy| scale_shift(dy, &factor, &share));
            dy
        })
    })
}

/// For every channel the sum over bands of `measure(row, place)`: the channel's pixels in a band, and where they begin.
pub(crate) fn channel_sums<E: Scalar>(
    values: &[E],
    layout: Layout,
    measure: impl Fn(&[E], usize) -> E + Sync,
) -> Vec<E> {
    let of_band = |(band, values): (usize, &[E])| -> Vec<E> {
        let pixels = values.len() / layout.channels;
        let rows = values.chunks_exact(pixels).enumerate();
        rows.map(|(c, row)| measure(row, band * layout.band_len() + c * pixels)).collect()
    };
    let bands: Vec<Vec<E>> = values.par_chunks(layout.band_len()).enumerate().map(of_band).collect();
    total(&bands)
}

/// The sum of vectors, in their order.
pub(crate) fn total<E: Scalar>(parts: &[Vec<E>]) -> Vec<E> {
    let mut total = parts[0].clone();
    for part in &parts[1..] {
        add(&mut total, part);
    }
    total
}

/// `weight x + bias`.
pub(crate) fn affine<E: Scalar>(weight: &[E], x: &[E], bias: &[E]) -> Vec<E> {
    let mut out = bias.to_vec();
    multiply(&mut out, true, Matrix::new(weight, bias.len(), x.len()), Matrix::new(x, x.len(), 1));
    out
}

/// The gradient with respect to every pixel that comes through the mean, from that with respect to the factors.
pub(crate) fn pooled_gradient<E: Scalar>(weight: &[E], dfactor: &[E], pixels: usize) -> Vec<E> {
    let channels = dfactor.len();
    let mut share = vec![E::default(); channels];
    let weight = Matrix::new(weight, channels, channels).transposed();
    multiply(&mut share, false, weight, Matrix::new(dfactor, channels, 1));
    let mut out = vec![E::default(); channels];
    scale(&mut out, &share, &vec![E::splat(1.0 / pixels as f64); channels]);
    out
}

#[cfg(test)]
mod tests {
    use super::channel_attention;
    use crate::nn::layout::Layout;
    use crate::nn::ops::testing::{check, compare};
    use crate::nn::tape::{Param, Planes};

    #[test]
    fn scales_by_a_function_of_the_means() {
        let layout = Layout { channels: 2, height: 1, width: 2 };
        let x = Planes::constant(vec![1.0, 3.0, 10.0, 20.0], layout).unwrap();
        let weight = Param::constant(vec![1.0, 2.0, -1.0, 0.5].into());
        let out = channel_attention(x, &weight, &Param::constant(vec![0.5, 0.25].into())).unwrap();
        let (a, b) = (2.0 + 2.0 * 15.0 + 0.5, -2.0 + 7.5 + 0.25);
        compare(out.values(), &[a, 3.0 * a, 10.0 * b, 20.0 * b], 1e-15, "attention");
    }

    #[test]
    fn gradients() {
        check(Layout { channels: 3, height: 20, width: 40 }, &[9, 3], |x, p| channel_attention(x, &p[0], &p[1]));
    }
}
