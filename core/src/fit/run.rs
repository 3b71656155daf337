//! The stages one after the other, and the thread that reports their progress.

use std::ops::ControlFlow;
use std::sync::mpsc;

use super::anisotropy;
use super::choice::Choice;
use super::direct::{DirectFit, FoldRelief, Relief, correct, fit_direct, fit_folds, relief, relief_of_raw};
use super::encode::{Prediction, encode};
use super::finish::{Finished, Judgement, LEFT_OUT, Problem, Rehearsal, Start, Weighting};
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
use crate::raw::{self, RAW};

/// Share of the error of photos left out that another pass has to take away.
const PASS_GAIN: f64 = 0.01;

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
            let (DirectFit { maps, gains }, _) = fit_direct(capture, Relief::Flat, options, &mut stages, control)?;
            let expected = fit_folds(capture, FoldRelief::Flat, None, LEFT_OUT, options, control)?.expected()?;
            let gains = (refine != Refine::None).then_some(gains);
            State { expected, ..State::new(maps, gains, stages) }
        }
        Route::Graph(graph) => fit_graph(capture, graph, stages, options, control)?,
    };
    Ok(State { choice, ..state })
}

/// Stages encode, direct and finish; the latter two again while that predicts photos left out better.
fn fit_graph(
    capture: &Capture,
    graph: &PhotoGraph,
    mut stages: Vec<StageReport>,
    options: &FitOptions,
    control: &mut Control<'_>,
) -> Result<State> {
    let prediction = encode(capture, graph, &mut stages, control)?;
    let predicted = relief(&prediction.maps);
    let mut state = State::new(prediction.maps.clone(), None, stages);
    let share_steps = options.steps(Stage::Direct);
    // One photo shows the shape of the highlight over the whole image, but not both widths of a lobe.
    let correcting = share_steps > 0 && capture.len() == 1 && options.reflectance != Reflectance::Anisotropic;
    let sharing = share_steps > 0 && !correcting;
    let mut taken = None;
    if correcting {
        state.maps = correct(capture, &prediction.maps, predicted, options, &mut state.stages, control)?;
    } else if sharing {
        taken = share(capture, Relief::Predicted(&predicted), &mut state, options, control)?;
    }
    if options.steps(Stage::Finish) == 0 {
        return Ok(state);
    }
    let floor = graph.config().roughness_floor;
    let Prediction { raw: network, deviation, .. } = &prediction;
    let problem = Problem::new(capture, network, deviation, options.reflectance, f64::from(floor))?;
    let rehearsal = if capture.len() == 1 {
        Rehearsal::default()
    } else if sharing {
        let relief = taken.as_deref().map_or(FoldRelief::Flat, FoldRelief::Common);
        Rehearsal::of_direct(capture, fit_folds(capture, relief, None, LEFT_OUT, options, control)?, floor)
    } else {
        // The prediction hardly changes where a photo is left out.
        Rehearsal::of_prediction(capture, network)
    };
    let mut judgement = problem.judge(&rehearsal, control)?;
    state = finish(&problem, &judgement, state, graph, options, control)?;
    let passes = if sharing && capture.len() > 2 { options.preset.passes() } else { 1 };
    for _ in 1..passes {
        let reliefs: Vec<Vec<f32>> = judgement.folds.iter().map(|raw| relief_of_raw(raw)).collect();
        let folds = fit_folds(capture, FoldRelief::Each(&reliefs), None, LEFT_OUT, options, control)?;
        let next = problem.judge(&Rehearsal::of_direct(capture, folds, floor), control)?;
        let [before, after] = [&judgement, &next].map(|one| one.expected.map_or(0.0, |expected| expected.error));
        tracing::debug!("photos left out, before another pass and after it: {before:.4}, {after:.4}");
        if after > (1.0 - PASS_GAIN) * before {
            break;
        }
        judgement = next;
        let found = relief(&state.maps);
        share(capture, Relief::Found(&found), &mut state, options, control)?;
        state = finish(&problem, &judgement, state, graph, options, control)?;
    }
    Ok(state)
}

/// Stage direct: what pixels have in common is fitted to the photos, from a flat start or with a relief. Gives the relief that was taken.
fn share(
    capture: &Capture,
    relief: Relief<'_>,
    state: &mut State,
    options: &FitOptions,
    control: &mut Control<'_>,
) -> Result<Option<Vec<f32>>> {
    let (direct, taken) = fit_direct(capture, relief, options, &mut state.stages, control)?;
    state.maps = direct.maps;
    state.gains = (options.refine != Refine::None).then_some(direct.gains);
    Ok(taken)
}

/// Stage finish: every pixel by itself, near the maps of `state`.
fn finish(
    problem: &Problem<'_>,
    judgement: &Judgement,
    mut state: State,
    graph: &PhotoGraph,
    options: &FitOptions,
    control: &mut Control<'_>,
) -> Result<State> {
    let (round, anisotropy) = anisotropy::split(&state.maps);
    let mut shared = vec![0.0; RAW * round.width() * round.height()];
    raw::encode(&round, graph.config().roughness_floor, &mut shared);
    let shots = problem.shots(state.gains.as_deref());
    let start = Start { raw: &shared, anisotropy: &anisotropy, shots: &shots };
    let steps = options.steps(Stage::Finish);
    let Finished { raw, deviation, expected } = problem.finish(start, judgement, steps, &mut state.stages, control)?;
    let mut round = round.into_owned();
    graph.decoding()?.decode(&raw, &mut round)?;
    let deviations = Some(raw::deviations(&round, &deviation)?);
    state.maps = anisotropy::join(round, &anisotropy)?;
    Ok(State { deviations, weighting: Some(judgement.weighting), expected: Some(expected), ..state })
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
