//! What was found in photos.

use serde::Serialize;

#[cfg(feature = "acquire")]
use super::camera::Lens;

/// How photos became a capture.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Report {
    /// The photos of the capture.
    pub photos: Vec<PhotoReport>,
    /// The others.
    pub left_out: Vec<LeftOut>,
    /// The lenses they were taken with.
    pub lenses: Vec<LensReport>,
    /// Side of the rectified photos in pixels.
    pub size: usize,
    /// What is assumed because no sheet tells it; empty for photos of one.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub assumptions: Vec<String>,
    /// What they do not show of the sample.
    pub missing: Vec<Missing>,
    /// What a user should know.
    pub warnings: Vec<String>,
}

/// A photo of the capture.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct PhotoReport {
    /// The file that it was.
    pub photo: String,
    /// The file that it is in the capture.
    pub file: String,
    /// Its lens, counted from 0.
    pub lens: usize,
    /// EXIF's orientation by which it was turned upright; absent where it is as the camera took it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation: Option<u8>,
    /// How many tags were found; 0 where the patch's corners were given.
    pub tags: usize,
    /// Root mean squared distance of their corners (or of the patch's) from where they should be, in pixels of the photo.
    pub tag_error: f64,
    /// The same as a share of the patch's width.
    pub position_error: f64,
    /// Standard deviation of its blur, in pixels of the rectified photo; only tags tell it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub blur: Option<f64>,
    /// Third quartile of its paper's deviations from what position and light explain, as a share.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub paper_error: Option<f64>,
    /// Share of the light on its paper that does not come from the flash, as far as it can be told apart.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ambient: Option<f64>,
    /// Share of the rectified pixels that are saturated.
    pub saturated: f64,
}

/// A photo that was not used.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct LeftOut {
    /// The file that it was.
    pub photo: String,
    /// Why.
    pub reason: String,
    /// Its place among the photos that were given.
    #[serde(skip)]
    pub(super) index: usize,
}

/// A photo that is not there.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Missing {
    /// What is not seen, and what to do.
    pub text: String,
    /// Where a photo of it could be taken from, in millimetres.
    pub camera: [f64; 3],
}

/// A lens as its photos have it.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct LensReport {
    /// How many photos were taken with it.
    pub photos: usize,
    /// Focal length in pixels.
    pub focal_length: f64,
    /// Standard deviation of its logarithm, from how well the photos' points tell it.
    pub focal_length_deviation: f64,
    /// What EXIF data say of it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focal_length_from_exif: Option<f64>,
    /// Radial distortion: coefficients of r^2 and r^4, where r is the tangent of the angle to the lens's axis.
    pub radial: [f64; 2],
    /// Logarithm of what it loses towards the edges: coefficients of r^2 and r^4.
    pub fall_off: [f64; 2],
    /// Likewise of the flash: of s^2 and s^4, where s is the tangent of the angle to the flash's axis.
    pub flash_fall_off: [f64; 2],
    /// Tone curve of the camera: sRGB's code for what the camera wrote u for is u + the sum of these times sin(k pi u), k from 1 on.
    pub tone: [f64; 4],
    /// Where the flash is, seen from the lens: to the right and up in the photo as it was taken, in millimetres.
    pub light_offset: [f64; 2],
}

#[cfg(feature = "acquire")]
impl LensReport {
    pub(super) fn lens(&self) -> Lens {
        Lens { focal_length: self.focal_length, radial: self.radial }
    }
}
