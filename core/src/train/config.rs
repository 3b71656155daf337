//! Training configurations.

use serde::{Deserialize, Serialize};

/// The optimiser, and its learning rate over the training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct OptimiserSettings {
    /// Largest learning rate.
    pub rate: f64,
    /// Learning rate at the end.
    pub final_rate: f64,
    /// Share of the training over which the learning rate grows to the largest.
    pub warmup: f64,
    /// Weight decay of the kernels of convolutions.
    pub decay: f64,
    /// Decays of the running means of the gradient and of its square.
    pub betas: [f64; 2],
    /// Largest norm of the gradient; a longer one is shortened to it.
    pub clip: f64,
    /// Decay of the moving average of the parameters.
    pub average: f64,
}

impl Default for OptimiserSettings {
    fn default() -> Self {
        Self { rate: 1e-3, final_rate: 1e-6, warmup: 0.02, decay: 1e-4, betas: [0.9, 0.95], clip: 1.0, average: 0.999 }
    }
}

/// Weights of the losses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct LossSettings {
    /// Weight of the maps.
    pub maps: f64,
    /// Weight of the renderings.
    pub rendering: f64,
    /// Renderings of a material.
    pub views: usize,
    /// Weight of the certainty.
    pub certainty: f64,
}

impl Default for LossSettings {
    fn default() -> Self {
        Self { maps: 10.0, rendering: 1.0, views: 9, certainty: 0.1 }
    }
}
