//! Scaled residual connection.

use dfdx::tensor::{Cpu, Tape};
use rayon::prelude::*;

use super::{expect, sum_over_bands};
use crate::error::{Error, Result};
use crate::nn::kernels::{add_scaled, dot, scale};
use crate::nn::scalar::Scalar;
use crate::nn::tape::{Param, Planes, record};

/// `x + factor * branch`, `factor` (C) per channel.
pub(crate) fn residual<E: Scalar, T: Tape<E, Cpu>>(
    x: Planes<E, T>,
    branch: Planes<E, T>,
    factor: &Param<E>,
) -> Result<Planes<E, T>> {
    let layout = x.layout;
    expect("residual factor", factor, layout.channels)?;
    if branch.layout != layout {
        return Err(Error::shape("residual", format!("{layout:?}"), format!("{:?}", branch.layout)));
    }
    let mut out = x.pool().copy(x.values());
    out.par_chunks_mut(layout.band_len())
        .zip(branch.values().par_chunks(layout.band_len()))
        .for_each(|(out, branch)| add_scaled(out, branch, factor.values()));

    let ((x, tape), (branch, other)) = (x.split(), branch.split());
    let factor = factor.clone();
    let wanted = T::OWNS_TAPE && (x.is_wanted() || branch.is_wanted() || factor.is_tracked());
    record(out, layout, tape.merge(other), wanted, move |dy, grads| {
        branch.add_gradient(grads, || {
            let mut dbranch = branch.pool().take(layout.len());
            let bands = dbranch.par_chunks_mut(layout.band_len()).zip(dy.par_chunks(layout.band_len()));
            bands.for_each(|(dbranch, dy)| scale(dbranch, dy, factor.values()));
            dbranch
        })?;
        factor.add_gradient(grads, |dscale| {
            sum_over_bands(dscale, layout.bands(), |dscale, band| {
                let (dy, branch) = (&dy[layout.band(band)], &branch.values()[layout.band(band)]);
                let pixels = dy.len() / layout.channels;
                let rows = dy.chunks_exact(pixels).zip(branch.chunks_exact(pixels));
                for (dscale, (dy, branch)) in dscale.iter_mut().zip(rows) {
                    *dscale += dot(dy, branch);
                }
            });
        })?;
        x.add_gradient(grads, || dy)
    })
}

#[cfg(test)]
mod tests {
    use super::residual;
    use crate::nn::layout::Layout;
    use crate::nn::ops::testing::check;
    use crate::nn::ops::{layer_norm, simple_gate};
    use crate::nn::tape::Planes;

    #[test]
    fn gradients() {
        let layout = Layout { channels: 3, height: 11, width: 37 };
        check(layout, &[3, 3, 3], |x, p| {
            let branch = layer_norm(x.branch(), &p[0], &p[1])?;
            residual(x, branch, &p[2])
        });
    }

    #[test]
    fn different_sizes_are_an_error() {
        let layout = Layout { channels: 2, height: 2, width: 2 };
        let x = Planes::constant(vec![0.0f32; 8], layout).unwrap();
        let branch = simple_gate(x.branch()).unwrap();
        let scale = crate::nn::tape::Param::constant(vec![1.0; 2].into());
        assert!(residual(x, branch, &scale).is_err());
    }
}
