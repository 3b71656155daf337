//! From photos to maps: with the default network and the finish, with the feature-embedded optimisation of the paper (Section 3.3), and
//! without a network.

pub mod adam;
pub mod adapters;
mod cluster;
mod conditions;
mod contradiction;
pub mod descent;
mod deviations;
mod direct;
mod finish;
mod holdout;
pub mod latent;
mod light;
mod memory;
mod network;
pub mod options;
mod predicted;
pub mod progress;
pub mod report;
mod search;
mod shading;
pub mod verdict;

use std::borrow::Cow;
use std::ops::ControlFlow;
use std::sync::mpsc;
use std::time::Instant;

use crate::capture::{Capture, Photo};
use crate::error::Result;
use crate::material::Material;
use crate::metrics::photo_rmse;
use crate::nn::{Model, Network, PhotoGraph};
use crate::pool::pool;
use crate::render::{Target, render};
use contradiction::contradicting;
pub use deviations::Deviations;
use direct::{Direct, fit_direct, fit_without};
use finish::LEFT_OUT;
use memory::Estimate;
use network::fit_network;
use options::{FitOptions, Method};
use predicted::{Predicted, fit_predicted};
use progress::{CancelToken, Control, Progress, ProgressFn, Stage};
use report::{FitReport, StageReport};
use verdict::Evidence;

/// A fitted material and how it came about.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The maps.
    pub material: Material,
    /// How sure the fit is of them; `None` where no finish ran.
    pub deviations: Option<Deviations>,
    /// Stages, losses, timings, warnings.
    pub report: FitReport,
}

/// Recovers the material that the photos of `capture` show.
///
/// One photo of which the light is [`Assumed`](crate::capture::Assumed) is fitted twice, the second time under the light that the first result calls for.
///
/// `model` may be `None`: then [`Model::embedded`]. `progress` is called at least after every step and stops the run when it breaks.
///
/// # Errors
/// [`Error::InvalidArgument`](crate::Error::InvalidArgument) for options out of range or a model that cannot take this many photos; [`Error::OutOfMemory`](crate::Error::OutOfMemory) before
/// anything is computed; [`Error::Cancelled`](crate::Error::Cancelled); [`Error::NonFinite`](crate::Error::NonFinite) if the loss is not finite from the start.
pub fn fit_material(
    capture: &Capture,
    model: Option<&Model>,
    options: &FitOptions,
    progress: &mut ProgressFn<'_>,
) -> Result<Fit> {
    let started = Instant::now();
    let fit = fit_stated(capture, 0, model, options, started, progress)?;
    let Some(assumed) = capture.assumed().filter(|assumed| assumed.light_is_chosen) else { return Ok(fit) };
    let assumed = assumed.with_light_for(&fit.material);
    drop(fit);
    fit_stated(&capture.with_assumed(assumed)?, capture.memory(), model, options, started, progress)
}

/// [`fit_material`] under the light that `capture` states, beside `held` bytes.
fn fit_stated(
    capture: &Capture,
    held: u64,
    model: Option<&Model>,
    options: &FitOptions,
    started: Instant,
    progress: &mut ProgressFn<'_>,
) -> Result<Fit> {
    options.check()?;
    let mut embedded = None;
    let model = match (options.method, model) {
        (Method::Direct, _) => None,
        (Method::Network | Method::Auto, Some(model)) => Some(model),
        (Method::Network | Method::Auto, None) => Some(&**embedded.insert(Model::embedded()?)),
    };
    let way = Way::of(model, capture.len())?;
    let pool = pool(options.threads)?;
    // The need depends on the number of threads.
    let Estimate { in_use, peak } = pool.install(|| memory::estimate(capture, model, way));
    let (in_use, peak) = (in_use.saturating_add(held), peak.saturating_add(held));
    let (width, height, photos) = (capture.width(), capture.height(), capture.len());
    let what = format!("a fit to {photos} photos of {width} x {height} pixels");
    crate::memory::check(&what, peak, crate::memory::allowed(options.max_memory, in_use))?;
    let memory_estimate = peak.max(capture.reading_memory());
    on_pool(&pool, options.cancel.clone(), progress, |control| {
        let mut warnings = [capture.warnings(), &conditions::warnings(capture)].concat();
        let mut stages = Vec::new();
        way.begin(options, control)?;
        let usual = conditions::usual_exposure(capture)?;
        let Choice { contradicting, kept, way } = choose_photos(&usual, model, way, options, control)?;
        let fitted = if kept.len() == capture.len() { usual } else { Cow::Owned(usual.select(&kept)?) };
        let Predicted { mut maps, gains, mut deviations, belief, expected } =
            way.run(&fitted, options, &mut stages, control)?;
        conditions::fill_unlit(capture, &mut maps, deviations.as_mut());
        let unit = capture.unit().cloned();
        let material = Material { unit, ..Material::from_maps(&maps, capture.patch_size())? };
        let (mut photo_errors, mut shifts) = (Vec::new(), Vec::new());
        for photo in capture.photos() {
            let rendering = render(&material, &photo.shot)?;
            photo_errors.push(photo_rmse(&rendering, &photo.image)?);
            shifts.push(verdict::shift(photo, &rendering));
        }
        let verdict = verdict::verdict(&Evidence {
            capture,
            contradicting: &contradicting,
            kept: &kept,
            expected,
            gains: gains.as_deref(),
            photo_deviation: belief.map(|belief| belief.photo_deviation),
            at_limit: conditions::at_limit(&maps),
            shifts: &shifts,
        });
        warnings.extend(verdict.warnings());
        for stage in stages.iter().filter(|stage| stage.rollbacks > 0) {
            let (name, count) = (stage.stage.name(), stage.rollbacks);
            warnings.push(format!("{name}: {count} steps led to values that are not finite and were undone"));
        }
        let name = |photo: &Photo| photo.name.clone();
        let report = FitReport {
            method: if matches!(way, Way::Direct) { Method::Direct } else { Method::Network },
            preset: options.preset,
            seed: options.seed,
            threads: rayon::current_num_threads(),
            photos: capture.photos().iter().map(name).collect(),
            photos_left_out: (0..capture.len())
                .filter(|photo| !kept.contains(photo))
                .map(|photo| name(&capture.photos()[photo]))
                .collect(),
            transfer: capture.transfer(),
            assumed: capture.assumed().copied(),
            stages,
            photo_errors,
            light_gains: gains.map(|gains| {
                let mut all = vec![1.0; capture.len()];
                kept.iter().zip(gains).for_each(|(&photo, gain)| all[photo] = gain);
                all
            }),
            photo_deviation: belief.map(|belief| belief.photo_deviation),
            believed_shares: belief.map(|belief| belief.shares),
            verdict,
            memory_estimate,
            seconds: started.elapsed().as_secs_f64(),
            warnings,
        };
        Ok(Fit { material, deviations, report })
    })
}

/// Which photos are fitted, and how.
struct Choice<'a> {
    /// Photos that contradict the others.
    contradicting: Vec<usize>,
    /// The photos that are fitted.
    kept: Vec<usize>,
    way: Way<'a>,
}

/// Leaves out photos that contradict the others, where `model` takes fewer.
fn choose_photos<'a>(
    capture: &Capture,
    model: Option<&'a Model>,
    way: Way<'a>,
    options: &FitOptions,
    control: &mut Control<'_>,
) -> Result<Choice<'a>> {
    let contradicting = contradicting(capture, options, control)?;
    let all = 0..capture.len();
    // A network of the paper's form may be for this number of photos alone.
    let (kept, way) = match Way::of(model, capture.len() - contradicting.len()) {
        Ok(way) => (all.filter(|photo| !contradicting.contains(photo)).collect(), way),
        Err(_) => (all.collect(), way),
    };
    Ok(Choice { contradicting, kept, way })
}

/// The photos as the loss compares with them.
fn targets(capture: &Capture) -> Result<Vec<Target>> {
    capture.photos().iter().map(Target::from_photo).collect()
}

/// How maps are found.
#[derive(Clone, Copy)]
pub(crate) enum Way<'a> {
    /// Without a network.
    Direct,
    /// With a network of the paper's form.
    Paper(&'a Network),
    /// With a photo graph and the finish.
    Graph(&'a PhotoGraph),
}

impl<'a> Way<'a> {
    /// # Errors
    /// As [`Model::network`].
    fn of(model: Option<&'a Model>, photos: usize) -> Result<Self> {
        let Some(model) = model else { return Ok(Self::Direct) };
        match model.photo_graph() {
            Some(graph) => Ok(Self::Graph(graph)),
            None => Ok(Self::Paper(model.network(photos)?)),
        }
    }

    /// Reports the first stage: what comes before it belongs to it.
    fn begin(self, options: &FitOptions, control: &mut Control<'_>) -> Result<()> {
        match self {
            Self::Direct => {
                let steps = options.direct_steps.unwrap_or(options.preset.direct_steps());
                control.report(Stage::Direct, 0, steps, None)
            }
            Self::Paper(_) | Self::Graph(_) => control.report(Stage::Encode, 0, 1, None),
        }
    }

    fn run(
        self,
        capture: &Capture,
        options: &FitOptions,
        stages: &mut Vec<StageReport>,
        control: &mut Control<'_>,
    ) -> Result<Predicted> {
        let alone = |maps, gains, expected| Predicted { maps, gains, deviations: None, belief: None, expected };
        match self {
            Self::Paper(network) => {
                Ok(alone(fit_network(capture, &targets(capture)?, network, options, stages, control)?, None, None))
            }
            Self::Direct => {
                let (Direct { maps, gains }, _) = fit_direct(capture, None, options, stages, control)?;
                let expected = fit_without(capture, None, LEFT_OUT, options, control)?.expected()?;
                Ok(alone(maps, Some(gains), expected))
            }
            Self::Graph(graph) => fit_predicted(capture, graph, options, stages, control),
        }
    }
}

/// Runs `work` on the threads of `pool` while the calling thread serves its progress: callbacks of hosts are bound to the thread they
/// come from.
fn on_pool<T: Send>(
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
