//! From photos to maps: with the default network and the finish, with the feature-embedded optimisation of the paper (Section 3.3), and
//! without a network.

pub mod adam;
pub mod adapters;
mod cluster;
pub mod descent;
mod deviations;
mod direct;
mod finish;
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

use std::ops::ControlFlow;
use std::sync::mpsc;
use std::time::Instant;

use crate::capture::Capture;
use crate::error::Result;
use crate::material::Material;
use crate::metrics::photo_rmse;
use crate::nn::{Model, Network, PhotoGraph};
use crate::pool::pool;
use crate::render::{Target, render};
pub use deviations::Deviations;
use direct::{Direct, fit_direct};
use network::fit_network;
use options::{FitOptions, Method};
use predicted::{Predicted, fit_predicted};
use progress::{CancelToken, Control, Progress, ProgressFn};
use report::FitReport;

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
    options.check()?;
    let mut warnings = capture.warnings().to_vec();
    let mut embedded = None;
    let way = match options.method {
        Method::Direct => Way::Direct,
        Method::Network | Method::Auto => {
            let model = match model {
                Some(model) => model,
                None => embedded.insert(Model::embedded()?),
            };
            match model.photo_graph() {
                Some(graph) => Way::Graph(graph),
                None => Way::Paper(model.network(capture.len())?),
            }
        }
    };
    let pool = pool(options.threads)?;
    // The need depends on the number of threads.
    let needed = pool.install(|| memory::estimate(capture, way));
    crate::memory::check("the run", needed, crate::memory::allowed(options.max_memory))?;
    on_pool(&pool, options.cancel.clone(), progress, |control| {
        let mut stages = Vec::new();
        let alone = |maps| Predicted { maps, gains: None, deviations: None, belief: None };
        let Predicted { maps, gains, deviations, belief } = match way {
            Way::Paper(network) => {
                alone(fit_network(capture, &targets(capture)?, network, options, &mut stages, control)?)
            }
            Way::Direct => {
                let Direct { maps, gains } = fit_direct(capture, None, options, &mut stages, control)?;
                Predicted { gains: Some(gains), ..alone(maps) }
            }
            Way::Graph(graph) => fit_predicted(capture, graph, options, &mut stages, control)?,
        };
        let unit = capture.unit().cloned();
        let material = Material { unit, ..Material::from_maps(&maps, capture.patch_size())? };
        let photo_errors = capture
            .photos()
            .iter()
            .map(|photo| photo_rmse(&render(&material, &photo.shot)?, &photo.image))
            .collect::<Result<Vec<_>>>()?;
        for stage in stages.iter().filter(|stage| stage.rollbacks > 0) {
            let (name, count) = (stage.stage.name(), stage.rollbacks);
            warnings.push(format!("{name}: {count} steps led to values that are not finite and were undone"));
        }
        let report = FitReport {
            method: if matches!(way, Way::Direct) { Method::Direct } else { Method::Network },
            preset: options.preset,
            seed: options.seed,
            threads: rayon::current_num_threads(),
            photos: capture.photos().iter().map(|photo| photo.name.clone()).collect(),
            transfer: capture.transfer(),
            stages,
            photo_errors,
            light_gains: gains,
            photo_deviation: belief.map(|belief| belief.photo_deviation),
            believed_shares: belief.map(|belief| belief.shares),
            seconds: started.elapsed().as_secs_f64(),
            warnings,
        };
        Ok(Fit { material, deviations, report })
    })
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
