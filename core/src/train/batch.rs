//! What one step of training sees.

use crate::shot::Shot;

/// A capture of one material, and what it should give.
pub(crate) struct Example {
    /// What the network sees, (N, 13, H, W), see `camera.network_input` / `nn::photo_graph::input`.
    pub inputs: Vec<f32>,
    /// The true maps, (10, H, W): diffuse 3, normal 3, roughness 1, specular 3.
    pub maps: Vec<f32>,
    /// Where renderings are compared: a patch from -1 to 1 (`patch_size` 2).
    pub views: Vec<Shot>,
}

/// The examples of a step, all with the same number of photos and the same size.
pub(crate) struct Batch {
    pub photos: usize,
    pub height: usize,
    pub width: usize,
    pub examples: Vec<Example>,
}
