//! Whether the surface has the relief that the network predicts.

use super::Problem;
use crate::capture::Capture;
use crate::error::Result;
use crate::fit::optim::holdout::{REHEARSAL_SIDE, left_out, thinned, thinned_planes};
use crate::fit::options::FitOptions;
use crate::maps::{Maps, NORMAL_PLANE};
use crate::progress::{CancelToken, Control};
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
    let mut problem = Problem::new(&capture, all.clone(), options.reflectance, options.seed)?;
    let mut error = |relief: Option<Vec<f32>>| -> Result<f64> {
        problem.parameters.relief = relief;
        let mut error = 0.0;
        for (rest, without) in rests.iter().zip(left_out.clone()) {
            control.poll()?;
            problem.targets.clone_from(rest);
            let (maps, _) = Control::silently(CancelToken::new(), |control| problem.fit(STEPS, [0; 2], control))?;
            error += photo_loss(&maps, problem.patch_size, &all[without..=without], None)?;
        }
        Ok(error)
    };
    let flat = error(None)?;
    let bumpy = error(Some(thinned_planes(relief, 2, &pick)))?;
    tracing::debug!("photos left out, flat and with the network's relief: {flat:.3}, {bumpy:.3}");
    Ok(bumpy < (1.0 - GAIN) * flat)
}

/// The slopes of the normals of `maps`, two planes without their means: how the sample leans is found elsewhere.
pub(crate) fn relief(maps: &Maps<f32>) -> Vec<f32> {
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
