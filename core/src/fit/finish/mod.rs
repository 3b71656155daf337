//! The finish: with maps and the network's certainty as a Gaussian prior, every pixel is fitted to the photos.
//!
//! Per pixel nine raw values are found by Levenberg-Marquardt with the exact Jacobian ([`pixel`]). How much the photos count against
//! the prior is chosen by leaving photos out and predicting them, from maps that have not seen them ([`weighting`]).
//!
//! Not from the paper.

mod pixel;
mod rehearsal;
mod weighting;

use std::time::Instant;

use rayon::prelude::*;

use crate::capture::{Capture, Photo};
use crate::error::{Error, Result};
use crate::fit::direct::light;
use crate::fit::options::Reflectance;
use crate::fit::report::StageReport;
use crate::fit::verdict::Expected;
use crate::progress::{Control, Stage};
use crate::raw::RAW;
use crate::real::Real;
use crate::render::encode_radiance;
use crate::shot::Shot;
use pixel::{Fit, Fitted, Pixels, Place};
pub(crate) use rehearsal::{Fold, Rehearsal};
pub(crate) use weighting::Weighting;

/// The photos, and what is known before them: nine planes each of raw values and of standard deviations.
pub(crate) struct Problem<'a> {
    capture: &'a Capture,
    views: Vec<View<'a>>,
    network: &'a [f32],
    deviation: &'a [f32],
    reflectance: Reflectance,
    roughness_floor: f64,
}

/// A photo as the finish compares with it.
struct View<'a> {
    photo: &'a Photo,
    /// Encoded colour of every pixel.
    code: Vec<[f32; 3]>,
}

/// Where a finish begins.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Start<'a> {
    /// Nine planes of raw values, the maps so far.
    pub raw: &'a [f32],
    /// The anisotropy of every pixel; none where lobes are round.
    pub anisotropy: &'a [[f32; 2]],
    /// How the photos are taken to be lit, one for each.
    pub shots: &'a [Shot],
}

/// What photos that were left out say.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Judgement {
    /// The weighting that predicts them best.
    pub weighting: Weighting,
    /// Expected errors of a new photo; `None` if none was left out.
    pub expected: Option<Expected>,
}

/// What a finish gives.
#[derive(Clone, Debug)]
pub(crate) struct Finished {
    /// Nine planes of raw values.
    pub raw: Vec<f32>,
    /// Their standard deviations, given the photos and the network's own.
    pub deviation: Vec<f32>,
    /// Expected errors of a new photo.
    pub expected: Expected,
}

/// Estimated bytes that a finish takes for photos of so many pixels, and its start: the photos' codes, and nine values each of the start, of what
/// is found with its deviations, of the latter as planes.
pub(crate) fn memory(photos: usize, pixels: u64) -> u64 {
    pixels * (3 * 4 * photos as u64 + 5 * 4 * RAW as u64)
}

fn check(capture: &Capture, name: &str, planes: &[f32]) -> Result<()> {
    let (width, height) = (capture.width(), capture.height());
    if planes.len() == RAW * width * height {
        return Ok(());
    }
    Err(Error::shape(name, format!("{RAW} planes of {height} x {width}"), format!("{} values", planes.len())))
}

impl<'a> Problem<'a> {
    /// The photos of `capture`; `network` are the network's maps, whose normals may be better than those so far, and `deviation` its standard deviations. A
    /// diffuse surface has no lobe to be fitted, a dielectric one has the specular albedo of the maps so far.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if the planes are not of the capture's size.
    pub fn new(
        capture: &'a Capture,
        network: &'a [f32],
        deviation: &'a [f32],
        reflectance: Reflectance,
        roughness_floor: f64,
    ) -> Result<Self> {
        check(capture, "network", network)?;
        check(capture, "deviation", deviation)?;
        let code = |color: &[f32]| [0, 1, 2].map(|c| encode_radiance(color[c]));
        let codes = |photo: &Photo| photo.image.data().chunks_exact(3).map(code).collect();
        let views = capture.photos().iter().map(|photo| View { photo, code: codes(photo) }).collect();
        Ok(Self { capture, views, network, deviation, reflectance, roughness_floor })
    }

    /// How the photos were shot as the capture states it.
    pub fn shots(&self) -> Vec<Shot> {
        light::stated(self.capture)
    }

    fn pixels(&self) -> usize {
        self.capture.width() * self.capture.height()
    }

    /// How photos and prior are to be weighted, by the photos that the folds of `rehearsal` left out; without folds, as suits a single photo.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn judge(&self, rehearsal: &Rehearsal, control: &mut Control<'_>) -> Result<Judgement> {
        let weighting = self.choose(rehearsal, control)?;
        tracing::debug!("{weighting:?}");
        Ok(Judgement { weighting, expected: self.expected(weighting, rehearsal) })
    }

    /// Fits every pixel, with `start` as the prior's mean, by up to `steps` Levenberg-Marquardt steps.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if the planes are not of the capture's size; [`Error::Cancelled`].
    pub fn finish(
        &self,
        start: Start<'_>,
        judgement: Judgement,
        steps: usize,
        stages: &mut Vec<StageReport>,
        control: &mut Control<'_>,
    ) -> Result<Finished> {
        let begun = Instant::now();
        let (width, height) = (self.capture.width(), self.capture.height());
        let pixels = width * height;
        check(self.capture, "raw", start.raw)?;
        control.report(Stage::Finish, 0, 1, None)?;
        let weighting = judgement.weighting;
        let fit_row = |row: usize| {
            let place = |pixel: usize| Place { pixel, so_far: pixel };
            let places: Vec<Place> = (row * width..(row + 1) * width).map(place).collect();
            let Start { raw: so_far, anisotropy, shots } = start;
            let pixels =
                Pixels { problem: self, places: &places, so_far, anisotropy, shots, without: None, weighting, steps };
            f32::run(Fit(pixels))
        };
        let mut rows: Vec<Fitted> = Vec::with_capacity(height);
        // Some rows at a time, so that a caller who wants to stop is heard.
        for first in (0..height).step_by(64) {
            rows.par_extend((first..height.min(first + 64)).into_par_iter().map(fit_row));
            control.poll()?;
        }
        let planes = |part: fn(&Fitted) -> &[[f32; RAW]]| {
            let mut planes = vec![0.0; RAW * pixels];
            planes.par_chunks_mut(pixels).enumerate().for_each(|(i, plane)| {
                for (out, row) in plane.chunks_exact_mut(width).zip(&rows) {
                    out.iter_mut().zip(part(row)).for_each(|(out, values)| *out = values[i]);
                }
            });
            planes
        };
        // In the unit of the other stages: 1000 times a mean of squares.
        let unit = 1000.0 * weighting.photo * weighting.photo / (3 * pixels * self.capture.len()) as f64;
        stages.push(StageReport {
            stage: Stage::Finish,
            steps,
            first_loss: unit * rows.iter().map(|row| row.first_cost).sum::<f64>(),
            best_loss: unit * rows.iter().map(|row| row.last_cost).sum::<f64>(),
            rollbacks: 0,
            stopped_early: false,
            seconds: begun.elapsed().as_secs_f64(),
        });
        control.report(Stage::Finish, 1, 1, None)?;
        let (raw, deviation) = (planes(|row| &row.raw), planes(|row| &row.deviation));
        let expected = judgement.expected.unwrap_or_else(|| self.estimated(&raw, start.anisotropy, &deviation));
        Ok(Finished { raw, deviation, expected })
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::{Finished, Fold, Judgement, Problem, RAW, Rehearsal, Start, Weighting};
    use crate::capture::Capture;
    use crate::color::Transfer;
    use crate::error::Error;
    use crate::fit::options::Reflectance;
    use crate::fit::testing::photo;
    use crate::image::Image;
    use crate::maps::{Lobe, Maps};
    use crate::nn::Decoding;
    use crate::progress::{CancelToken, Control, Progress};
    use crate::shot::Shot;

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
        let photos = shots(count).into_iter().map(|shot| photo(&maps, shot));
        Capture::new(photos.collect(), 2.0, Transfer::Linear).unwrap()
    }

    /// As if `raw` had been found without each of the photos.
    fn rehearsal(capture: &Capture, raw: &[f32]) -> Rehearsal {
        let shots: Vec<Shot> = capture.photos().iter().map(|photo| photo.shot).collect();
        let fold = |without| Fold { without, raw: raw.to_vec(), anisotropy: Vec::new(), shots: shots.clone() };
        let folds = if capture.len() > 1 { (0..capture.len()).map(fold).collect() } else { Vec::new() };
        Rehearsal { size: [WIDTH, HEIGHT], pixels: (0..PIXELS).collect(), folds }
    }

    /// The finish of `capture` from `raw`, with which weighting, and what it finds where a photo is left out.
    fn run(capture: &Capture, raw: &[f32], deviation: f32) -> (Finished, Weighting, Vec<Vec<f32>>) {
        let mut callback = |_: &Progress| ControlFlow::Continue(());
        let mut control = Control::new(&mut callback, CancelToken::new());
        let mut stages = Vec::new();
        let deviation = vec![deviation; raw.len()];
        let problem = Problem::new(capture, raw, &deviation, Reflectance::Isotropic, -0.9).unwrap();
        let rehearsal = rehearsal(capture, raw);
        let judgement = problem.judge(&rehearsal, &mut control).unwrap();
        let weighting = judgement.weighting;
        let folds = rehearsal.folds.iter().map(|fold| problem.without(fold, weighting, &rehearsal)).collect();
        let shots: Vec<Shot> = capture.photos().iter().map(|photo| photo.shot).collect();
        let start = Start { raw, anisotropy: &[], shots: &shots };
        let finished = problem.finish(start, judgement, 20, &mut stages, &mut control).unwrap();
        assert!(stages[0].best_loss <= stages[0].first_loss);
        (finished, weighting, folds)
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
        let (Finished { raw, deviation, expected }, weighting, folds) = run(&capture(&truth, 8), &start, 0.12);
        assert!(
            folds.len() == 8 && folds.iter().all(|fold| rms(fold, &truth, 0..RAW) < 0.5 * rms(&start, &truth, 0..RAW))
        );
        assert!(weighting.photo <= 0.0125, "{weighting:?}");
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
        let (Finished { raw, deviation, expected }, ..) = run(&black, &truth, 0.1);
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
            let problem = Problem::new(&capture, &truth, raw, Reflectance::Isotropic, -1.0)?;
            let judgement = Judgement { weighting: Weighting::START, expected: None };
            let start = Start { raw: &truth, anisotropy: &[], shots: &shots(2) };
            problem.finish(start, judgement, 1, &mut Vec::new(), &mut control)
        };
        assert!(matches!(attempt(&truth[1..], ControlFlow::Continue(())), Err(Error::ShapeMismatch { .. })));
        assert!(matches!(attempt(&truth, ControlFlow::Break(())), Err(Error::Cancelled)));
    }
}
