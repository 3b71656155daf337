//! What is assumed of photos without a sheet.
//!
//! The patch's corners tell where the camera stood, and together the focal length where EXIF data have none. Nothing tells how bright the light was: it is as bright in every photo, or
//! as exposures say, and such that 99 % of the diffuse albedos are at most 0.9, as for one photo alone ([`Assumed`](crate::capture::Assumed)).

use std::f64::consts::PI;

use super::AcquireOptions;
use super::pipeline::Placed;
use super::report::LensReport;
use crate::capture::{BRIGHTEST_ALBEDO, brightest};
use crate::error::Result;
use crate::image::Image;
use crate::memory;
use crate::shot::Shot;

/// Deviation of the focal length's logarithm from which on photos do not tell it.
const FOCAL_LENGTH_UNSURE: f64 = 0.05;

/// Exposures of photos as shares of the first one's: by EXIF data where all have them, else all the same.
pub fn exposures(photos: &[Placed]) -> (Vec<f64>, bool) {
    let stated: Option<Vec<f64>> = photos.iter().map(|photo| photo.sighting.camera.exposure).collect();
    match stated {
        Some(stated) => (stated.iter().map(|exposure| exposure / stated[0]).collect(), true),
        None => (vec![1.0; photos.len()], false),
    }
}

/// The intensity of a light of exposure 1, from rectified photos and their saturation: as if the surface were matt, of every pixel in the median photo (the darker of two), so
/// that highlights of single photos do not count.
pub fn intensity(photos: &[(&Image, &[u8], Shot, f64)], width: f64) -> Result<f64> {
    let side = photos[0].0.width();
    let pitch = width / side as f64;
    let albedo = |p: usize, c: usize| {
        let (x, y) = ((p % side) as f64 + 0.5, (p / side) as f64 + 0.5);
        let at = [x * pitch - width / 2.0, width / 2.0 - y * pitch];
        let one = |&(image, saturated, shot, exposure): &(&Image, &[u8], Shot, f64)| {
            let irradiance = exposure * shot.fall_off(at);
            (saturated[p] >> c & 1 == 1, f64::from(image.data()[3 * p + c]) * PI / irradiance)
        };
        let mut all: Vec<(bool, f64)> = photos.iter().map(one).collect();
        // What is saturated is brighter than it looks.
        all.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        all[(all.len() - 1) / 2].1
    };
    let values = (0..3 * side * side).map(|i| albedo(i / 3, i % 3) as f32);
    let matt = Image::new(side, side, 3, memory::collected(3 * side * side, values)?)?;
    let needed = brightest(&matt, |_| 1.0) / BRIGHTEST_ALBEDO;
    Ok(if needed > 0.0 { needed } else { PI * photos[0].2.light[2].powi(2) })
}

/// What is assumed of such photos.
pub fn assumptions(lenses: &[LensReport], exposures_known: bool, options: &AcquireOptions) -> Vec<String> {
    let mut said = vec!["the patch is a flat square, whose corners are those given".to_owned()];
    for lens in lenses {
        let f = lens.focal_length;
        let text = match lens.focal_length_from_exif {
            Some(exif) => format!("the focal length is {f:.0} pixels, near the {exif:.0} of the EXIF data"),
            None if lens.focal_length_deviation <= FOCAL_LENGTH_UNSURE => {
                let known = 100.0 * lens.focal_length_deviation;
                format!(
                    "the focal length is {f:.0} pixels, from the corners of all photos, to some {known:.1} %: no EXIF data tell it"
                )
            }
            None => format!(
                "the focal length is {f:.0} pixels, a usual one: no EXIF data tell it, and corners only in photos that lean"
            ),
        };
        said.push(text);
    }
    let [right, up] = options.light_offset.unwrap_or_default();
    said.push(match [right, up] {
        [0.0, 0.0] => "the flash is at the lens".to_owned(),
        _ => format!("the flash is {right} mm right and {up} mm up of the lens, as stated"),
    });
    let bright =
        if exposures_known { "as bright in every photo as its exposure says" } else { "as bright in every photo" };
    said.push(format!(
        "the light is {bright}, and such that 99 % of the diffuse albedos are at most {BRIGHTEST_ALBEDO}; its beam, the lens's fall-off and the tone curve (sRGB) are not corrected"
    ));
    said
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A matt surface of albedo 0.9 and 0.45: its light is found, past a highlight and what is saturated.
    #[test]
    fn light_is_such_that_albedos_end_at_nine_tenths() {
        const SIDE: usize = 16;
        let width = 100.0;
        let photo = |k: usize| {
            let place = [40.0 * k as f64 - 40.0, 10.0, 250.0];
            let exposure = [1.0, 0.5, 0.8][k];
            let shot = Shot { camera: place, light: place, light_intensity: [1.0; 3] };
            let value = |i: usize| {
                let (p, c) = (i / 3, i % 3);
                let at = |i: usize| (i as f64 + 0.5) / SIDE as f64 * width - width / 2.0;
                let (x, y) = (place[0] - at(p % SIDE), place[1] + at(p / SIDE));
                let albedo = if c == 1 { 0.9 } else { 0.45 };
                let highlight = if p % SIDE / 4 == k { 3.0 } else { 0.0 };
                let d2 = x * x + y * y + place[2] * place[2];
                (exposure * 50_000.0 * (albedo / PI * place[2] / (d2 * d2.sqrt())) * (1.0 + highlight)) as f32
            };
            let image = Image::new(SIDE, SIDE, 3, (0..3 * SIDE * SIDE).map(value).collect()).unwrap();
            let mut saturated = vec![0u8; SIDE * SIDE];
            for (p, bits) in saturated.iter_mut().enumerate().filter(|(p, _)| k == 2 && p % SIDE / 4 == k) {
                *bits = if p % 2 == 0 { 7 } else { 2 };
            }
            (image, saturated, shot, exposure)
        };
        let photos: Vec<_> = (0..3).map(photo).collect();
        let lent: Vec<(&Image, &[u8], Shot, f64)> =
            photos.iter().map(|(image, saturated, shot, exposure)| (image, &saturated[..], *shot, *exposure)).collect();
        let found = intensity(&lent, width).unwrap();
        assert!((found / 50_000.0 - 1.0).abs() < 1e-3, "{found}");
        let black = Image::new(2, 2, 3, vec![0.0; 12]).unwrap();
        let dark = intensity(&[(&black, &[0; 4], lent[0].2, 1.0)], width).unwrap();
        assert!(dark > 0.0 && dark.is_finite());
    }
}
