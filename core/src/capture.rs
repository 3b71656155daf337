//! A capture: flash photos of one nearly flat sample, and where camera and light stood for each.
//!
//! Frame: the sample is centred at the origin in the plane z = 0, x right, y up (image row 0 is +y), z towards the camera.
//! Pixel (row i, column j) of an H x W image lies at `x = ((j + 0.5) / W - 0.5) * patch_size`,
//! `y = -((i + 0.5) / H - 0.5) * patch_size * H / W`. Positions and `patch_size` (the width) share one length unit.

use crate::color::Transfer;
use crate::image::Image;

/// Where camera and light stood for one photo, and how bright the light was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shot {
    /// Camera position, in the capture's unit.
    pub camera: [f64; 3],
    /// Position of the point light; equal to `camera` for a flash beside the lens.
    pub light: [f64; 3],
    /// RGB intensity: photo units times length squared, so that a surface at distance r receives `light_intensity / r^2`.
    pub light_intensity: [f64; 3],
}

/// One photo.
#[derive(Clone, Debug, PartialEq)]
pub struct Photo {
    /// File name or a name given by the host, for messages.
    pub name: String,
    /// Positions and light.
    pub shot: Shot,
    /// Linear RGB, (H, W, 3).
    pub image: Image,
    /// One byte per pixel; bit c is set where channel c stands at the encoding's upper end and only says "at least this bright".
    pub saturated: Vec<u8>,
}

/// Photos of one sample, all of the same size.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    photos: Vec<Photo>,
    patch_size: f64,
    transfer: Transfer,
    unit: Option<String>,
    warnings: Vec<String>,
}
