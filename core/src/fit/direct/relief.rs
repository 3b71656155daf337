//! Whether the surface has the relief that the network predicts.

use super::folds::{FoldRelief, fit_folds};
use crate::capture::Capture;
use crate::error::Result;
use crate::fit::options::FitOptions;
use crate::maps::{Maps, NORMAL_PLANE, slope};
use crate::progress::{Control, Stage};
use crate::raw::{NORMAL, RAW};

/// Photos left out at most, one at a time, to choose between a flat surface and a given relief; and steps of those fits.
const FOLDS: usize = 3;
const STEPS: usize = 100;
/// Share of the flat surface's squared error that the relief has to take away.
const GAIN: f64 = 0.1;

/// Whether photos that are left out are predicted better with `relief` than from a flat surface, on a part of the pixels.
pub(super) fn predicts_better(
    relief: &[f32],
    capture: &Capture,
    options: &FitOptions,
    control: &mut Control<'_>,
) -> Result<bool> {
    let steps = options.steps(Stage::Direct).min(STEPS);
    let options = FitOptions { direct_steps: Some(steps), ..options.clone() };
    let mut error = |relief: FoldRelief<'_>| fit_folds(capture, relief, None, FOLDS, &options, control)?.error();
    let (flat, bumpy) = (error(FoldRelief::Flat)?, error(FoldRelief::Common(relief))?);
    tracing::debug!("photos left out, flat and with the network's relief: {flat:.4}, {bumpy:.4}");
    Ok(bumpy.powi(2) < (1.0 - GAIN) * flat.powi(2))
}

/// The slopes of the normals of `maps`, two planes without their means: how the sample leans is found elsewhere.
pub(crate) fn relief(maps: &Maps<f32>) -> Vec<f32> {
    let up = maps.plane(NORMAL_PLANE + 2);
    [0, 1].into_iter().flat_map(|c| slopes(maps.plane(NORMAL_PLANE + c), up)).collect()
}

/// Likewise of the normals of nine planes of raw values.
pub(crate) fn relief_of_raw(raw: &[f32]) -> Vec<f32> {
    let pixels = raw.len() / RAW;
    let [x, y] = [NORMAL, NORMAL + 1].map(|plane| &raw[plane * pixels..][..pixels]);
    let up: Vec<f32> = x.iter().zip(y).map(|(x, y)| (1.0 - x * x - y * y).max(0.0).sqrt()).collect();
    slopes(x, &up).chain(slopes(y, &up)).collect()
}

/// The slopes of normals with these components across and up, less their mean.
fn slopes<'a>(across: &'a [f32], up: &'a [f32]) -> impl Iterator<Item = f32> + 'a {
    let slope = |(&across, &up): (&f32, &f32)| slope(across, up);
    let mean = across.iter().zip(up).map(slope).map(f64::from).sum::<f64>() / across.len() as f64;
    across.iter().zip(up).map(move |pair| slope(pair) - mean as f32)
}
