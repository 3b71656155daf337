//! Which stages a fit runs, on which photos, and how much memory they take.

use super::{direct, finish};
use crate::capture::Capture;
use crate::error::Result;
use crate::fit::contradiction::contradicting;
use crate::fit::options::{FitOptions, Method};
use crate::memory;
use crate::nn::{Model, Network, PhotoGraph};
use crate::progress::{Control, Stage};

/// What leads from photos to maps.
#[derive(Clone, Copy)]
pub(crate) enum Route<'a> {
    /// Stage direct, without a network.
    Direct,
    /// Stages encode, latent and adapters, with a network of the paper's form.
    Paper(&'a Network),
    /// Stages encode, direct and finish, with a photo graph.
    Graph(&'a PhotoGraph),
}

impl<'a> Route<'a> {
    /// # Errors
    /// As [`Model::network`].
    pub fn of(model: Option<&'a Model>, photos: usize) -> Result<Self> {
        let Some(model) = model else { return Ok(Self::Direct) };
        match model.photo_graph() {
            Some(graph) => Ok(Self::Graph(graph)),
            None => Ok(Self::Paper(model.network(photos)?)),
        }
    }

    /// The method that a report names.
    pub fn method(self) -> Method {
        match self {
            Self::Direct => Method::Direct,
            Self::Paper(_) | Self::Graph(_) => Method::Network,
        }
    }

    /// The first stage.
    pub fn first(self) -> Stage {
        match self {
            Self::Direct => Stage::Direct,
            Self::Paper(_) | Self::Graph(_) => Stage::Encode,
        }
    }
}

/// Which photos are fitted, and how.
pub(crate) struct Selection<'a> {
    /// Photos that contradict the others.
    pub contradicting: Vec<usize>,
    /// The photos that are fitted.
    pub kept: Vec<usize>,
    pub route: Route<'a>,
}

/// Leaves out photos that contradict the others, where `model` takes fewer.
pub(crate) fn select<'a>(
    capture: &Capture,
    model: Option<&'a Model>,
    route: Route<'a>,
    options: &FitOptions,
    control: &mut Control<'_>,
) -> Result<Selection<'a>> {
    let contradicting = contradicting(capture, options, control)?;
    let all = 0..capture.len();
    // A network of the paper's form may be for this number of photos alone.
    let (kept, route) = match Route::of(model, capture.len() - contradicting.len()) {
        Ok(route) => (all.filter(|photo| !contradicting.contains(photo)).collect(), route),
        Err(_) => (all.collect(), route),
    };
    Ok(Selection { contradicting, kept, route })
}

/// Estimated bytes at the peak of a run on the threads of the current pool, from the reading of photos on, `held` beside it.
///
/// # Errors
/// [`Error::OutOfMemory`](crate::Error::OutOfMemory) if that is more than `options.max_memory` grants.
pub(crate) fn memory(
    capture: &Capture,
    held: u64,
    model: Option<&Model>,
    route: Route<'_>,
    options: &FitOptions,
) -> Result<u64> {
    let Estimate { in_use, peak } = estimate(capture, model, route, options);
    let (in_use, peak) = (in_use.saturating_add(held), peak.saturating_add(held));
    let (width, height, photos) = (capture.width(), capture.height(), capture.len());
    let what = format!("a fit to {photos} photos of {width} x {height} pixels");
    memory::check(&what, peak, memory::allowed(options.max_memory, in_use))?;
    Ok(peak.max(capture.reading_memory()))
}

/// Estimated bytes at the peak of a fit, of which the capture and the weights are there before it.
fn estimate(capture: &Capture, model: Option<&Model>, route: Route<'_>, options: &FitOptions) -> Estimate {
    let in_use = capture.memory().saturating_add(model.map_or(0, Model::memory));
    let pixels = (capture.width() * capture.height()) as u64;
    let (photos, maps) = (capture.len(), pixels * 10 * 4);
    let size = (capture.width(), capture.height());
    let beside = match route {
        Route::Direct => direct::memory(photos, size, false),
        Route::Paper(network) => {
            // Encoded photos and what is saturated in them; maps and their gradient; the material and what is rendered of it.
            let common = photos as u64 * (3 * 4 + 1) + 2 * 14 * 4 + (14 + 6) * 4;
            pixels * common + network.fit_memory(capture.height(), capture.width())
        }
        Route::Graph(graph) => {
            // What the network predicts: nine planes and their deviations.
            let predicted = 2 * 9 * 4 * pixels;
            let after = direct::memory(photos, size, true).max(finish::memory(photos, pixels));
            // The mean, while the next mirror image is predicted.
            let mean = if options.preset.mirror_images(photos) > 1 { predicted } else { 0 };
            let encoding = graph.memory(photos, capture.height(), capture.width()).saturating_add(mean);
            encoding.max((predicted + maps).saturating_add(after))
        }
    };
    let threads = match route {
        Route::Direct => 0,
        _ => THREAD * rayon::current_num_threads() as u64 + memory::SMALL,
    };
    Estimate { in_use, peak: in_use.saturating_add(beside).saturating_add(threads + memory::SMALL) }
}

/// What every thread keeps for products of matrices: the size of its second cache, on most machines no more than this.
const THREAD: u64 = 9 << 18;

/// See [`estimate`].
struct Estimate {
    in_use: u64,
    peak: u64,
}
