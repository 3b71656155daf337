//! How each photo was taken: real captures know the light to some per cent only, and cameras choose exposures by themselves.
//!
//! Not from the paper.

use rayon::prelude::*;

use super::place::placed;
use crate::capture::{Capture, Photo};
use crate::color::GAMMA;
use crate::error::Result;
use crate::fit::options::Refine;
use crate::maps::Maps;
use crate::render::{encode_all, render_maps};
use crate::shot::Shot;

/// Largest deviation that is granted, as a logarithm: a factor of 2.
const LIMIT: f64 = 0.7;
/// Standard deviation of a light before the photos, as a logarithm, and how many independent values all pixels of a photo count for: what is missed, is missed alike
/// by many.
const DEVIATION: f64 = 0.1;
const EVIDENCE: f64 = 20.0;
/// Differences of codes beyond this count less and less (Cauchy).
const OUTLIER: f64 = 0.1;
/// Photos below which nothing is estimated: with two, what differs is as likely the surface.
const PHOTOS_MIN: usize = 3;
/// Rounds of reweighting.
const ROUNDS: usize = 10;

/// The shots of `capture` as `refine` lets `maps` correct them: the light of each by a factor, near 1 in the geometric mean; positions.
pub(super) fn refined(capture: &Capture, maps: &Maps<f32>, refine: Refine) -> Result<Vec<Shot>> {
    let count = capture.len();
    if count < PHOTOS_MIN || refine == Refine::None {
        return Ok(stated(capture));
    }
    let shots = if refine == Refine::All { placed(capture, maps)? } else { stated(capture) };
    let log = |(photo, shot)| log_gain(photo, shot, capture.patch_size(), maps);
    let logs = capture.photos().par_iter().zip(&shots).map(log).collect::<Result<Vec<f64>>>()?;
    let mean = logs.iter().sum::<f64>() / count as f64;
    Ok(shots.iter().zip(logs).map(|(shot, log)| lit(shot, granted(log - mean))).collect())
}

/// A factor on the light of one photo that `maps` have not seen; theirs are near 1.
pub(super) fn held_out_gain(capture: &Capture, photo: usize, maps: &Maps<f32>) -> Result<f64> {
    if capture.len() <= PHOTOS_MIN {
        return Ok(1.0);
    }
    let photo = &capture.photos()[photo];
    Ok(granted(log_gain(photo, &photo.shot, capture.patch_size(), maps)?))
}

/// The shots as `capture` states them.
pub(crate) fn stated(capture: &Capture) -> Vec<Shot> {
    capture.photos().iter().map(|photo| photo.shot).collect()
}

/// The factor on the light of `stated` that `shot` has.
pub(crate) fn gain(shot: &Shot, stated: &Shot) -> f64 {
    let brightest =
        (0..3).max_by(|&a, &b| stated.light_intensity[a].total_cmp(&stated.light_intensity[b])).unwrap_or(0);
    shot.light_intensity[brightest] / stated.light_intensity[brightest]
}

/// Whether a gain is the largest or the least that is granted.
pub(crate) fn at_limit(gain: f64) -> bool {
    gain.ln().abs() > 0.99 * LIMIT
}

fn granted(log: f64) -> f64 {
    log.clamp(-LIMIT, LIMIT).exp()
}

/// The logarithm of the factor on a photo's light: what `maps` say of it against a Gaussian around the stated light. Of a photo that is well explained all is
/// believed; where maps miss it by as much as it shows, as the dark photos of a mirror, hardly anything is.
fn log_gain(photo: &Photo, shot: &Shot, patch_size: f64, maps: &Maps<f32>) -> Result<f64> {
    let (ratio, variance) = code_ratio(photo, &render_maps(maps, patch_size, shot)?);
    let [prior, variance] = [DEVIATION.powi(2), GAMMA * GAMMA * variance];
    Ok(GAMMA * ratio.ln() * prior / (prior + variance))
}

/// `shot` under `gain` times its light.
pub(super) fn lit(shot: &Shot, gain: f64) -> Shot {
    Shot { light_intensity: shot.light_intensity.map(|intensity| intensity * gain), ..*shot }
}

/// The factor on the codes of `rendering` (three planes of radiance) that brings it nearest to the photo, where that is not saturated, by reweighted least squares;
/// and the variance of its logarithm, infinite where nothing is rendered or seen.
fn code_ratio(photo: &Photo, rendering: &[f32]) -> (f64, f64) {
    let pixels = photo.saturated.len();
    let used: Vec<usize> = (0..pixels).filter(|&p| photo.saturated[p] == 0).collect();
    let seen = |&p: &usize| photo.image.data()[3 * p..3 * p + 3].iter().sum::<f32>() / 3.0;
    let rendered = |&p: &usize| (0..3).map(|c| rendering[c * pixels + p]).sum::<f32>() / 3.0;
    let mut codes: [Vec<f32>; 2] = [used.iter().map(seen).collect(), used.iter().map(rendered).collect()];
    codes.iter_mut().for_each(|codes| encode_all(codes));
    let [seen, rendered] = codes;
    let (mut ratio, mut variance) = (1.0, f64::INFINITY);
    for _ in 0..ROUNDS {
        let (mut up, mut down, mut missed) = (0.0, 0.0, 0.0);
        for [seen, rendered] in seen.iter().zip(&rendered).map(|(&seen, &rendered)| [seen, rendered].map(f64::from)) {
            let off = seen - ratio * rendered;
            let weight = 1.0 / (1.0 + (off / OUTLIER).powi(2));
            up += weight * seen * rendered;
            down += weight * rendered * rendered;
            missed += weight * off * off;
        }
        if !(up > 0.0 && down > 0.0) {
            return (1.0, f64::INFINITY);
        }
        ratio = up / down;
        variance = missed / (down * ratio * ratio * EVIDENCE);
    }
    (ratio, variance)
}

#[cfg(test)]
mod tests {
    use super::{code_ratio, gain, log_gain, refined};
    use crate::capture::{Capture, Photo};
    use crate::color::{GAMMA, Transfer};
    use crate::fit::options::Refine;
    use crate::fit::testing::photo;
    use crate::maps::{Lobe, Maps};
    use crate::render::render_maps;
    use crate::shot::Shot;

    const SIDE: usize = 12;

    fn maps() -> Maps<f32> {
        let mut maps = Maps::new(Lobe::Isotropic, SIDE, SIDE, vec![0.0; 10 * SIDE * SIDE]).unwrap();
        for (i, value) in maps.data_mut().iter_mut().enumerate() {
            *value = match i / (SIDE * SIDE) {
                plane @ ..3 => 0.2 + 0.1 * plane as f32 + 0.002 * (i % 11) as f32,
                3 | 4 => 0.0,
                5 => 1.0,
                6 => 0.4,
                _ => 0.04,
            };
        }
        maps
    }

    /// A capture of `maps` whose photos were lit by `truth` times what is stated.
    fn capture(maps: &Maps<f32>, truth: &[f64]) -> Capture {
        let photos = truth.iter().enumerate().map(|(i, factor)| {
            let place = [0.5 * i as f64 - 0.7, 0.3, 2.2];
            let shot = Shot { camera: place, light: place, light_intensity: [9.0; 3] };
            let lit = Shot { light_intensity: [9.0 * factor; 3], ..shot };
            Photo { shot, ..photo(maps, lit) }
        });
        Capture::new(photos.collect(), 2.0, Transfer::Linear).unwrap()
    }

    fn gains(capture: &Capture, maps: &Maps<f32>) -> Vec<f64> {
        let shots = refined(capture, maps, Refine::Light).unwrap();
        capture.photos().iter().zip(&shots).map(|(photo, shot)| gain(shot, &photo.shot)).collect()
    }

    #[test]
    fn other_light_is_found() {
        let maps = maps();
        let truth = [0.9f64, 1.2, 1.0, 0.95];
        let mean = truth.iter().map(|t| t.ln()).sum::<f64>() / 4.0;
        let capture = capture(&maps, &truth);
        let found = gains(&capture, &maps);
        for (found, truth) in found.iter().zip(truth) {
            assert!((found.ln() - (truth.ln() - mean)).abs() < 0.01, "{found} {truth}");
        }
        let lit = refined(&capture, &maps, Refine::Light).unwrap();
        assert_eq!(lit[1].camera, capture.photos()[1].shot.camera);
        assert_eq!(refined(&capture, &maps, Refine::None).unwrap()[1], capture.photos()[1].shot);
    }

    #[test]
    fn a_photo_that_the_maps_miss_says_little_of_its_light() {
        let maps = maps();
        let stated = capture(&maps, &[1.0]);
        // The share of the estimated light that is believed.
        let believed = |factor: &dyn Fn(usize) -> f32| {
            let mut photo = stated.photos()[0].clone();
            photo.image.data_mut().iter_mut().enumerate().for_each(|(i, value)| *value *= factor(i / 3));
            let (ratio, _) = code_ratio(&photo, &render_maps(&maps, 2.0, &photo.shot).unwrap());
            let log = log_gain(&photo, &photo.shot, 2.0, &maps).unwrap();
            assert!(log > 0.2, "{log}");
            log / (GAMMA * ratio.ln())
        };
        let (even, uneven) = (believed(&|_| 1.5), believed(&|pixel| 0.3 * (pixel * 5 % 11) as f32));
        assert!(even > 0.99 && uneven < 0.7, "{even} {uneven}");
    }

    #[test]
    fn right_light_few_photos_and_black_ones_change_nothing() {
        let maps = maps();
        assert!(gains(&capture(&maps, &[1.0; 4]), &maps).iter().all(|gain| (gain - 1.0).abs() < 1e-6));
        assert_eq!(gains(&capture(&maps, &[0.5, 1.0]), &maps), [1.0, 1.0]);
        let black = capture(&maps, &[0.0; 3]);
        assert!(gains(&black, &maps).iter().all(|gain| (gain - 1.0).abs() < 1e-9));
    }
}
