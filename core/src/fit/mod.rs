//! From photos to maps: the feature-embedded optimisation of the paper (Section 3.3), and the fit without a network.

pub mod adam;
pub mod adapters;
mod cluster;
pub mod descent;
mod direct;
mod finish;
pub mod latent;
mod memory;
mod network;
pub mod options;
pub mod progress;
pub mod report;

use std::ops::ControlFlow;
use std::sync::mpsc;
use std::time::Instant;

use crate::capture::Capture;
use crate::error::{Error, Result};
use crate::material::Material;
use crate::metrics::photo_rmse;
use crate::nn::Model;
use crate::render::{Target, render};
use direct::fit_direct;
use network::fit_network;
use options::{FitOptions, Method};
use progress::{CancelToken, Control, Progress, ProgressFn};
use report::FitReport;

/// A fitted material and how it came about.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The maps.
    pub material: Material,
    /// Stages, losses, timings, warnings.
    pub report: FitReport,
}

/// Recovers the material that the photos of `capture` show.
///
/// `model` may be `None`: [`Method::Auto`] then means [`Method::Direct`]. `progress` is called at least after every step and stops the
/// run when it breaks.
///
/// # Errors
/// [`Error::InvalidArgument`] for options out of range or a model that cannot take this many photos; [`Error::OutOfMemory`] before
/// anything is computed; [`Error::Cancelled`]; [`Error::NonFinite`] if the loss is not finite from the start.
pub fn fit_material(
    capture: &Capture,
    model: Option<&Model>,
    options: &FitOptions,
    progress: &mut ProgressFn<'_>,
) -> Result<Fit> {
    let started = Instant::now();
    let mut warnings = capture.warnings().to_vec();
    let network = match (options.method, model) {
        (Method::Direct, _) => None,
        (Method::Network, None) => return Err(Error::invalid("method", "network needs weights, got none")),
        (Method::Auto, None) => {
            warnings
                .push("no weights: the maps are fitted directly, without what a network knows of materials".to_owned());
            None
        }
        (Method::Network | Method::Auto, Some(model)) => Some(model.network(capture.len())?),
    };
    let pool = pool(options.threads)?;
    memory::check(memory::estimate(capture, network), options.max_memory)?;
    on_pool(&pool, options.cancel.clone(), progress, |control| {
        let targets = capture.photos().iter().map(Target::from_photo).collect::<Result<Vec<_>>>()?;
        let mut stages = Vec::new();
        let maps = match network {
            Some(network) => fit_network(capture, &targets, network, options, &mut stages, control)?,
            None => fit_direct(capture, &targets, options, &mut stages, control)?,
        };
        let material = Material::from_maps(&maps, capture.patch_size())?;
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
            method: if network.is_some() { Method::Network } else { Method::Direct },
            preset: options.preset,
            seed: options.seed,
            threads: rayon::current_num_threads(),
            photos: capture.photos().iter().map(|photo| photo.name.clone()).collect(),
            transfer: capture.transfer(),
            stages,
            photo_errors,
            seconds: started.elapsed().as_secs_f64(),
            warnings,
        };
        Ok(Fit { material, report })
    })
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

/// A pool of its own for each fit, so that the host's global one stays as it is.
fn pool(threads: Option<usize>) -> Result<rayon::ThreadPool> {
    if threads == Some(0) {
        return Err(Error::invalid("threads", "expected at least 1, got 0"));
    }
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads.unwrap_or(0))
        .build()
        .map_err(|error| Error::invalid("threads", format!("{threads:?} threads cannot be started: {error}")))
}
