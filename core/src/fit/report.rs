//! What a fit did, for `material.json` and for the caller.

use serde::Serialize;

use crate::capture::Assumed;
use crate::color::Transfer;
use crate::fit::descent::Descent;
use crate::fit::options::{Method, Preset};
use crate::fit::progress::Stage;
use crate::fit::verdict::Verdict;

/// What one stage did.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct StageReport {
    /// The stage.
    pub stage: Stage,
    /// Steps taken.
    pub steps: usize,
    /// Loss before the first step: 1000 times the mean squared error of the gamma 2.2 encoded photos, plus the priors of the stage.
    pub first_loss: f64,
    /// Loss of the state that was kept.
    pub best_loss: f64,
    /// How often a value was not finite and the stage went back to its best state with smaller steps.
    pub rollbacks: usize,
    /// Whether it stopped because the loss had flattened.
    pub stopped_early: bool,
    /// Wall-clock seconds.
    pub seconds: f64,
}

impl StageReport {
    pub(crate) fn new(stage: Stage, descent: &Descent, seconds: f64) -> Self {
        Self {
            stage,
            steps: descent.steps,
            first_loss: descent.first_loss,
            best_loss: descent.best_loss,
            rollbacks: descent.rollbacks,
            stopped_early: descent.stopped_early,
            seconds,
        }
    }
}

/// What a fit did and with which settings.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct FitReport {
    /// [`Method::Network`] or [`Method::Direct`], whichever ran.
    pub method: Method,
    /// The preset asked for.
    pub preset: Preset,
    /// The seed.
    pub seed: u64,
    /// Threads used.
    pub threads: usize,
    /// Names of the photos of the capture.
    pub photos: Vec<String>,
    /// Of these, the ones that contradict the others: the maps were fitted without them.
    pub photos_left_out: Vec<String>,
    /// The transfer function the photos were decoded with.
    pub transfer: Transfer,
    /// What was assumed of a photo that came without a capture.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub assumed: Option<Assumed>,
    /// The stages that ran, in order.
    pub stages: Vec<StageReport>,
    /// Error of each photo re-rendered under the stated light: RMSE of gamma 2.2 encoded values, clamped to [0, 1].
    pub photo_errors: Vec<f64>,
    /// Factor on the stated light intensity of each photo with which the maps were fitted; `None` where the stated ones were taken, 1 for photos left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light_gains: Option<Vec<f64>>,
    /// Standard deviation of what the maps cannot explain in the photos (gamma 2.2 codes), as the finish chose it; `None` without finish.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub photo_deviation: Option<f64>,
    /// Shares of the network's deviation that the finish believed: in normals; in specular albedo and roughness.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub believed_shares: Option<[f64; 2]>,
    /// What may be expected of the maps: `verdict`, `expected_error`, `material_error`, `estimated` and `reasons` in files.
    #[serde(flatten)]
    pub verdict: Verdict,
    /// Estimated bytes at the peak of the run, from the reading of photos on, as they were compared with `max_memory`.
    pub memory_estimate: u64,
    /// Wall-clock seconds of the whole fit.
    pub seconds: f64,
    /// What the user should know, the capture's own warnings first.
    pub warnings: Vec<String>,
}
