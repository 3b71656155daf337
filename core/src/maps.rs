//! The maps of a material in the layout the renderer, the network and the fit compute on: one plane per channel.

use crate::error::{Error, Result};

/// Which reflectance model a set of maps belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Lobe {
    /// One roughness per pixel: 10 planes.
    Isotropic,
    /// Two roughnesses and a tangent per pixel: 14 planes.
    Anisotropic,
}

impl Lobe {
    /// Planes of a set of maps.
    pub const fn planes(self) -> usize {
        match self {
            Self::Isotropic => 10,
            Self::Anisotropic => 14,
        }
    }

    /// Planes of the roughness map: 1, or 2 for (x, y).
    pub const fn roughness_planes(self) -> usize {
        match self {
            Self::Isotropic => 1,
            Self::Anisotropic => 2,
        }
    }

    /// First plane of the specular albedo.
    pub const fn specular_plane(self) -> usize {
        ROUGHNESS_PLANE + self.roughness_planes()
    }

    /// First plane of the tangent; only anisotropic maps have one.
    pub const fn tangent_plane(self) -> usize {
        self.specular_plane() + 3
    }
}

/// First plane of the diffuse albedo.
pub const DIFFUSE_PLANE: usize = 0;
/// First plane of the normal (x, y, z).
pub const NORMAL_PLANE: usize = 3;
/// First plane of the (perceptual) roughness.
pub const ROUGHNESS_PLANE: usize = 6;

/// Least z of a normal whose slope is taken as it is.
const STEEPEST: f32 = 0.2;

/// The slope of a surface along x or y: that component of its normal over the one up.
pub(crate) fn slope(component: f32, up: f32) -> f32 {
    component / up.max(STEEPEST)
}

/// Material maps, one plane of `height * width` values per channel, rows from the top, in the order of the network's outputs
/// (REFERENCE: diffuse 3, normal 3, roughness 1, specular 3; anisotropic: diffuse 3, normal 3, roughness (x, y) 2, specular 3, tangent 3).
///
/// Albedos are linear, [0, 1]; roughness is perceptual (alpha is its square), [0, 1]; normal and tangent point
/// +x right, +y up, +z out of the surface and need not have unit length: the shading model normalises them.
#[derive(Clone, Debug, PartialEq)]
pub struct Maps<T> {
    lobe: Lobe,
    width: usize,
    height: usize,
    data: Vec<T>,
}

impl<T> Maps<T> {
    /// Maps from all their planes in order.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if `data` does not hold `lobe.planes() * height * width` values, or a size is zero.
    pub fn new(lobe: Lobe, width: usize, height: usize, data: Vec<T>) -> Result<Self> {
        let expected = width.checked_mul(height).and_then(|n| n.checked_mul(lobe.planes()));
        if expected != Some(data.len()) || data.is_empty() {
            return Err(Error::shape(
                "maps",
                format!("{} planes of {height} x {width}", lobe.planes()),
                format!("{} values", data.len()),
            ));
        }
        Ok(Self { lobe, width, height, data })
    }

    /// The reflectance model.
    pub fn lobe(&self) -> Lobe {
        self.lobe
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All planes in order.
    pub fn data(&self) -> &[T] {
        &self.data
    }

    /// All planes in order, to be changed in place.
    pub fn data_mut(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// Plane `index`.
    pub fn plane(&self, index: usize) -> &[T] {
        let pixels = self.width * self.height;
        &self.data[index * pixels..(index + 1) * pixels]
    }

    /// Plane `index`, to be changed in place.
    pub fn plane_mut(&mut self, index: usize) -> &mut [T] {
        let pixels = self.width * self.height;
        &mut self.data[index * pixels..(index + 1) * pixels]
    }
}
