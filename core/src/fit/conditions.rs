//! Whether photos can be fitted at all as they are: too dark or too bright numbers, photos that show nothing, channels without light.

use std::borrow::Cow;

use crate::capture::{Capture, Photo};
use crate::deviations::Deviations;
use crate::error::Result;
use crate::image::Image;
use crate::maps::{DIFFUSE_PLANE, Maps, ROUGHNESS_PLANE};
use crate::memory::collected;
use crate::shot::Shot;

/// Radiance of a white matt surface within this factor of 1 is as photos have it; the fit's constants are made for that.
const USUAL: f64 = 4.0;
/// Share of a photo's pixels that may be saturated before that is worth a word.
const SATURATED: f64 = 0.5;
/// Diffuse albedos from here on are at their limit, and the share of pixels from which much of the patch is.
const AT_LIMIT: f32 = 0.985;
const AT_LIMIT_SHARE: f64 = 0.25;
/// Standard deviation of an albedo of which nothing is known but that it lies in [0, 1].
const UNKNOWN: f32 = 0.29;
/// Radiance, as a share of that of white, below which a pixel is black; and the specular albedo of a perfect mirror.
const BLACK: f64 = 0.008;
const MIRROR: f32 = 1.0;
const CHANNELS: [&str; 3] = ["red", "green", "blue"];

/// `capture` in numbers near 1: photos and light multiplied by one power of two. Which numbers stand for white is a matter of the camera.
///
/// # Errors
/// [`Error::OutOfMemory`](crate::Error::OutOfMemory).
pub(super) fn usual_exposure(capture: &Capture) -> Result<Cow<'_, Capture>> {
    let mut whites: Vec<f64> = capture.photos().iter().map(|photo| white(&photo.shot)).collect();
    whites.sort_by(f64::total_cmp);
    let white = whites[whites.len() / 2];
    if !(white.is_finite() && white > 0.0) || (1.0 / USUAL..=USUAL).contains(&white) {
        return Ok(Cow::Borrowed(capture));
    }
    let factor = (-white.log2().round()).exp2();
    let scaled = |photo: &Photo| -> Result<Photo> {
        let values = photo.image.data();
        let data = collected(values.len(), values.iter().map(|&value| (f64::from(value) * factor) as f32))?;
        Ok(Photo {
            name: photo.name.clone(),
            shot: Shot { light_intensity: photo.shot.light_intensity.map(|value| value * factor), ..photo.shot },
            image: Image::new(photo.image.width(), photo.image.height(), 3, data)?,
            saturated: photo.saturated.clone(),
        })
    };
    let photos = capture.photos().iter().map(scaled).collect::<Result<_>>()?;
    Ok(Cow::Owned(Capture::new(photos, capture.patch_size(), capture.transfer())?))
}

/// The radiance of a white matt surface in the middle of the patch, in its brightest channel.
fn white(shot: &Shot) -> f64 {
    let brightest = shot.light_intensity.into_iter().fold(0.0, f64::max);
    brightest * shot.fall_off([0.0; 2]) / std::f64::consts::PI
}

/// What should be said of the photos before the fit.
pub(super) fn warnings(capture: &Capture) -> Vec<String> {
    let mut warnings = Vec::new();
    for photo in capture.photos() {
        let name = &photo.name;
        let (low, high) = photo
            .image
            .data()
            .iter()
            .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &value| (low.min(value), high.max(value)));
        let full = photo.saturated.iter().filter(|&&channels| channels == 0b111).count();
        let share = full as f64 / photo.saturated.len() as f64;
        if high <= 0.0 {
            warnings.push(format!("{name}: is black; leave it out, or check its exposure"));
        } else if low == high && photo.saturated.len() > 1 {
            warnings.push(format!("{name}: every pixel has the value {low}; it shows no surface"));
        } else if share > SATURATED {
            warnings.push(format!(
                "{name}: {:.0} % of its pixels are saturated and say little; expose less",
                100.0 * share
            ));
        }
    }
    for channel in unlit(capture) {
        warnings.push(format!(
            "light_intensity: no photo has {} light; that channel of the albedos is taken from the others",
            CHANNELS[channel]
        ));
    }
    warnings
}

/// Channels in which no photo has light.
fn unlit(capture: &Capture) -> impl Iterator<Item = usize> + '_ {
    (0..3).filter(|&channel| capture.photos().iter().all(|photo| photo.shot.light_intensity[channel] == 0.0))
}

/// Albedos of channels without light become the mean of the others, and their deviations say that nothing is known of them.
pub(super) fn fill_unlit(capture: &Capture, maps: &mut Maps<f32>, deviations: Option<&mut Deviations>) {
    let unlit: Vec<usize> = unlit(capture).collect();
    if unlit.is_empty() {
        return;
    }
    let lit: Vec<usize> = (0..3).filter(|channel| !unlit.contains(channel)).collect();
    let pixels = maps.width() * maps.height();
    for first in [DIFFUSE_PLANE, maps.lobe().specular_plane()] {
        for p in 0..pixels {
            let mean = lit.iter().map(|channel| maps.plane(first + channel)[p]).sum::<f32>() / lit.len() as f32;
            unlit.iter().for_each(|channel| maps.data_mut()[(first + channel) * pixels + p] = mean);
        }
    }
    if let Some(deviations) = deviations {
        // A deviation is the root mean square over the three channels.
        let share = unlit.len() as f32 / 3.0;
        for image in [&mut deviations.diffuse_albedo, &mut deviations.specular_albedo] {
            for value in image.data_mut() {
                *value = ((1.0 - share) * *value * *value + share * UNKNOWN * UNKNOWN).sqrt();
            }
        }
    }
}

/// Which pixels are black in every photo. A surface that reflects nothing looks like that, and so does a mirror wherever no photo shows its highlight.
fn black(capture: &Capture) -> Vec<bool> {
    let limits: Vec<f32> = capture.photos().iter().map(|photo| (BLACK * white(&photo.shot)) as f32).collect();
    let dark = |p: usize| {
        let mut photos = capture.photos().iter().zip(&limits);
        photos.all(|(photo, limit)| photo.image.data()[3 * p..3 * p + 3].iter().all(|value| value < limit))
    };
    (0..capture.width() * capture.height()).map(dark).collect()
}

/// The share of pixels that are [`black`].
pub(super) fn black_share(capture: &Capture) -> f64 {
    let black = black(capture);
    black.iter().filter(|black| **black).count() as f64 / black.len() as f64
}

/// Where pixels are [`black`], the deviations of specular albedo and roughness reach to those of a mirror.
pub(super) fn doubt_black(capture: &Capture, maps: &Maps<f32>, deviations: &mut Deviations) {
    let first = maps.lobe().specular_plane();
    for (p, _) in black(capture).into_iter().enumerate().filter(|(_, black)| *black) {
        let specular = (0..3).map(|c| maps.plane(first + c)[p]).sum::<f32>() / 3.0;
        let roughness = (ROUGHNESS_PLANE..first).map(|plane| maps.plane(plane)[p]).fold(0.0, f32::max);
        let reach =
            |deviations: &mut Image, distance: f32| deviations.data_mut()[p] = deviations.data()[p].max(distance);
        reach(&mut deviations.specular_albedo, MIRROR - specular);
        reach(&mut deviations.roughness, roughness);
    }
}

/// Whether the diffuse albedo is at its limit of 1 in much of the patch.
pub(super) fn at_limit(maps: &Maps<f32>) -> bool {
    let pixels = maps.width() * maps.height();
    let at_limit = |p: &usize| (0..3).any(|c| maps.plane(DIFFUSE_PLANE + c)[*p] >= AT_LIMIT);
    (0..pixels).filter(at_limit).count() as f64 > AT_LIMIT_SHARE * pixels as f64
}

#[cfg(test)]
mod tests {
    use std::borrow::Cow;

    use super::{MIRROR, UNKNOWN, at_limit, black_share, doubt_black, fill_unlit, usual_exposure, warnings, white};
    use crate::capture::{Capture, Photo};
    use crate::color::Transfer;
    use crate::deviations::Deviations;
    use crate::image::Image;
    use crate::maps::{Lobe, Maps};
    use crate::shot::Shot;

    fn photo(name: &str, intensity: [f64; 3], values: [f32; 4]) -> Photo {
        let shot = Shot { camera: [0.0, 0.0, 2.0], light: [0.0, 0.0, 2.0], light_intensity: intensity };
        let data = values.iter().flat_map(|&value| [value; 3]).collect();
        Photo { name: name.into(), shot, image: Image::new(2, 2, 3, data).unwrap(), saturated: vec![0; 4] }
    }

    fn capture(photos: Vec<Photo>) -> Capture {
        Capture::new(photos, 2.0, Transfer::Linear).unwrap()
    }

    #[test]
    fn numbers_far_from_one_are_scaled_with_their_light() {
        let near = capture(vec![photo("a", [12.0; 3], [0.1, 0.2, 0.3, 0.4])]);
        assert!(matches!(usual_exposure(&near).unwrap(), Cow::Borrowed(_)));
        for factor in [1e-6, 1e-3, 30.0, 1e5] {
            let values = [0.1, 0.2, 0.3, 0.4].map(|value: f64| (value * factor) as f32);
            let far = capture(vec![photo("a", [12.0 * factor; 3], values)]);
            let usual = usual_exposure(&far).unwrap();
            let (usual, far) = (&usual.photos()[0], &far.photos()[0]);
            assert!((0.7..1.5).contains(&white(&usual.shot)), "{factor}: {}", white(&usual.shot));
            let ratio = usual.shot.light_intensity[1] / far.shot.light_intensity[1];
            for (usual, far) in usual.image.data().iter().zip(far.image.data()) {
                assert_eq!(f64::from(*usual), f64::from(*far) * ratio, "a power of two rounds nothing");
            }
        }
    }

    #[test]
    fn what_photos_lack_is_said() {
        let fine = photo("fine.png", [9.0, 9.0, 0.0], [0.1, 0.2, 0.3, 0.4]);
        let mut bright = photo("bright.png", [9.0, 9.0, 0.0], [1.0, 1.0, 1.0, 0.4]);
        bright.saturated = vec![7, 7, 7, 0];
        let black = photo("black.png", [9.0, 9.0, 0.0], [0.0; 4]);
        let flat = photo("flat.png", [9.0, 9.0, 0.0], [0.25; 4]);
        let said = warnings(&capture(vec![fine.clone(), bright, black, flat]));
        let begins = [
            "bright.png: 75 % of its pixels are saturated",
            "black.png: is black",
            "flat.png: every pixel has",
            "light_intensity: no photo has blue",
        ];
        assert_eq!(said.len(), begins.len(), "{said:?}");
        for (said, begin) in said.iter().zip(begins) {
            assert!(said.starts_with(begin), "{said}");
        }
        let lit = photo("lit.png", [9.0; 3], [0.1, 0.2, 0.3, 0.4]);
        assert_eq!(warnings(&capture(vec![fine, lit])), Vec::<String>::new());
    }

    #[test]
    fn a_channel_without_light_is_that_of_the_others_and_unsure() {
        let dark = capture(vec![photo("a", [9.0, 9.0, 0.0], [0.1, 0.2, 0.3, 0.4])]);
        let mut maps = Maps::new(Lobe::Isotropic, 2, 2, vec![0.5; 40]).unwrap();
        maps.data_mut()[..4].fill(0.1);
        let image = || Image::new(2, 2, 1, vec![0.01; 4]).unwrap();
        let mut deviations =
            Deviations { diffuse_albedo: image(), specular_albedo: image(), roughness: image(), normal: image() };
        fill_unlit(&dark, &mut maps, Some(&mut deviations));
        assert_eq!((maps.plane(2)[3], maps.plane(9)[0]), (0.3, 0.5));
        assert!((deviations.diffuse_albedo.data()[0] - UNKNOWN / 3f32.sqrt()).abs() < 1e-3);
        assert_eq!(deviations.roughness.data()[0], 0.01);
        assert!(!at_limit(&maps));
        maps.data_mut()[..4].fill(1.0);
        assert!(at_limit(&maps));
    }
    #[test]
    fn what_is_black_in_every_photo_may_be_a_mirror() {
        // White reads 12 / (4 pi).
        let photos = [[0.0, 0.001, 0.3, 0.0], [0.0, 0.002, 0.0, 0.5]].map(|values| photo("a", [12.0; 3], values));
        let capture = capture(photos.to_vec());
        assert_eq!(black_share(&capture), 0.5);
        let maps = Maps::new(Lobe::Isotropic, 2, 2, vec![0.25; 40]).unwrap();
        let image = || Image::new(2, 2, 1, vec![0.01; 4]).unwrap();
        let mut deviations =
            Deviations { diffuse_albedo: image(), specular_albedo: image(), roughness: image(), normal: image() };
        doubt_black(&capture, &maps, &mut deviations);
        assert_eq!(deviations.specular_albedo.data(), [MIRROR - 0.25, MIRROR - 0.25, 0.01, 0.01]);
        assert_eq!(deviations.roughness.data(), [0.25, 0.25, 0.01, 0.01]);
        assert_eq!((deviations.diffuse_albedo, deviations.normal), (image(), image()));
    }
}
