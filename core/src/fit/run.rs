//! The stages one after the other, and the thread that reports their progress.

use std::ops::ControlFlow;
use std::sync::mpsc;

use super::anisotropy;
use super::choice::Choice;
use super::direct::{DirectFit, FoldRelief, Relief, correct, fit_direct, fit_folds, light, relief, relief_of_raw};
use super::encode::{Prediction, encode};
use super::finish::{Finished, Fold, Judgement, Problem, Rehearsal, Start, Weighting};
use super::optim::holdout::LEFT_OUT;
use super::paper::fit_network;
use super::plan::Route;
use crate::cancel::CancelToken;
use crate::capture::Capture;
use crate::deviations::Deviations;
use crate::error::Result;
use crate::fit::options::{FitOptions, Refine, Reflectance};
use crate::fit::report::StageReport;
use crate::fit::verdict::Expected;
use crate::maps::Maps;
use crate::nn::PhotoGraph;
use crate::progress::{Control, Progress, ProgressFn, Stage};
use crate::raw::{self, RAW};
use crate::shot::Shot;

/// Share of the error of photos left out that another pass has to take away.
const PASS_GAIN: f64 = 0.01;
/// Another pass begins nearer to its end: it takes this fraction of the first one's steps.
const PASS_STEPS: usize = 3;

/// What a run has come to.
pub(crate) struct State {
    pub maps: Maps<f32>,
    /// How the photos are taken to have been shot, where that was corrected.
    pub refined: Option<Refined>,
    /// Where the finish ran.
    pub deviations: Option<Deviations>,
    pub weighting: Option<Weighting>,
    /// Expected errors of a new photo, where some were left out or the finish says how sure it is.
    pub expected: Option<Expected>,
    pub stages: Vec<StageReport>,
}

/// How photos were shot in place of what their capture states.
pub(crate) struct Refined {
    pub shots: Vec<Shot>,
    /// Factors on the stated light.
    pub gains: Vec<f64>,
    /// How far camera and light were moved.
    pub offsets: Vec<[f64; 3]>,
}

impl Refined {
    fn new(capture: &Capture, shots: Vec<Shot>) -> Self {
        let stated = || capture.photos().iter().map(|photo| &photo.shot).zip(&shots);
        let gains: Vec<f64> = stated().map(|(stated, shot)| light::gain(shot, stated)).collect();
        tracing::debug!("light of the photos: {gains:.3?}");
        let offset = |(stated, shot): (&Shot, &Shot)| std::array::from_fn(|i| shot.camera[i] - stated.camera[i]);
        let offsets = stated().map(offset).collect();
        Self { shots, gains, offsets }
    }
}

impl State {
    fn new(maps: Maps<f32>, refined: Option<Refined>, stages: Vec<StageReport>) -> Self {
        Self { maps, refined, deviations: None, weighting: None, expected: None, stages }
    }
}

/// Runs the stages of `route` on all photos of `capture`; and what the scene was found to require.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled); [`Error::NonFinite`](crate::Error::NonFinite) if a loss or a network's values are not finite from the start.
pub(crate) fn run(
    route: Route<'_>,
    capture: &Capture,
    options: &FitOptions,
    control: &mut Control<'_>,
) -> Result<(State, Choice)> {
    let mut stages = Vec::new();
    let graph = match route {
        Route::Paper(network) => {
            let maps = fit_network(capture, &super::targets(capture)?, network, options, &mut stages, control)?;
            let choice = Choice::of_lobe(maps.lobe());
            return Ok((State::new(maps, None, stages), choice));
        }
        Route::Direct => None,
        Route::Graph(graph) => Some(graph),
    };
    let choice = Choice::new(capture, options, control)?;
    let Choice { reflectance, refine, .. } = choice;
    let options = &FitOptions { reflectance, refine, ..options.clone() };
    let state = match graph {
        Some(graph) => fit_graph(capture, graph, options, control)?,
        None => {
            let (state, _) = share(capture, Relief::Flat, stages, options, control)?;
            let expected = fit_folds(capture, FoldRelief::Flat, None, LEFT_OUT, options, control)?.expected()?;
            State { expected, ..state }
        }
    };
    Ok((state, choice))
}

/// Stages encode, direct and finish; the latter two again while that predicts photos left out better.
fn fit_graph(capture: &Capture, graph: &PhotoGraph, options: &FitOptions, control: &mut Control<'_>) -> Result<State> {
    let mut stages = Vec::new();
    let Prediction { maps, raw: network, deviation } =
        encode(capture, graph, options.preset.mirror_images(capture.len()), &mut stages, control)?;
    let predicted = relief(&maps);
    // One photo shows the shape of the highlight over the whole image, but not both widths of a lobe.
    let correcting = capture.len() == 1 && options.reflectance != Reflectance::Anisotropic;
    let sharing = options.steps(Stage::Direct) > 0 && !correcting;
    let (mut state, takes_relief) = if sharing {
        share(capture, Relief::Predicted(&predicted), stages, options, control)?
    } else if options.steps(Stage::Direct) > 0 {
        let maps = correct(capture, &maps, predicted.clone(), options, &mut stages, control)?;
        (State::new(maps, None, stages), false)
    } else {
        (State::new(maps, None, stages), false)
    };
    if options.steps(Stage::Finish) == 0 {
        return Ok(state);
    }
    let floor = graph.config().roughness_floor;
    let problem = Problem::new(capture, &network, &deviation, options.reflectance, f64::from(floor))?;
    let mut rehearsal = if capture.len() == 1 {
        Rehearsal::default()
    } else if sharing {
        let relief = if takes_relief { FoldRelief::Common(&predicted) } else { FoldRelief::Flat };
        Rehearsal::of_direct(fit_folds(capture, relief, None, LEFT_OUT, options, control)?, floor)
    } else {
        // The prediction hardly changes where a photo is left out.
        Rehearsal::of_prediction(capture, &network)
    };
    let mut judgement = problem.judge(&rehearsal, control)?;
    state = finish(&problem, judgement, state, graph, options, control)?;
    let passes = if sharing && capture.len() > 2 { options.preset.passes() } else { 1 };
    let options =
        &FitOptions { direct_steps: Some(options.steps(Stage::Direct).div_ceil(PASS_STEPS)), ..options.clone() };
    for _ in 1..passes {
        let without = |fold: &Fold| relief_of_raw(&problem.without(fold, judgement.weighting, &rehearsal));
        let reliefs: Vec<Vec<f32>> = rehearsal.folds.iter().map(without).collect();
        let folds = fit_folds(capture, FoldRelief::Each(&reliefs), None, LEFT_OUT, options, control)?;
        rehearsal = Rehearsal::of_direct(folds, floor);
        let next = problem.judge(&rehearsal, control)?;
        let [before, after] = [judgement, next].map(|one| one.expected.map_or(0.0, |expected| expected.error));
        tracing::debug!("photos left out, before another pass and after it: {before:.4}, {after:.4}");
        if after > (1.0 - PASS_GAIN) * before {
            break;
        }
        judgement = next;
        let found = relief(&state.maps);
        (state, _) = share(capture, Relief::Found(&found), state.stages, options, control)?;
        state = finish(&problem, judgement, state, graph, options, control)?;
    }
    Ok(state)
}

/// Stage direct: what pixels have in common is fitted to the photos, from a flat start or with a relief. Whether the relief was taken, too.
fn share(
    capture: &Capture,
    relief: Relief<'_>,
    mut stages: Vec<StageReport>,
    options: &FitOptions,
    control: &mut Control<'_>,
) -> Result<(State, bool)> {
    let (DirectFit { maps, shots }, takes_relief) = fit_direct(capture, relief, options, &mut stages, control)?;
    let refined = (options.refine != Refine::None).then(|| Refined::new(capture, shots));
    Ok((State::new(maps, refined, stages), takes_relief))
}

/// Stage finish: every pixel by itself, near the maps of `state`.
fn finish(
    problem: &Problem<'_>,
    judgement: Judgement,
    mut state: State,
    graph: &PhotoGraph,
    options: &FitOptions,
    control: &mut Control<'_>,
) -> Result<State> {
    let (round, anisotropy) = anisotropy::split(&state.maps);
    let mut shared = vec![0.0; RAW * round.width() * round.height()];
    raw::encode(&round, graph.config().roughness_floor, &mut shared);
    let shots = state.refined.as_ref().map_or_else(|| problem.shots(), |refined| refined.shots.clone());
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
