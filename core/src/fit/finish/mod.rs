//! The finish: with maps and the network's certainty as a Gaussian prior, every pixel is fitted to the photos.
//!
//! Per pixel nine raw values are found by Levenberg-Marquardt with the exact Jacobian ([`shading`](super::shading)). How much the photos count against
//! the prior is chosen by leaving photos out and predicting them.
//!
//! Not from the paper.
#![allow(clippy::needless_range_loop, reason = "indices of raw values are those of vectors and matrices alike")]

mod solve;

use std::time::Instant;

use rayon::prelude::*;

use crate::capture::{Capture, Photo, Shot};
use crate::error::{Error, Result};
use crate::fit::progress::{Control, Stage};
use crate::fit::report::StageReport;
use crate::fit::shading::{FLAT_LIMIT, NORMAL, RAW, ROUGHNESS, SPECULAR, Sight, Surface};
use crate::render::encode_radiance;
use solve::Cholesky;

/// Candidates for the standard deviation of what the model cannot explain in a photo, gamma 2.2 encoded.
const PHOTO_DEVIATIONS: [f64; 6] = [0.2, 0.1, 0.05, 0.025, 0.0125, 0.006];
/// Candidates for the share of the network's deviation that is believed, in normals, and in specular albedo and roughness.
const SHARES: [f64; 4] = [1.0, 0.3, 0.1, 0.03];
/// Candidates for how far the prior's mean is the network's maps instead of those so far, and of these its normals alone.
const NETWORK: [f64; 3] = [0.0, 0.5, 1.0];
/// Pixels on which these are chosen.
const CHOICE_PIXELS: usize = 1024;
/// Photos left out at most, one at a time.
const LEFT_OUT: usize = 4;
/// Residuals beyond so many deviations count less and less (Cauchy).
const OUTLIER: f64 = 3.0;
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
    /// A photo that does not count.
    without: Option<usize>,
}

impl Trust {
    /// Where the search begins, and what a single photo gets.
    const START: Self =
        Self { photo: 0.025, normal: 0.3, specular: 0.3, network_normal: 0.0, network: 0.0, without: None };
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

    fn prior(&self, pixel: usize, trust: Trust) -> Prior {
        let n = self.pixels();
        let mut prior = Prior { mean: [0.0; RAW], weight: [0.0; RAW] };
        for i in 0..RAW {
            let network = if (NORMAL..ROUGHNESS).contains(&i) { trust.network_normal } else { trust.network };
            let mean = |maps: &[f32]| f64::from(maps[i * n + pixel]);
            prior.mean[i] = (1.0 - network) * mean(self.start.raw) + network * mean(self.start.network);
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

    /// The pixel in every photo.
    fn sights(&self, pixel: usize) -> Vec<Sight> {
        let width = self.capture.width();
        let [x, y] = self.capture.position(pixel / width, pixel % width);
        self.views.iter().map(|view| Sight::new(&view.shot, x, y)).collect()
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
        let scale = (OUTLIER * trust.photo).powi(2);
        let mut cost = 0.0;
        for (index, (view, sight)) in self.views.iter().zip(sights).enumerate() {
            if trust.without == Some(index) {
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

    /// Moves `raw` by up to `steps` Levenberg-Marquardt steps; returns the cost where it begins and the system where it ends.
    fn fit(
        &self,
        pixel: usize,
        sights: &[Sight],
        raw: &mut [f64; RAW],
        prior: &Prior,
        trust: Trust,
        steps: usize,
    ) -> (f64, System) {
        let mut system = self.system(pixel, sights, raw, prior, trust);
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
        (first, system)
    }

    /// Fits a row of pixels.
    fn finish_row(&self, row: usize, trust: Trust, steps: usize) -> Row {
        let width = self.capture.width();
        let empty = || Vec::with_capacity(width);
        let mut out = Row { raw: empty(), deviation: empty(), first_cost: 0.0, last_cost: 0.0 };
        for pixel in row * width..(row + 1) * width {
            let (sights, prior) = (self.sights(pixel), self.prior(pixel, trust));
            let mut raw = prior.mean;
            let (first, last) = self.fit(pixel, &sights, &mut raw, &prior, trust, steps);
            out.first_cost += first;
            out.last_cost += last.cost;
            out.raw.push(raw.map(|value| value as f32));
            // Around its minimum the cost is that of a Gaussian with this inverse covariance, but for the prior: shares of the network's deviation hold a
            // pixel near the maps so far, which are no surer for that.
            let sure = self.prior(pixel, Trust { normal: 1.0, specular: 1.0, ..trust }).weight;
            let mut matrix = last.matrix;
            for i in 0..RAW {
                matrix[i][i] += sure[i] - prior.weight[i];
            }
            let variances = Cholesky::new(&matrix).map(|cholesky| cholesky.inverse_diagonal());
            out.deviation.push(variances.unwrap_or(sure.map(f64::recip)).map(|variance| variance.sqrt() as f32));
        }
        out
    }

    /// Pixels on a regular grid, about `count`, each in every photo.
    fn sample(&self, count: usize) -> Vec<(usize, Vec<Sight>)> {
        let (width, height) = (self.capture.width(), self.capture.height());
        let pitch = (self.pixels() as f64 / count as f64).sqrt().max(1.0);
        let ticks = |len: usize| {
            let number = ((len as f64 / pitch).round() as usize).clamp(1, len);
            (0..number).map(move |i| (2 * i + 1) * len / (2 * number))
        };
        let pixels = ticks(height).flat_map(|row| ticks(width).map(move |column| row * width + column));
        pixels.map(|pixel| (pixel, self.sights(pixel))).collect()
    }

    /// The trust with which photos that are left out are predicted best, found one value after the other.
    fn choose(&self, control: &mut Control<'_>) -> Result<Trust> {
        if self.views.len() < 2 {
            return Ok(Trust::START);
        }
        let sample = self.sample(CHOICE_PIXELS);
        let mut best = (f64::INFINITY, Trust::START);
        // The maps so far have seen all photos, which speaks for them: the network has to be better in spite of that.
        for network in NETWORK {
            for start in [Trust::START, Trust::OF_PHOTOS] {
                let found = self.search(Trust { network, network_normal: network, ..start }, &sample, control)?;
                if found.0 < best.0 {
                    best = found;
                }
            }
        }
        Ok(best.1)
    }

    /// From `best` on, the trust with the least error of photos that are left out, one value after the other; and that error.
    fn search(
        &self,
        mut best: Trust,
        sample: &[(usize, Vec<Sight>)],
        control: &mut Control<'_>,
    ) -> Result<(f64, Trust)> {
        let mut lowest = self.left_out_error(best, sample);
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
                let error = self.left_out_error(trust, sample);
                if error < lowest {
                    (lowest, best) = (error, trust);
                }
            }
        }
        Ok((lowest, best))
    }

    /// Mean squared error of photos that are left out one at a time, on the pixels of `sample`.
    fn left_out_error(&self, trust: Trust, sample: &[(usize, Vec<Sight>)]) -> f64 {
        let count = self.views.len();
        let folds = count.min(LEFT_OUT);
        let mut total = (0.0, 0.0);
        for without in (0..folds).map(|fold| fold * count / folds) {
            let trust = Trust { without: Some(without), ..trust };
            let view = &self.views[without];
            // Summed in order: the same bits on any number of threads.
            let errors: Vec<(f64, f64)> = sample
                .par_iter()
                .map(|&(pixel, ref sights)| {
                    let prior = self.prior(pixel, trust);
                    let mut raw = prior.mean;
                    self.fit(pixel, sights, &mut raw, &prior, trust, 6);
                    let seen = sights[without].look(&Surface::new(&raw));
                    let known = (0..3).filter(|c| view.photo.saturated[pixel] >> c & 1 == 0);
                    let error = |c: usize| (seen.code[c].min(1.0) - f64::from(view.code[pixel][c])).powi(2);
                    known.fold((0.0, 0.0), |(sum, count), c| (sum + error(c), count + 1.0))
                })
                .collect();
            for (error, count) in errors {
                total = (total.0 + error, total.1 + count);
            }
        }
        total.0 / f64::max(total.1, 1.0)
    }
}

/// Where the slopes of channel `c` belong among the raw values, in ascending order.
fn places(c: usize) -> [usize; 5] {
    [c, NORMAL, NORMAL + 1, ROUGHNESS, SPECULAR + c]
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

    let trust = problem.choose(control)?;
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
    let belief = Belief { photo_deviation: trust.photo, shares: [trust.normal, trust.specular] };
    Ok(Finished { raw: planes(|row| &row.raw), deviation: planes(|row| &row.deviation), belief })
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::{Finished, RAW, Start, finish};
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

    fn run(capture: &Capture, raw: &[f32], deviation: f32) -> Finished {
        let mut callback = |_: &Progress| ControlFlow::Continue(());
        let mut control = Control::new(&mut callback, CancelToken::new());
        let mut stages = Vec::new();
        let finished = finish(
            capture,
            &capture.photos().iter().map(|photo| photo.shot).collect::<Vec<_>>(),
            Start { raw, network: raw, deviation: &vec![deviation; raw.len()] },
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
        let Finished { raw, deviation, belief } = run(&capture(&truth, 8), &start, 0.12);
        assert!(belief.photo_deviation <= 0.0125, "{belief:?}");
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
        let Finished { raw, deviation, .. } = run(&black, &truth, 0.1);
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
            let start = Start { raw, network: &truth, deviation: &truth };
            finish(&capture, &shots(2), start, -1.0, 1, &mut Vec::new(), &mut control)
        };
        assert!(matches!(attempt(&truth[1..], ControlFlow::Continue(())), Err(Error::ShapeMismatch { .. })));
        assert!(matches!(attempt(&truth, ControlFlow::Break(())), Err(Error::Cancelled)));
    }
}
