//! The maps themselves are optimised against the photos, under priors that a nearly flat surface made of few materials suggests.
//!
//! A handful of photos does not determine nine unknowns per pixel: fitted freely, every pixel explains its own photos and fails on new
//! ones. What holds the fit together is that pixels of one colour are mostly one material. Specular albedo and roughness of a pixel are
//! therefore those of its colour group plus a small deviation of its own, normals are a common tilt plus a small slope of their own, and
//! only the diffuse albedo is (nearly) free. The sum of squared photo residuals and of these Gaussian priors is minimised by Adam.
//! Where the photos say nothing (unlit, saturated), a parameter falls back to its group's.
//!
//! Not from the paper.

use std::time::Instant;

use rayon::prelude::*;

use crate::brdf::real::{Kernel, Lanes, Real};
use crate::capture::{Capture, Photo};
use crate::color::Transfer;
use crate::error::Result;
use crate::fit::cluster::{Membership, soft_groups};
use crate::fit::descent::{Descent, Settings, descend};
use crate::fit::holdout::{REHEARSAL_SIDE, grid, left_out, thinned, thinned_planes};
use crate::fit::light;
use crate::fit::options::FitOptions;
use crate::fit::progress::{CancelToken, Control, Stage};
use crate::fit::report::StageReport;
use crate::fit::search::{self, Found, Prior, search};
use crate::fit::verdict::Expected;
use crate::image::Image;
use crate::maps::{DIFFUSE_PLANE, Lobe, Maps, NORMAL_PLANE, ROUGHNESS_PLANE};
use crate::metrics::{photo_rmse, photo_rmse_smooth_gain};
use crate::render::{Target, photo_loss, render_maps};

/// Colour groups, and how many at most where they only correct a prediction.
const GROUPS: usize = 32;
const CORRECTED_GROUPS: usize = 4;
/// Rounds: after each, pixels are grouped anew by the diffuse albedo that was found, which highlights reach less than the first estimate, and the
/// light of every photo is estimated. Steps of a round at least.
const ROUNDS: usize = 4;
const ROUND_STEPS: usize = 50;
/// Standard deviation of what the model cannot explain in a photo, gamma 2.2 encoded.
const PHOTO_DEVIATION: f64 = 0.2;
/// Standard deviation of a pixel's slope (tangent of the angle) from the common tilt.
const SLOPE_DEVIATION: f64 = 0.01;
/// Standard deviation of the common tilt, as a slope: a few degrees.
const TILT_DEVIATION: f64 = 0.1;
/// Photos left out at most, one at a time, to choose between a flat surface and a given relief; and steps of those fits.
const REHEARSALS: usize = 3;
const REHEARSAL_STEPS: usize = 100;
/// Share of the flat surface's error that the relief has to take away.
const REHEARSAL_GAIN: f64 = 0.1;
/// Standard deviation of a pixel's specular albedo and roughness from its group's, in logits.
const OWN_DEVIATION: f64 = 0.2;
/// Where specular albedo starts and what it returns to without evidence: a dielectric's 4 %, in logits.
const SPECULAR_LOGIT: f32 = -3.178;
/// Likewise for its roughness: 0.5.
const ROUGHNESS_LOGIT: f32 = 0.0;
/// The three channels of one, and the other.
const BASE: [f32; 4] = [SPECULAR_LOGIT, SPECULAR_LOGIT, SPECULAR_LOGIT, ROUGHNESS_LOGIT];
/// From a flat start the diffuse albedo is free where a photo says anything, and groups may be anything.
const FLAT: Spread = Spread { diffuse: 5.0, group: 2.0, evidence: 0.002 };
/// Around a prediction a pixel's diffuse albedo stays near it: a single photo would put its highlight there.
const AROUND: Spread = Spread { diffuse: 0.3, group: 1.0, evidence: 0.02 };
/// In the search before the descent the prior of a group counts as if this share of its pixels spoke for it: a lobe that no photo shows must not be made up from noise.
const SEARCH_EVIDENCE: f64 = 0.04;
/// Roughness is held above this; sharper lobes cannot be told apart at the resolution of photos.
const ROUGHNESS_MIN: f32 = 0.02;
/// Parameters that one thread takes at a time.
const PART: usize = 1 << 14;
/// Adam's step length in the logits and slopes of pixels.
const LEARNING_RATE: f64 = 0.03;
/// Steps of group values are longer by this factor, and those of the common tilt shorter.
const GROUP_STEP: f32 = 2.0;
const TILT_STEP: f32 = 1.0 / 3.0;

/// How far values may be from where they start.
#[derive(Clone, Copy)]
struct Spread {
    /// Standard deviation of a pixel's diffuse albedo, in logits.
    diffuse: f64,
    /// Standard deviation of a group's offsets, in logits.
    group: f64,
    /// The prior of a group counts as if this share of its pixels spoke for it.
    evidence: f64,
}

/// What is fitted.
#[derive(Clone, Debug)]
pub(crate) struct Direct {
    pub maps: Maps<f32>,
    /// Factors on the stated light of the photos.
    pub gains: Vec<f64>,
}

/// What [`fit_direct`] finds on some pixels where one photo is left out.
pub(crate) struct HeldOut {
    /// All photos on a regular grid of pixels, and which pixels of the capture these are.
    pub thinned: Capture,
    pub pixels: Vec<usize>,
    /// The photo left out, and what was found; its gain is that with which the maps predict it best.
    pub folds: Vec<(usize, Direct)>,
}

impl HeldOut {
    /// Expected errors of a new photo, from how the photos left out are missed under their stated light; `None` if there are none.
    pub fn expected(&self) -> Result<Option<Expected>> {
        let mut errors = Vec::new();
        for (without, direct) in &self.folds {
            let photo = &self.thinned.photos()[*without];
            let (width, height) = (self.thinned.width(), self.thinned.height());
            let planes = render_maps(&direct.maps, self.thinned.patch_size(), &photo.shot)?;
            let rendering = Image::from_planar(width, height, 3, &planes)?;
            errors.push([photo_rmse(&rendering, &photo.image)?, photo_rmse_smooth_gain(&rendering, &photo.image)?]);
        }
        Ok(Expected::of(&errors))
    }
}

/// Fits isotropic maps to all photos of `capture`. Gives the relief, too, where it was taken.
///
/// `relief`: two planes of slopes that the surface may have beside leaning as a whole. Whether it has them or is flat is chosen by predicting
/// photos that are left out.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled); [`Error::NonFinite`](crate::Error::NonFinite) if the photos' loss is not finite at the start.
pub(crate) fn fit_direct(
    capture: &Capture,
    relief: Option<&[f32]>,
    options: &FitOptions,
    stages: &mut Vec<StageReport>,
    control: &mut Control<'_>,
) -> Result<(Direct, Option<Vec<f32>>)> {
    let begun = Instant::now();
    let steps = options.direct_steps.unwrap_or(options.preset.direct_steps());
    control.report(Stage::Direct, 0, steps, None)?;
    let relief = match relief.filter(|_| capture.len() > 2) {
        Some(relief) if predicts_better(relief, capture, options.seed, control)? => Some(relief.to_vec()),
        _ => None,
    };
    let mut problem = Problem::new(capture, super::targets(capture)?, options.seed)?;
    problem.relief.clone_from(&relief);
    let (direct, descent) = problem.fit_in_rounds(capture, steps, options.seed, control)?;
    tracing::debug!("light of the photos: {:.3?}", direct.gains);
    stages.push(StageReport::new(Stage::Direct, &descent, begun.elapsed().as_secs_f64()));
    Ok((direct, relief))
}

/// [`fit_direct`] without one photo, for each of some photos, on a part of the pixels: maps that can be judged on that photo. `relief` as it was chosen
/// for all photos.
///
/// # Errors
/// As [`fit_direct`].
pub(crate) fn fit_without(
    capture: &Capture,
    relief: Option<&[f32]>,
    most: usize,
    options: &FitOptions,
    control: &mut Control<'_>,
) -> Result<HeldOut> {
    let steps = options.direct_steps.unwrap_or(options.preset.direct_steps());
    let (thin, pixels) = thinned(capture, REHEARSAL_SIDE)?;
    let relief = relief.map(|relief| thinned_planes(relief, 2, &pixels));
    let mut folds = Vec::new();
    // A single photo cannot be left out.
    let count = if capture.len() > 1 { capture.len() } else { 0 };
    for without in left_out(count, most) {
        control.poll()?;
        let rest: Vec<usize> = (0..capture.len()).filter(|&photo| photo != without).collect();
        let rest = thin.select(&rest)?;
        let mut problem = Problem::new(&rest, super::targets(&rest)?, options.seed)?;
        problem.relief.clone_from(&relief);
        let fit = |control: &mut Control<'_>| problem.fit_in_rounds(&rest, steps, options.seed, control);
        let (mut direct, _) = Control::silently(options.cancel.clone(), fit)?;
        let gain = light::gain_alone(&thin, without, &direct.maps)?;
        direct.gains.insert(without, gain);
        folds.push((without, direct));
    }
    Ok(HeldOut { thinned: thin, pixels, folds })
}

/// Corrects maps that were predicted where pixels of one colour are wrong together: specular albedo and roughness of a colour group and the common
/// tilt follow the photos, what distinguishes the pixels of a group stays mostly as predicted. `relief` are the slopes of `maps`, less their mean.
///
/// For a single photo, which shows every pixel from one side only: over the whole image it still shows the shape of the highlight.
///
/// # Errors
/// As [`fit_direct`].
pub(crate) fn correct(
    capture: &Capture,
    maps: &Maps<f32>,
    relief: Vec<f32>,
    options: &FitOptions,
    stages: &mut Vec<StageReport>,
    control: &mut Control<'_>,
) -> Result<Maps<f32>> {
    let begun = Instant::now();
    let steps = options.direct_steps.unwrap_or(options.preset.direct_steps());
    control.report(Stage::Direct, 0, steps, None)?;
    let problem = Problem::around(capture, super::targets(capture)?, maps, relief, options.seed);
    let (maps, descent) = problem.fit(steps, [0; 2], control)?;
    stages.push(StageReport::new(Stage::Direct, &descent, begun.elapsed().as_secs_f64()));
    Ok(maps)
}

/// Estimated bytes that [`fit_direct`] takes for photos of this size: encoded photos, slopes, groups and starts of pixels, and either the search, the descent or,
/// where there is a `relief`, the rehearsals, which hold the photos of a part of the pixels several times, and search and descend there.
pub(crate) fn memory(photos: usize, size: (usize, usize), relief: bool) -> u64 {
    // Parameters with gradient, best state and Adam's two moments; the maps, their gradient, those of the round before, and gradients by logits; as much
    // more as the system was seen to keep of what is freed.
    const DESCENT: u64 = 4 * (5 * 7 + 3 * 10 + 7 + 8);
    // Slopes twice, memberships, diffuse albedo, specular albedo and roughness.
    const PROBLEM: u64 = 4 * (2 * 2 + 3 + 4) + size_of::<Membership>() as u64;
    let pixels = |(width, height): (usize, usize)| (width * height) as u64;
    let encoded = |(width, height): (usize, usize)| Target::memory(width, height);
    let working = |size: (usize, usize)| {
        (DESCENT * pixels(size)).max(search::memory(photos) * rayon::current_num_threads() as u64)
    };
    let rehearsal = if relief && photos > 2 {
        let ([across, down], _) = grid(size.0, size.1, REHEARSAL_SIDE);
        let part = (across, down);
        // The photos themselves, encoded, of every rehearsal, and of the one that runs.
        let copies = (REHEARSALS.min(photos) + 3) as u64 * photos as u64;
        copies * encoded(part) + PROBLEM * pixels(part) + working(part)
    } else {
        0
    };
    photos as u64 * encoded(size) + PROBLEM * pixels(size) + working(size).max(rehearsal)
}

/// Whether photos that are left out are predicted better with `relief` than from a flat surface, on a part of the pixels.
fn predicts_better(relief: &[f32], capture: &Capture, seed: u64, control: &mut Control<'_>) -> Result<bool> {
    let (capture, pick) = thinned(capture, REHEARSAL_SIDE)?;
    let all: Vec<Target> = super::targets(&capture)?;
    let left_out = left_out(all.len(), REHEARSALS);
    let rests: Vec<Vec<Target>> =
        left_out.clone().map(|without| [&all[..without], &all[without + 1..]].concat()).collect();
    let mut problem = Problem::new(&capture, all.clone(), seed)?;
    let mut error = |relief: Option<Vec<f32>>| -> Result<f64> {
        problem.relief = relief;
        let mut error = 0.0;
        for (rest, without) in rests.iter().zip(left_out.clone()) {
            control.poll()?;
            problem.targets.clone_from(rest);
            let (maps, _) =
                Control::silently(CancelToken::new(), |control| problem.fit(REHEARSAL_STEPS, [0; 2], control))?;
            error += photo_loss(&maps, problem.patch_size, &all[without..=without], None)?;
        }
        Ok(error)
    };
    let flat = error(None)?;
    let bumpy = error(Some(thinned_planes(relief, 2, &pick)))?;
    tracing::debug!("photos left out, flat and with the network's relief: {flat:.3}, {bumpy:.3}");
    Ok(bumpy < (1.0 - REHEARSAL_GAIN) * flat)
}

/// Where each kind of parameter lies in the flat vector that Adam moves.
#[derive(Clone, Copy)]
struct Layout {
    pixels: usize,
    groups: usize,
}

impl Layout {
    const fn slope(self) -> usize {
        3 * self.pixels
    }
    const fn specular_own(self) -> usize {
        5 * self.pixels
    }
    const fn roughness_own(self) -> usize {
        6 * self.pixels
    }
    const fn specular_group(self) -> usize {
        7 * self.pixels
    }
    const fn roughness_group(self) -> usize {
        self.specular_group() + 3 * self.groups
    }
    const fn tilt(self) -> usize {
        self.roughness_group() + self.groups
    }
    const fn len(self) -> usize {
        self.tilt() + 2
    }
}

struct Problem {
    targets: Vec<Target>,
    patch_size: f64,
    width: usize,
    height: usize,
    layout: Layout,
    memberships: Vec<Membership>,
    /// Logits of the diffuse albedo at the start, three planes.
    diffuse: Vec<f32>,
    /// Logits of specular albedo and roughness to which the offsets of groups and pixels are added, four planes.
    base: Vec<f32>,
    /// What the groups start from: offsets of specular albedo and roughness, in logits; and the tilt.
    groups: Vec<[f32; 4]>,
    tilt: [f64; 2],
    /// Slopes to which those of the pixels are added, two planes.
    relief: Option<Vec<f32>>,
    spread: Spread,
}

impl Problem {
    fn new(capture: &Capture, targets: Vec<Target>, seed: u64) -> Result<Self> {
        let (width, height) = (capture.width(), capture.height());
        let pixels = width * height;
        let albedo = diffuse_start(capture);
        let (memberships, groups) = colour_groups(&albedo, GROUPS, seed);
        let layout = Layout { pixels, groups };
        let square = |x: f64| x * x;
        let unit = PHOTO_DEVIATION * PHOTO_DEVIATION;
        let group = unit * SEARCH_EVIDENCE / FLAT.group.powi(2);
        let off = |value: f64, start: f32| logit(value as f32) - start;
        let prior = Prior {
            specular: &|s| group * square(off(s, SPECULAR_LOGIT).into()),
            roughness: &|r| group * square(off(r, ROUGHNESS_LOGIT).into()),
            tilt: &|[x, y]| unit * (x * x + y * y) / (TILT_DEVIATION * TILT_DEVIATION) / pixels as f64,
        };
        let (found, tilt) = search(capture, &memberships, groups, &prior);
        tracing::debug!("start: {found:?}, tilt {tilt:?}");
        let diffuse = search::diffuse(capture, &memberships, &found, tilt);
        let diffuse = (0..3).flat_map(|c| diffuse.iter().map(move |d| logit(0.9 * d[c] + 0.005))).collect();
        Ok(Self {
            targets,
            patch_size: capture.patch_size(),
            width,
            height,
            layout,
            memberships,
            diffuse,
            base: BASE.iter().flat_map(|&logit| std::iter::repeat_n(logit, pixels)).collect(),
            groups: found.iter().map(offsets).collect(),
            tilt,
            relief: None,
            spread: FLAT,
        })
    }

    /// A problem that stays near `maps`.
    fn around(capture: &Capture, targets: Vec<Target>, maps: &Maps<f32>, relief: Vec<f32>, seed: u64) -> Self {
        let (width, height) = (capture.width(), capture.height());
        let pixels = width * height;
        let (memberships, groups) = colour_groups(diffuse_planes(maps), CORRECTED_GROUPS, seed);
        Self {
            targets,
            patch_size: capture.patch_size(),
            width,
            height,
            layout: Layout { pixels, groups },
            memberships,
            diffuse: logits(diffuse_planes(maps)).collect(),
            base: lobe_planes(maps).into_iter().flat_map(logits).collect(),
            groups: vec![[0.0; 4]; groups],
            tilt: [0.0; 2],
            relief: Some(relief),
            spread: AROUND,
        }
    }

    /// Groups pixels anew, by the diffuse albedo of `maps`, where the next descent begins.
    fn regroup(&mut self, maps: &Maps<f32>, seed: u64) {
        let (memberships, groups) = colour_groups(diffuse_planes(maps), GROUPS, seed);
        let planes = lobe_planes(maps);
        let mut sums = vec![([0.0f64; 4], 0.0f64); groups];
        for (p, membership) in memberships.iter().enumerate() {
            for &(group, weight) in membership {
                let (sum, total) = &mut sums[group as usize];
                *total += f64::from(weight);
                for (sum, plane) in sum.iter_mut().zip(planes) {
                    *sum += f64::from(weight) * f64::from(logit(inside(plane[p])));
                }
            }
        }
        let offset = |(sum, total): &([f64; 4], f64)| {
            [0, 1, 2, 3].map(|i| (sum[i] / total.max(f64::MIN_POSITIVE)) as f32 - BASE[i])
        };
        self.groups = sums.iter().map(offset).collect();
        self.diffuse = logits(diffuse_planes(maps)).collect();
        self.memberships = memberships;
        self.layout.groups = groups;
    }

    /// Fits in rounds: after each, pixels are grouped anew and the light of the photos of `capture` is estimated.
    fn fit_in_rounds(
        &mut self,
        capture: &Capture,
        steps: usize,
        seed: u64,
        control: &mut Control<'_>,
    ) -> Result<(Direct, Descent)> {
        let rounds = (steps / ROUND_STEPS).clamp(1, ROUNDS);
        let begins = |round: usize| round * steps / rounds;
        let mut gains = vec![1.0; capture.len()];
        let (mut maps, mut whole) = self.fit(begins(1), [0, steps - begins(1)], control)?;
        for round in 1..rounds {
            gains = light::gains(capture, &maps)?;
            for (target, shot) in self.targets.iter_mut().zip(light::shots(capture, &gains)) {
                target.set_shot(shot);
            }
            self.regroup(&maps, seed);
            let (begin, end) = (begins(round), begins(round + 1));
            let (next, descent) = self.fit(end - begin, [begin, steps - end], control)?;
            maps = next;
            whole.steps += descent.steps;
            whole.best_loss = descent.best_loss;
            whole.rollbacks += descent.rollbacks;
        }
        Ok((Direct { maps, gains }, whole))
    }

    /// The maps after `steps` steps; `around` as in [`Settings`].
    fn fit(&self, steps: usize, around: [usize; 2], control: &mut Control<'_>) -> Result<(Maps<f32>, Descent)> {
        let mut params = self.start();
        let settings = Settings {
            stage: Stage::Direct,
            steps,
            learning_rate: LEARNING_RATE,
            final_rate: 0.02,
            early_stop: None,
            around,
        };
        let mut maps = self.empty_maps()?;
        let mut slopes = maps.clone();
        let descent = descend(&mut params, &settings, control, |params, gradient, _| {
            self.decode(params, &mut maps);
            let Some(gradient) = gradient else {
                return Ok(self.photo_loss(&maps, None)? + self.prior(params, None));
            };
            let loss = self.photo_loss(&maps, Some(&mut slopes))?;
            self.chain(&maps, &slopes, gradient);
            Ok(loss + self.prior(params, Some(gradient)))
        })?;
        self.decode(&params, &mut maps);
        Ok((maps, descent))
    }

    fn start(&self) -> Vec<f32> {
        let layout = self.layout;
        let mut params = vec![0.0; layout.len()];
        params[..layout.slope()].copy_from_slice(&self.diffuse);
        for (g, offsets) in self.groups.iter().enumerate() {
            for (i, offset) in offsets.iter().enumerate() {
                params[layout.specular_group() + i * layout.groups + g] = offset / GROUP_STEP;
            }
        }
        for c in 0..2 {
            params[layout.tilt() + c] = self.tilt[c] as f32 / TILT_STEP;
        }
        params
    }

    fn empty_maps(&self) -> Result<Maps<f32>> {
        let lobe = Lobe::Isotropic;
        Maps::new(lobe, self.width, self.height, vec![0.0; lobe.planes() * self.layout.pixels])
    }

    fn photo_loss(&self, maps: &Maps<f32>, gradient: Option<&mut Maps<f32>>) -> Result<f64> {
        photo_loss(maps, self.patch_size, &self.targets, gradient)
    }

    /// Plane `i` of the base, plus the offset of its group at every pixel, plus the pixel's own deviation.
    fn mixed_logits<'s>(&'s self, i: usize, values: &'s [f32], own: &'s [f32]) -> impl Iterator<Item = f32> + 's {
        let base = &self.base[i * self.layout.pixels..];
        self.memberships.iter().zip(own).zip(base).map(move |((&[(a, of_a), (b, of_b)], own), base)| {
            base + own + (of_a * values[a as usize] + of_b * values[b as usize]) * GROUP_STEP
        })
    }

    /// The transpose of [`Problem::mixed_logits`] with respect to the groups' values.
    fn gather(&self, slopes: &[f32]) -> Vec<f32> {
        let mut sums = vec![0.0f64; self.layout.groups];
        for (membership, &slope) in self.memberships.iter().zip(slopes) {
            for (group, weight) in membership {
                sums[*group as usize] += f64::from(weight * slope);
            }
        }
        sums.into_iter().map(|sum| sum as f32 * GROUP_STEP).collect()
    }

    /// Parameters to maps. Normals are left as (slope x, slope y, 1).
    fn decode(&self, params: &[f32], maps: &mut Maps<f32>) {
        let layout = self.layout;
        let n = layout.pixels;
        let tilt = [params[layout.tilt()] * TILT_STEP, params[layout.tilt() + 1] * TILT_STEP];
        let specular_plane = maps.lobe().specular_plane();
        maps.data_mut().par_chunks_mut(n).enumerate().for_each(|(plane, out)| {
            if plane < NORMAL_PLANE {
                let logits = &params[(plane - DIFFUSE_PLANE) * n..][..n];
                out.copy_from_slice(logits);
                f32::run(Sigmoid { values: out, least: 0.0 });
            } else if plane < NORMAL_PLANE + 2 {
                let c = plane - NORMAL_PLANE;
                let slopes = &params[layout.slope() + c * n..][..n];
                out.iter_mut().zip(slopes).for_each(|(out, slope)| *out = slope + tilt[c]);
                if let Some(relief) = &self.relief {
                    out.iter_mut().zip(&relief[c * n..]).for_each(|(out, slope)| *out += slope);
                }
            } else if plane < ROUGHNESS_PLANE {
                out.fill(1.0);
            } else if plane < specular_plane {
                let groups = &params[layout.roughness_group()..layout.tilt()];
                let own = &params[layout.roughness_own()..layout.specular_group()];
                let logits = self.mixed_logits(3, groups, own);
                out.iter_mut().zip(logits).for_each(|(out, x)| *out = x);
                f32::run(Sigmoid { values: out, least: ROUGHNESS_MIN });
            } else {
                let c = plane - specular_plane;
                let groups = &params[layout.specular_group() + c * layout.groups..][..layout.groups];
                let own = &params[layout.specular_own()..layout.roughness_own()];
                let logits = self.mixed_logits(c, groups, own);
                out.iter_mut().zip(logits).for_each(|(out, x)| *out = x);
                f32::run(Sigmoid { values: out, least: 0.0 });
            }
        });
    }

    /// From the gradient with respect to the maps to that with respect to the parameters, which it overwrites.
    fn chain(&self, maps: &Maps<f32>, slopes: &Maps<f32>, gradient: &mut [f32]) {
        let layout = self.layout;
        let n = layout.pixels;
        let specular_plane = maps.lobe().specular_plane();
        // d loss / d logit of every plane that is a sigmoid.
        let logit_gradient = |plane: usize| -> Vec<f32> {
            let (values, slopes) = (maps.plane(plane), slopes.plane(plane));
            values.iter().zip(slopes).map(|(&value, &slope)| slope * value * (1.0 - value)).collect()
        };
        let planes: Vec<usize> = (DIFFUSE_PLANE..DIFFUSE_PLANE + 3)
            .chain([ROUGHNESS_PLANE])
            .chain(specular_plane..specular_plane + 3)
            .collect();
        let logits: Vec<Vec<f32>> = planes.into_par_iter().map(logit_gradient).collect();
        let (diffuse, rest) = logits.split_at(3);
        let (roughness, specular) = (&rest[0], &rest[1..]);

        for (c, values) in diffuse.iter().enumerate() {
            gradient[c * n..(c + 1) * n].copy_from_slice(values);
        }
        for c in 0..2 {
            let values = slopes.plane(NORMAL_PLANE + c);
            gradient[layout.slope() + c * n..][..n].copy_from_slice(values);
            gradient[layout.tilt() + c] = sum(values.iter().copied()) * TILT_STEP;
        }
        let own = &mut gradient[layout.specular_own()..layout.roughness_own()];
        for (p, own) in own.iter_mut().enumerate() {
            *own = specular[0][p] + specular[1][p] + specular[2][p];
        }
        gradient[layout.roughness_own()..layout.specular_group()].copy_from_slice(roughness);
        let shared: Vec<f32> = [&specular[0], &specular[1], &specular[2], roughness]
            .into_par_iter()
            .flat_map_iter(|slopes| self.gather(slopes))
            .collect();
        gradient[layout.specular_group()..layout.tilt()].copy_from_slice(&shared);
    }

    /// Minus the logarithm of the priors in the units of the photo loss, whose gradient is added to `gradient`.
    fn prior(&self, params: &[f32], mut gradient: Option<&mut [f32]>) -> f64 {
        let layout = self.layout;
        let n = layout.pixels;
        // photo_loss is 1000 times a mean of squares; as a negative log likelihood it would be their sum over 2 sigma^2.
        let residuals = (self.targets.len() * 3 * n) as f64;
        let unit = 1000.0 * 2.0 * PHOTO_DEVIATION * PHOTO_DEVIATION / residuals;
        let Spread { diffuse, group, evidence } = self.spread;
        let group_unit = evidence * unit * n as f64 / layout.groups as f64 / group.powi(2);
        // (range, where it is pulled to, step factor, weight)
        let terms = [
            (0..layout.slope(), Some(&self.diffuse), 1.0, unit / diffuse.powi(2)),
            (layout.slope()..layout.specular_own(), None, 1.0, unit / SLOPE_DEVIATION.powi(2)),
            (layout.specular_own()..layout.specular_group(), None, 1.0, unit / OWN_DEVIATION.powi(2)),
            (layout.specular_group()..layout.tilt(), None, GROUP_STEP, group_unit),
            (layout.tilt()..layout.len(), None, TILT_STEP, unit / TILT_DEVIATION.powi(2)),
        ];
        let mut total = 0.0;
        for (range, mean, step, weight) in terms {
            let weight = weight * f64::from(step * step);
            let values = &params[range.clone()];
            let off = |i: usize, value: f32| value - mean.map_or(0.0, |mean| mean[i]);
            let squares = |(part, values): (usize, &[f32])| -> f64 {
                let off = |(i, &value): (usize, &f32)| off(part * PART + i, value);
                values.iter().enumerate().map(off).map(|off| f64::from(off * off)).sum()
            };
            let squares: Vec<f64> = values.par_chunks(PART).enumerate().map(squares).collect();
            total += 0.5 * weight * squares.iter().sum::<f64>();
            if let Some(gradient) = gradient.as_deref_mut() {
                gradient[range].par_iter_mut().with_min_len(PART).zip(values).enumerate().for_each(
                    |(i, (slope, &value))| {
                        *slope += weight as f32 * off(i, value);
                    },
                );
            }
        }
        total
    }
}

/// A first diffuse albedo, three planes: each photo divided by the irradiance of a flat surface, and of these the mean over the darker
/// ones, which highlights reach least.
fn diffuse_start(capture: &Capture) -> Vec<f32> {
    let (width, height) = (capture.width(), capture.height());
    let pixels = width * height;
    let photos = capture.photos();
    let darker = (photos.len() / 2).max(2).saturating_sub(1).clamp(1, photos.len());
    let mut albedo = vec![0.0; 3 * pixels];
    let rows: Vec<Vec<[f32; 3]>> = (0..height)
        .into_par_iter()
        .map(|row| {
            (0..width)
                .map(|column| {
                    let mut values: [Vec<f32>; 3] = Default::default();
                    for photo in photos {
                        let seen = flat_albedo(photo, capture.position(row, column), row * width + column);
                        values.iter_mut().zip(seen).for_each(|(values, seen)| values.push(seen));
                    }
                    values.map(|mut values| {
                        values.sort_by(f32::total_cmp);
                        (sum(values[..darker].iter().copied()) / darker as f32).clamp(1e-3, 0.95)
                    })
                })
                .collect()
        })
        .collect();
    for (p, color) in rows.into_iter().flatten().enumerate() {
        color.into_iter().enumerate().for_each(|(c, value)| albedo[c * pixels + p] = value);
    }
    albedo
}

/// The albedo a flat Lambertian surface would need for what `photo` shows at `pixel`.
fn flat_albedo(photo: &Photo, position: [f64; 2], pixel: usize) -> [f32; 3] {
    let to_light = [photo.shot.light[0] - position[0], photo.shot.light[1] - position[1], photo.shot.light[2]];
    let distance2: f64 = to_light.iter().map(|x| x * x).sum();
    let n_dot_l = to_light[2] / distance2.sqrt();
    let seen = &photo.image.data()[3 * pixel..3 * pixel + 3];
    [0, 1, 2].map(|c| {
        let irradiance = photo.shot.light_intensity[c] * n_dot_l / distance2;
        // An unlit channel says nothing: grey.
        if irradiance > 0.0 { (f64::from(seen[c]) * std::f64::consts::PI / irradiance) as f32 } else { 0.5 }
    })
}

/// The planes of specular albedo, and that of roughness.
fn lobe_planes(maps: &Maps<f32>) -> [&[f32]; 4] {
    let specular = maps.lobe().specular_plane();
    [specular, specular + 1, specular + 2, ROUGHNESS_PLANE].map(|plane| maps.plane(plane))
}

/// What a group was found to be, as offsets from where it starts.
fn offsets(found: &Found) -> [f32; 4] {
    let [r, g, b] = found.specular;
    let logits = [r, g, b, found.roughness].map(|value| logit(value as f32));
    [0, 1, 2, 3].map(|i| logits[i] - BASE[i])
}

/// Pixels in at most `count` groups by three planes of diffuse albedo, and how many groups there are.
fn colour_groups(diffuse: &[f32], count: usize, seed: u64) -> (Vec<Membership>, usize) {
    let encoded: Vec<f32> = diffuse.iter().map(|&value| Transfer::Gamma22.encode(value)).collect();
    soft_groups(&encoded, diffuse.len() / 3, count, seed)
}

/// The three planes of diffuse albedo.
fn diffuse_planes(maps: &Maps<f32>) -> &[f32] {
    let pixels = maps.width() * maps.height();
    &maps.data()[DIFFUSE_PLANE * pixels..][..3 * pixels]
}

fn logits(values: &[f32]) -> impl Iterator<Item = f32> + '_ {
    values.iter().map(|&value| logit(inside(value)))
}

/// Makes values of logits, `1 / (1 + exp(-x))`, none below `least`.
struct Sigmoid<'a> {
    values: &'a mut [f32],
    least: f32,
}

impl Kernel<f32> for Sigmoid<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes<Scalar = f32>>(self) {
        let one = L::splat(1.0);
        for values in self.values.chunks_mut(L::LANES) {
            let power = (L::load(values) * L::splat(-std::f64::consts::LOG2_E)).exp2();
            (one / (one + power)).max(L::splat(self.least.into())).store(values);
        }
    }
}

/// A value between 0 and 1 whose logit is finite.
fn inside(x: f32) -> f32 {
    x.clamp(1e-4, 1.0 - 1e-4)
}

fn logit(x: f32) -> f32 {
    (x / (1.0 - x)).ln()
}

/// Sum in f64, in order.
fn sum(values: impl Iterator<Item = f32>) -> f32 {
    values.map(f64::from).sum::<f64>() as f32
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::{FitOptions, Lobe, Maps, NORMAL_PLANE, ROUGHNESS_PLANE, correct};
    use crate::capture::{Capture, Photo, Shot};
    use crate::color::Transfer;
    use crate::fit::progress::{CancelToken, Control, Progress};
    use crate::image::Image;
    use crate::render::render_maps;

    const SIZE: usize = 24;
    const PIXELS: usize = SIZE * SIZE;

    /// A grey and a red material side by side, with grain.
    fn maps(roughness: f32, specular: f32) -> Maps<f32> {
        let lobe = Lobe::Isotropic;
        let mut maps = Maps::new(lobe, SIZE, SIZE, vec![0.0; lobe.planes() * PIXELS]).unwrap();
        let first = lobe.specular_plane();
        for (plane, out) in maps.data_mut().chunks_exact_mut(PIXELS).enumerate() {
            for (p, out) in out.iter_mut().enumerate() {
                let grain = 1.0 + 0.1 * (p as f32 * 2.3).sin();
                *out = match plane {
                    0 => 0.4 * grain,
                    1 | 2 => grain * if p % SIZE < SIZE / 2 { 0.1 } else { 0.4 },
                    _ if plane == NORMAL_PLANE + 2 => 1.0,
                    ROUGHNESS_PLANE => roughness * grain,
                    _ if plane >= first => specular,
                    _ => 0.0,
                };
            }
        }
        maps
    }

    #[test]
    fn one_photo_corrects_what_pixels_share() {
        let shot = Shot { camera: [0.0, 0.0, 2.2], light: [0.0, 0.0, 2.2], light_intensity: [12.0; 3] };
        let truth = maps(0.3, 0.06);
        let image = Image::from_planar(SIZE, SIZE, 3, &render_maps(&truth, 2.0, &shot).unwrap()).unwrap();
        let photo = Photo { name: "0".into(), shot, image, saturated: vec![0; PIXELS] };
        let capture = Capture::new(vec![photo], 2.0, Transfer::Linear).unwrap();
        let predicted = maps(0.6, 0.03);
        let mut callback = |_: &Progress| ControlFlow::Continue(());
        let mut control = Control::new(&mut callback, CancelToken::new());
        let mut stages = Vec::new();
        let options = FitOptions::default();
        let corrected =
            correct(&capture, &predicted, vec![0.0; 2 * PIXELS], &options, &mut stages, &mut control).unwrap();
        assert!(stages[0].best_loss < 0.2 * stages[0].first_loss, "{stages:?}");
        let off = |maps: &Maps<f32>, plane: usize| {
            let pairs = maps.plane(plane).iter().zip(truth.plane(plane));
            (pairs.map(|(a, b)| (a - b).powi(2)).sum::<f32>() / PIXELS as f32).sqrt()
        };
        for plane in [ROUGHNESS_PLANE, Lobe::Isotropic.specular_plane()] {
            let (before, after) = (off(&predicted, plane), off(&corrected, plane));
            assert!(after < 0.4 * before, "plane {plane}: {before} {after}");
        }
        // The highlight stays out of the diffuse albedo, and the grain of the roughness stays.
        assert!(off(&corrected, 0) < 0.02, "{}", off(&corrected, 0));
        let ratio = |p: usize| corrected.plane(ROUGHNESS_PLANE)[p] / predicted.plane(ROUGHNESS_PLANE)[p];
        assert!((ratio(0) / ratio(1) - 1.0).abs() < 0.1, "{} {}", ratio(0), ratio(1));
    }
}
