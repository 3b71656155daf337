//! Layer norm over channels.

use dfdx::tensor::{Cpu, Tape};
use rayon::prelude::*;

use super::{expect, sum_over_bands};
use crate::error::Result;
use crate::nn::kernels::{add, norm, norm_backward, norm_backward_params};
use crate::nn::scalar::Scalar;
use crate::nn::tape::{Param, Planes, record};

/// Layer norm over the channels of every pixel (biased variance, epsilon 1e-6). `weight`, `bias` (C).
///
/// # Source
/// Ba et al., "Layer Normalization", 2016; over channels as in Chen et al., "Simple Baselines for Image Restoration", ECCV 2022.
pub(crate) fn layer_norm<E: Scalar, T: Tape<E, Cpu>>(
    x: Planes<E, T>,
    weight: &Param<E>,
    bias: &Param<E>,
) -> Result<Planes<E, T>> {
    let layout = x.layout;
    expect("norm weight", weight, layout.channels)?;
    expect("norm bias", bias, layout.channels)?;
    let mut out = x.pool().take(layout.len());
    let bands = out.par_chunks_mut(layout.band_len()).zip(x.values().par_chunks(layout.band_len()));
    bands.for_each(|(out, x)| norm(out, x, weight.values(), bias.values()));

    let (x, tape) = x.split();
    let (weight, bias) = (weight.clone(), bias.clone());
    let tracked = weight.is_tracked() || bias.is_tracked();
    record(out, layout, tape, T::OWNS_TAPE && (x.is_wanted() || tracked), move |dy, grads| {
        x.add_gradient(grads, || {
            let mut dx = x.pool().zeros(layout.len());
            let bands = dx.par_chunks_mut(layout.band_len()).zip(dy.par_chunks(layout.band_len()));
            bands
                .zip(x.values().par_chunks(layout.band_len()))
                .for_each(|((dx, dy), x)| norm_backward(dx, dy, x, weight.values()));
            dx
        })?;
        if !tracked {
            return Ok(());
        }
        let mut both = vec![E::default(); 2 * layout.channels];
        sum_over_bands(&mut both, layout.bands(), |both, band| {
            let (dweight, dbias) = both.split_at_mut(layout.channels);
            norm_backward_params(dweight, dbias, &dy[layout.band(band)], &x.values()[layout.band(band)]);
        });
        let (dweight, dbias) = both.split_at(layout.channels);
        weight.add_gradient(grads, |gradient| add(gradient, dweight))?;
        bias.add_gradient(grads, |gradient| add(gradient, dbias))
    })
}

#[cfg(test)]
mod tests {
    use super::layer_norm;
    use crate::nn::layout::Layout;
    use crate::nn::ops::testing::{check, numbers};
    use crate::nn::tape::{Param, Planes};

    #[test]
    fn normalises_over_channels() {
        let layout = Layout { channels: 5, height: 11, width: 37 };
        let x: Vec<f32> = numbers(layout.len(), 3).iter().map(|&v| 1e3 + v as f32).collect();
        let (one, zero) = (Param::constant(vec![1.0; 5].into()), Param::constant(vec![0.0; 5].into()));
        let out = layer_norm(Planes::constant(x, layout).unwrap(), &one, &zero).unwrap();
        let planar = out.layout.unpack(out.values(), 11, 37);
        for p in 0..11 * 37 {
            let pixel: Vec<f32> = (0..5).map(|c| planar[c * 11 * 37 + p]).collect();
            let (mean, square) = (pixel.iter().sum::<f32>() / 5.0, pixel.iter().map(|v| v * v).sum::<f32>() / 5.0);
            assert!(mean.abs() < 1e-3 && (square - 1.0).abs() < 1e-3, "{pixel:?}");
        }
    }

    #[test]
    fn gradients() {
        check(Layout { channels: 5, height: 11, width: 37 }, &[5, 5], |x, p| layer_norm(x, &p[0], &p[1]));
    }
}
