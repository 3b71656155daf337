//! The fit with the default network: it predicts the maps and how sure it is of them. What pixels have in common is fitted to the photos
//! from a flat start, or, where there is a single photo, around the prediction ([`direct`](super::direct)), then every pixel by itself ([`finish`](super::finish)).

use std::time::Instant;

use crate::capture::{Capture, Shot};
use crate::color::Transfer;
use crate::error::Result;
use crate::fit::deviations::Deviations;
use crate::fit::direct::{Direct, HeldOut, correct, fit_direct, fit_without};
use crate::fit::finish::{Belief, Finished, Fold, LEFT_OUT, Rehearsal, Start, finish};
use crate::fit::holdout::{REHEARSAL_SIDE, grid, left_out, thinned_planes};
use crate::fit::light;
use crate::fit::options::FitOptions;
use crate::fit::progress::{Control, Stage};
use crate::fit::report::StageReport;
use crate::fit::verdict::Expected;
use crate::image::Image;
use crate::maps::{DIFFUSE_PLANE, Maps, NORMAL_PLANE, ROUGHNESS_PLANE};
use crate::metrics::photo_rmse;
use crate::nn::PhotoGraph;
use crate::render::render_maps;

/// Half a raw albedo or roughness is the unit of the network's certainty, except for the two planes of the normal.
const UNITS: [f32; 9] = [2.0, 2.0, 2.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0];

/// Least z of a normal whose slope is taken as it is.
const STEEPEST: f32 = 0.2;

/// Isotropic maps, and what the finish found where it ran.
pub(crate) struct Predicted {
    pub maps: Maps<f32>,
    /// Factors on the light of the photos, where they were estimated.
    pub gains: Option<Vec<f64>>,
    pub deviations: Option<Deviations>,
    pub belief: Option<Belief>,
    /// Expected errors of a new photo, where some were left out or the finish says how sure it is.
    pub expected: Option<Expected>,
}

/// Predicts isotropic maps from all photos of `capture` and finishes them.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled); [`Error::NonFinite`](crate::Error::NonFinite) if the network's values are not finite.
pub(crate) fn fit_predicted(
    capture: &Capture,
    graph: &PhotoGraph,
    options: &FitOptions,
    stages: &mut Vec<StageReport>,
    control: &mut Control<'_>,
) -> Result<Predicted> {
    let begun = Instant::now();
    control.report(Stage::Encode, 0, 1, None)?;
    let mut prediction = graph.predict(capture, control)?;
    let mut maps = graph.maps(&prediction)?;
    let loss = loss(capture, &maps)?;
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
    let mut gains = None;
    let mut taken = None;
    let direct_steps = options.direct_steps.unwrap_or(options.preset.direct_steps());
    if direct_steps == 0 {
        // The prediction is what the finish starts from.
    } else if capture.len() == 1 {
        maps = correct(capture, &maps, relief(&maps), options, stages, control)?;
    } else {
        let (direct, relief) = fit_direct(capture, Some(&relief(&maps)), options, stages, control)?;
        maps = direct.maps;
        taken = relief;
        gains = Some(direct.gains);
    }
    let steps = options.finish_steps.unwrap_or(options.preset.finish_steps());
    if steps == 0 {
        return Ok(Predicted { maps, gains, deviations: None, belief: None, expected: None });
    }
    let pixels = capture.width() * capture.height();
    let planes = prediction.log_sigma.chunks_exact_mut(pixels);
    planes.zip(UNITS).for_each(|(plane, unit)| plane.iter_mut().for_each(|value| *value = value.exp() * unit));
    let floor = graph.config().roughness_floor;
    let rehearsal = if capture.len() == 1 {
        Rehearsal::default()
    } else if direct_steps == 0 {
        of_prediction(capture, &prediction.raw)
    } else {
        of_direct(capture, fit_without(capture, taken.as_deref(), LEFT_OUT, options, control)?, floor)
    };
    let mut shared = prediction.raw.clone();
    encode(&maps, floor, &mut shared);
    let start =
        Start { raw: &shared, network: &prediction.raw, deviation: &prediction.log_sigma, rehearsal: &rehearsal };
    let shots = light::shots(capture, gains.as_deref().unwrap_or(&vec![1.0; capture.len()]));
    let Finished { raw, deviation, belief, expected } =
        finish(capture, &shots, start, f64::from(floor), steps, stages, control)?;
    graph.decoding()?.decode(&raw, &mut maps)?;
    let deviations = Some(deviations(&maps, &deviation)?);
    Ok(Predicted { maps, gains, deviations, belief: Some(belief), expected: Some(expected) })
}

/// The maps that `direct` finds where a photo is left out.
fn of_direct(capture: &Capture, held_out: HeldOut, floor: f32) -> Rehearsal {
    let HeldOut { thinned, pixels, folds } = held_out;
    let fold = |(without, direct): (usize, Direct)| {
        let mut raw = vec![0.0; 9 * pixels.len()];
        encode(&direct.maps, floor, &mut raw);
        Fold { without, raw, shots: light::shots(capture, &direct.gains) }
    };
    let folds = folds.into_iter().map(fold).collect();
    Rehearsal { size: [thinned.width(), thinned.height()], pixels, folds }
}

/// The prediction, which hardly changes where a photo is left out.
fn of_prediction(capture: &Capture, prediction: &[f32]) -> Rehearsal {
    let (size, pixels) = grid(capture.width(), capture.height(), REHEARSAL_SIDE);
    let raw = thinned_planes(prediction, 9, &pixels);
    let shots: Vec<Shot> = capture.photos().iter().map(|photo| photo.shot).collect();
    let fold = |without| Fold { without, raw: raw.clone(), shots: shots.clone() };
    Rehearsal { size, folds: left_out(capture.len(), LEFT_OUT).map(fold).collect(), pixels }
}

/// The slopes of the normals of `maps`, two planes without their means: how the sample leans is found elsewhere.
fn relief(maps: &Maps<f32>) -> Vec<f32> {
    let pixels = maps.width() * maps.height();
    let mut slopes = Vec::with_capacity(2 * pixels);
    for c in 0..2 {
        let (across, up) = (maps.plane(NORMAL_PLANE + c), maps.plane(NORMAL_PLANE + 2));
        let slope = |(across, up): (&f32, &f32)| across / up.max(STEEPEST);
        let mean = across.iter().zip(up).map(slope).map(f64::from).sum::<f64>() / pixels as f64;
        slopes.extend(across.iter().zip(up).map(slope).map(|slope| slope - mean as f32));
    }
    slopes
}

/// Standard deviations of `maps` from those of nine planes of raw values.
fn deviations(maps: &Maps<f32>, raw: &[f32]) -> Result<Deviations> {
    let (width, height) = (maps.width(), maps.height());
    let pixels = width * height;
    // A raw value is twice a gamma 2.2 code, less 1.
    let linear = |value: f32, raw: f32| 0.5 * 2.2 * Transfer::Gamma22.encode(value).powf(1.2) * raw;
    let image = |at: &dyn Fn(usize) -> f32| Image::new(width, height, 1, (0..pixels).map(at).collect());
    let color = |first: usize, first_raw: usize| {
        image(&|p| {
            let of = |c: usize| linear(maps.plane(first + c)[p], raw[(first_raw + c) * pixels + p]);
            ((of(0).powi(2) + of(1).powi(2) + of(2).powi(2)) / 3.0).sqrt()
        })
    };
    Ok(Deviations {
        diffuse_albedo: color(DIFFUSE_PLANE, 0)?,
        specular_albedo: color(maps.lobe().specular_plane(), 6)?,
        roughness: image(&|p| linear(maps.plane(ROUGHNESS_PLANE)[p], raw[5 * pixels + p]))?,
        normal: image(&|p| raw[3 * pixels + p].hypot(raw[4 * pixels + p]))?,
    })
}

/// The raw planes of isotropic maps: the inverse of [`Decoding`](crate::nn::Decoding).
fn encode(maps: &Maps<f32>, floor: f32, raw: &mut [f32]) {
    let pixels = maps.width() * maps.height();
    for (i, plane) in raw.chunks_exact_mut(pixels).enumerate() {
        let map = match i {
            ..5 => i,
            _ => i + 1,
        };
        match i {
            3 | 4 => {
                for (p, value) in plane.iter_mut().enumerate() {
                    let [x, y, z] = [0, 1, 2].map(|c| maps.plane(NORMAL_PLANE + c)[p]);
                    *value = maps.plane(map)[p] / (x * x + y * y + z * z).sqrt().max(f32::MIN_POSITIVE);
                }
            }
            _ => {
                let low = if map == ROUGHNESS_PLANE { floor } else { -1.0 };
                let code = |value: f32| 2.0 * Transfer::Gamma22.encode(value) - 1.0;
                plane.iter_mut().zip(maps.plane(map)).for_each(|(raw, &value)| *raw = code(value).clamp(low, 1.0));
            }
        }
    }
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
