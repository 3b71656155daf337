//! The stages one after the other, and the thread that reports their progress.

use std::ops::ControlFlow;
use std::sync::mpsc;

use super::anisotropy;
use super::choice::Choice;
use super::direct::{DirectFit, Folds, correct, fit_direct, fit_folds, light, relief};
use super::encode::{Prediction, encode};
use super::finish::{Finished, LEFT_OUT, Rehearsal, Start, Weighting, finish};
use super::paper::fit_network;
use super::plan::Route;
use crate::cancel::CancelToken;
use crate::capture::Capture;
use crate::deviations::Deviations;
use crate::error::Result;
use crate::fit::options::{FitOptions, Refine, Reflectance};
use crate::fit::report::StageReport;
use crate::fit::verdict::Expected;
use crate::maps::{Lobe, Maps};
use crate::nn::PhotoGraph;
use crate::progress::{Control, Progress, ProgressFn, Stage};
use crate::raw;

/// What a run has come to.
pub(crate) struct State {
    pub maps: Maps<f32>,
    /// Factors on the light of the photos, where they were estimated.
    pub gains: Option<Vec<f64>>,
    /// Where the finish ran.
    pub deviations: Option<Deviations>,
    pub weighting: Option<Weighting>,
    /// Expected errors of a new photo, where some were left out or the finish says how sure it is.
    pub expected: Option<Expected>,
    /// What the scene was found to require.
    pub choice: Choice,
    pub stages: Vec<StageReport>,
}

impl State {
    fn new(maps: Maps<f32>, gains: Option<Vec<f64>>, stages: Vec<StageReport>) -> Self {
        let reflectance = match maps.lobe() {
            Lobe::Isotropic => Reflectance::Isotropic,
            Lobe::Anisotropic => Reflectance::Anisotropic,
        };
        Self {
            maps,
            gains,
            deviations: None,
            weighting: None,
            expected: None,
            choice: Choice { reflectance, refine: Refine::None, comparisons: Vec::new() },
            stages,
        }
    }
}

/// Runs the stages of `route` on all photos of `capture`.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled); [`Error::NonFinite`](crate::Error::NonFinite) if a loss or a network's values are not finite from the start.
pub(crate) fn run(
    route: Route<'_>,
    capture: &Capture,
    options: &FitOptions,
    control: &mut Control<'_>,
) -> Result<State> {
    let mut stages = Vec::new();
    if let Route::Paper(network) = route {
        let maps = fit_network(capture, &super::targets(capture)?, network, options, &mut stages, control)?;
        return Ok(State::new(maps, None, stages));
    }
    let choice = Choice::new(capture, options, control)?;
    let Choice { reflectance, refine, .. } = choice;
    let options = &FitOptions { reflectance, refine, ..options.clone() };
    let state = match route {
        // Left above.
        Route::Direct | Route::Paper(_) => {
            let (DirectFit { maps, gains }, _) = fit_direct(capture, None, options, &mut stages, control)?;
            let expected = fit_folds(capture, None, LEFT_OUT, options, control)?.expected()?;
            let gains = (refine != Refine::None).then_some(gains);
            State { expected, ..State::new(maps, gains, stages) }
        }
        Route::Graph(graph) => {
            let prediction = encode(capture, graph, &mut stages, control)?;
            let (state, folds) = share(capture, &prediction, options, stages, control)?;
            match options.steps(Stage::Finish) {
                0 => state,
                _ => finish_maps(capture, graph, &prediction, state, folds, options, control)?,
            }
        }
    };
    Ok(State { choice, ..state })
}

/// Stage direct beside a prediction: what pixels have in common is fitted to the photos, from a flat start or, where there is a single photo, near the
/// prediction. With the folds that the finish judges by, if any.
fn share(
    capture: &Capture,
    prediction: &Prediction,
    options: &FitOptions,
    mut stages: Vec<StageReport>,
    control: &mut Control<'_>,
) -> Result<(State, Option<Folds>)> {
    if options.steps(Stage::Direct) == 0 {
        return Ok((State::new(prediction.maps.clone(), None, stages), None));
    }
    let relief = relief(&prediction.maps);
    // One photo does not show both widths of a lobe: the prediction would be no start.
    if capture.len() == 1 && options.reflectance != Reflectance::Anisotropic {
        let maps = correct(capture, &prediction.maps, relief, options, &mut stages, control)?;
        return Ok((State::new(maps, None, stages), None));
    }
    let (direct, taken) = fit_direct(capture, Some(&relief), options, &mut stages, control)?;
    let folds = match options.steps(Stage::Finish) {
        0 => None,
        _ => Some(fit_folds(capture, taken.as_deref(), LEFT_OUT, options, control)?),
    };
    let gains = (options.refine != Refine::None).then_some(direct.gains);
    Ok((State::new(direct.maps, gains, stages), folds))
}

/// Stage finish: every pixel by itself, near the maps of `state`.
fn finish_maps(
    capture: &Capture,
    graph: &PhotoGraph,
    prediction: &Prediction,
    mut state: State,
    folds: Option<Folds>,
    options: &FitOptions,
    control: &mut Control<'_>,
) -> Result<State> {
    let floor = graph.config().roughness_floor;
    let rehearsal = match folds {
        _ if capture.len() == 1 => Rehearsal::default(),
        Some(folds) => Rehearsal::of_direct(capture, folds, floor),
        // The prediction hardly changes where a photo is left out.
        None => Rehearsal::of_prediction(capture, &prediction.raw),
    };
    let mut shared = prediction.raw.clone();
    let (round, anisotropy) = anisotropy::split(&state.maps);
    raw::encode(&round, floor, &mut shared);
    let Prediction { raw: network, deviation, .. } = prediction;
    let start = Start {
        raw: &shared,
        network,
        deviation,
        anisotropy: &anisotropy,
        reflectance: options.reflectance,
        rehearsal: &rehearsal,
    };
    let shots = light::shots(capture, state.gains.as_deref().unwrap_or(&vec![1.0; capture.len()]));
    let steps = options.steps(Stage::Finish);
    let Finished { raw, deviation, weighting, expected } =
        finish(capture, &shots, start, f64::from(floor), steps, &mut state.stages, control)?;
    let mut round = round.into_owned();
    graph.decoding()?.decode(&raw, &mut round)?;
    let deviations = Some(raw::deviations(&round, &deviation)?);
    state.maps = anisotropy::join(round, &anisotropy)?;
    Ok(State { deviations, weighting: Some(weighting), expected: Some(expected), ..state })
}

/// Runs `work` on the threads of `pool` while the calling thread serves its progress: callbacks of hosts are bound to the thread they
/// come from.
pub(crate) fn on_pool<T: Send>(
    pool: &rayon::ThreadPool,
    cancel: CancelToken,
    progress: &mut ProgressFn<'_>,
    work: impl FnOnce(&mut Control<'_>) -> Result<T> + Send,
) -> Result<T> {
    let (reports, reported) = mpsc::sync_channel::<Progress>(0);
    let (answers, answered) = mpsc::sync_channel::<ControlFlow<()>>(0);
    std::thread::scope(|scope| {
        let worker = scope.spawn(move || {
            pool.install(move || {
                // A caller that is gone (its callback panicked) wants nothing more.
                let mut ask = |progress: &Progress| match reports.send(*progress) {
                    Ok(()) => answered.recv().unwrap_or(ControlFlow::Break(())),
                    Err(_) => ControlFlow::Break(()),
                };
                work(&mut Control::new(&mut ask, cancel))
            })
        });
        while let Ok(report) = reported.recv() {
            if answers.send(progress(&report)).is_err() {
                break;
            }
        }
        // A panic in the work goes on in the caller, whose guard expects it there.
        worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}
