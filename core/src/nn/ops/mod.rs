//! The operations of the network on dfdx's tape, each with the gradients with respect to its input and its parameters.

mod attention;
mod conv;
mod depthwise;
mod gate;
mod graph;
mod norm;
mod residual;
mod shuffle;
#[cfg(test)]
pub(crate) mod testing;
mod window;

pub(crate) use attention::{affine, channel_attention, pooled_gradient, total};
pub(crate) use conv::{conv3x3, pointwise};
pub(crate) use depthwise::{depthwise_band, depthwise3x3, taps, turned};
pub(crate) use gate::simple_gate;
pub(crate) use graph::{Graph, graph_convolution};
pub(crate) use norm::layer_norm;
pub(crate) use residual::residual;
pub(crate) use shuffle::{pixel_shuffle, pixel_unshuffle};
pub(crate) use window::window_means;

use super::scalar::Scalar;
use super::tape::Param;
use crate::error::{Error, Result};

/// Fails unless `param` holds `expected` values.
fn expect<E: Scalar>(name: &str, param: &Param<E>, expected: usize) -> Result<()> {
    let got = param.values().len();
    if got == expected {
        Ok(())
    } else {
        Err(Error::shape(name, format!("{expected} values"), format!("{got} values")))
    }
}
