//! Where [`direct`](super::direct) begins: which specular albedo, roughness and common tilt explain the photos of a flat surface best.
//!
//! For fixed roughness and specular albedo the diffuse albedo of a pixel is a linear least-squares problem, so that a colour group's two
//! values can be searched on a grid. A descent from a dielectric of 4 % alone stays there where the photos show metal or gloss.
//!
//! Not from the paper.

use rayon::prelude::*;

use super::shading::{Parts, Sight};
use crate::capture::Capture;
use crate::fit::cluster::Membership;
use crate::render::encode_radiance;

/// Pixels of a group that are looked at.
const GROUP_PIXELS: usize = 96;
/// While the tilt is searched, one in so many of them in green, and every second candidate of the values.
const TILT_STRIDE: usize = 4;
/// Photos that are looked at.
const PHOTOS: usize = 16;
/// Candidates.
const ROUGHNESSES: [f64; 9] = [0.12, 0.17, 0.23, 0.3, 0.38, 0.47, 0.58, 0.72, 0.9];
const SPECULARS: [f64; 9] = [0.01, 0.02, 0.04, 0.07, 0.12, 0.2, 0.35, 0.6, 0.85];
/// Candidates for either slope of the common tilt.
const TILTS: [f64; 5] = [-0.14, -0.07, 0.0, 0.07, 0.14];
/// Differences of codes beyond this count less and less (Cauchy).
const OUTLIER: f64 = 0.1;
/// Largest diffuse albedo.
const DIFFUSE_MAX: f64 = 0.95;

/// How unlikely a specular albedo and a roughness are before the photos, in sums of squared differences of codes per pixel.
pub(super) struct Prior<'a> {
    pub specular: &'a (dyn Fn(f64) -> f64 + Sync),
    pub roughness: &'a (dyn Fn(f64) -> f64 + Sync),
    pub tilt: &'a (dyn Fn([f64; 2]) -> f64 + Sync),
}

/// What was found for a colour group.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    pub specular: [f64; 3],
    pub roughness: f64,
}

/// A pixel in one photo.
struct View {
    sight: Sight,
    code: [f64; 3],
    radiance: [f64; 3],
    /// Squared slopes of the codes, by radiance; 0 where that is not known.
    weight: [f64; 3],
    saturated: [bool; 3],
}

impl View {
    fn new(capture: &Capture, photo: usize, pixel: usize) -> Self {
        let photo = &capture.photos()[photo];
        let [x, y] = capture.position(pixel / capture.width(), pixel % capture.width());
        let radiance = [0, 1, 2].map(|c| f64::from(photo.image.data()[3 * pixel + c]));
        let saturated = [0, 1, 2].map(|c| photo.saturated[pixel] >> c & 1 == 1);
        let weight = |c: usize| if saturated[c] { 0.0 } else { radiance[c].max(1e-3).powf(2.0 / 2.2 - 2.0) };
        Self {
            sight: Sight::new(&photo.shot, x, y),
            code: radiance.map(encode_radiance),
            radiance,
            weight: [0, 1, 2].map(weight),
            saturated,
        }
    }
}

/// The unit normal of a slope.
fn normal([x, y]: [f64; 2]) -> [f64; 3] {
    let scale = 1.0 / (1.0 + x * x + y * y).sqrt();
    [x * scale, y * scale, scale]
}

/// The diffuse albedo in channel `c` that fits best beside specular albedo `s`: least squares with differences of codes to first order.
fn diffuse_beside(views: &[View], parts: &[Parts], c: usize, s: f64) -> f64 {
    let (mut up, mut down) = (0.0, 0.0);
    for (view, parts) in views.iter().zip(parts) {
        let matt = parts.diffuse[c] * (1.0 - s);
        up += view.weight[c] * matt * (view.radiance[c] - parts.specular[c] * (s + (1.0 - s) * parts.fresnel));
        down += view.weight[c] * matt * matt;
    }
    if down > 0.0 { (up / down).clamp(0.0, DIFFUSE_MAX) } else { 0.5 * DIFFUSE_MAX }
}

/// How far a pixel's channel is from the photos with these albedos.
fn misfit(views: &[View], parts: &[Parts], c: usize, d: f64, s: f64) -> f64 {
    let off = |(view, parts): (&View, &Parts)| {
        let radiance = parts.diffuse[c] * d * (1.0 - s) + parts.specular[c] * (s + (1.0 - s) * parts.fresnel);
        let off = encode_radiance(radiance) - view.code[c];
        if view.saturated[c] && off > 0.0 { 0.0 } else { (off / OUTLIER).powi(2).ln_1p() * OUTLIER * OUTLIER }
    };
    views.iter().zip(parts).map(off).sum()
}

/// How thoroughly to search: every `step`-th sample and candidate, in these channels.
struct Search<'a> {
    samples: usize,
    step: usize,
    channels: &'a [usize],
}

impl Search<'_> {
    /// The best values of a group on a surface that leans by `tilt`, and how far from the photos they are per sample.
    fn best(&self, samples: &[Vec<View>], tilt: [f64; 2], prior: &Prior<'_>) -> (f64, Found) {
        let normal = normal(tilt);
        let mut best = (f64::INFINITY, Found { specular: [0.04; 3], roughness: 0.5 });
        let count = samples.iter().step_by(self.samples).count() as f64;
        for roughness in ROUGHNESSES.into_iter().step_by(self.step) {
            let alpha = roughness * roughness;
            let mut sums = [[0.0; SPECULARS.len()]; 3];
            for views in samples.iter().step_by(self.samples) {
                let parts: Vec<Parts> = views.iter().map(|view| view.sight.parts(normal, alpha)).collect();
                for &c in self.channels {
                    for (sum, s) in sums[c].iter_mut().zip(SPECULARS).step_by(self.step) {
                        *sum += misfit(views, &parts, c, diffuse_beside(views, &parts, c, s), s);
                    }
                }
            }
            let mut total = (prior.roughness)(roughness);
            let mut specular = [0.04; 3];
            for &c in self.channels {
                let costs = sums[c].iter().zip(SPECULARS).step_by(self.step);
                let costs = costs.map(|(sum, s)| (sum / count + (prior.specular)(s), s));
                let (cost, s) = costs.fold((f64::INFINITY, 0.04), |a, b| if b.0 < a.0 { b } else { a });
                total += cost;
                specular[c] = s;
            }
            if total < best.0 {
                best = (total, Found { specular, roughness });
            }
        }
        best
    }
}

/// Estimated bytes that [`search`] takes.
pub(super) fn memory(photos: usize, groups: usize) -> u64 {
    (groups * GROUP_PIXELS * photos.min(PHOTOS) * size_of::<View>()) as u64
}

/// For each of `groups` colour groups the values that explain the photos best, and the tilt that all share.
pub(super) fn search(
    capture: &Capture,
    memberships: &[Membership],
    groups: usize,
    prior: &Prior<'_>,
) -> (Vec<Found>, [f64; 2]) {
    let count = capture.len().min(PHOTOS);
    let photos: Vec<usize> = (0..count).map(|i| i * capture.len() / count).collect();
    let mut members = vec![Vec::new(); groups];
    for (pixel, [(group, _), _]) in memberships.iter().enumerate() {
        members[*group as usize].push(pixel);
    }
    let samples: Vec<Vec<Vec<View>>> = members
        .par_iter()
        .map(|pixels| {
            let taken = pixels.len().min(GROUP_PIXELS);
            let pick = (0..taken).map(|i| pixels[(2 * i + 1) * pixels.len() / (2 * taken)]);
            pick.map(|pixel| photos.iter().map(|&photo| View::new(capture, photo, pixel)).collect()).collect()
        })
        .collect();

    let quick = Search { samples: TILT_STRIDE, step: 2, channels: &[1] };
    let cost = |tilt: [f64; 2]| {
        let of_group = |(samples, all): (&Vec<Vec<View>>, &Vec<usize>)| match all.len() {
            0 => 0.0,
            // A group counts by its size.
            count => count as f64 * quick.best(samples, tilt, prior).0,
        };
        let costs: Vec<f64> = samples.par_iter().zip(&members).map(of_group).collect();
        costs.iter().sum::<f64>() / memberships.len() as f64 + (prior.tilt)(tilt)
    };
    let mut best = (f64::INFINITY, [0.0; 2]);
    for x in TILTS {
        for y in TILTS {
            let cost = cost([x, y]);
            if cost < best.0 {
                best = (cost, [x, y]);
            }
        }
    }
    let tilt = best.1;
    let thorough = Search { samples: 1, step: 1, channels: &[0, 1, 2] };
    let found = samples.par_iter().map(|samples| thorough.best(samples, tilt, prior).1).collect();
    (found, tilt)
}

/// The diffuse albedo of `pixel` beside these specular albedos and this roughness, on a surface that leans by `tilt`.
pub(super) fn diffuse(capture: &Capture, pixel: usize, specular: [f64; 3], roughness: f64, tilt: [f64; 2]) -> [f64; 3] {
    let views: Vec<View> = (0..capture.len()).map(|photo| View::new(capture, photo, pixel)).collect();
    let normal = normal(tilt);
    let parts: Vec<Parts> = views.iter().map(|view| view.sight.parts(normal, roughness * roughness)).collect();
    [0, 1, 2].map(|c| diffuse_beside(&views, &parts, c, specular[c]))
}
