//! Scaled residual connection.

use dfdx::tensor::{Cpu, Tape};
use rayon::prelude::*;

use super::expect;
use crate::error::{Error, Result};
use crate::nn::kernels::{add, add_scaled, dot};
use crate::nn::scalar::Scalar;
use crate::nn::tape::{Param, Planes, record};

/// `x + scale * branch`, `scale` (C) per channel.
pub(crate) fn residual<E: Scalar, T: Tape<E, Cpu>>(
    x: Planes<E, T>,
    branch: Planes<E, T>,
    scale: &Param<E>,
) -> Result<Planes<E, T>> {
    let layout = x.layout;
    expect("residual scale", scale, layout.channels)?;
    if branch.layout != layout {
        return Err(Error::shape("residual", format!("{layout:?}"), format!("{:?}", branch.layout)));
    }
    let (mut out, values) = (x.values(), branch.values());
    out.par_chunks_mut(layout.band_len())
        .zip(values.par_chunks(layout.band_len()))
        .for_each(|(out, branch)| add_scaled(out, branch, scale.values()));
    drop(values);

    let ((x, tape), (branch, other)) = (x.split(), branch.split());
    let scale = scale.clone();
    let wanted = T::OWNS_TAPE && (x.is_wanted() || branch.is_wanted() || scale.is_tracked());
    record(out, layout, tape.merge(other), wanted, move |dy, grads| {
        x.add_gradient(grads, |dx| add(dx, &dy))?;
        branch.add_gradient(grads, |dbranch| {
            let bands = dbranch.par_chunks_mut(layout.band_len()).zip(dy.par_chunks(layout.band_len()));
            bands.for_each(|(dbranch, dy)| add_scaled(dbranch, dy, scale.values()));
        })?;
        scale.add_gradient(grads, |dscale| {
            let values = branch.values();
            for (dy, branch) in dy.chunks(layout.band_len()).zip(values.chunks(layout.band_len())) {
                let pixels = dy.len() / layout.channels;
                let rows = dy.chunks_exact(pixels).zip(branch.chunks_exact(pixels));
                for (dscale, (dy, branch)) in dscale.iter_mut().zip(rows) {
                    *dscale += dot(dy, branch);
                }
            }
        })
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
