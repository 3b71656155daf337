//! The photos pass through the default network once: it predicts the maps and how sure it is of them.

use std::time::Instant;

use crate::capture::Capture;
use crate::error::Result;
use crate::fit::report::StageReport;
use crate::image::Image;
use crate::maps::Maps;
use crate::metrics::photo_rmse;
use crate::nn::PhotoGraph;
use crate::progress::{Control, Stage};
use crate::raw::{NORMAL, ROUGHNESS};
use crate::render::render_maps;

/// What the network predicts.
pub(crate) struct Prediction {
    pub maps: Maps<f32>,
    /// Nine planes of raw values, and of their standard deviations.
    pub raw: Vec<f32>,
    pub deviation: Vec<f32>,
}

/// Predicts isotropic maps from all photos of `capture`.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled); [`Error::NonFinite`](crate::Error::NonFinite) if the network's values are not finite.
pub(crate) fn encode(
    capture: &Capture,
    graph: &PhotoGraph,
    stages: &mut Vec<StageReport>,
    control: &mut Control<'_>,
) -> Result<Prediction> {
    let begun = Instant::now();
    control.report(Stage::Encode, 0, 1, None)?;
    let prediction = graph.predict(capture, control)?;
    let maps = graph.maps(&prediction)?;
    let loss = loss(capture, &maps)?;
    let mut deviation = prediction.log_sigma;
    for (i, plane) in deviation.chunks_exact_mut(capture.width() * capture.height()).enumerate() {
        // Half a raw albedo or roughness is the unit of the network's certainty, except for the two planes of the normal.
        let unit = if (NORMAL..ROUGHNESS).contains(&i) { 1.0 } else { 2.0 };
        plane.iter_mut().for_each(|value| *value = value.exp() * unit);
    }
    stages.push(StageReport {
        stage: Stage::Encode,
        steps: 1,
        first_loss: loss,
        best_loss: loss,
        rollbacks: 0,
        stopped_early: false,
        seconds: begun.elapsed().as_secs_f64(),
    });
    control.report(Stage::Encode, 1, 1, Some(loss))?;
    Ok(Prediction { maps, raw: prediction.raw, deviation })
}

/// 1000 times the mean squared error of the re-rendered photos, gamma 2.2.
fn loss(capture: &Capture, maps: &Maps<f32>) -> Result<f64> {
    let (width, height) = (capture.width(), capture.height());
    let mut sum = 0.0;
    for photo in capture.photos() {
        let planes = render_maps(maps, capture.patch_size(), &photo.shot)?;
        let image = Image::from_planar(width, height, 3, &planes)?;
        sum += photo_rmse(&image, &photo.image)?.powi(2);
    }
    Ok(1000.0 * sum / capture.len() as f64)
}
