//! Photos that contradict the others: black ones, ones of another material, ones whose positions were swapped. One of them spoils the maps.
//!
//! On a part of the pixels the photos are fitted with and without single ones. Where a photo fits the others, leaving it out changes the
//! error of the rest little; where it does not, the error falls to a fraction, because the maps need no longer explain both. A small highlight that only one photo
//! shows is no contradiction, and neither is one that only a stretched lobe explains.
//!
//! Not from the paper.

use crate::capture::{Capture, Photo};
use crate::error::Result;
use crate::fit::direct::{Relief, fit_direct};
use crate::fit::optim::holdout::thinned;
use crate::fit::options::{FitOptions, Reflectance};
use crate::progress::Control;
use crate::render::{encode_all, render_maps};

/// Pixels along the longer side, and steps, of the fits that compare.
const SIDE: usize = 32;
const STEPS: usize = 100;
/// Photos that have to stay: fewer cannot outvote another one.
const PHOTOS_MIN: usize = 3;
/// Photos left out at most, as a share of all.
const SHARE_MAX: f64 = 0.34;
/// Only photos whose error is this many times the median are tried, the worst of them: what contradicts is explained worst.
const SUSPECT: f64 = 1.2;
const TRIED: usize = 4;
/// The error of the rest has to fall below this part of what it was, for each photo left out. Captures without such photos keep more than
/// three quarters.
const FALL: f64 = 0.5;
/// Root mean squared error of gamma 2.2 codes below which photos do not contradict each other.
const ERROR_MIN: f64 = 0.02;
/// Share of a photo's pixels, those that are missed most, that do not count: a highlight of a smooth surface, which no other photo shows.
const HIGHLIGHT: f64 = 0.05;

/// The photos of `capture` that contradict the others, in ascending order.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled); [`Error::NonFinite`](crate::Error::NonFinite) if the photos' loss is not finite.
pub(super) fn contradicting(capture: &Capture, options: &FitOptions, control: &mut Control<'_>) -> Result<Vec<usize>> {
    let most = ((capture.len() as f64 * SHARE_MAX) as usize).min(capture.len().saturating_sub(PHOTOS_MIN));
    if most == 0 {
        return Ok(Vec::new());
    }
    let (capture, _) = thinned(capture, SIDE)?;
    let options = FitOptions { direct_steps: Some(STEPS), ..options.clone() };
    let mut left_out = Vec::new();
    let mut accepted = 0;
    // `whole` is the error with all photos that are not left out for good.
    let (mut whole, mut each) = errors(&capture, &options, control)?;
    while left_out.len() < most && whole > ERROR_MIN {
        let rest: Vec<usize> = (0..capture.len()).filter(|photo| !left_out.contains(photo)).collect();
        let mut worst: Vec<usize> = (0..rest.len()).collect();
        worst.sort_by(|&a, &b| each[b].total_cmp(&each[a]));
        let median = each[worst[worst.len() / 2]];
        worst.retain(|&place| each[place] > SUSPECT * median);
        worst.truncate(TRIED);
        let tried = control.each(&worst, |&place, control| {
            let without: Vec<usize> = rest.iter().copied().filter(|&photo| photo != rest[place]).collect();
            let (error, errors) = errors(&capture.select(&without)?, &options, control)?;
            Ok((error, errors, rest[place]))
        })?;
        // The first of those with the least error.
        let Some((error, errors, photo)) = tried.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
        tracing::debug!("without {}: error {error:.4} instead of {whole:.4}", capture.photos()[photo].name);
        left_out.push(photo);
        each = errors;
        if error < FALL.powi((left_out.len() - accepted) as i32) * whole {
            (accepted, whole) = (left_out.len(), error);
        }
    }
    left_out.truncate(accepted);
    left_out.sort_unstable();
    if !left_out.is_empty() && options.reflectance == Reflectance::Auto {
        let (stretched, _) = errors(&capture, &options.reflectance(Reflectance::Anisotropic), control)?;
        tracing::debug!("all photos with a stretched lobe: error {stretched:.4}");
        if FALL * stretched < whole {
            left_out.clear();
        }
    }
    Ok(left_out)
}

/// How far a fit is from the photos, as a root mean square of gamma 2.2 codes: from all, and from each.
fn errors(capture: &Capture, options: &FitOptions, control: &mut Control<'_>) -> Result<(f64, Vec<f64>)> {
    control.poll()?;
    let fit = |control: &mut Control<'_>| fit_direct(capture, Relief::Flat, options, &mut Vec::new(), control);
    let (direct, _) = Control::silently(options.cancel.clone(), fit)?;
    let error = |(photo, shot)| missed(photo, render_maps(&direct.maps, capture.patch_size(), shot)?);
    let each = capture.photos().iter().zip(&direct.shots).map(error).collect::<Result<Vec<f64>>>()?;
    let mean = each.iter().map(|error| error * error).sum::<f64>() / each.len() as f64;
    Ok((mean.sqrt(), each))
}

/// The root mean squared error of the codes of `rendering`, three planes of radiance, without the pixels that are missed most.
fn missed(photo: &Photo, mut rendering: Vec<f32>) -> Result<f64> {
    let mut seen = photo.image.to_planar()?;
    encode_all(&mut seen);
    encode_all(&mut rendering);
    let pixels = photo.saturated.len();
    let square = |pixel: usize| -> f64 {
        let of_channel = |c: usize| {
            let off = f64::from(rendering[c * pixels + pixel] - seen[c * pixels + pixel]);
            // Where the photo is saturated, brighter is right.
            if photo.saturated[pixel] >> c & 1 == 1 { off.min(0.0) } else { off }
        };
        (0..3).map(|c| of_channel(c).powi(2)).sum::<f64>() / 3.0
    };
    let mut squares: Vec<f64> = (0..pixels).map(square).collect();
    squares.sort_by(f64::total_cmp);
    squares.truncate(pixels - (pixels as f64 * HIGHLIGHT) as usize);
    Ok((squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::contradicting;
    use crate::cancel::CancelToken;
    use crate::capture::{Capture, Photo};
    use crate::color::Transfer;
    use crate::fit::options::FitOptions;
    use crate::fit::testing::photo;
    use crate::image::Image;
    use crate::maps::{Lobe, Maps};
    use crate::progress::{Control, Progress};
    use crate::shot::Shot;

    const SIDE: usize = 16;
    const PIXELS: usize = SIDE * SIDE;

    /// Photos of two materials side by side from seven places, the light a few per cent off what is stated.
    fn photos() -> Vec<Photo> {
        let mut maps = Maps::new(Lobe::Isotropic, SIDE, SIDE, vec![0.0; 10 * PIXELS]).unwrap();
        let mut random = fastrand::Rng::with_seed(5);
        for (i, value) in maps.data_mut().iter_mut().enumerate() {
            let left = i % SIDE < SIDE / 2;
            *value = match i / PIXELS {
                plane @ ..3 => (if left { 0.1 } else { 0.5 }) + 0.05 * plane as f32 + 0.1 * random.f32(),
                3 | 4 => 0.1 * (random.f32() - 0.5),
                5 => 1.0,
                6 => {
                    if left {
                        0.3
                    } else {
                        0.6
                    }
                }
                _ => 0.05,
            };
        }
        let shown = |i: usize| {
            let angle = i as f64 * 2.4;
            let place = [0.35 * i as f64 * angle.cos(), 0.35 * i as f64 * angle.sin(), 2.4];
            let shot = Shot { camera: place, light: place, light_intensity: [14.0; 3] };
            let lit = Shot { light_intensity: [14.0 * (1.0 + 0.04 * (i as f64 * 1.7).sin()); 3], ..shot };
            Photo { shot, ..photo(&maps, lit) }
        };
        (0..7).map(shown).collect()
    }

    fn found(photos: Vec<Photo>) -> Vec<usize> {
        let capture = Capture::new(photos, 2.0, Transfer::Linear).unwrap();
        let mut callback = |_: &Progress| ControlFlow::Continue(());
        contradicting(&capture, &FitOptions::default(), &mut Control::new(&mut callback, CancelToken::new())).unwrap()
    }

    fn scaled(photo: &Photo, factor: f32) -> Image {
        Image::new(SIDE, SIDE, 3, photo.image.data().iter().map(|value| value * factor).collect()).unwrap()
    }

    #[test]
    fn photos_of_one_surface_do_not_contradict() {
        assert_eq!(found(photos()), Vec::<usize>::new());
        // Three photos cannot be told which of them is right.
        let mut three = photos().split_off(4);
        three[0].image = scaled(&three[0], 0.0);
        assert_eq!(found(three), Vec::<usize>::new());
    }

    /// Photos of one even surface from these places.
    fn photos_of(diffuse: f32, specular: f32, roughness: [f32; 2], places: &[[f64; 3]]) -> Vec<Photo> {
        let lobe = if roughness[0] == roughness[1] { Lobe::Isotropic } else { Lobe::Anisotropic };
        let mut maps = Maps::new(lobe, SIDE, SIDE, vec![0.0; lobe.planes() * PIXELS]).unwrap();
        let first = lobe.specular_plane();
        for (i, value) in maps.data_mut().iter_mut().enumerate() {
            *value = match i / PIXELS {
                ..3 => diffuse,
                5 => 1.0,
                6 => roughness[0],
                7 if lobe == Lobe::Anisotropic => roughness[1],
                plane if (first..first + 3).contains(&plane) => specular,
                plane => f32::from(u8::from(plane == first + 3)),
            };
        }
        let shots = places.iter().map(|&place| Shot { camera: place, light: place, light_intensity: [60.0; 3] });
        shots.map(|shot| photo(&maps, shot)).collect()
    }

    #[test]
    fn highlights_do_not_contradict() {
        let places = [[0.1, 0.0, 2.4], [0.4, 0.3, 2.4], [-0.5, 0.6, 2.4], [0.2, -0.9, 2.4]];
        let mirror = photos_of(0.02, 0.9, [0.1; 2], &places);
        assert_eq!(found(mirror), Vec::<usize>::new());
        let places = [[0.12, -0.06, 4.4], [1.8, 1.0, 4.4], [-1.6, 1.2, 4.6], [0.2, -2.0, 4.2]];
        let mut brushed = photos_of(0.0, 0.8, [0.22, 0.63], &places);
        for photo in &mut brushed {
            let clipped = |value: &f32| u8::from(*value >= 1.0);
            photo.saturated = photo.image.data().chunks_exact(3).map(|rgb| 7 * clipped(&rgb[0])).collect();
            photo.image.data_mut().iter_mut().for_each(|value| *value = value.min(1.0));
        }
        assert_eq!(found(brushed), Vec::<usize>::new());
    }

    #[test]
    fn a_black_a_bright_and_a_foreign_photo_contradict() {
        for (place, factor) in [(2, 0.0), (5, 1000.0)] {
            let mut photos = photos();
            photos[place].image = scaled(&photos[place], factor);
            assert_eq!(found(photos), [place]);
        }
        let mut foreign = photos();
        let turned = foreign[3].image.data().chunks_exact(3).rev().flatten().copied().collect();
        foreign[3].image = Image::new(SIDE, SIDE, 3, turned).unwrap();
        assert_eq!(found(foreign), [3]);
    }

    #[test]
    fn both_of_two_swapped_photos_contradict() {
        let mut photos = photos();
        let (first, second) = (photos[2].shot, photos[6].shot);
        (photos[2].shot, photos[6].shot) = (second, first);
        assert_eq!(found(photos), [2, 6]);
    }
}
