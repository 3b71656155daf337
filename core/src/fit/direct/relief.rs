//! Whether the surface has the relief that the network predicts.

use super::Problem;
use crate::capture::Capture;
use crate::error::Result;
use crate::fit::optim::holdout::{REHEARSAL_SIDE, left_out, thinned, thinned_planes};
use crate::fit::options::FitOptions;
use crate::maps::{Maps, NORMAL_PLANE};
use crate::progress::{CancelToken, Control};
use crate::raw::{NORMAL, RAW};
use crate::render::{Target, photo_loss};

/// Photos left out at most, one at a time, to choose between a flat surface and a given relief; and steps of those fits.
pub(super) const FOLDS: usize = 3;
const STEPS: usize = 100;
/// Share of the flat surface's error that the relief has to take away.
const GAIN: f64 = 0.1;
/// Least z of a normal whose slope is taken as it is.
const STEEPEST: f32 = 0.2;

/// Whether photos that are left out are predicted better with `relief` than from a flat surface, on a part of the pixels.
pub(super) fn predicts_better(
    relief: &[f32],
    capture: &Capture,
    options: &FitOptions,
    control: &mut Control<'_>,
) -> Result<bool> {
    let (capture, pick) = thinned(capture, REHEARSAL_SIDE)?;
    let all: Vec<Target> = crate::fit::targets(&capture)?;
    let left_out = left_out(all.len(), FOLDS);
    let rests: Vec<Vec<Target>> =
        left_out.clone().map(|without| [&all[..without], &all[without + 1..]].concat()).collect();
    let error = |relief: Option<Vec<f32>>, control: &mut Control<'_>| -> Result<f64> {
        let mut problem = Problem::new(&capture, all.clone(), relief, options)?;
        let mut error = 0.0;
        for (rest, without) in rests.iter().zip(left_out.clone()) {
            control.poll()?;
            problem.targets.clone_from(rest);
            let (maps, _) = Control::silently(CancelToken::new(), |control| problem.fit(STEPS, [0; 2], control))?;
            error += photo_loss(&maps, problem.patch_size, &all[without..=without], None)?;
        }
        Ok(error)
    };
    let flat = error(None, control)?;
    let bumpy = error(Some(thinned_planes(relief, 2, &pick)), control)?;
    tracing::debug!("photos left out, flat and with the network's relief: {flat:.3}, {bumpy:.3}");
    Ok(bumpy < (1.0 - GAIN) * flat)
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
    let slope = |(across, up): (&f32, &f32)| across / up.max(STEEPEST);
    let mean = across.iter().zip(up).map(slope).map(f64::from).sum::<f64>() / across.len() as f64;
    across.iter().zip(up).map(move |pair| slope(pair) - mean as f32)
}
