//! One photo without a capture: what is assumed of it.
//!
//! The whole photo is the patch, 2 wide on its shorter side, taken from straight above with the flash at the lens.

use serde::Serialize;

use super::Shot;
use crate::image::Image;
use crate::io::CameraData;
use crate::material::Material;

/// Width of the patch on the photo's shorter side.
const SHORTER_SIDE: f64 = 2.0;
/// Field of view across the shorter side where the file does not tell: that of telephones' main cameras.
const FIELD_OF_VIEW_DEG: f64 = 50.0;
/// The diffuse albedo that all but a hundredth of the pixels stay below.
pub(crate) const BRIGHTEST_ALBEDO: f64 = 0.9;
const BRIGHTEST_SHARE: f64 = 0.99;
/// The most by which a fit corrects the first guess of the light.
const MAX_CORRECTION: f64 = 1000.0;

/// What was assumed of a photo that came without a capture. The patch is the whole photo, 2 wide on its shorter side; camera and light are above its centre.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Assumed {
    /// Field of view across the photo's shorter side, in degrees.
    pub field_of_view_deg: f64,
    /// Whether the photo's EXIF data say so; else it is a usual one.
    pub field_of_view_is_from_exif: bool,
    /// Distance of camera and light from the patch, where the shorter side is 2.
    pub distance: f64,
    /// Intensity of the light.
    pub light_intensity: [f64; 3],
    /// Whether the light is chosen such that 99 % of the diffuse albedos are at most 0.9; else it was stated.
    pub light_is_chosen: bool,
}

impl Assumed {
    /// For a photo of `width` x `height` pixels, under light of `light_intensity` or one that [`Assumed::with_light_of`] is to choose.
    pub(super) fn new(width: usize, height: usize, camera: &CameraData, light_intensity: Option<[f64; 3]>) -> Self {
        let shorter = width.min(height) as f64;
        let focal_length = camera.focal_length_in_pixels(width, height);
        let half_angle = match focal_length {
            Some(focal_length) => (shorter / 2.0 / focal_length).atan(),
            None => FIELD_OF_VIEW_DEG.to_radians() / 2.0,
        };
        let distance = SHORTER_SIDE / 2.0 / half_angle.tan();
        Self {
            field_of_view_deg: 2.0 * half_angle.to_degrees(),
            field_of_view_is_from_exif: focal_length.is_some(),
            distance,
            // White in the middle of the patch.
            light_intensity: light_intensity.unwrap_or([std::f64::consts::PI * distance * distance; 3]),
            light_is_chosen: light_intensity.is_none(),
        }
    }

    /// Width of the patch of a photo of `width` x `height` pixels.
    pub(super) fn patch_size(width: usize, height: usize) -> f64 {
        SHORTER_SIDE * width as f64 / width.min(height) as f64
    }

    pub(super) fn shot(&self) -> Shot {
        let place = [0.0, 0.0, self.distance];
        Shot { camera: place, light: place, light_intensity: self.light_intensity }
    }

    /// With a first guess of the light, if it is to be chosen: as if the whole of `photo` were matt.
    pub(super) fn with_light_of(self, photo: &Image) -> Self {
        let (width, height) = (photo.width(), photo.height());
        let pitch = Self::patch_size(width, height) / width as f64;
        let along = |pixel: usize, pixels: usize| (pixel as f64 + 0.5 - pixels as f64 / 2.0) * pitch;
        let shot = self.shot();
        let irradiance = |p: usize| shot.fall_off([along(p % width, width), along(p / width, height)]);
        let needed = brightest(photo, |p| std::f64::consts::PI / irradiance(p)) / BRIGHTEST_ALBEDO;
        if self.light_is_chosen && needed > 0.0 { Self { light_intensity: [needed; 3], ..self } } else { self }
    }

    /// With the light that `material`, fitted under this one, calls for.
    pub(crate) fn with_light_for(self, material: &Material) -> Self {
        let factor = brightest(&material.diffuse_albedo, |_| 1.0) / BRIGHTEST_ALBEDO;
        if !self.light_is_chosen || factor <= 0.0 {
            return self;
        }
        let factor = factor.clamp(1.0 / MAX_CORRECTION, MAX_CORRECTION);
        Self { light_intensity: self.light_intensity.map(|value| value * factor), ..self }
    }

    /// What is to be said of the photo before a fit.
    pub(super) fn notes(&self, flash_fired: Option<bool>) -> Vec<String> {
        let mut notes = vec![format!(
            "one photo without a capture: assumed are a flat patch seen from straight above, a flash at the lens and {}",
            self.field_of_view()
        )];
        if self.light_is_chosen {
            notes.push(format!(
                "the light is assumed to be such that 99 % of the diffuse albedos are at most {BRIGHTEST_ALBEDO}; light_intensity states another"
            ));
        }
        if flash_fired == Some(false) {
            notes.push("its EXIF data say that the flash did not fire: take it with the flash on".to_owned());
        }
        notes
    }

    /// What a verdict says of it.
    pub(crate) fn summary(&self) -> String {
        let [red, green, blue] = self.light_intensity;
        let light =
            if red == green && green == blue { format!("{red:.4}") } else { format!("{:.4?}", [red, green, blue]) };
        let chosen = if self.light_is_chosen { "chosen by its brightness" } else { "stated" };
        format!(
            "where camera and light stood is assumed: straight above at {:.3}, where the shorter side is {SHORTER_SIDE} ({}); light intensity {light}, {chosen}",
            self.distance,
            self.field_of_view()
        )
    }

    fn field_of_view(&self) -> String {
        let source = if self.field_of_view_is_from_exif { ", as EXIF says" } else { "" };
        format!("{:.1} degrees across the shorter side{source}", self.field_of_view_deg)
    }
}

/// The value that the brightest channel, times a factor of the pixel, exceeds in a hundredth of the pixels.
pub(crate) fn brightest(image: &Image, factor: impl Fn(usize) -> f64) -> f64 {
    let mut values: Vec<f64> = image
        .data()
        .chunks_exact(image.channels())
        .enumerate()
        .map(|(p, channels)| f64::from(channels.iter().copied().fold(0.0, f32::max)) * factor(p))
        .collect();
    let at = ((values.len() - 1) as f64 * BRIGHTEST_SHARE) as usize;
    *values.select_nth_unstable_by(at, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::Capture;
    use crate::maps::{Lobe, Maps};
    use crate::render::render_maps;

    #[test]
    fn the_patch_is_2_on_its_shorter_side() {
        assert_eq!(Assumed::patch_size(300, 300), 2.0);
        assert_eq!(Assumed::patch_size(300, 200), 3.0);
        assert_eq!(Assumed::patch_size(200, 300), 2.0);
        let assumed = Assumed::new(300, 200, &CameraData::default(), None);
        // Half of the shorter side under half of 50 degrees.
        assert!((1.0 / assumed.distance - 25f64.to_radians().tan()).abs() < 1e-12);
        assert!(!assumed.field_of_view_is_from_exif && assumed.light_is_chosen);
    }

    /// A matt surface, rendered under known light: the first guess is that light.
    #[test]
    fn the_light_of_a_matt_surface_is_found() {
        const SIDE: usize = 20;
        let mut maps = Maps::new(Lobe::Isotropic, SIDE, SIDE, vec![0.0; 10 * SIDE * SIDE]).unwrap();
        for (i, value) in maps.data_mut().iter_mut().enumerate() {
            // Red is the brightest channel.
            *value = [0.9, 0.5, 0.2, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0][i / (SIDE * SIDE)];
        }
        let stated = Assumed::new(SIDE, SIDE, &CameraData::default(), Some([17.0; 3]));
        let planes = render_maps(&maps, 2.0, &stated.shot()).unwrap();
        let photo = Image::from_planar(SIDE, SIDE, 3, &planes).unwrap();
        let assumed = Assumed::new(SIDE, SIDE, &CameraData::default(), None).with_light_of(&photo);
        assert!((assumed.light_intensity[0] / 17.0 - 1.0).abs() < 1e-3, "{assumed:?}");
        assert_eq!(stated.with_light_of(&photo), stated);
        let black = Image::new(2, 2, 3, vec![0.0; 12]).unwrap();
        assert!(assumed.with_light_of(&black).light_intensity[0] > 0.0);
    }

    #[test]
    fn a_material_that_is_too_bright_asks_for_more_light() {
        let assumed = Assumed::new(4, 4, &CameraData::default(), None);
        let maps = Maps::new(Lobe::Isotropic, 4, 4, vec![0.45; 160]).unwrap();
        let material = Material::from_maps(&maps, 2.0).unwrap();
        let corrected = assumed.with_light_for(&material);
        assert!((corrected.light_intensity[1] / assumed.light_intensity[1] - 0.5).abs() < 1e-6, "{corrected:?}");
        let stated = Assumed::new(4, 4, &CameraData::default(), Some([1.0, 2.0, 3.0]));
        assert_eq!(stated.with_light_for(&material), stated);
        assert!(stated.summary().contains("[1.0000, 2.0000, 3.0000], stated"), "{}", stated.summary());
    }

    #[test]
    fn notes_say_what_is_assumed() {
        let assumed = Assumed::new(4, 4, &CameraData::default(), None);
        let notes = assumed.notes(Some(false));
        assert_eq!(notes.len(), 3);
        assert!(notes[0].contains("50.0 degrees across the shorter side") && notes[2].contains("did not fire"));
        assert_eq!(Assumed { light_is_chosen: false, ..assumed }.notes(Some(true)).len(), 1);
    }

    /// What is read of a photo is what [`Capture::with_assumed`] makes of it under other light.
    #[test]
    fn another_light_stays_assumed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("photo.png");
        let image = Image::new(6, 4, 3, vec![0.3; 72]).unwrap();
        crate::io::write_image(&path, &image, crate::Transfer::Srgb).unwrap();
        let capture = Capture::open(&path).unwrap();
        let assumed = *capture.assumed().unwrap();
        let brighter = Assumed { light_intensity: assumed.light_intensity.map(|value| 2.0 * value), ..assumed };
        let relit = capture.with_assumed(brighter).unwrap();
        assert_eq!(relit.assumed(), Some(&brighter));
        assert_eq!(relit.photos()[0].shot, brighter.shot());
        assert_eq!(relit.photos()[0].image, capture.photos()[0].image);
        assert_eq!(relit.patch_size(), 3.0);
    }
}
