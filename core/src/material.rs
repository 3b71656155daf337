//! A material: its maps as images, ready to be looked at and written.

use crate::error::{Error, Result};
use crate::image::Image;
use crate::maps::{DIFFUSE_PLANE, Lobe, Maps, NORMAL_PLANE, ROUGHNESS_PLANE};

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

impl Material {
    /// Columns of the maps.
    pub fn width(&self) -> usize {
        self.normal.width()
    }

    /// Rows of the maps.
    pub fn height(&self) -> usize {
        self.normal.height()
    }

    /// The reflectance model: anisotropic where there is a tangent.
    pub fn lobe(&self) -> Lobe {
        if self.tangent.is_some() { Lobe::Anisotropic } else { Lobe::Isotropic }
    }

    /// A material from maps: albedos and roughness limited to [0, 1], normals and tangents of unit length and orthogonal.
    ///
    /// A normal of length 0 becomes (0, 0, 1), a tangent that is 0 or parallel to the normal one along x (or y).
    ///
    /// # Errors
    /// [`Error::NonFinite`] if a map holds NaN or infinity; [`Error::InvalidArgument`] if `patch_size` is not positive and finite.
    pub fn from_maps(maps: &Maps<f32>, patch_size: f64) -> Result<Self> {
        check_patch_size(patch_size)?;
        if !maps.data().iter().all(|value| value.is_finite()) {
            return Err(Error::NonFinite { stage: "maps".into(), iteration: 0 });
        }
        let (lobe, pixels) = (maps.lobe(), maps.width() * maps.height());
        let image = |channels: usize, planar: &[f32]| Image::from_planar(maps.width(), maps.height(), channels, planar);
        let limited = |first: usize, count: usize| {
            let planes = &maps.data()[first * pixels..(first + count) * pixels];
            image(count, &planes.iter().map(|value| value.clamp(0.0, 1.0)).collect::<Vec<_>>())
        };
        let vector = |first: usize, p: usize| [0, 1, 2].map(|i| f64::from(maps.plane(first + i)[p]));
        let vectors = |at: &dyn Fn(usize) -> [f64; 3]| {
            let data = (0..pixels).flat_map(|p| at(p).map(|component| component as f32)).collect();
            Image::new(maps.width(), maps.height(), 3, data)
        };
        let normal = |p: usize| unit(vector(NORMAL_PLANE, p)).unwrap_or([0.0, 0.0, 1.0]);
        let tangent = |p: usize| {
            let n = normal(p);
            let axis = if n[0].abs() > 0.8 { [0.0, 1.0, 0.0] } else { [1.0, 0.0, 0.0] };
            let stored = unit(vector(lobe.tangent_plane(), p)).and_then(|t| orthogonal(t, n));
            stored.or_else(|| orthogonal(axis, n)).unwrap_or(axis)
        };
        Ok(Self {
            diffuse_albedo: limited(DIFFUSE_PLANE, 3)?,
            specular_albedo: limited(lobe.specular_plane(), 3)?,
            roughness: limited(ROUGHNESS_PLANE, lobe.roughness_planes())?,
            normal: vectors(&normal)?,
            tangent: match lobe {
                Lobe::Isotropic => None,
                Lobe::Anisotropic => Some(vectors(&tangent)?),
            },
            patch_size,
        })
    }

    /// The maps as planes, albedos and roughness limited to [0, 1].
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if an image's size or channels do not fit; [`Error::InvalidArgument`] if a value is not finite or
    /// `patch_size` is not positive and finite.
    pub fn to_maps(&self) -> Result<Maps<f32>> {
        check_patch_size(self.patch_size)?;
        let lobe = self.lobe();
        let (width, height) = (self.normal.width(), self.normal.height());
        let mut data = Vec::with_capacity(lobe.planes() * width * height);
        let mut push = |name: &str, image: &Image, channels: usize, limited: bool| {
            if (image.width(), image.height(), image.channels()) != (width, height, channels) {
                let got = format!("({}, {}, {})", image.height(), image.width(), image.channels());
                return Err(Error::shape(name, format!("shape ({height}, {width}, {channels})"), got));
            }
            if let Some(value) = image.data().iter().find(|value| !value.is_finite()) {
                return Err(Error::invalid(name, format!("expected finite values, got {value}")));
            }
            let limit = |value: f32| if limited { value.clamp(0.0, 1.0) } else { value };
            data.extend(image.to_planar().into_iter().map(limit));
            Ok(())
        };
        push("diffuse_albedo", &self.diffuse_albedo, 3, true)?;
        push("normal", &self.normal, 3, false)?;
        push("roughness", &self.roughness, lobe.roughness_planes(), true)?;
        push("specular_albedo", &self.specular_albedo, 3, true)?;
        if let Some(tangent) = &self.tangent {
            push("tangent", tangent, 3, false)?;
        }
        Maps::new(lobe, width, height, data)
    }
}

fn check_patch_size(patch_size: f64) -> Result<()> {
    if patch_size.is_finite() && patch_size > 0.0 {
        return Ok(());
    }
    Err(Error::invalid("patch_size", format!("expected a positive length, got {patch_size}")))
}

/// `vector` at unit length, unless it is (nearly) 0.
fn unit(vector: [f64; 3]) -> Option<[f64; 3]> {
    let length = vector.iter().map(|component| component * component).sum::<f64>().sqrt();
    (length > 1e-15).then(|| vector.map(|component| component / length))
}

/// The unit vector in the plane of the unit vectors `vector` and `normal` that is orthogonal to `normal`, unless they are parallel (to 1e-5).
fn orthogonal(vector: [f64; 3], normal: [f64; 3]) -> Option<[f64; 3]> {
    let along: f64 = vector.iter().zip(normal).map(|(v, n)| v * n).sum();
    let rest: [f64; 3] = std::array::from_fn(|i| vector[i] - along * normal[i]);
    let length2: f64 = rest.iter().map(|component| component * component).sum();
    if length2 > 1e-10 { unit(rest) } else { None }
}
