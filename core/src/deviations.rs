//! How sure a fit is of its maps.

use crate::image::Image;

/// Standard deviations of fitted maps per pixel, each an (H, W, 1) image: what photos and prior leave open, as the finish sees it. How often the
/// truth lies within one of them is measured in `docs/accuracy.md`.
#[derive(Clone, Debug, PartialEq)]
pub struct Deviations {
    /// Of the diffuse albedo, linear: root mean square over the colours.
    pub diffuse_albedo: Image,
    /// Of the specular albedo, linear: root mean square over the colours.
    pub specular_albedo: Image,
    /// Of the perceptual roughness.
    pub roughness: Image,
    /// Of the normal: the root of the summed variances of x and y, about an angle in radians.
    pub normal: Image,
}
