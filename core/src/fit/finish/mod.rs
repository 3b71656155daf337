//! The finish: with the network's maps and how sure it is of them as a Gaussian prior, every pixel is fitted to the photos.
//!
//! Per pixel nine raw values are found by Levenberg-Marquardt with the exact Jacobian ([`shading`]). What pixels have in common is found
//! with them, the pixels' own values eliminated (Schur complement): for every colour group how far the network is off in specular albedo
//! and roughness, a common tilt, and the relative power of each photo. How much the photos count against the prior is chosen
//! by leaving photos out and predicting them.
//!
//! Not from the paper.

mod shading;
mod solve;

use std::time::Instant;

use rayon::prelude::*;

use crate::capture::{Capture, Shot};
use crate::error::{Error, Result};
use crate::fit::cluster::{Membership, soft_groups};
use crate::fit::progress::{Control, Stage};
use crate::fit::report::StageReport;
use crate::render::encode_radiance;
use shading::{FLAT_LIMIT, NORMAL, RAW, ROUGHNESS, SPECULAR, Sight, Surface};
use solve::{Cholesky, solve_dense};

/// Candidates for the standard deviation of what the model cannot explain in a photo, gamma 2.2 encoded.
const DEVIATIONS: [f64; 7] = [0.2, 0.1, 0.05, 0.025, 0.0125, 0.006, 0.003];
/// The deviation where a single photo leaves no choice.
const SINGLE_DEVIATION: f64 = 0.025;
/// Pixels on which the deviation is chosen, and on which the common values are found.
const CHOICE_PIXELS: usize = 1024;
const COMMON_PIXELS: usize = 8192;
/// Photos left out at most, one at a time.
const LEFT_OUT: usize = 5;
/// Residuals beyond so many deviations count less and less (Cauchy).
const OUTLIER: f64 = 3.0;
/// Colour groups.
const GROUPS: usize = 12;
/// Share of the network's variance in specular albedo, roughness and normal that pixels of a group have in common.
const COMMON_SHARE: f64 = 0.5;
/// Standard deviation of the common tilt, as normal x and y.
const TILT_DEVIATION: f64 = 0.05;
/// Standard deviation of a photo's relative power, as a logarithm.
const POWER_DEVIATION: f64 = 0.05;
/// Smallest deviation of the network that is believed, raw.
const PRIOR_MIN: f64 = 0.02;

/// What a finish is told.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Settings {
    /// Levenberg-Marquardt steps per pixel in the last pass.
    pub steps: usize,
    /// Rounds on what pixels have in common; 0: every pixel for itself.
    pub rounds: usize,
    /// Seed of the colour groups.
    pub seed: u64,
}

/// What a finish found.
#[derive(Clone, Debug)]
pub(crate) struct Finished {
    /// Nine planes of raw values.
    pub raw: Vec<f32>,
    /// Their standard deviations.
    pub deviation: Vec<f32>,
    /// Relative power of every photo, their logarithms' mean 0.
    pub power: Vec<f64>,
    /// Standard deviation of the photos that was chosen.
    pub photo_deviation: f64,
}

/// A photo as the finish compares with it.
struct View<'a> {
    shot: Shot,
    /// Encoded colour of every pixel.
    code: Vec<[f32; 3]>,
    saturated: &'a [u8],
}

/// The data and the prior.
struct Problem<'a> {
    width: usize,
    height: usize,
    patch_size: f64,
    views: Vec<View<'a>>,
    raw: &'a [f32],
    deviation: &'a [f32],
    roughness_floor: f64,
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

/// What all pixels share: log power of every photo, tilt, and offsets of roughness and specular of every group.
#[derive(Clone)]
struct Common {
    power: Vec<f64>,
    tilt: [f64; 2],
    groups: Vec<[f64; 4]>,
}

/// Raw planes that have an offset per group.
const GROUPED: [usize; 4] = [ROUGHNESS, SPECULAR, SPECULAR + 1, SPECULAR + 2];

/// One channel of a pixel in one photo, compared with a rendering.
struct Compared {
    photo: usize,
    channel: usize,
    residual: f64,
    weight: f64,
    /// As in [`shading::Seen`].
    slopes: [f64; 5],
    code: f64,
}

/// How residuals count.
#[derive(Clone, Copy)]
struct Trust {
    /// Inverse variance of a photo's code.
    weight: f64,
    /// A photo that does not count.
    without: Option<usize>,
}

impl Trust {
    fn new(deviation: f64) -> Self {
        Self { weight: deviation.powi(-2), without: None }
    }
}

impl<'a> Problem<'a> {
    fn pixels(&self) -> usize {
        self.width * self.height
    }

    fn position(&self, pixel: usize) -> (f64, f64) {
        let pitch = self.patch_size / self.width as f64;
        let (row, column) = ((pixel / self.width) as f64, (pixel % self.width) as f64);
        ((column + 0.5 - 0.5 * self.width as f64) * pitch, (0.5 * self.height as f64 - row - 0.5) * pitch)
    }

    fn prior(&self, pixel: usize) -> Prior {
        let n = self.pixels();
        let mut prior = Prior { mean: [0.0; RAW], weight: [0.0; RAW] };
        for i in 0..RAW {
            prior.mean[i] = f64::from(self.raw[i * n + pixel]);
            prior.weight[i] = f64::from(self.deviation[i * n + pixel]).max(PRIOR_MIN).powi(-2);
        }
        self.limit(&mut prior.mean);
        prior
    }

    /// Moves values into their ranges.
    fn limit(&self, raw: &mut [f64; RAW]) {
        for (i, value) in raw.iter_mut().enumerate() {
            *value = match i {
                NORMAL..ROUGHNESS => *value,
                ROUGHNESS => value.clamp(self.roughness_floor, 1.0),
                _ => value.clamp(-0.999, 1.0),
            };
        }
        let length2 = raw[NORMAL].powi(2) + raw[NORMAL + 1].powi(2);
        if length2 > FLAT_LIMIT {
            let factor = (FLAT_LIMIT / length2).sqrt();
            raw[NORMAL] *= factor;
            raw[NORMAL + 1] *= factor;
        }
    }

    fn sights(&self, pixel: usize, power: &[f64]) -> Vec<Sight> {
        let (x, y) = self.position(pixel);
        let sight = |(view, power): (&View<'_>, &f64)| {
            let gain = power.exp();
            Sight::new(&Shot { light_intensity: view.shot.light_intensity.map(|i| i * gain), ..view.shot }, x, y)
        };
        self.views.iter().zip(power).map(sight).collect()
    }

    /// Calls `each` for everything that `raw` is compared with; returns the photos' part of the cost.
    fn compare(
        &self,
        pixel: usize,
        sights: &[Sight],
        raw: &[f64; RAW],
        trust: Trust,
        mut each: impl FnMut(&Compared),
    ) -> f64 {
        let surface = Surface::new(raw);
        let scale = OUTLIER * OUTLIER / trust.weight;
        let mut cost = 0.0;
        for (index, (view, sight)) in self.views.iter().zip(sights).enumerate() {
            if trust.without == Some(index) {
                continue;
            }
            let seen = sight.look(&surface);
            for c in 0..3 {
                let residual = seen.code[c] - f64::from(view.code[pixel][c]);
                if view.saturated[pixel] >> c & 1 == 1 && residual > 0.0 {
                    continue;
                }
                let relative = residual * residual / scale;
                cost += OUTLIER * OUTLIER * relative.ln_1p();
                let weight = trust.weight / (1.0 + relative);
                let (slopes, code) = (seen.slopes[c], seen.code[c]);
                each(&Compared { photo: index, channel: c, residual, weight, slopes, code });
            }
        }
        cost
    }

    fn system(&self, pixel: usize, sights: &[Sight], raw: &[f64; RAW], prior: &Prior, trust: Trust) -> System {
        let mut system = System { cost: 0.0, gradient: [0.0; RAW], matrix: [[0.0; RAW]; RAW] };
        let System { gradient, matrix, .. } = &mut system;
        let cost = self.compare(pixel, sights, raw, trust, |seen| {
            let places = places(seen.channel);
            for (a, &i) in places.iter().enumerate() {
                let slope = seen.weight * seen.slopes[a];
                gradient[i] += slope * seen.residual;
                for (b, &j) in places[..=a].iter().enumerate() {
                    matrix[i][j] += slope * seen.slopes[b];
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

    /// Moves `raw` by up to `steps` Levenberg-Marquardt steps; returns the normal equations where it ends.
    fn fit(
        &self,
        pixel: usize,
        sights: &[Sight],
        raw: &mut [f64; RAW],
        prior: &Prior,
        trust: Trust,
        steps: usize,
    ) -> System {
        let mut system = self.system(pixel, sights, raw, prior, trust);
        let mut damping = 1e-2;
        for _ in 0..steps {
            let mut matrix = system.matrix;
            let mut gradient = system.gradient;
            for i in 0..RAW {
                matrix[i][i] *= 1.0 + damping;
                // At a limit and pushed against it: held.
                let (low, high) = match i {
                    NORMAL..ROUGHNESS => (f64::NEG_INFINITY, f64::INFINITY),
                    ROUGHNESS => (self.roughness_floor, 1.0),
                    _ => (-0.999, 1.0),
                };
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
            let next = self.system(pixel, sights, &moved, prior, trust);
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
        system
    }

    /// Pixels on a regular grid, about `count`.
    fn sample(&self, count: usize) -> Vec<usize> {
        let pitch = (self.pixels() as f64 / count as f64).sqrt().max(1.0);
        let ticks = |len: usize| {
            let number = ((len as f64 / pitch).round() as usize).clamp(1, len);
            (0..number).map(move |i| (2 * i + 1) * len / (2 * number))
        };
        ticks(self.height).flat_map(|row| ticks(self.width).map(move |column| row * self.width + column)).collect()
    }

    /// The candidate deviation with which photos that are left out are predicted best.
    fn choose_deviation(&self) -> f64 {
        let count = self.views.len();
        if count < 2 {
            return SINGLE_DEVIATION;
        }
        let left_out: Vec<usize> = (0..count.min(LEFT_OUT)).map(|i| i * count / count.min(LEFT_OUT)).collect();
        let errors = self
            .sample(CHOICE_PIXELS)
            .into_par_iter()
            .map(|pixel| {
                let (sights, prior) = (self.sights(pixel, &vec![0.0; count]), self.prior(pixel));
                let mut errors = [0.0; DEVIATIONS.len()];
                for &without in &left_out {
                    let mut raw = prior.mean;
                    for (error, deviation) in errors.iter_mut().zip(DEVIATIONS) {
                        let trust = Trust { without: Some(without), ..Trust::new(deviation) };
                        self.fit(pixel, &sights, &mut raw, &prior, trust, 4);
                        let seen = sights[without].look(&Surface::new(&raw));
                        let view = &self.views[without];
                        for c in 0..3 {
                            if view.saturated[pixel] >> c & 1 == 0 {
                                *error += (seen.code[c].min(1.0) - f64::from(view.code[pixel][c])).powi(2);
                            }
                        }
                    }
                }
                errors
            })
            .reduce(|| [0.0; DEVIATIONS.len()], |a, b| std::array::from_fn(|i| a[i] + b[i]));
        let best = (0..DEVIATIONS.len()).min_by(|&a, &b| errors[a].total_cmp(&errors[b])).unwrap_or(0);
        DEVIATIONS[best]
    }

    /// The prior of a pixel's own values, given what is common.
    fn shifted(&self, pixel: usize, common: &Common, members: &[Membership]) -> Prior {
        let mut prior = self.prior(pixel);
        if common.groups.is_empty() {
            return prior;
        }
        for (k, place) in GROUPED.into_iter().enumerate() {
            prior.weight[place] /= 1.0 - COMMON_SHARE;
            for &(group, share) in &members[pixel] {
                prior.mean[place] += f64::from(share) * common.groups[group as usize][k];
            }
        }
        for i in 0..2 {
            prior.mean[NORMAL + i] += common.tilt[i];
        }
        prior
    }

    /// One Gauss-Newton step on what pixels have in common, their own values free.
    fn step_common(&self, common: &mut Common, members: &[Membership], sample: &[usize], trust: Trust) {
        let (photos, groups) = (self.views.len(), common.groups.len());
        let unknowns = photos + 2 + 4 * groups;
        let zero = || (vec![0.0; unknowns * unknowns], vec![0.0; unknowns]);
        let current = &*common;
        // Chunks of a fixed length, summed in order: the same bits on any number of threads.
        let parts: Vec<_> = sample
            .par_chunks(256)
            .map(|pixels| {
                let (mut matrix, mut gradient) = zero();
                for &pixel in pixels {
                    let sights = self.sights(pixel, &current.power);
                    let prior = self.shifted(pixel, current, members);
                    let mut raw = prior.mean;
                    let system = self.fit(pixel, &sights, &mut raw, &prior, trust, 5);
                    self.eliminate(pixel, &sights, &raw, &prior, &system, members, trust, &mut matrix, &mut gradient);
                }
                (matrix, gradient)
            })
            .collect();
        let (mut matrix, mut gradient) = zero();
        for (part, slope) in parts {
            matrix.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
            gradient.iter_mut().zip(slope).for_each(|(sum, part)| *sum += part);
        }
        // Pixels near each other err alike: so many count as one.
        let alike = 16.0;
        matrix.iter_mut().chain(&mut gradient).for_each(|value| *value /= alike);

        let mut weigh = |place: usize, value: f64, weight: f64| {
            matrix[place * unknowns + place] += weight;
            gradient[place] += weight * value;
        };
        for (i, &power) in common.power.iter().enumerate() {
            weigh(i, power, POWER_DEVIATION.powi(-2));
        }
        for (i, &tilt) in common.tilt.iter().enumerate() {
            weigh(photos + i, tilt, TILT_DEVIATION.powi(-2));
        }
        let spread = self.spread(sample);
        for (group, offsets) in common.groups.iter().enumerate() {
            for (k, &offset) in offsets.iter().enumerate() {
                weigh(photos + 2 + 4 * group + k, offset, 1.0 / (COMMON_SHARE * spread[GROUPED[k]]));
            }
        }
        solve_dense(&mut matrix, &mut gradient);
        for (power, step) in common.power.iter_mut().zip(&gradient) {
            *power = (*power - step).clamp(-0.5, 0.5);
        }
        // Their mean is the capture's to state.
        let mean = common.power.iter().sum::<f64>() / photos as f64;
        common.power.iter_mut().for_each(|power| *power -= mean);
        for (tilt, step) in common.tilt.iter_mut().zip(&gradient[photos..]) {
            *tilt = (*tilt - step).clamp(-0.3, 0.3);
        }
        for (offsets, steps) in common.groups.iter_mut().zip(gradient[photos + 2..].chunks_exact(4)) {
            for (offset, step) in offsets.iter_mut().zip(steps) {
                *offset = (*offset - step).clamp(-1.0, 1.0);
            }
        }
    }

    /// Mean variance of every raw value in the prior of these pixels.
    fn spread(&self, sample: &[usize]) -> [f64; RAW] {
        let mut spread = [0.0; RAW];
        for &pixel in sample {
            let weight = self.prior(pixel).weight;
            spread.iter_mut().zip(weight).for_each(|(sum, weight)| *sum += 1.0 / weight);
        }
        spread.map(|sum| sum / sample.len() as f64)
    }

    /// Adds to the normal equations of the common values what remains of a pixel's when its own values are free.
    #[allow(clippy::too_many_arguments)]
    fn eliminate(
        &self,
        pixel: usize,
        sights: &[Sight],
        raw: &[f64; RAW],
        prior: &Prior,
        system: &System,
        members: &[Membership],
        trust: Trust,
        matrix: &mut [f64],
        gradient: &mut [f64],
    ) {
        let photos = self.views.len();
        let unknowns = gradient.len();
        let Some(cholesky) = Cholesky::new(&system.matrix) else { return };
        // Per common unknown: its place, what it does to the pixel's values, its own curvature and gradient.
        let mut columns: Vec<(usize, [f64; RAW], f64, f64)> =
            (0..photos).map(|photo| (photo, [0.0; RAW], 0.0, 0.0)).collect();
        self.compare(pixel, sights, raw, trust, |seen| {
            // The code's slope by the logarithm of the power.
            let slope = seen.code / 2.2;
            let (_, cross, curvature, push) = &mut columns[seen.photo];
            for (a, i) in places(seen.channel).into_iter().enumerate() {
                cross[i] += seen.weight * seen.slopes[a] * slope;
            }
            *curvature += seen.weight * slope * slope;
            *push += seen.weight * slope * seen.residual;
        });
        // A shift of the prior's mean.
        let mut shift = |place: usize, value: usize, share: f64| {
            let weight = prior.weight[value];
            let mut cross = [0.0; RAW];
            cross[value] = -weight * share;
            columns.push((place, cross, weight * share * share, -weight * share * (raw[value] - prior.mean[value])));
        };
        shift(photos, NORMAL, 1.0);
        shift(photos + 1, NORMAL + 1, 1.0);
        for (k, value) in GROUPED.into_iter().enumerate() {
            for &(group, share) in &members[pixel] {
                if share > 0.01 {
                    shift(photos + 2 + 4 * group as usize + k, value, f64::from(share));
                }
            }
        }
        let free = cholesky.forward(system.gradient);
        let reduced: Vec<[f64; RAW]> = columns.iter().map(|column| cholesky.forward(column.1)).collect();
        let product = |a: &[f64; RAW], b: &[f64; RAW]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        for (i, (place, _, curvature, push)) in columns.iter().enumerate() {
            gradient[*place] += push - product(&reduced[i], &free);
            matrix[place * unknowns + place] += curvature;
            for (j, (other, ..)) in columns.iter().enumerate() {
                let mut value = -product(&reduced[i], &reduced[j]);
                // Two groups shift the same value.
                if i != j
                    && *place >= photos + 2
                    && *other >= photos + 2
                    && (place - photos - 2) % 4 == (other - photos - 2) % 4
                {
                    let k = GROUPED[(place - photos - 2) % 4];
                    value += columns[i].1[k] * columns[j].1[k] / prior.weight[k];
                }
                matrix[place * unknowns + other] += value;
            }
        }
    }
}

/// Where the slopes of channel `c` belong among the raw values, in ascending order but for the diffuse value, which is the first.
fn places(c: usize) -> [usize; 5] {
    [c, NORMAL, NORMAL + 1, ROUGHNESS, SPECULAR + c]
}

/// Fits every pixel of `capture` to the photos, with nine planes of predicted `raw` values and their standard deviations as the prior.
///
/// # Errors
/// [`Error::ShapeMismatch`] if the planes are not of the capture's size; [`Error::Cancelled`].
pub(crate) fn finish(
    capture: &Capture,
    raw: &[f32],
    deviation: &[f32],
    roughness_floor: f64,
    settings: Settings,
    stages: &mut Vec<StageReport>,
    control: &mut Control<'_>,
) -> Result<Finished> {
    let begun = Instant::now();
    let (width, height) = (capture.width(), capture.height());
    let pixels = width * height;
    for (name, planes) in [("raw", raw), ("deviation", deviation)] {
        if planes.len() != RAW * pixels {
            let expected = format!("{RAW} planes of {height} x {width}");
            return Err(Error::shape(name, expected, format!("{} values", planes.len())));
        }
    }
    let passes = settings.rounds + 2;
    control.report(Stage::Finish, 0, passes, None)?;
    let encode = |photo: &crate::capture::Photo| {
        let code = |color: &[f32]| [0, 1, 2].map(|c| encode_radiance(color[c]));
        photo.image.data().chunks_exact(3).map(code).collect()
    };
    let views = capture
        .photos()
        .iter()
        .map(|photo| View { shot: photo.shot, code: encode(photo), saturated: &photo.saturated })
        .collect();
    let problem = Problem { width, height, patch_size: capture.patch_size(), views, raw, deviation, roughness_floor };

    let photo_deviation = problem.choose_deviation();
    let trust = Trust::new(photo_deviation);
    control.report(Stage::Finish, 1, passes, None)?;

    let mut common = Common { power: vec![0.0; capture.len()], tilt: [0.0; 2], groups: Vec::new() };
    let mut members = Vec::new();
    if settings.rounds > 0 {
        let groups;
        let colors: Vec<f32> = raw[..3 * pixels].iter().map(|value| 0.5 * value.clamp(-1.0, 1.0) + 0.5).collect();
        (members, groups) = soft_groups(&colors, pixels, GROUPS, settings.seed);
        common.groups = vec![[0.0; 4]; groups];
        let sample = problem.sample(COMMON_PIXELS);
        for round in 0..settings.rounds {
            problem.step_common(&mut common, &members, &sample, trust);
            control.report(Stage::Finish, 2 + round, passes, None)?;
        }
    }

    let mut rows: Vec<(Vec<[f32; RAW]>, Vec<[f32; RAW]>, f64, f64)> = Vec::with_capacity(height);
    // Some rows at a time, so that a caller who wants to stop is heard.
    for start in (0..height).step_by(64) {
        let part = (start..height.min(start + 64)).into_par_iter().map(|row| {
            let (mut values, mut deviations, mut first, mut last) = (Vec::new(), Vec::new(), 0.0, 0.0);
            for pixel in row * width..(row + 1) * width {
                let sights = problem.sights(pixel, &common.power);
                let prior = problem.shifted(pixel, &common, &members);
                let mut raw = prior.mean;
                problem.limit(&mut raw);
                first += problem.compare(pixel, &sights, &raw, trust, |_| ());
                let system = problem.fit(pixel, &sights, &mut raw, &prior, trust, settings.steps);
                last += system.cost;
                let variance = Cholesky::new(&system.matrix).map_or([f64::INFINITY; RAW], |c| c.inverse_diagonal());
                values.push(raw.map(|value| value as f32));
                deviations.push(variance.map(|value| value.sqrt().min(2.0) as f32));
            }
            (values, deviations, first, last)
        });
        rows.par_extend(part);
        control.poll()?;
    }
    let scatter = |of: fn(&(Vec<[f32; RAW]>, Vec<[f32; RAW]>, f64, f64)) -> &Vec<[f32; RAW]>| {
        let mut planes = vec![0.0; RAW * pixels];
        planes.par_chunks_mut(pixels).enumerate().for_each(|(i, plane)| {
            for (out, row) in plane.chunks_exact_mut(width).zip(&rows) {
                out.iter_mut().zip(of(row)).for_each(|(out, values)| *out = values[i]);
            }
        });
        planes
    };
    // In the unit of the other stages: 1000 times a mean of squares.
    let unit = 1000.0 * photo_deviation * photo_deviation / (3 * pixels * capture.len()) as f64;
    stages.push(StageReport {
        stage: Stage::Finish,
        steps: settings.steps,
        first_loss: unit * rows.iter().map(|row| row.2).sum::<f64>(),
        best_loss: unit * rows.iter().map(|row| row.3).sum::<f64>(),
        rollbacks: 0,
        stopped_early: false,
        seconds: begun.elapsed().as_secs_f64(),
    });
    control.report(Stage::Finish, passes, passes, None)?;
    Ok(Finished {
        raw: scatter(|row| &row.0),
        deviation: scatter(|row| &row.1),
        power: common.power.iter().map(|power| power.exp()).collect(),
        photo_deviation,
    })
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::{Finished, RAW, Settings, finish};
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

    /// Photos of `raw`; photo i taken with `power[i]` times the light that is stated.
    fn capture(raw: &[f32], count: usize, power: &[f64]) -> Capture {
        let mut maps = Maps::new(Lobe::Isotropic, WIDTH, HEIGHT, vec![0.0; 10 * PIXELS]).unwrap();
        Decoding::new(Lobe::Isotropic).decode(raw, &mut maps).unwrap();
        let photos = shots(count).into_iter().enumerate().map(|(i, shot)| {
            let gain = power.get(i).copied().unwrap_or(1.0);
            let lit = Shot { light_intensity: shot.light_intensity.map(|x| x * gain), ..shot };
            let image = Image::from_planar(WIDTH, HEIGHT, 3, &render_maps(&maps, 2.0, &lit).unwrap()).unwrap();
            Photo { name: i.to_string(), shot, image, saturated: vec![0; PIXELS] }
        });
        Capture::new(photos.collect(), 2.0, Transfer::Linear).unwrap()
    }

    fn run(capture: &Capture, raw: &[f32], deviation: f32, rounds: usize) -> Finished {
        let mut callback = |_: &Progress| ControlFlow::Continue(());
        let mut control = Control::new(&mut callback, CancelToken::new());
        let settings = Settings { steps: 20, rounds, seed: 0 };
        let mut stages = Vec::new();
        let finished =
            finish(capture, raw, &vec![deviation; raw.len()], -0.9, settings, &mut stages, &mut control).unwrap();
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
        let finished = run(&capture(&truth, 8, &[]), &start, 0.12, 0);
        assert!(finished.photo_deviation <= 0.0125, "{}", finished.photo_deviation);
        for planes in [0..3, 3..5, 5..6, 6..9] {
            let (before, after) = (rms(&start, &truth, planes.clone()), rms(&finished.raw, &truth, planes.clone()));
            assert!(after < 0.5 * before, "{planes:?}: {before} {after}");
        }
        // Where the posterior says it is sure, it is: errors over deviations are of the order of one.
        let relative: f32 =
            (0..truth.len()).map(|i| ((finished.raw[i] - truth[i]) / finished.deviation[i]).powi(2)).sum();
        assert!((relative / truth.len() as f32).sqrt() < 2.0, "{relative}");
        assert!(finished.deviation.iter().all(|&deviation| deviation < 0.1201));
    }

    #[test]
    fn what_pixels_share_is_found() {
        let truth = truth();
        // One photo does not tell specular from roughness in a pixel; a wrong roughness of a whole group shows in many.
        let mut start = disturbed(&truth, 0.02);
        for p in 0..PIXELS {
            start[5 * PIXELS + p] += 0.25;
        }
        let alone = run(&capture(&truth, 3, &[]), &start, 0.2, 0);
        let shared = run(&capture(&truth, 3, &[]), &start, 0.2, 3);
        let (alone, shared) = (rms(&alone.raw, &truth, 5..6), rms(&shared.raw, &truth, 5..6));
        assert!(shared < 0.8 * alone, "{alone} {shared}");
    }

    #[test]
    fn wrong_powers_are_found() {
        let truth = truth();
        let power = [1.1, 0.9, 1.0, 1.05, 0.95];
        let finished = run(&capture(&truth, 5, &power), &disturbed(&truth, 0.05), 0.1, 4);
        let mean = power.iter().map(|power: &f64| power.ln()).sum::<f64>() / 5.0;
        for (got, expected) in finished.power.iter().zip(power) {
            let expected = expected.ln() - mean;
            assert!((got.ln() - expected).abs() <= 0.6 * expected.abs() + 0.01, "{:?}", finished.power);
        }
    }

    #[test]
    fn without_light_the_prediction_stays() {
        let truth = truth();
        let mut dark = capture(&truth, 1, &[]).photos()[0].clone();
        dark.shot.light_intensity = [1e-9; 3];
        dark.image = Image::new(WIDTH, HEIGHT, 3, vec![0.0; 3 * PIXELS]).unwrap();
        let black = Capture::new(vec![dark], 2.0, Transfer::Linear).unwrap();
        let finished = run(&black, &truth, 0.1, 0);
        assert!(rms(&finished.raw, &truth, 0..RAW) < 1e-6);
    }

    #[test]
    fn wrong_sizes_are_errors_and_cancelling_ends() {
        let truth = truth();
        let capture = capture(&truth, 2, &[]);
        let settings = Settings { steps: 1, rounds: 0, seed: 0 };
        let mut on = |_: &Progress| ControlFlow::Continue(());
        let short = finish(
            &capture,
            &truth[1..],
            &truth,
            -1.0,
            settings,
            &mut Vec::new(),
            &mut Control::new(&mut on, CancelToken::new()),
        );
        assert!(matches!(short, Err(Error::ShapeMismatch { .. })));
        let mut off = |_: &Progress| ControlFlow::Break(());
        let ended = finish(
            &capture,
            &truth,
            &truth,
            -1.0,
            settings,
            &mut Vec::new(),
            &mut Control::new(&mut off, CancelToken::new()),
        );
        assert!(matches!(ended, Err(Error::Cancelled)));
    }
}
