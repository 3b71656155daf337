//! Dense convolutions: 1x1, and 3x3 with zero padding.

use dfdx::tensor::{Cpu, Tape};
use rayon::prelude::*;

use super::expect;
use crate::error::{Error, Result};
use crate::nn::kernels::{fill, sum};
use crate::nn::layout::Layout;
use crate::nn::matrix::{Matrix, multiply};
use crate::nn::scalar::Scalar;
use crate::nn::tape::{Param, Planes, record};

/// 1x1 convolution: (C, H, W) -> (O, H, W). `weight` (O, C), `bias` (O).
pub(crate) fn pointwise<E: Scalar, T: Tape<E, Cpu>>(
    x: Planes<E, T>,
    weight: &Param<E>,
    bias: Option<&Param<E>>,
) -> Result<Planes<E, T>> {
    let layout = x.layout;
    let outputs = outputs("conv1x1", weight, bias, layout.channels)?;
    let to = layout.with_channels(outputs);
    let values = x.values();
    let mut out = vec![E::default(); to.len()];
    out.par_chunks_mut(to.band_len()).zip(values.par_chunks(layout.band_len())).for_each(|(out, x)| {
        let pixels = out.len() / outputs;
        fill(out, outputs, bias.map(Param::values));
        let x = Matrix::new(x, layout.channels, pixels);
        multiply(out, true, Matrix::new(weight.values(), outputs, layout.channels), x);
    });
    drop(values);

    let (x, tape) = x.split();
    let (weight, bias) = (weight.clone(), bias.cloned());
    let tracked = weight.is_tracked() || bias.as_ref().is_some_and(Param::is_tracked);
    record(out, to, tape, T::OWNS_TAPE && (x.is_wanted() || tracked), move |dy, grads| {
        x.add_gradient(grads, |dx| {
            let weight = Matrix::new(weight.values(), outputs, layout.channels).transposed();
            dx.par_chunks_mut(layout.band_len()).zip(dy.par_chunks(to.band_len())).for_each(|(dx, dy)| {
                multiply(dx, true, weight, Matrix::new(dy, outputs, dy.len() / outputs));
            });
        })?;
        weight.add_gradient(grads, |dweight| {
            for (dy, x) in dy.chunks(to.band_len()).zip(x.values().chunks(layout.band_len())) {
                let pixels = dy.len() / outputs;
                let x = Matrix::new(x, layout.channels, pixels).transposed();
                multiply(dweight, true, Matrix::new(dy, outputs, pixels), x);
            }
        })?;
        bias.map_or(Ok(()), |bias| bias.add_gradient(grads, |dbias| add_sums(dbias, &dy, to)))
    })
}

/// 3x3 convolution with zero padding 1: (C, H, W) -> (O, H, W). `weight` (O, C, 3, 3), `bias` (O).
pub(crate) fn conv3x3<E: Scalar, T: Tape<E, Cpu>>(
    x: Planes<E, T>,
    weight: &Param<E>,
    bias: &Param<E>,
) -> Result<Planes<E, T>> {
    let layout = x.layout;
    let outputs = outputs("conv3x3", weight, Some(bias), 9 * layout.channels)?;
    let to = layout.with_channels(outputs);
    let mut out = vec![E::default(); to.len()];
    correlate(&mut out, &x.values(), layout, weight.values(), Some(bias.values()));

    let (x, tape) = x.split();
    let (weight, bias) = (weight.clone(), bias.clone());
    let wanted = T::OWNS_TAPE && (x.is_wanted() || weight.is_tracked() || bias.is_tracked());
    record(out, to, tape, wanted, move |dy, grads| {
        x.add_gradient(grads, |dx| correlate(dx, &dy, to, &mirrored(weight.values(), layout.channels), None))?;
        weight.add_gradient(grads, |dweight| {
            let values = x.values();
            for (band, dy) in dy.chunks(to.band_len()).enumerate() {
                let columns = neighbourhoods(&values, layout, band);
                let pixels = dy.len() / outputs;
                let columns = Matrix::new(&columns, 9 * layout.channels, pixels).transposed();
                multiply(dweight, true, Matrix::new(dy, outputs, pixels), columns);
            }
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

/// Adds the sums over pixels of each channel.
fn add_sums<E: Scalar>(sums: &mut [E], values: &[E], layout: Layout) {
    for band in values.chunks(layout.band_len()) {
        let pixels = band.len() / layout.channels;
        for (total, row) in sums.iter_mut().zip(band.chunks_exact(pixels)) {
            *total += sum(row);
        }
    }
}

/// Adds the convolution of `x` with 3x3 `weight`s, or sets `out` to it plus `bias` where there is one.
fn correlate<E: Scalar>(out: &mut [E], x: &[E], layout: Layout, weight: &[E], bias: Option<&[E]>) {
    let outputs = weight.len() / (9 * layout.channels);
    let weight = Matrix::new(weight, outputs, 9 * layout.channels);
    out.par_chunks_mut(layout.with_channels(outputs).band_len()).enumerate().for_each(|(band, out)| {
        if bias.is_some() {
            fill(out, outputs, bias);
        }
        let columns = neighbourhoods(x, layout, band);
        multiply(out, true, weight, Matrix::new(&columns, 9 * layout.channels, out.len() / outputs));
    });
}

/// The 3x3 neighbourhoods of the pixels of a band: (C * 9, pixels), zero outside the image.
fn neighbourhoods<E: Scalar>(x: &[E], layout: Layout, band: usize) -> Vec<E> {
    let (rows, width) = (layout.band_rows(band), layout.width);
    let mut columns = vec![E::default(); 9 * layout.channels * rows.len() * width];
    for (line, to) in columns.chunks_exact_mut(width).enumerate() {
        let (row, tap) = (rows.start + line % rows.len(), line / rows.len());
        let (channel, dy, dx) = (tap / 9, tap % 9 / 3, tap % 3);
        let Some(row) = (row + dy).checked_sub(1).filter(|&row| row < layout.height) else { continue };
        let from = &x[layout.row(channel, row)];
        match dx {
            0 => to[1..].copy_from_slice(&from[..width - 1]),
            1 => to.copy_from_slice(from),
            _ => to[..width - 1].copy_from_slice(&from[1..]),
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
        let planes = Planes::constant(layout.from_planar(&x, 20, 40), layout).unwrap();
        let params = [&weight, &bias].map(|values| Param::constant(values.clone().into()));
        let out = conv3x3(planes, &params[0], &params[1]).unwrap();
        let out = out.layout.to_planar(&out.values(), 20, 40);
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
        check(layout, &[2 * 3 * 9, 2], |x, p| conv3x3(x, &p[0], &p[1]));
        check(Layout { channels: 2, height: 3, width: 1 }, &[2 * 9, 1], |x, p| conv3x3(x, &p[0], &p[1]));
    }

    #[test]
    fn wrong_sizes_are_errors() {
        let layout = Layout { channels: 3, height: 2, width: 2 };
        let x = || Planes::constant(vec![0.0f32; 12], layout).unwrap();
        let param = |len| Param::constant(vec![0.0f32; len].into());
        assert!(pointwise(x(), &param(7), None).is_err());
        assert!(pointwise(x(), &param(0), None).is_err());
        assert!(pointwise(x(), &param(6), Some(&param(3))).is_err());
        assert!(conv3x3(x(), &param(27), &param(2)).is_err());
    }
}
