//! The photos pass through the default network, also mirrored: it predicts the maps and how sure it is of them.

use std::time::Instant;

use crate::capture::Capture;
use crate::error::Result;
use crate::fit::report::StageReport;
use crate::image::Image;
use crate::maps::Maps;
use crate::metrics::photo_rmse;
use crate::nn::{Mirror, PhotoGraph};
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

/// Predicts isotropic maps from all photos of `capture`: the mean of what the network makes of so many of its mirror `images`.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled); [`Error::NonFinite`](crate::Error::NonFinite) if the network's values are not finite.
pub(crate) fn encode(
    capture: &Capture,
    graph: &PhotoGraph,
    images: usize,
    stages: &mut Vec<StageReport>,
    control: &mut Control<'_>,
) -> Result<Prediction> {
    let begun = Instant::now();
    control.report(Stage::Encode, 0, images, None)?;
    let mut prediction = graph.predict(capture, Mirror::IMAGES[0], control)?;
    for (before, &mirror) in (1..).zip(&Mirror::IMAGES[1..images]) {
        control.report(Stage::Encode, before, images, None)?;
        let next = graph.predict(capture, mirror, control)?;
        let share = 1.0 / (before + 1) as f32;
        let mix = |mean: &mut [f32], next: &[f32]| mean.iter_mut().zip(next).for_each(|(a, b)| *a += (b - *a) * share);
        mix(&mut prediction.raw, &next.raw);
        mix(&mut prediction.log_sigma, &next.log_sigma);
    }
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
        steps: images,
        first_loss: loss,
        best_loss: loss,
        rollbacks: 0,
        stopped_early: false,
        seconds: begun.elapsed().as_secs_f64(),
    });
    control.report(Stage::Encode, images, images, Some(loss))?;
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

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::{Prediction, encode};
    use crate::capture::Capture;
    use crate::color::Transfer;
    use crate::fit::testing::photo;
    use crate::maps::{Lobe, Maps};
    use crate::nn::{Mirror, PhotoGraph, PhotoGraphConfig};
    use crate::progress::{CancelToken, Control, Progress};
    use crate::shot::Shot;

    #[test]
    fn the_mean_of_mirror_images_is_taken() {
        let data = (0..10).flat_map(|plane| vec![if plane == 5 { 1.0 } else { 0.3 }; 64]).collect();
        let maps = Maps::new(Lobe::Isotropic, 8, 8, data).unwrap();
        let place = [0.7, -0.2, 3.0];
        let shot = Shot { camera: place, light: place, light_intensity: [20.0; 3] };
        let capture = Capture::new(vec![photo(&maps, shot)], 2.0, Transfer::Gamma22).unwrap();
        let config = PhotoGraphConfig { stem: 3, node: 4, width: 4, tail: 3, ..PhotoGraphConfig::default() };
        let graph = PhotoGraph::random(config, 5).unwrap();
        let mut steps = Vec::new();
        let mut callback = |progress: &Progress| {
            steps.push((progress.step, progress.steps));
            ControlFlow::Continue(())
        };
        let mut control = Control::new(&mut callback, CancelToken::new());
        let mut stages = Vec::new();
        let Prediction { raw, .. } = encode(&capture, &graph, 4, &mut stages, &mut control).unwrap();
        let each = Mirror::IMAGES.map(|mirror| graph.predict(&capture, mirror, &mut control).unwrap().raw);
        for (i, value) in raw.iter().enumerate() {
            let mean = each.iter().map(|raw| raw[i]).sum::<f32>() / 4.0;
            assert!((value - mean).abs() < 1e-5, "{i}: {value} {mean}");
        }
        assert!(each[1..].iter().all(|raw| *raw != each[0]), "mirror images tell nothing new");
        assert_eq!(stages[0].steps, 4);
        steps.dedup();
        assert_eq!(steps[..5], [(0, 4), (1, 4), (2, 4), (3, 4), (4, 4)]);
    }
}
