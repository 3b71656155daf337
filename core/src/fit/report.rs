//! What a fit did, for `material.json` and for the caller.

use serde::Serialize;

use std::time::Instant;

use crate::capture::{Assumed, Capture, Photo};
use crate::color::Transfer;
use crate::error::Result;
use crate::fit::choice::{Choice, Comparison};
use crate::fit::conditions;
use crate::fit::optim::descent::Descent;
use crate::fit::options::FitOptions;
use crate::fit::options::{Method, Preset, Refine, Reflectance};
use crate::fit::plan::Selection;
use crate::fit::run::State;
use crate::fit::verdict::{self, Evidence, Verdict};
use crate::material::Material;
use crate::metrics::photo_rmse;
use crate::progress::Stage;
use crate::render::render;

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
    /// What the surface was taken to be made of.
    pub reflectance: Reflectance,
    /// Where that was chosen by photos left out: the error under each, simplest first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub reflectance_errors: Vec<Comparison>,
    /// What of the capture's statements was corrected.
    pub refine: Refine,
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
    /// How far camera and light of each photo were moved for the fit, in the capture's unit; `None` where the stated positions were taken, 0 for photos left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_offsets: Option<Vec<[f64; 3]>>,
    /// Factor on the stated light intensity of each photo with which the maps were fitted; `None` where the stated ones were taken, 1 for photos left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light_gains: Option<Vec<f64>>,
    /// Standard deviation of what the maps cannot explain in the photos (gamma 2.2 codes), as the finish chose it; `None` without finish.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub photo_deviation: Option<f64>,
    /// Shares of the network's deviation that the finish believed: in normals; in specular albedo and roughness.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub believed_shares: Option<[f64; 2]>,
    /// How the surface leans as a whole ([`Material::tilt`]): mean slopes towards +x and +y. The maps are in the capture's frame; an export takes it out.
    pub tilt: [f64; 2],
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

impl FitReport {
    /// What is to be said of `material`, the maps of `state`, beside the photos of `capture`.
    pub(super) fn new(
        capture: &Capture,
        selection: &Selection<'_>,
        (state, choice): (State, Choice),
        material: &Material,
        memory_estimate: u64,
        options: &FitOptions,
        started: Instant,
    ) -> Result<Self> {
        let Selection { contradicting, kept, route } = selection;
        let State { maps, refined, weighting, expected, stages, .. } = state;
        let (mut photo_errors, mut shifts) = (Vec::new(), Vec::new());
        for photo in capture.photos() {
            let rendering = render(material, &photo.shot)?;
            photo_errors.push(photo_rmse(&rendering, &photo.image)?);
            shifts.push(verdict::shift(photo, &rendering));
        }
        let verdict = verdict::verdict(&Evidence {
            capture,
            contradicting,
            kept,
            expected,
            gains: refined.as_ref().map(|refined| &refined.gains[..]),
            photo_deviation: weighting.map(|weighting| weighting.photo),
            at_limit: conditions::at_limit(&maps),
            black_share: conditions::black_share(capture),
            shifts: &shifts,
        });
        let mut warnings = [capture.warnings(), &conditions::warnings(capture)].concat();
        warnings.extend(verdict.warnings());
        for stage in stages.iter().filter(|stage| stage.rollbacks > 0) {
            let (name, count) = (stage.stage.name(), stage.rollbacks);
            warnings.push(format!("{name}: {count} steps led to values that are not finite and were undone"));
        }
        let name = |photo: &Photo| photo.name.clone();
        let moved = refined.as_ref().filter(|_| choice.refine == Refine::All);
        let left_out = (0..capture.len()).filter(|photo| !kept.contains(photo));
        Ok(Self {
            method: route.method(),
            preset: options.preset,
            reflectance: choice.reflectance,
            reflectance_errors: choice.comparisons,
            refine: choice.refine,
            seed: options.seed,
            threads: rayon::current_num_threads(),
            photos: capture.photos().iter().map(name).collect(),
            photos_left_out: left_out.map(|photo| name(&capture.photos()[photo])).collect(),
            transfer: capture.transfer(),
            assumed: capture.assumed().copied(),
            stages,
            photo_errors,
            position_offsets: moved.map(|refined| of_all(capture.len(), kept, &refined.offsets, [0.0; 3])),
            light_gains: refined.as_ref().map(|refined| of_all(capture.len(), kept, &refined.gains, 1.0)),
            photo_deviation: weighting.map(|weighting| weighting.photo),
            believed_shares: weighting.map(|weighting| [weighting.normal, weighting.specular]),
            tilt: material.tilt(),
            verdict,
            memory_estimate,
            seconds: started.elapsed().as_secs_f64(),
            warnings,
        })
    }
}

/// One value for each of `count` photos: `values` for the `kept` ones, `other` for the rest.
fn of_all<T: Copy>(count: usize, kept: &[usize], values: &[T], other: T) -> Vec<T> {
    let mut all = vec![other; count];
    kept.iter().zip(values).for_each(|(&photo, value)| all[photo] = *value);
    all
}
