//! Dense convolutions: 1x1, and 3x3 with zero padding.

use std::ops::Range;

use dfdx::tensor::{Cpu, Tape};
use rayon::prelude::*;

use super::{expect, sum_over_bands};
use crate::error::{Error, Result};
use crate::nn::kernels::{fill, sum};
use crate::nn::layout::Layout;
use crate::nn::matrix::{Matrix, multiply};
use crate::nn::scalar::Scalar;
use crate::nn::tape::{Buffer, Param, Planes, Pool, record};

/// 1x1 convolution: (C, H, W) -> (O, H, W). `weight` (O, C), `bias` (O).
pub(crate) fn pointwise<E: Scalar, T: Tape<E, Cpu>>(
    x: Planes<E, T>,
    weight: &Param<E>,
    bias: Option<&Param<E>>,
) -> Result<Planes<E, T>> {
    let layout = x.layout;
    let outputs = outputs("conv1x1", weight, bias, layout.channels)?;
    let to = layout.with_channels(outputs);
    let mut out = x.pool().take(to.len());
    out.par_chunks_mut(to.band_len()).zip(x.values().par_chunks(layout.band_len())).for_each(|(out, x)| {
        let pixels = out.len() / outputs;
        fill(out, outputs, bias.map(Param::values));
        let x = Matrix::new(x, layout.channels, pixels);
        multiply(out, true, Matrix::new(weight.values(), outputs, layout.channels), x);
    });

    let pool = x.pool().clone();
    let (x, tape) = x.split();
    let (slot, x) = (x.slot(), weight.is_tracked().then_some(x));
    let (weight, bias) = (weight.clone(), bias.cloned());
    let tracked = weight.is_tracked() || bias.as_ref().is_some_and(Param::is_tracked);
    record(out, to, tape, T::OWNS_TAPE && (slot.is_wanted() || tracked), move |dy, grads| {
        slot.add(grads, || {
            let weight = Matrix::new(weight.values(), outputs, layout.channels).transposed();
            let mut dx = pool.take(layout.len());
            dx.par_chunks_mut(layout.band_len()).zip(dy.par_chunks(to.band_len())).for_each(|(dx, dy)| {
                multiply(dx, false, weight, Matrix::new(dy, outputs, dy.len() / outputs));
            });
            dx
        })?;
        weight.add_gradient(grads, |dweight| {
            let Some(x) = x else { return };
            sum_over_bands(dweight, layout.bands(), |dweight, band| {
                let (dy, x) = (&dy[to.band(band)], &x.values()[layout.band(band)]);
                let pixels = dy.len() / outputs;
                let x = Matrix::new(x, layout.channels, pixels).transposed();
                multiply(dweight, true, Matrix::new(dy, outputs, pixels), x);
            });
        })?;
        bias.map_or(Ok(()), |bias| bias.add_gradient(grads, |dbias| add_sums(dbias, &dy, to)))
    })
}

/// 3x3 convolution with zero padding 1, the same for each of `images` images whose channels lie one after the other:
/// (images * C, H, W) -> (images * O, H, W). `weight` (O, C, 3, 3), `bias` (O).
pub(crate) fn conv3x3<E: Scalar, T: Tape<E, Cpu>>(
    x: Planes<E, T>,
    images: usize,
    weight: &Param<E>,
    bias: &Param<E>,
) -> Result<Planes<E, T>> {
    let layout = x.layout;
    if images == 0 || !layout.channels.is_multiple_of(images) {
        return Err(Error::shape("conv3x3", format!("channels of {images} images"), layout.channels.to_string()));
    }
    let channels = layout.channels / images;
    let outputs = outputs("conv3x3", weight, Some(bias), 9 * channels)?;
    let to = layout.with_channels(images * outputs);
    let out = correlate(x.pool(), x.values(), layout, images, weight.values(), Some(bias.values()));

    let pool = x.pool().clone();
    let (x, tape) = x.split();
    let (slot, x) = (x.slot(), weight.is_tracked().then_some(x));
    let (weight, bias) = (weight.clone(), bias.clone());
    let wanted = T::OWNS_TAPE && (slot.is_wanted() || weight.is_tracked() || bias.is_tracked());
    record(out, to, tape, wanted, move |dy, grads| {
        slot.add(grads, || correlate(&pool, &dy, to, images, &mirrored(weight.values(), channels), None))?;
        weight.add_gradient(grads, |dweight| {
            let Some(x) = x else { return };
            sum_over_bands(dweight, layout.bands(), |dweight, band| {
                let dy = &dy[to.band(band)];
                let pixels = dy.len() / to.channels;
                for (image, dy) in dy.chunks_exact(outputs * pixels).enumerate() {
                    let of_image = image * channels..(image + 1) * channels;
                    let columns = neighbourhoods(&pool, x.values(), layout, band, of_image);
                    let columns = Matrix::new(&columns, 9 * channels, pixels).transposed();
                    multiply(dweight, true, Matrix::new(dy, outputs, pixels), columns);
                }
            });
        })?;
        bias.add_gradient(grads, |dbias| add_sums(dbias, &dy, to))
    })
}

/// Output channels of a convolution with `inputs` weights for each.
fn outputs<E: Scalar>(name: &str, weight: &Param<E>, bias: Option<&Param<E>>, inputs: usize) -> Result<usize> {
    let outputs = weight.values().len() / inputs;
    if outputs == 0 {
        return Err(Error::shape(name, format!("{inputs} weights or more"), weight.values().len().to_string()));
    }
    expect(name, weight, outputs * inputs)?;
    bias.map_or(Ok(()), |bias| expect(name, bias, outputs))?;
    Ok(outputs)
}

/// Adds the sums over pixels of each channel; channels beyond those of `sums` begin from its first again.
fn add_sums<E: Scalar>(sums: &mut [E], values: &[E], layout: Layout) {
    let outputs = sums.len();
    sum_over_bands(sums, layout.bands(), |sums, band| {
        let band = &values[layout.band(band)];
        let pixels = band.len() / layout.channels;
        for (channel, row) in band.chunks_exact(pixels).enumerate() {
            sums[channel % outputs] += sum(row);
        }
    });
}

/// The convolution of each image with 3x3 `weight`s, plus `bias` where there is one.
fn correlate<E: Scalar>(
    pool: &Pool<E>,
    x: &[E],
    layout: Layout,
    images: usize,
    weight: &[E],
    bias: Option<&[E]>,
) -> Buffer<E> {
    let channels = layout.channels / images;
    let outputs = weight.len() / (9 * channels);
    let weight = Matrix::new(weight, outputs, 9 * channels);
    let to = layout.with_channels(images * outputs);
    let mut out = pool.take(to.len());
    out.par_chunks_mut(to.band_len()).enumerate().for_each(|(band, out)| {
        let pixels = out.len() / to.channels;
        for (image, out) in out.chunks_exact_mut(outputs * pixels).enumerate() {
            fill(out, outputs, bias);
            let columns = neighbourhoods(pool, x, layout, band, image * channels..(image + 1) * channels);
            multiply(out, true, weight, Matrix::new(&columns, 9 * channels, pixels));
        }
    });
    out
}

/// The 3x3 neighbourhoods of the pixels of a band, in some of its channels: (channels * 9, pixels), zero outside the image.
fn neighbourhoods<E: Scalar>(
    pool: &Pool<E>,
    x: &[E],
    layout: Layout,
    band: usize,
    channels: Range<usize>,
) -> Buffer<E> {
    let (rows, width) = (layout.band_rows(band), layout.width);
    let mut columns = pool.take(9 * channels.len() * rows.len() * width);
    for (line, to) in columns.chunks_exact_mut(width).enumerate() {
        let (row, tap) = (rows.start + line % rows.len(), line / rows.len());
        let (channel, dy, dx) = (channels.start + tap / 9, tap % 9 / 3, tap % 3);
        let Some(row) = (row + dy).checked_sub(1).filter(|&row| row < layout.height) else {
            to.fill(E::default());
            continue;
        };
        let from = &x[layout.row(channel, row)];
        match dx {
            0 => {
                to[0] = E::default();
                to[1..].copy_from_slice(&from[..width - 1]);
            }
            1 => to.copy_from_slice(from),
            _ => {
                to[..width - 1].copy_from_slice(&from[1..]);
                to[width - 1] = E::default();
            }
        }
    }
    columns
}

/// The weights of the convolution that takes gradients back: (O, C, 3, 3) -> (C, O, 3, 3), turned by half a turn.
fn mirrored<E: Scalar>(weight: &[E], channels: usize) -> Vec<E> {
    let outputs = weight.len() / (9 * channels);
    (0..weight.len())
        .map(|i| {
            let (channel, output, tap) = (i / (9 * outputs), i / 9 % outputs, i % 9);
            weight[(output * channels + channel) * 9 + 8 - tap]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::{conv3x3, pointwise};
    use crate::nn::layout::Layout;
    use crate::nn::ops::testing::{check, numbers};
    use crate::nn::tape::{Param, Planes};

    #[test]
    fn values_are_those_of_the_definition() {
        let layout = Layout { channels: 3, height: 20, width: 40 };
        let (x, weight, bias) = (numbers(layout.len(), 1), numbers(2 * 3 * 9, 2), numbers(2, 3));
        let planes = Planes::constant(layout.pack(&x, 20, 40), layout).unwrap();
        let params = [&weight, &bias].map(|values| Param::constant(values.clone().into()));
        let out = conv3x3(planes, 1, &params[0], &params[1]).unwrap();
        let out = out.layout.unpack(out.values(), 20, 40);
        for o in 0..2 {
            for i in 0..20isize {
                for j in 0..40isize {
                    let mut expected = bias[o];
                    for c in 0..3 {
                        for t in 0..9isize {
                            let (y, x_) = (i + t / 3 - 1, j + t % 3 - 1);
                            if (0..20).contains(&y) && (0..40).contains(&x_) {
                                expected += weight[(o * 3 + c) * 9 + t as usize] * x[c * 800 + (y * 40 + x_) as usize];
                            }
                        }
                    }
                    let got = out[o * 800 + (i * 40 + j) as usize];
                    assert!((got - expected).abs() < 1e-12, "{o} {i} {j}: {got} {expected}");
                }
            }
        }
    }

    #[test]
    fn gradients() {
        let layout = Layout { channels: 3, height: 20, width: 40 };
        check(layout, &[2 * 3, 2], |x, p| pointwise(x, &p[0], Some(&p[1])));
        check(layout, &[12], |x, p| pointwise(x, &p[0], None));
        check(layout, &[2 * 3 * 9, 2], |x, p| conv3x3(x, 1, &p[0], &p[1]));
        check(layout, &[2 * 9, 2], |x, p| conv3x3(x, 3, &p[0], &p[1]));
        check(Layout { channels: 2, height: 3, width: 1 }, &[2 * 9, 1], |x, p| conv3x3(x, 1, &p[0], &p[1]));
    }

    #[test]
    fn wrong_sizes_are_errors() {
        let layout = Layout { channels: 3, height: 2, width: 2 };
        let x = || Planes::constant(vec![0.0f32; 12], layout).unwrap();
        let param = |len| Param::constant(vec![0.0f32; len].into());
        assert!(pointwise(x(), &param(7), None).is_err());
        assert!(pointwise(x(), &param(0), None).is_err());
        assert!(pointwise(x(), &param(6), Some(&param(3))).is_err());
        assert!(conv3x3(x(), 1, &param(27), &param(2)).is_err());
        assert!(conv3x3(x(), 2, &param(27), &param(1)).is_err());
    }
}
