//! EXIF data: which way up a photo is, its colours, and how it was taken.
//!
//! # Source
//! CIPA DC-008, "Exchangeable image file format for digital still cameras: Exif", version 2.32.

use image::metadata::Orientation;

use super::profile::FileColors;
use super::tiff::{Directory, File, tag};
use crate::color::Chromaticities;

/// Diagonal of a frame of 35 mm film, in millimetres.
const FILM_DIAGONAL: f64 = 43.266_615_305_567_87;
/// Fields of view across the diagonal that lenses have, in degrees; what says something else is not believed.
const FIELD_OF_VIEW: std::ops::Range<f64> = 3.0..150.0;

/// What is taken from EXIF data.
#[derive(Default)]
pub(super) struct Exif {
    pub orientation: Option<Orientation>,
    /// Cameras name Adobe RGB there, often without a profile.
    pub colors: Option<FileColors>,
    pub camera: CameraData,
}

/// How a photo was taken, as its camera wrote it down.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct CameraData {
    /// Columns and rows that the camera wrote; a cropped or scaled photo has others.
    pixels: Option<[u64; 2]>,
    /// Focal length that gives the same picture on a frame of 35 mm film, in millimetres.
    focal_length_35mm: Option<f64>,
    /// Focal length in millimetres.
    focal_length: Option<f64>,
    /// Pixels per millimetre in the focal plane.
    focal_plane_resolution: Option<f64>,
    /// Exposure time in seconds, times the sensitivity, over the square of the f-number.
    pub exposure: Option<f64>,
    /// Whether the flash fired.
    pub flash_fired: Option<bool>,
    /// The orientation tag by which the picture was turned or mirrored, 2 to 8; `None` if it is as the camera took it.
    pub orientation: Option<u8>,
}

impl Exif {
    /// From the bytes of EXIF data.
    pub fn read(exif: &[u8]) -> Self {
        let Some((file, first)) = File::open(exif) else { return Self::default() };
        file.directory(first).map(|main| Self::of(&main)).unwrap_or_default()
    }

    /// From the main directory.
    pub fn of(main: &Directory<'_>) -> Self {
        let photo = main.below(tag::EXIF_DIRECTORY);
        // DCF 2.0: the colour space is "uncalibrated" and the index of interoperability R03; some cameras write 2.
        let color_space = photo.as_ref().and_then(|photo| photo.number(tag::EXIF_COLOR_SPACE));
        let index = photo.as_ref().and_then(|photo| photo.below(tag::INTEROPERABILITY_DIRECTORY));
        let is_r03 = index.and_then(|index| index.bytes(1)).is_some_and(|index| index.starts_with(b"R03"));
        let is_adobe_rgb = color_space == Some(2) || color_space == Some(0xffff) && is_r03;
        let adobe_rgb = FileColors::Chromaticities {
            chromaticities: Chromaticities::ADOBE_RGB,
            gamma: Some(563.0 / 256.0),
            source: "Adobe RGB, which its EXIF data name",
        };
        let camera = photo.as_ref().map(CameraData::of).unwrap_or_default();
        Self { orientation: main.orientation(), colors: is_adobe_rgb.then_some(adobe_rgb), camera }
    }
}

impl CameraData {
    fn of(photo: &Directory<'_>) -> Self {
        let positive = |value: f64| (value.is_finite() && value > 0.0).then_some(value);
        let fraction = |tag| photo.fractions(tag).and_then(|values| positive(*values.first()?));
        let whole = |tag| photo.number(tag).and_then(|value| positive(value as f64));
        let unit = match photo.number(tag::FOCAL_PLANE_RESOLUTION_UNIT) {
            Some(3) => 10.0,
            // The standard's default.
            _ => 25.4,
        };
        let pixels = |tag| photo.number(tag).filter(|&pixels| pixels > 0);
        Self {
            pixels: pixels(tag::PIXEL_X_DIMENSION)
                .zip(pixels(tag::PIXEL_Y_DIMENSION))
                .map(|(columns, rows)| [columns, rows]),
            focal_length_35mm: whole(tag::FOCAL_LENGTH_35MM),
            focal_length: fraction(tag::FOCAL_LENGTH),
            focal_plane_resolution: fraction(tag::FOCAL_PLANE_X_RESOLUTION).map(|resolution| resolution / unit),
            exposure: fraction(tag::EXPOSURE_TIME)
                .zip(fraction(tag::F_NUMBER))
                .zip(whole(tag::SENSITIVITY))
                .map(|((time, f_number), sensitivity)| time * sensitivity / (f_number * f_number)),
            orientation: None,
            flash_fired: photo.number(tag::FLASH).map(|flash| flash & 1 == 1),
        }
    }

    /// By how many quarters the picture was turned clockwise after it was taken; a mirrored one by none.
    pub fn quarter_turns(&self) -> u8 {
        match self.orientation {
            Some(6) => 1,
            Some(3) => 2,
            Some(8) => 3,
            _ => 0,
        }
    }

    /// Whether both say the same of the lens.
    pub fn has_same_lens(&self, other: &Self) -> bool {
        let lens = |camera: &Self| (camera.focal_length_35mm, camera.focal_length, camera.focal_plane_resolution);
        lens(self) == lens(other)
    }

    /// The focal length in pixels of a photo of `width` x `height`; `None` where nothing is said of it, or of a photo of another size: one that was cropped
    /// or scaled keeps what its camera wrote.
    pub fn focal_length_in_pixels(&self, width: usize, height: usize) -> Option<f64> {
        let size = [width as u64, height as u64];
        let [columns, rows] = self.pixels?;
        // What turned the photo may have left the camera's columns and rows as they were.
        if size != [columns, rows] && size != [rows, columns] {
            return None;
        }
        let diagonal = (width as f64).hypot(height as f64);
        let from_film = self.focal_length_35mm.map(|focal_length| focal_length / FILM_DIAGONAL * diagonal);
        let from_sensor = self.focal_length.zip(self.focal_plane_resolution).map(|(length, pixels)| length * pixels);
        from_film
            .or(from_sensor)
            .filter(|focal_length| FIELD_OF_VIEW.contains(&(2.0 * (diagonal / 2.0 / focal_length).atan()).to_degrees()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn telephone() -> CameraData {
        CameraData { pixels: Some([4032, 3024]), focal_length_35mm: Some(26.0), ..CameraData::default() }
    }

    #[test]
    fn the_focal_length_is_that_of_film() {
        let found = telephone().focal_length_in_pixels(4032, 3024).unwrap();
        // 26 mm on film: 79.5 degrees across the diagonal.
        assert!((2.0 * (2520.0 / found).atan().to_degrees() - 79.5).abs() < 0.1, "{found}");
        assert_eq!(telephone().focal_length_in_pixels(3024, 4032), Some(found));
    }

    #[test]
    fn the_sensor_tells_where_film_is_not_named() {
        let camera = CameraData {
            pixels: Some([6000, 4000]),
            focal_length: Some(35.0),
            focal_plane_resolution: Some(250.0),
            ..CameraData::default()
        };
        assert_eq!(camera.focal_length_in_pixels(6000, 4000), Some(8750.0));
    }

    #[test]
    fn cropped_photos_and_absurd_lenses_are_not_believed() {
        assert_eq!(telephone().focal_length_in_pixels(3024, 3024), None);
        assert_eq!(telephone().focal_length_in_pixels(2016, 1512), None);
        for focal_length in [1e-3, 4.0, 5000.0] {
            let absurd = CameraData { focal_length_35mm: Some(focal_length), ..telephone() };
            assert_eq!(absurd.focal_length_in_pixels(4032, 3024), None, "{focal_length}");
        }
        assert_eq!(CameraData::default().focal_length_in_pixels(4032, 3024), None);
    }
}
