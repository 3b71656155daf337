//! The finish: with maps and the network's certainty as a Gaussian prior, every pixel is fitted to the photos.
//!
//! Per pixel nine raw values are found by Levenberg-Marquardt with the exact Jacobian ([`shading`](super::shading)). How much the photos count against
//! the prior is chosen by leaving photos out and predicting them, from maps that have not seen them.
//!
//! Not from the paper.
#![allow(clippy::needless_range_loop, reason = "indices of raw values are those of vectors and matrices alike")]

use std::time::Instant;

use rayon::prelude::*;

use crate::capture::{Capture, Photo, Shot};
use crate::cholesky::Cholesky;
use crate::error::{Error, Result};
use crate::fit::holdout::grid;
use crate::fit::progress::{Control, Stage};
use crate::fit::report::StageReport;
use crate::fit::shading::{FLAT_LIMIT, NORMAL, RAW, ROUGHNESS, SPECULAR, Sight, Surface};
use crate::fit::verdict::Expected;
use crate::metrics::code_rmse_smooth_gain;
use crate::render::encode_radiance;

/// Candidates for the standard deviation of what the model cannot explain in a photo, gamma 2.2 encoded.
const PHOTO_DEVIATIONS: [f64; 6] = [0.2, 0.1, 0.05, 0.025, 0.0125, 0.006];
/// Candidates for the share of the network's deviation that is believed, in normals, and in specular albedo and roughness.
const SHARES: [f64; 4] = [1.0, 0.3, 0.1, 0.03];
/// Candidates for how far the prior's mean is the network's maps instead of those so far, and of these its normals alone.
const NETWORK: [f64; 3] = [0.0, 0.5, 1.0];
/// Pixels along the longer side on which these are chosen.
const CHOICE_SIDE: usize = 32;
/// Photos left out at most, one at a time.
pub(super) const LEFT_OUT: usize = 4;
/// Residuals beyond so many deviations count less and less (Cauchy).
const OUTLIER: f64 = 3.0;
/// A single photo's maps are looked at from this many places around, so far from the normal, in radians.
const NEW_PLACES: usize = 4;
const NEW_ANGLE: f64 = 0.35;
/// Smallest deviation of the network that is believed, raw.
const PRIOR_MIN: f64 = 0.02;

/// What a finish starts from: nine planes each of raw values and of the network's standard deviations.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Start<'a> {
    /// The maps so far.
    pub raw: &'a [f32],
    /// The network's maps, whose normals may be the better ones.
    pub network: &'a [f32],
    /// The network's standard deviations.
    pub deviation: &'a [f32],
    /// What decides how much of this is believed; without folds it is what suits a single photo.
    pub rehearsal: &'a Rehearsal,
}

/// On some pixels, the maps so far as they are where one photo is left out: they decide what is believed how much.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rehearsal {
    /// Columns and rows of the grid of `pixels`.
    pub size: [usize; 2],
    /// Which pixels of the capture.
    pub pixels: Vec<usize>,
    /// One for each photo left out.
    pub folds: Vec<Fold>,
}

/// Maps that have not seen one photo.
#[derive(Clone, Debug)]
pub(crate) struct Fold {
    /// The photo.
    pub without: usize,
    /// Nine planes of raw values of the pixels.
    pub raw: Vec<f32>,
    /// How all photos are taken to be lit.
    pub shots: Vec<Shot>,
}

/// What a finish gives.
#[derive(Clone, Debug)]
pub(crate) struct Finished {
    /// Nine planes of raw values.
    pub raw: Vec<f32>,
    /// Their standard deviations, given the photos and the network's own.
    pub deviation: Vec<f32>,
    /// What the photos were found to say about photos and prior.
    pub belief: Belief,
    /// Expected errors of a new photo.
    pub expected: Expected,
}

/// What the photos were found to say about photos and prior.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Belief {
    /// Standard deviation of the photos that was chosen.
    pub photo_deviation: f64,
    /// Shares of the network's deviation that were believed: in normals; in specular albedo and roughness.
    pub shares: [f64; 2],
}

/// A photo as the finish compares with it.
struct View<'a> {
    photo: &'a Photo,
    /// Where camera and light are taken to stand, and how bright it is taken to be.
    shot: Shot,
    /// Encoded colour of every pixel.
    code: Vec<[f32; 3]>,
}

/// The data and the prior.
struct Problem<'a> {
    capture: &'a Capture,
    views: Vec<View<'a>>,
    start: Start<'a>,
    roughness_floor: f64,
}

/// A finished row of pixels, and its cost before and after.
struct Row {
    raw: Vec<[f32; RAW]>,
    deviation: Vec<[f32; RAW]>,
    first_cost: f64,
    last_cost: f64,
}

/// Normal equations of one pixel at one place.
struct System {
    cost: f64,
    /// Half the gradient, and the Gauss-Newton matrix (lower triangle), prior included.
    gradient: [f64; RAW],
    matrix: [[f64; RAW]; RAW],
}

/// What is known of a pixel before the photos.
#[derive(Clone, Copy)]
struct Prior {
    mean: [f64; RAW],
    /// Inverse variances.
    weight: [f64; RAW],
}

/// A pixel in all photos but one.
#[derive(Clone, Copy)]
struct Seen<'a> {
    pixel: usize,
    /// One for each photo.
    sights: &'a [Sight],
    /// A photo that does not count.
    without: Option<usize>,
}

/// One channel of a pixel in one photo, compared with a rendering.
struct Compared {
    channel: usize,
    residual: f64,
    weight: f64,
    /// As in [`shading::Seen`].
    slopes: [f64; 5],
}

/// What is believed how much.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Trust {
    /// Standard deviation of a photo's codes.
    photo: f64,
    /// Shares of the network's deviation that are believed, in normals, and in specular albedo and roughness.
    normal: f64,
    specular: f64,
    /// How far what is expected is what the network has, in normals, and elsewhere.
    network_normal: f64,
    network: f64,
}

impl Trust {
    /// Where the search begins, and what a single photo gets.
    const START: Self = Self { photo: 0.025, normal: 0.3, specular: 0.3, network_normal: 0.0, network: 0.0 };
    /// Where the search begins a second time: one value after the other, it does not find the way here from the first.
    const OF_PHOTOS: Self = Self { photo: 0.006, normal: 1.0, specular: 1.0, ..Self::START };
}

impl<'a> Problem<'a> {
    fn pixels(&self) -> usize {
        self.capture.width() * self.capture.height()
    }

    /// The least and the largest value of the raw value `i`.
    fn range(&self, i: usize) -> (f64, f64) {
        match i {
            NORMAL..ROUGHNESS => (f64::NEG_INFINITY, f64::INFINITY),
            ROUGHNESS => (self.roughness_floor, 1.0),
            _ => (-0.999, 1.0),
        }
    }

    /// The prior of a pixel whose raw values so far are `so_far`.
    fn prior(&self, so_far: &[f64; RAW], pixel: usize, trust: Trust) -> Prior {
        let n = self.pixels();
        let mut prior = Prior { mean: [0.0; RAW], weight: [0.0; RAW] };
        for i in 0..RAW {
            let network = if (NORMAL..ROUGHNESS).contains(&i) { trust.network_normal } else { trust.network };
            prior.mean[i] = (1.0 - network) * so_far[i] + network * f64::from(self.start.network[i * n + pixel]);
            let share = match i {
                ..NORMAL => 1.0,
                NORMAL..ROUGHNESS => trust.normal,
                ROUGHNESS.. => trust.specular,
            };
            prior.weight[i] = (share * f64::from(self.start.deviation[i * n + pixel]).max(PRIOR_MIN)).powi(-2);
        }
        self.limit(&mut prior.mean);
        prior
    }

    /// Moves values into their ranges.
    fn limit(&self, raw: &mut [f64; RAW]) {
        for (i, value) in raw.iter_mut().enumerate() {
            let (low, high) = self.range(i);
            *value = value.clamp(low, high);
        }
        let length2 = raw[NORMAL].powi(2) + raw[NORMAL + 1].powi(2);
        if length2 > FLAT_LIMIT {
            let factor = (FLAT_LIMIT / length2).sqrt();
            raw[NORMAL] *= factor;
            raw[NORMAL + 1] *= factor;
        }
    }

    /// The pixel in every photo, under the light of `shots`.
    fn sights<'s>(&self, pixel: usize, shots: impl Iterator<Item = &'s Shot>) -> Vec<Sight> {
        let width = self.capture.width();
        let [x, y] = self.capture.position(pixel / width, pixel % width);
        shots.map(|shot| Sight::new(shot, x, y)).collect()
    }

    /// Calls `each` for everything that `raw` is compared with, the photo `without` apart; returns the photos' part of the cost.
    fn compare(
        &self,
        Seen { pixel, sights, without }: Seen<'_>,
        raw: &[f64; RAW],
        trust: Trust,
        mut each: impl FnMut(&Compared),
    ) -> f64 {
        let surface = Surface::new(raw);
        let scale = (OUTLIER * trust.photo).powi(2);
        let mut cost = 0.0;
        for (index, (view, sight)) in self.views.iter().zip(sights).enumerate() {
            if without == Some(index) {
                continue;
            }
            let seen = sight.look(&surface);
            for c in 0..3 {
                let residual = seen.code[c] - f64::from(view.code[pixel][c]);
                if view.photo.saturated[pixel] >> c & 1 == 1 && residual > 0.0 {
                    continue;
                }
                let relative = residual * residual / scale;
                cost += OUTLIER * OUTLIER * relative.ln_1p();
                let weight = trust.photo.powi(-2) / (1.0 + relative);
                each(&Compared { channel: c, residual, weight, slopes: seen.slopes[c] });
            }
        }
        cost
    }

    fn system(&self, seen: Seen<'_>, raw: &[f64; RAW], prior: &Prior, trust: Trust) -> System {
        let mut system = System { cost: 0.0, gradient: [0.0; RAW], matrix: [[0.0; RAW]; RAW] };
        let System { gradient, matrix, .. } = &mut system;
        let cost = self.compare(seen, raw, trust, |compared| {
            let places = places(compared.channel);
            for (a, &i) in places.iter().enumerate() {
                let slope = compared.weight * compared.slopes[a];
                gradient[i] += slope * compared.residual;
                for (b, &j) in places[..=a].iter().enumerate() {
                    matrix[i][j] += slope * compared.slopes[b];
                }
            }
        });
        system.cost = cost;
        for i in 0..RAW {
            let off = raw[i] - prior.mean[i];
            system.cost += prior.weight[i] * off * off;
            system.gradient[i] += prior.weight[i] * off;
            system.matrix[i][i] += prior.weight[i];
        }
        system
    }

    /// Moves `raw` by up to `steps` Levenberg-Marquardt steps; returns the cost where it begins and the system where it ends.
    fn fit(&self, seen: Seen<'_>, raw: &mut [f64; RAW], prior: &Prior, trust: Trust, steps: usize) -> (f64, System) {
        let mut system = self.system(seen, raw, prior, trust);
        let first = system.cost;
        let mut damping = 1e-2;
        for _ in 0..steps {
            let mut matrix = system.matrix;
            let mut gradient = system.gradient;
            for i in 0..RAW {
                matrix[i][i] *= 1.0 + damping;
                // At a limit and pushed against it: held.
                let (low, high) = self.range(i);
                if raw[i] <= low && gradient[i] > 0.0 || raw[i] >= high && gradient[i] < 0.0 {
                    gradient[i] = 0.0;
                    matrix[i][i] *= 1e6;
                }
            }
            let Some(cholesky) = Cholesky::new(&matrix) else { break };
            let step = cholesky.solve(gradient);
            let mut moved = *raw;
            moved.iter_mut().zip(step).for_each(|(value, step)| *value -= step);
            self.limit(&mut moved);
            let next = self.system(seen, &moved, prior, trust);
            if next.cost < system.cost {
                let gain = system.cost - next.cost;
                *raw = moved;
                system = next;
                damping = (damping * 0.2).max(1e-6);
                if gain < 1e-3 * system.cost.min(1.0) {
                    break;
                }
            } else {
                damping *= 8.0;
                if damping > 1e4 {
                    break;
                }
            }
        }
        (first, system)
    }

    /// Fits a row of pixels.
    fn finish_row(&self, row: usize, trust: Trust, steps: usize) -> Row {
        let width = self.capture.width();
        let empty = || Vec::with_capacity(width);
        let mut out = Row { raw: empty(), deviation: empty(), first_cost: 0.0, last_cost: 0.0 };
        for pixel in row * width..(row + 1) * width {
            let so_far = so_far(self.start.raw, self.pixels(), pixel);
            let prior = self.prior(&so_far, pixel, trust);
            let sights = self.sights(pixel, self.views.iter().map(|view| &view.shot));
            let mut raw = prior.mean;
            let seen = Seen { pixel, sights: &sights, without: None };
            let (first, last) = self.fit(seen, &mut raw, &prior, trust, steps);
            out.first_cost += first;
            out.last_cost += last.cost;
            out.raw.push(raw.map(|value| value as f32));
            // Around its minimum the cost is that of a Gaussian with this inverse covariance, but for the prior: shares of the network's deviation hold a
            // pixel near the maps so far, which are no surer for that.
            let sure = self.prior(&so_far, pixel, Trust { normal: 1.0, specular: 1.0, ..trust }).weight;
            let mut matrix = last.matrix;
            for i in 0..RAW {
                matrix[i][i] += sure[i] - prior.weight[i];
            }
            let variances = Cholesky::new(&matrix).map(|cholesky| cholesky.inverse_diagonal());
            out.deviation.push(variances.unwrap_or(sure.map(f64::recip)).map(|variance| variance.sqrt() as f32));
        }
        out
    }

    /// The trust with which photos that are left out are predicted best, found one value after the other.
    fn choose(&self, rehearsal: &Rehearsal, control: &mut Control<'_>) -> Result<Trust> {
        if rehearsal.folds.is_empty() {
            return Ok(Trust::START);
        }
        let mut best = (f64::INFINITY, Trust::START);
        for network in NETWORK {
            for start in [Trust::START, Trust::OF_PHOTOS] {
                let found = self.search(Trust { network, network_normal: network, ..start }, rehearsal, control)?;
                if found.0 < best.0 {
                    best = found;
                }
            }
        }
        tracing::debug!("error of photos left out: {:.4}", best.0.sqrt());
        Ok(best.1)
    }

    /// From `best` on, the trust with the least error of photos that are left out, one value after the other; and that error.
    fn search(&self, mut best: Trust, rehearsal: &Rehearsal, control: &mut Control<'_>) -> Result<(f64, Trust)> {
        let mut lowest = self.left_out_error(best, rehearsal);
        type Set = fn(&mut Trust, f64);
        let searches: [(&[f64], Set); 5] = [
            (&PHOTO_DEVIATIONS, |trust, value| trust.photo = value),
            (&NETWORK, |trust, value| trust.network_normal = value),
            (&SHARES, |trust, value| trust.normal = value),
            (&SHARES, |trust, value| trust.specular = value),
            (&PHOTO_DEVIATIONS, |trust, value| trust.photo = value),
        ];
        for (values, set) in searches {
            for &value in values {
                let mut trust = best;
                set(&mut trust, value);
                if trust == best {
                    continue;
                }
                control.poll()?;
                let error = self.left_out_error(trust, rehearsal);
                if error < lowest {
                    (lowest, best) = (error, trust);
                }
            }
        }
        Ok((lowest, best))
    }

    /// Mean squared error of the photos that the folds of `rehearsal` left out.
    fn left_out_error(&self, trust: Trust, rehearsal: &Rehearsal) -> f64 {
        let mut total = (0.0, 0.0);
        for fold in &rehearsal.folds {
            let view = &self.views[fold.without];
            // Summed in order: the same bits on any number of threads.
            for (pixel, code) in self.predict(fold, &fold.shots[fold.without], trust, rehearsal) {
                for c in (0..3).filter(|c| view.photo.saturated[pixel] >> c & 1 == 0) {
                    total.0 += (code[c].min(1.0) - f64::from(view.code[pixel][c])).powi(2);
                    total.1 += 1.0;
                }
            }
        }
        total.0 / f64::max(total.1, 1.0)
    }

    /// What the photo that `fold` left out would show if it was taken as `shot`: some pixels, and their codes.
    fn predict(&self, fold: &Fold, shot: &Shot, trust: Trust, rehearsal: &Rehearsal) -> Vec<(usize, [f64; 3])> {
        let [width, height] = rehearsal.size;
        let (_, sample) = grid(width, height, CHOICE_SIDE);
        let predict = |place: usize| {
            let pixel = rehearsal.pixels[place];
            let prior = self.prior(&so_far(&fold.raw, width * height, place), pixel, trust);
            let sights = self.sights(pixel, fold.shots.iter());
            let mut raw = prior.mean;
            let seen = Seen { pixel, sights: &sights, without: Some(fold.without) };
            self.fit(seen, &mut raw, &prior, trust, 6);
            (pixel, self.sights(pixel, [shot].into_iter())[0].look(&Surface::new(&raw)).code)
        };
        sample.into_par_iter().map(predict).collect()
    }

    /// Expected errors of a new photo, from how those are missed that the folds of `rehearsal` left out, under their stated light.
    fn expected(&self, trust: Trust, rehearsal: &Rehearsal) -> Option<Expected> {
        let [width, height] = rehearsal.size;
        let ([columns, _], _) = grid(width, height, CHOICE_SIDE);
        let error = |fold: &Fold| {
            let view = &self.views[fold.without];
            let predicted = self.predict(fold, &view.photo.shot, trust, rehearsal);
            let clamped = |code: [f64; 3]| code.map(|value| value.clamp(0.0, 1.0));
            let seen: Vec<[f64; 3]> =
                predicted.iter().map(|&(pixel, _)| clamped(view.code[pixel].map(f64::from))).collect();
            let predicted: Vec<[f64; 3]> = predicted.into_iter().map(|(_, code)| clamped(code)).collect();
            let off = |(a, b): (&[f64; 3], &[f64; 3])| (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f64>();
            let squares: f64 = predicted.iter().zip(&seen).map(off).sum();
            let plain = (squares / (3 * seen.len()) as f64).sqrt();
            [plain, code_rmse_smooth_gain(&predicted, &seen, columns)]
        };
        Expected::of(&rehearsal.folds.iter().map(error).collect::<Vec<_>>())
    }

    /// Likewise from the deviations of the maps alone: how far they move what is seen from around.
    fn estimated(&self, raw: &[f32], deviation: &[f32]) -> Expected {
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
        let variance = |pixel: usize| -> f64 {
            let at = |planes: &[f32]| so_far(planes, self.pixels(), pixel);
            let (raw, deviation) = (at(raw), at(deviation));
            let of = |sight: Sight| -> f64 {
                let seen = sight.look(&Surface::new(&raw));
                let moved = |c: usize| (0..5).map(move |i| (seen.slopes[c][i] * deviation[places(c)[i]]).powi(2));
                (0..3).flat_map(moved).sum()
            };
            self.sights(pixel, shots.iter()).into_iter().map(of).sum()
        };
        let sum: f64 = sample.iter().map(|&pixel| variance(pixel)).sum();
        let error = (sum / (3 * NEW_PLACES * sample.len()) as f64).sqrt();
        Expected { error, material: error, estimated: true }
    }
}

/// The raw values at `place` of nine planes, each `length` long.
fn so_far(planes: &[f32], length: usize, place: usize) -> [f64; RAW] {
    std::array::from_fn(|i| planes[i * length + place].into())
}

/// Where the slopes of channel `c` belong among the raw values, in ascending order.
fn places(c: usize) -> [usize; 5] {
    [c, NORMAL, NORMAL + 1, ROUGHNESS, SPECULAR + c]
}

/// Estimated bytes that [`finish`] takes for photos of so many pixels, and its start: the photos' codes, the sample, and nine values each of the start, of what
/// is found with its deviations, of the latter as planes.
pub(crate) fn memory(photos: usize, pixels: u64) -> u64 {
    let sample = (CHOICE_SIDE * CHOICE_SIDE * photos * size_of::<Sight>()) as u64;
    sample + pixels * (3 * 4 * photos as u64 + 5 * 4 * RAW as u64)
}

/// Fits every pixel of `capture`, its photos taken as `shots` say, with `start` as the prior, by up to `steps` Levenberg-Marquardt steps.
///
/// # Errors
/// [`Error::ShapeMismatch`] if the planes are not of the capture's size; [`Error::Cancelled`].
pub(crate) fn finish(
    capture: &Capture,
    shots: &[Shot],
    start: Start<'_>,
    roughness_floor: f64,
    steps: usize,
    stages: &mut Vec<StageReport>,
    control: &mut Control<'_>,
) -> Result<Finished> {
    let begun = Instant::now();
    let (width, height) = (capture.width(), capture.height());
    let pixels = width * height;
    for (name, planes) in [("raw", start.raw), ("network", start.network), ("deviation", start.deviation)] {
        if planes.len() != RAW * pixels {
            let expected = format!("{RAW} planes of {height} x {width}");
            return Err(Error::shape(name, expected, format!("{} values", planes.len())));
        }
    }
    control.report(Stage::Finish, 0, 2, None)?;
    let code = |color: &[f32]| [0, 1, 2].map(|c| encode_radiance(color[c]));
    let codes = |photo: &Photo| photo.image.data().chunks_exact(3).map(code).collect();
    let views =
        capture.photos().iter().zip(shots).map(|(photo, &shot)| View { photo, shot, code: codes(photo) }).collect();
    let problem = Problem { capture, views, start, roughness_floor };

    let trust = problem.choose(start.rehearsal, control)?;
    tracing::debug!("{trust:?}");
    control.report(Stage::Finish, 1, 2, None)?;

    let mut rows: Vec<Row> = Vec::with_capacity(height);
    // Some rows at a time, so that a caller who wants to stop is heard.
    for start in (0..height).step_by(64) {
        let part = start..height.min(start + 64);
        rows.par_extend(part.into_par_iter().map(|row| problem.finish_row(row, trust, steps)));
        control.poll()?;
    }
    let planes = |part: fn(&Row) -> &[[f32; RAW]]| {
        let mut planes = vec![0.0; RAW * pixels];
        planes.par_chunks_mut(pixels).enumerate().for_each(|(i, plane)| {
            for (out, row) in plane.chunks_exact_mut(width).zip(&rows) {
                out.iter_mut().zip(part(row)).for_each(|(out, values)| *out = values[i]);
            }
        });
        planes
    };
    // In the unit of the other stages: 1000 times a mean of squares.
    let unit = 1000.0 * trust.photo * trust.photo / (3 * pixels * capture.len()) as f64;
    stages.push(StageReport {
        stage: Stage::Finish,
        steps,
        first_loss: unit * rows.iter().map(|row| row.first_cost).sum::<f64>(),
        best_loss: unit * rows.iter().map(|row| row.last_cost).sum::<f64>(),
        rollbacks: 0,
        stopped_early: false,
        seconds: begun.elapsed().as_secs_f64(),
    });
    control.report(Stage::Finish, 2, 2, None)?;
    let (raw, deviation) = (planes(|row| &row.raw), planes(|row| &row.deviation));
    let expected = problem.expected(trust, start.rehearsal).unwrap_or_else(|| problem.estimated(&raw, &deviation));
    let belief = Belief { photo_deviation: trust.photo, shares: [trust.normal, trust.specular] };
    Ok(Finished { raw, deviation, belief, expected })
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::{Finished, Fold, RAW, Rehearsal, Start, finish};
    use crate::capture::{Capture, Photo, Shot};
    use crate::color::Transfer;
    use crate::error::Error;
    use crate::fit::progress::{CancelToken, Control, Progress};
    use crate::image::Image;
    use crate::maps::{Lobe, Maps};
    use crate::nn::Decoding;
    use crate::render::render_maps;

    const WIDTH: usize = 24;
    const HEIGHT: usize = 20;
    const PIXELS: usize = WIDTH * HEIGHT;

    /// Raw planes of two materials side by side, with a bumpy surface.
    fn truth() -> Vec<f32> {
        let mut raw = vec![0.0; RAW * PIXELS];
        for p in 0..PIXELS {
            let (row, column) = (p / WIDTH, p % WIDTH);
            let left = column < WIDTH / 2;
            let colour = if left { [0.4, 0.0, -0.3] } else { [-0.4, 0.1, 0.3] };
            for c in 0..3 {
                raw[c * PIXELS + p] = colour[c] + 0.05 * (row as f32).sin();
                raw[(6 + c) * PIXELS + p] = if left { -0.5 } else { -0.3 };
            }
            raw[3 * PIXELS + p] = 0.1 * (column as f32 * 0.8).sin();
            raw[4 * PIXELS + p] = 0.1 * (row as f32 * 0.7).cos();
            raw[5 * PIXELS + p] = if left { 0.2 } else { 0.45 };
        }
        raw
    }

    fn shots(count: usize) -> Vec<Shot> {
        let place = |i: usize| {
            let angle = i as f64 * 2.4;
            let radius = 0.45 * (i as f64).sqrt();
            [radius * angle.cos(), radius * angle.sin(), 2.2]
        };
        (0..count).map(|i| Shot { camera: place(i), light: place(i), light_intensity: [12.0; 3] }).collect()
    }

    /// Photos of `raw`.
    fn capture(raw: &[f32], count: usize) -> Capture {
        let mut maps = Maps::new(Lobe::Isotropic, WIDTH, HEIGHT, vec![0.0; 10 * PIXELS]).unwrap();
        Decoding::new(Lobe::Isotropic).decode(raw, &mut maps).unwrap();
        let photos = shots(count).into_iter().enumerate().map(|(i, shot)| {
            let image = Image::from_planar(WIDTH, HEIGHT, 3, &render_maps(&maps, 2.0, &shot).unwrap()).unwrap();
            Photo { name: i.to_string(), shot, image, saturated: vec![0; PIXELS] }
        });
        Capture::new(photos.collect(), 2.0, Transfer::Linear).unwrap()
    }

    /// As if `raw` had been found without each of the photos.
    fn rehearsal(capture: &Capture, raw: &[f32]) -> Rehearsal {
        let shots: Vec<Shot> = capture.photos().iter().map(|photo| photo.shot).collect();
        let fold = |without| Fold { without, raw: raw.to_vec(), shots: shots.clone() };
        let folds = if capture.len() > 1 { (0..capture.len()).map(fold).collect() } else { Vec::new() };
        Rehearsal { size: [WIDTH, HEIGHT], pixels: (0..PIXELS).collect(), folds }
    }

    fn run(capture: &Capture, raw: &[f32], deviation: f32) -> Finished {
        let mut callback = |_: &Progress| ControlFlow::Continue(());
        let mut control = Control::new(&mut callback, CancelToken::new());
        let mut stages = Vec::new();
        let finished = finish(
            capture,
            &capture.photos().iter().map(|photo| photo.shot).collect::<Vec<_>>(),
            Start { raw, network: raw, deviation: &vec![deviation; raw.len()], rehearsal: &rehearsal(capture, raw) },
            -0.9,
            20,
            &mut stages,
            &mut control,
        )
        .unwrap();
        assert!(stages[0].best_loss <= stages[0].first_loss);
        finished
    }

    fn rms(a: &[f32], b: &[f32], planes: std::ops::Range<usize>) -> f32 {
        let range = planes.start * PIXELS..planes.end * PIXELS;
        let squares: f32 = a[range.clone()].iter().zip(&b[range.clone()]).map(|(a, b)| (a - b).powi(2)).sum();
        (squares / range.len() as f32).sqrt()
    }

    fn disturbed(raw: &[f32], by: f32) -> Vec<f32> {
        let mut rng = fastrand::Rng::with_seed(3);
        raw.iter().map(|value| value + by * (2.0 * rng.f32() - 1.0)).collect()
    }

    #[test]
    fn photos_correct_a_wrong_prediction() {
        let truth = truth();
        let start = disturbed(&truth, 0.2);
        let Finished { raw, deviation, belief, expected } = run(&capture(&truth, 8), &start, 0.12);
        assert!(belief.photo_deviation <= 0.0125, "{belief:?}");
        assert!(expected.error < 0.02 && expected.material <= expected.error && !expected.estimated, "{expected:?}");
        for planes in [0..3, 3..5, 5..6, 6..9] {
            let (before, after) = (rms(&start, &truth, planes.clone()), rms(&raw, &truth, planes.clone()));
            assert!(after < 0.5 * before, "{planes:?}: {before} {after}");
        }
        // The photos made every value surer than the prior was.
        assert!(deviation.iter().all(|&value| value > 0.0 && value < 0.12 * 1.001));
    }

    #[test]
    fn without_light_the_prediction_stays() {
        let truth = truth();
        let mut dark = capture(&truth, 1).photos()[0].clone();
        dark.shot.light_intensity = [1e-9; 3];
        dark.image = Image::new(WIDTH, HEIGHT, 3, vec![0.0; 3 * PIXELS]).unwrap();
        let black = Capture::new(vec![dark], 2.0, Transfer::Linear).unwrap();
        let Finished { raw, deviation, expected, .. } = run(&black, &truth, 0.1);
        assert!(expected.estimated, "{expected:?}");
        assert!(rms(&raw, &truth, 0..RAW) < 1e-6);
        // Nor is anything surer than the network is.
        assert!(deviation.iter().all(|value| (value - 0.1).abs() < 1e-4), "{}", deviation[0]);
    }

    #[test]
    fn wrong_sizes_are_errors_and_cancelling_ends() {
        let truth = truth();
        let capture = capture(&truth, 2);
        let attempt = |raw: &[f32], answer: ControlFlow<()>| {
            let mut callback = |_: &Progress| answer;
            let mut control = Control::new(&mut callback, CancelToken::new());
            let rehearsal = rehearsal(&capture, &truth);
            let start = Start { raw, network: &truth, deviation: &truth, rehearsal: &rehearsal };
            finish(&capture, &shots(2), start, -1.0, 1, &mut Vec::new(), &mut control)
        };
        assert!(matches!(attempt(&truth[1..], ControlFlow::Continue(())), Err(Error::ShapeMismatch { .. })));
        assert!(matches!(attempt(&truth, ControlFlow::Break(())), Err(Error::Cancelled)));
    }
}
