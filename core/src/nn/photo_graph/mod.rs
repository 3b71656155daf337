//! The `default` network: any number of photos with their light and half vectors in, raw maps and their certainty out.
//!
//! `python/svbrdf_gcn/training/model.py` states it in full. The photos are the nodes of a graph; nothing depends on their order.

mod config;
mod hints;
mod input;
mod mirror;
mod net;
mod rounds;
mod scales;

use std::collections::BTreeMap;
use std::sync::Arc;

use rayon::prelude::*;

use super::decode::Decoding;
use super::layout::Layout;
use super::scalar::Scalar;
use super::tape::Param;
use super::weights::broken;
use crate::capture::Capture;
use crate::error::{Error, Result};
use crate::maps::{Lobe, Maps};
use crate::progress::Control;
pub(crate) use config::INPUTS;
pub use config::PhotoGraphConfig;
use config::{HINTS, RAW_PLANES};
#[cfg(feature = "train")]
pub(crate) use input::PhotoView;
use input::View;
pub use mirror::Mirror;
use net::{Net, Output};
use rounds::DIRECTIONS;

/// A network that takes any number of photos with the places of camera and light, and gives raw maps and how certain they are.
///
/// Immutable, `Send` and `Sync`.
pub struct PhotoGraph {
    config: PhotoGraphConfig,
    tensors: BTreeMap<String, Arc<Vec<f32>>>,
    net: Net<f32>,
}

impl std::fmt::Debug for PhotoGraph {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("PhotoGraph").field(&self.config).finish()
    }
}

/// What a photo graph makes of a capture.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// Rows of all planes.
    pub height: usize,
    /// Columns of all planes.
    pub width: usize,
    /// Raw maps in the order of [`Decoding`], (9, H, W): diffuse 3, normal x and y, roughness 1, specular 3; not limited to [-1, 1].
    pub raw: Vec<f32>,
    /// The natural logarithm of the standard deviation of each raw value, (9, H, W), [-7, 1]. Its unit is the encoded map: half of a
    /// raw albedo or roughness, a normal's x and y as they are.
    pub log_sigma: Vec<f32>,
}

impl PhotoGraph {
    /// A network whose tensors `get` gives by name and shape.
    pub(crate) fn new(
        config: PhotoGraphConfig,
        mut get: impl FnMut(&str, &[usize]) -> Result<Vec<f32>>,
    ) -> Result<Self> {
        config.validate()?;
        let mut tensors = BTreeMap::new();
        for (name, shape) in config.tensors() {
            let values = Arc::new(get(&name, &shape)?);
            tensors.insert(name, values);
        }
        let net = build(&config, &tensors, Clone::clone)?;
        Ok(Self { config, tensors, net })
    }

    /// A network of these sizes with random weights, the same for the same `seed`: for benchmarks and tests.
    ///
    /// # Errors
    /// [`Error::Weights`] if a size is out of range.
    pub fn random(config: PhotoGraphConfig, seed: u64) -> Result<Self> {
        let mut state = seed;
        Self::new(config, |name, shape| Ok(super::model::random_tensor(name, shape, &mut state)))
    }

    /// Sizes and form.
    pub fn config(&self) -> &PhotoGraphConfig {
        &self.config
    }

    /// Kind, sizes and form, as a weights file states them in JSON.
    ///
    /// # Errors
    /// [`Error::Weights`] if they cannot be written as JSON.
    pub fn architecture(&self) -> Result<serde_json::Value> {
        self.config.architecture().map_err(|error| broken(format!("architecture: {error}")))
    }

    /// How many parameters there are.
    pub fn parameters(&self) -> usize {
        self.tensors.values().map(|values| values.len()).sum()
    }

    pub(crate) fn for_each_tensor<'a>(&'a self, mut visit: impl FnMut(&str, Vec<usize>, &'a [f32])) {
        for (name, shape) in self.config.tensors() {
            if let Some(values) = self.tensors.get(&name) {
                visit(&name, shape, values);
            }
        }
    }

    /// How the raw planes of a [`Prediction`] become maps.
    ///
    /// # Errors
    /// As [`Decoding::with_roughness_floor`].
    pub fn decoding(&self) -> Result<Decoding> {
        Decoding::new(Lobe::Isotropic).with_roughness_floor(f64::from(self.config.roughness_floor))
    }

    /// The maps that `prediction` says.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if `prediction` has not nine planes of its size.
    pub fn maps(&self, prediction: &Prediction) -> Result<Maps<f32>> {
        let Prediction { height, width, ref raw, .. } = *prediction;
        let mut maps = Maps::new(Lobe::Isotropic, width, height, vec![0.0; Lobe::Isotropic.planes() * height * width])?;
        self.decoding()?.decode(raw, &mut maps)?;
        Ok(maps)
    }

    /// Raw maps and their certainty from all photos of `capture` as `mirror` shows them, mirrored back; on the threads of the current rayon pool. `control` is
    /// polled between the parts. Captures of more pixels than the network was trained on are seen smaller, too: what spreads over many pixels is known better from there.
    ///
    /// Every photo is read once for each size and its full-resolution features are dropped before the next, see [`PhotoGraph::memory`].
    ///
    /// # Errors
    /// [`Error::Cancelled`]; [`Error::NonFinite`] if the network gives values that are not finite.
    pub fn predict(&self, capture: &Capture, mirror: Mirror, control: &mut Control<'_>) -> Result<Prediction> {
        let (height, width) = (capture.height(), capture.width());
        let steps = scales::steps(height.max(width), self.config.window);
        let mut found = self.predict_at(capture, View { mirror, step: steps[steps.len() - 1] }, control)?;
        for &step in steps.iter().rev().skip(1) {
            let finer = self.predict_at(capture, View { mirror, step }, control)?;
            let coarser = std::mem::replace(&mut found, finer);
            if let Some(window) = self.config.window {
                let size = (found.height, found.width);
                scales::correct(&mut found.raw, &coarser.raw, size, window);
                scales::correct(&mut found.log_sigma, &coarser.log_sigma, size, window);
            }
        }
        mirror.undo_raw(&mut found.raw, height, width);
        mirror.undo(&mut found.log_sigma, height, width);
        Ok(found)
    }

    /// What the network itself gives.
    fn predict_at(&self, capture: &Capture, view: View, control: &mut Control<'_>) -> Result<Prediction> {
        let (height, width) = (capture.height().div_ceil(view.step), capture.width().div_ceil(view.step));
        let layout = padded(&self.config, height, width);
        let photo =
            |index: usize, pool: &_| input::planes(&capture.photos()[index], capture.patch_size(), view, layout, pool);
        let Output { raw, log_sigma } =
            self.net.run(&self.config, capture.len(), layout, (height, width), photo, control)?;
        if !raw.par_iter().chain(&log_sigma).all(|value| value.is_finite()) {
            return Err(Error::NonFinite { stage: "prediction".into(), iteration: 0 });
        }
        Ok(Prediction { height, width, raw, log_sigma })
    }

    /// Estimated bytes that [`PhotoGraph::predict`] takes at its peak for `photos` photos of `height` x `width` pixels, beyond capture and parameters.
    pub fn memory(&self, photos: usize, height: usize, width: usize) -> u64 {
        let config = &self.config;
        let grain = config.grain() as u64;
        let (height, width) = ((height as u64).next_multiple_of(grain), (width as u64).next_multiple_of(grain));
        // No machine holds more photos than this.
        let photos = (photos as u64).min(1 << 32);
        // What is alive in each part, in channels of full resolution; those of half resolution count a quarter. A block has its input, twice as many
        // channels before its gate, those after it, their means, and its output. Memory that was freed goes back between the operations.
        const BLOCK: u64 = 6;
        let of = |channels: usize| channels as u64;
        let quarter = |channels: u64| channels.div_ceil(4);
        let (stem, node, tail, feature) = (of(config.stem), of(config.node), of(config.tail), of(config.feature));
        let (hints, raw, directions) = (of(HINTS), of(RAW_PLANES), quarter(of(DIRECTIONS)));
        let nodes = photos.saturating_mul(quarter(node) + directions);
        let pooled = |channels: u64| 3 * channels + hints + 1;
        let in_stem = if config.stem_blocks > 0 { BLOCK * stem } else { of(INPUTS) + stem };
        let photo = in_stem.max(2 * stem + quarter(node)).max(quarter((BLOCK - 1) * node));
        let see = pooled(stem) + of(hints::SUMS) + nodes + photo;
        let hinted = pooled(stem) + of(hints::SUMS) + nodes + tail + hints + quarter(hints);
        let exchange = tail + quarter(hints) + nodes + quarter((BLOCK - 1) * node).max(quarter(pooled(node)));
        let trunk = tail + quarter(BLOCK * of(config.width)).max(quarter(pooled(node) + of(config.width)));
        let end = (BLOCK * tail).max(3 * tail + quarter(of(config.width))).max(2 * raw + BLOCK * feature);
        // The prediction at half the resolution.
        let coarser = quarter(2 * raw);
        // What every thread holds of a band: in a round of messages, at half resolution; neighbourhoods of a convolution; inside of a block.
        let threads = rayon::current_num_threads() as u64;
        let band = |step: u64| width.div_ceil(step).clamp(256, 1 << 20);
        let messages = photos.saturating_mul(2 * of(config.heads) * of(config.dim) + node + 1) + 3 * node;
        let coarsest = of(config.channels(config.levels()));
        let inside = (9 * stem * band(1)).max(3 * coarsest * band(2 << config.levels()));
        let bytes = |channels: u64, scratch: u64| {
            let values = channels.saturating_mul(height.saturating_mul(width));
            values.saturating_add(scratch.saturating_mul(threads)).saturating_mul(size_of::<f32>() as u64)
        };
        let rest = see.max(hinted).max(trunk).max(end);
        bytes(coarser + rest, inside).max(bytes(coarser + exchange, messages.saturating_mul(band(2))))
    }
}

/// The layers of `config` with the tensors as `convert` gives them.
fn build<E: Scalar>(
    config: &PhotoGraphConfig,
    tensors: &BTreeMap<String, Arc<Vec<f32>>>,
    convert: impl Fn(&Arc<Vec<f32>>) -> Arc<Vec<E>>,
) -> Result<Net<E>> {
    Net::new(config, &mut |name| match tensors.get(name) {
        Some(values) => Ok(Param::constant(convert(values))),
        None => Err(broken(format!("tensor {name} is missing"))),
    })
}

/// The layout of a photo's planes.
fn padded(config: &PhotoGraphConfig, height: usize, width: usize) -> Layout {
    let grain = config.grain();
    Layout { channels: INPUTS, height: height.next_multiple_of(grain), width: width.next_multiple_of(grain) }
}

#[cfg(test)]
mod tests;
