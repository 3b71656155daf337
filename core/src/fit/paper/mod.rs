//! The paper's fit: encode once, then the latent code, then the adapters.

pub mod adapters;
pub mod latent;
mod tape;

use std::time::Instant;

use self::latent::fit_latent;
use crate::capture::Capture;
use crate::color::Transfer;
use crate::error::Result;
use crate::fit::optim::descent::EarlyStop;
use crate::fit::options::FitOptions;
use crate::fit::paper::adapters::{Readout, fit_adapters};
use crate::fit::report::StageReport;
use crate::maps::Maps;
use crate::nn::{AdapterParams, Decoding, Network};
use crate::progress::{Control, Stage};
use crate::render::Target;

/// Fits maps of the network's kind to all photos of `capture`, of which the network encodes as many of the first as it takes.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled); [`Error::NonFinite`](crate::Error::NonFinite) if the loss is not finite at the start of a stage.
pub(crate) fn fit_network(
    capture: &Capture,
    targets: &[Target],
    network: &Network,
    options: &FitOptions,
    stages: &mut Vec<StageReport>,
    control: &mut Control<'_>,
) -> Result<Maps<f32>> {
    let config = network.config();
    let decoding = Decoding::new(config.lobe).with_roughness_floor(f64::from(config.roughness_floor))?;
    let early_stop = options.early_stop.unwrap_or(true).then(EarlyStop::default);

    control.report(Stage::Encode, 0, 1, None)?;
    // The encoder was trained on photos in [0, 1]; float photos may be brighter.
    let stored = |linear: f32| Transfer::Gamma22.encode(linear).min(1.0);
    let photos: Vec<Vec<f32>> = capture.photos()[..config.photos]
        .iter()
        .map(|photo| Ok(photo.image.to_planar()?.into_iter().map(stored).collect()))
        .collect::<Result<_>>()?;
    let photos: Vec<&[f32]> = photos.iter().map(Vec::as_slice).collect();
    let mut code = network.encode(&photos, capture.height(), capture.width(), control)?;
    control.report(Stage::Encode, 1, 1, None)?;

    let mut adapters = network.adapters().to_vec();
    let outputs: Vec<usize> = adapters.iter().map(AdapterParams::outputs).collect();
    let channels = config.feature_channels();
    let empty = vec![0.0; channels * capture.height() * capture.width()];
    let mut readout = Readout::new(&empty, channels, &outputs, decoding, capture.patch_size(), targets)?;

    let begun = Instant::now();
    let steps = options.steps(Stage::Latent);
    let descent = fit_latent(network, &mut code, &adapters, &mut readout, steps, early_stop, control)?;
    stages.push(StageReport::new(Stage::Latent, &descent, begun.elapsed().as_secs_f64()));
    // The skips are large and no longer needed.
    drop(code);

    let begun = Instant::now();
    let steps = options.steps(Stage::Adapters);
    let descent = fit_adapters(&mut readout, &mut adapters, steps, early_stop, control)?;
    stages.push(StageReport::new(Stage::Adapters, &descent, begun.elapsed().as_secs_f64()));
    Ok(readout.into_maps())
}
