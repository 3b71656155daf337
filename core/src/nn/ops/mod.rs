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

use rayon::prelude::*;

use super::kernels::add;
use super::scalar::Scalar;
use super::tape::Param;
use crate::error::{Error, Result};

/// Adds what `add_band` adds for each of `bands` bands to `sums`. Runs of bands go in parallel, the same ones on any number of threads.
fn sum_over_bands<E: Scalar>(sums: &mut [E], bands: usize, add_band: impl Fn(&mut [E], usize) + Sync) {
    const RUNS: usize = 16;
    let run = bands.div_ceil(RUNS);
    let of_run = |first: usize| {
        let mut part = vec![E::default(); sums.len()];
        (first..bands.min(first + run)).for_each(|band| add_band(&mut part, band));
        part
    };
    let parts: Vec<Vec<E>> = (0..bands.div_ceil(run)).into_par_iter().map(|index| of_run(index * run)).collect();
    parts.iter().for_each(|part| add(sums, part));
}

/// Fails unless `param` holds `expected` values.
fn expect<E: Scalar>(name: &str, param: &Param<E>, expected: usize) -> Result<()> {
    let got = param.values().len();
    if got == expected {
        Ok(())
    } else {
        Err(Error::shape(name, format!("{expected} values"), format!("{got} values")))
    }
}
