//! From photos to maps: with the default network and the finish, with the feature-embedded optimisation of the paper (Section 3.3), and
//! without a network.
//!
//! [`fit_material`] reads as what happens: a plan (photos, route, memory), a run (the stages, one after the other), a report with a verdict.

mod anisotropy;
pub mod choice;
mod conditions;
mod contradiction;
mod direct;
mod encode;
mod finish;
pub mod optim;
pub mod options;
pub mod paper;
mod plan;
pub mod report;
mod run;
mod shading;
#[cfg(test)]
mod testing;
pub mod verdict;

use std::borrow::Cow;
use std::time::Instant;

use crate::capture::{Capture, Photo};
use crate::deviations::Deviations;
use crate::error::{Error, Result};
use crate::material::Material;
use crate::nn::Model;
use crate::pool::pool;
use crate::progress::ProgressFn;
use crate::render::Target;
use options::{FitOptions, Method, Reflectance};
use plan::Route;
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
/// One photo of which the light is [`Assumed`](crate::capture::Assumed) is fitted twice, the second time under the light that the first result calls for.
///
/// `model` may be `None`: then [`Model::embedded`]. `progress` is called at least after every step and stops the run when it breaks.
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
    let route = Route::of(model, capture.len())?;
    if matches!(route, Route::Paper(_)) && options.reflectance != Reflectance::Auto {
        let name = options.reflectance.name();
        return Err(Error::invalid(
            "reflectance",
            format!("expected auto, got {name}: a network of the paper's form has its own"),
        ));
    }
    let pool = pool(options.threads)?;
    let memory_estimate = pool.install(|| plan::memory(capture, held, model, route, options))?;
    run::on_pool(&pool, options.cancel.clone(), progress, |control| {
        control.report(route.first(), 0, options.steps(route.first()), None)?;
        let usual = conditions::usual_exposure(capture)?;
        let selection = plan::select(&usual, model, route, options, control)?;
        let fitted = match selection.kept.len() {
            count if count == capture.len() => usual,
            _ => Cow::Owned(usual.select(&selection.kept)?),
        };
        let (mut state, choice) = run::run(selection.route, &fitted, options, control)?;
        conditions::fill_unlit(capture, &mut state.maps, state.deviations.as_mut());
        if let Some(deviations) = &mut state.deviations {
            conditions::doubt_black(&fitted, &state.maps, deviations);
        }
        let unit = capture.unit().cloned();
        let material = Material { unit, ..Material::from_maps(&state.maps, capture.patch_size())? };
        let deviations = state.deviations.take();
        let report =
            FitReport::new(capture, &selection, (state, choice), &material, memory_estimate, options, started)?;
        Ok(Fit { material, deviations, report })
    })
}

/// The photos as the loss compares with them.
fn targets(capture: &Capture) -> Result<Vec<Target>> {
    capture.photos().iter().map(Photo::target).collect()
}
