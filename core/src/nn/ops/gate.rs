//! The simple gate.

use dfdx::tensor::{Cpu, Tape};
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::nn::kernels::{gate, gate_backward};
use crate::nn::scalar::Scalar;
use crate::nn::tape::{Planes, record};

/// Simple gate: (2C, H, W) -> (C, H, W), the first half of the channels times the second.
///
/// # Source
/// Chen et al., "Simple Baselines for Image Restoration", ECCV 2022, eq. 4.
pub(crate) fn simple_gate<E: Scalar, T: Tape<E, Cpu>>(x: Planes<E, T>) -> Result<Planes<E, T>> {
    let layout = x.layout;
    if !layout.channels.is_multiple_of(2) {
        return Err(Error::shape("gate", "an even number of channels", layout.channels.to_string()));
    }
    let to = layout.with_channels(layout.channels / 2);
    let mut out = x.pool().take(to.len());
    let bands = out.par_chunks_mut(to.band_len()).zip(x.values().par_chunks(layout.band_len()));
    bands.for_each(|(out, x)| gate(out, x));

    let (x, tape) = x.split();
    let wanted = T::OWNS_TAPE && x.is_wanted();
    record(out, to, tape, wanted, move |dy, grads| {
        x.add_gradient(grads, || {
            let mut dx = x.pool().copy(x.values());
            let bands = dx.par_chunks_mut(layout.band_len()).zip(dy.par_chunks(to.band_len()));
            bands.for_each(|(dx, dy)| gate_backward(dx, dy));
            dx
        })
    })
}

#[cfg(test)]
mod tests {
    use super::simple_gate;
    use crate::nn::layout::Layout;
    use crate::nn::ops::testing::check;
    use crate::nn::tape::Planes;

    #[test]
    fn multiplies_halves() {
        let layout = Layout { channels: 4, height: 1, width: 1 };
        let x = Planes::constant(vec![2.0f32, 3.0, 5.0, 7.0], layout).unwrap();
        assert_eq!(simple_gate(x).unwrap().values(), [10.0, 21.0]);
        let odd = Planes::constant(vec![1.0f32; 3], layout.with_channels(3)).unwrap();
        assert!(simple_gate(odd).is_err());
    }

    #[test]
    fn gradients() {
        check(Layout { channels: 4, height: 20, width: 40 }, &[], |x, _| simple_gate(x));
    }
}
