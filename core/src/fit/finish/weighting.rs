//! How much the photos, the maps so far and the network are believed: what predicts photos that are left out best, from maps that have not seen them.

use rayon::prelude::*;

use super::pixel::{Fit, Look, Pixels, Place, Predict, places};
use super::{Fold, Problem, Rehearsal};
use crate::error::Result;
use crate::fit::optim::holdout::grid;
use crate::fit::verdict::Expected;
use crate::metrics::code_rmse_smooth_gain;
use crate::progress::Control;
use crate::raw::RAW;
use crate::real::Real;
use crate::shot::Shot;

/// Candidates for the standard deviation of what the model cannot explain in a photo, gamma 2.2 encoded.
const PHOTO_DEVIATIONS: [f64; 6] = [0.2, 0.1, 0.05, 0.025, 0.0125, 0.006];
/// Candidates for the share of the network's deviation that is believed, in normals, and in specular albedo and roughness.
const SHARES: [f64; 4] = [1.0, 0.3, 0.1, 0.03];
/// Candidates for how far the prior's mean is the network's maps instead of those so far, and of these its normals alone.
const NETWORK: [f64; 3] = [0.0, 0.5, 1.0];
/// Pixels along the longer side on which these are chosen.
pub(super) const CHOICE_SIDE: usize = 32;
/// Levenberg-Marquardt steps there.
const CHOICE_STEPS: usize = 6;
/// Pixels that one thread takes at a time.
const PART: usize = 64;
/// A single photo's maps are looked at from this many places around, so far from the normal, in radians.
const NEW_PLACES: usize = 4;
const NEW_ANGLE: f64 = 0.35;

/// How much the photos count, the maps so far and the network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Weighting {
    /// Standard deviation of a photo's codes.
    pub photo: f64,
    /// Shares of the network's deviation that are believed, in normals, and in specular albedo and roughness.
    pub normal: f64,
    pub specular: f64,
    /// How far what is expected is what the network has, in normals, and elsewhere.
    pub network_normal: f64,
    pub network: f64,
}

impl Weighting {
    /// Where the search begins, and what a single photo gets.
    pub(super) const START: Self = Self { photo: 0.025, normal: 0.3, specular: 0.3, network_normal: 0.0, network: 0.0 };
    /// Where the search begins a second time: one value after the other, it does not find the way here from the first.
    const OF_PHOTOS: Self = Self { photo: 0.006, normal: 1.0, specular: 1.0, ..Self::START };
}

impl Problem<'_> {
    /// The weighting with which photos that are left out are predicted best, found one value after the other.
    pub(super) fn choose(&self, rehearsal: &Rehearsal, control: &mut Control<'_>) -> Result<Weighting> {
        if rehearsal.folds.is_empty() {
            return Ok(Weighting::START);
        }
        let mut best = (f64::INFINITY, Weighting::START);
        for network in NETWORK {
            for start in [Weighting::START, Weighting::OF_PHOTOS] {
                let found = self.search(Weighting { network, network_normal: network, ..start }, rehearsal, control)?;
                if found.0 < best.0 {
                    best = found;
                }
            }
        }
        tracing::debug!("error of photos left out: {:.4}", best.0.sqrt());
        Ok(best.1)
    }

    /// From `best` on, the weighting with the least error of photos that are left out, one value after the other; and that error.
    fn search(
        &self,
        mut best: Weighting,
        rehearsal: &Rehearsal,
        control: &mut Control<'_>,
    ) -> Result<(f64, Weighting)> {
        let mut lowest = self.left_out_error(best, rehearsal);
        type Set = fn(&mut Weighting, f64);
        let searches: [(&[f64], Set); 5] = [
            (&PHOTO_DEVIATIONS, |weighting, value| weighting.photo = value),
            (&NETWORK, |weighting, value| weighting.network_normal = value),
            (&SHARES, |weighting, value| weighting.normal = value),
            (&SHARES, |weighting, value| weighting.specular = value),
            (&PHOTO_DEVIATIONS, |weighting, value| weighting.photo = value),
        ];
        for (values, set) in searches {
            for &value in values {
                let mut weighting = best;
                set(&mut weighting, value);
                if weighting == best {
                    continue;
                }
                control.poll()?;
                let error = self.left_out_error(weighting, rehearsal);
                if error < lowest {
                    (lowest, best) = (error, weighting);
                }
            }
        }
        Ok((lowest, best))
    }

    /// Mean squared error of the photos that the folds of `rehearsal` left out.
    fn left_out_error(&self, weighting: Weighting, rehearsal: &Rehearsal) -> f64 {
        let mut total = (0.0, 0.0);
        for fold in &rehearsal.folds {
            let view = &self.views[fold.without];
            // Summed in order: the same bits on any number of threads.
            for (pixel, code) in self.predict(fold, &fold.shots[fold.without], weighting, rehearsal) {
                for c in (0..3).filter(|c| view.photo.saturated[pixel] >> c & 1 == 0) {
                    total.0 += (f64::from(code[c].min(1.0)) - f64::from(view.code[pixel][c])).powi(2);
                    total.1 += 1.0;
                }
            }
        }
        total.0 / f64::max(total.1, 1.0)
    }

    /// Some pixels, to be fitted without the photo of `fold`.
    fn pixels_without<'p>(&'p self, fold: &'p Fold, places: &'p [Place], weighting: Weighting) -> Pixels<'p> {
        Pixels {
            problem: self,
            places,
            so_far: &fold.raw,
            anisotropy: &fold.anisotropy,
            shots: &fold.shots,
            without: Some(fold.without),
            weighting,
            steps: CHOICE_STEPS,
        }
    }

    /// What the photo that `fold` left out would show if it was taken as `shot`: some pixels, and their codes.
    fn predict(&self, fold: &Fold, shot: &Shot, weighting: Weighting, rehearsal: &Rehearsal) -> Vec<(usize, [f32; 3])> {
        let [width, height] = rehearsal.size;
        let (_, sample) = grid(width, height, CHOICE_SIDE);
        let places: Vec<Place> =
            sample.into_iter().map(|place| Place { pixel: rehearsal.pixels[place], so_far: place }).collect();
        let predict = |places: &[Place]| f32::run(Predict(self.pixels_without(fold, places, weighting), shot));
        let codes: Vec<Vec<[f32; 3]>> = places.par_chunks(PART).map(predict).collect();
        places.iter().map(|place| place.pixel).zip(codes.into_iter().flatten()).collect()
    }

    /// Nine planes of raw values on all pixels of `rehearsal`, found without the photo of `fold`.
    pub fn without(&self, fold: &Fold, weighting: Weighting, rehearsal: &Rehearsal) -> Vec<f32> {
        let place = |(so_far, &pixel): (usize, &usize)| Place { pixel, so_far };
        let places: Vec<Place> = rehearsal.pixels.iter().enumerate().map(place).collect();
        let fit = |places: &[Place]| f32::run(Fit(self.pixels_without(fold, places, weighting))).raw;
        let values: Vec<Vec<[f32; RAW]>> = places.par_chunks(PART).map(fit).collect();
        (0..RAW).flat_map(|i| values.iter().flatten().map(move |values| values[i])).collect()
    }

    /// Expected errors of a new photo, from how those are missed that the folds of `rehearsal` left out, under their stated light.
    pub(super) fn expected(&self, weighting: Weighting, rehearsal: &Rehearsal) -> Option<Expected> {
        let [width, height] = rehearsal.size;
        let ([columns, _], _) = grid(width, height, CHOICE_SIDE);
        let error = |fold: &Fold| {
            let view = &self.views[fold.without];
            let predicted = self.predict(fold, &view.photo.shot, weighting, rehearsal);
            let clamped = |code: [f32; 3]| code.map(|value| f64::from(value).clamp(0.0, 1.0));
            let seen: Vec<[f64; 3]> = predicted.iter().map(|&(pixel, _)| clamped(view.code[pixel])).collect();
            let predicted: Vec<[f64; 3]> = predicted.into_iter().map(|(_, code)| clamped(code)).collect();
            let off = |(a, b): (&[f64; 3], &[f64; 3])| (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f64>();
            let squares: f64 = predicted.iter().zip(&seen).map(off).sum();
            let plain = (squares / (3 * seen.len()) as f64).sqrt();
            [plain, code_rmse_smooth_gain(&predicted, &seen, columns)]
        };
        Expected::of(&rehearsal.folds.iter().map(error).collect::<Vec<_>>())
    }

    /// Likewise from the deviations of the maps alone: how far they move what is seen from around.
    pub(super) fn estimated(&self, raw: &[f32], anisotropy: &[[f32; 2]], deviation: &[f32]) -> Expected {
        let (_, sample) = grid(self.capture.width(), self.capture.height(), CHOICE_SIDE);
        let shot = &self.capture.photos()[0].shot;
        let around = |direction: usize| {
            let far = shot.light.iter().map(|x| x * x).sum::<f64>().sqrt();
            let angle = std::f64::consts::TAU * direction as f64 / NEW_PLACES as f64;
            let (sin, cos) = NEW_ANGLE.sin_cos();
            let place = [far * sin * angle.cos(), far * sin * angle.sin(), far * cos];
            Shot { camera: place, light: place, ..*shot }
        };
        let shots: Vec<Shot> = (0..NEW_PLACES).map(around).collect();
        let sample: Vec<Place> = sample.into_iter().map(|pixel| Place { pixel, so_far: pixel }).collect();
        let seen = f32::run(Look { problem: self, places: &sample, raw, anisotropy, shots: &shots });
        let moved = |(place, (code, jacobian)): (&Place, &([f32; 3], [[f32; 5]; 3]))| -> f64 {
            let by =
                |c: usize, i: usize| f64::from(jacobian[c][i] * deviation[places(c)[i] * self.pixels() + place.so_far]);
            let channel = |c: usize| {
                let (code, by) = (f64::from(code[c]), (0..5).map(|i| by(c, i).powi(2)).sum::<f64>().sqrt());
                // Errors are those of codes that end at 0 and 1.
                0.5 * ((code + by).clamp(0.0, 1.0) - (code - by).clamp(0.0, 1.0))
            };
            (0..3).map(|c| channel(c).powi(2)).sum()
        };
        let sum: f64 = sample.iter().cycle().zip(&seen).map(moved).sum();
        let error = (sum / (3 * seen.len()) as f64).sqrt();
        Expected { error, material: error, estimated: true }
    }
}
