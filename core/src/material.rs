//! A material: its maps as images, ready to be looked at and written.

use crate::image::Image;

/// The maps of a material, each an (H, W, C) image, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Diffuse albedo, (H, W, 3), linear, [0, 1].
    pub diffuse_albedo: Image,
    /// Specular albedo (reflectance at normal incidence), (H, W, 3), linear, [0, 1].
    pub specular_albedo: Image,
    /// Perceptual roughness, (H, W, 1), or (H, W, 2) for (x, y) of an anisotropic material; [0, 1].
    pub roughness: Image,
    /// Unit normals, (H, W, 3), +x right, +y up, +z out of the surface, [-1, 1].
    pub normal: Image,
    /// Unit tangents of an anisotropic material, (H, W, 3), [-1, 1].
    pub tangent: Option<Image>,
    /// Width of the patch in the capture's length unit.
    pub patch_size: f64,
}
