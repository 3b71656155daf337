//! A material: its maps as images, ready to be looked at and written.

use crate::error::{Error, Result};
use crate::image::Image;
use crate::maps::{DIFFUSE_PLANE, Lobe, Maps, NORMAL_PLANE, ROUGHNESS_PLANE, slope};
use crate::memory;
use crate::unit::Unit;

/// The maps of a material, each an (H, W, C) image, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Diffuse albedo, (H, W, 3), linear Rec. 709, [0, 1].
    pub diffuse_albedo: Image,
    /// Specular albedo (reflectance at normal incidence), (H, W, 3), linear Rec. 709, [0, 1].
    pub specular_albedo: Image,
    /// Perceptual roughness, (H, W, 1), or (H, W, 2) for (x, y) of an anisotropic material; [0, 1].
    pub roughness: Image,
    /// Unit normals, (H, W, 3), +x right, +y up, +z out of the surface, [-1, 1].
    pub normal: Image,
    /// Unit tangents of an anisotropic material, (H, W, 3), [-1, 1].
    pub tangent: Option<Image>,
    /// Width of the patch in the capture's length unit.
    pub patch_size: f64,
    /// The unit of `patch_size`, where it is known.
    pub unit: Option<Unit>,
    /// What a user should know about how the maps were read.
    pub warnings: Vec<String>,
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

    /// A material from maps, of no known unit: albedos and roughness limited to [0, 1], normals and tangents of unit length and orthogonal.
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
            image(count, &memory::collected(planes.len(), planes.iter().map(|value| value.clamp(0.0, 1.0)))?)
        };
        let vector = |first: usize, p: usize| [0, 1, 2].map(|i| f64::from(maps.plane(first + i)[p]));
        let vectors = |at: &dyn Fn(usize) -> [f64; 3]| {
            let values = (0..pixels).flat_map(|p| at(p).map(|component| component as f32));
            Image::new(maps.width(), maps.height(), 3, memory::collected(3 * pixels, values)?)
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
            unit: None,
            warnings: Vec::new(),
        })
    }

    /// The material with its maps limited as [`Material::from_maps`] does.
    ///
    /// # Errors
    /// As [`Material::to_maps`].
    pub fn limited(&self) -> Result<Self> {
        self.check_ranges()?;
        self.normalised()
    }

    /// [`Material::limited`] whatever the values are: those of files, which may be rounded or in another colour space, and averages of vectors.
    pub(crate) fn normalised(&self) -> Result<Self> {
        self.with_maps(&self.planes()?)
    }

    /// Other maps of the same patch, limited as [`Material::from_maps`] does.
    fn with_maps(&self, maps: &Maps<f32>) -> Result<Self> {
        let limited = Self::from_maps(maps, self.patch_size)?;
        Ok(Self { unit: self.unit.clone(), warnings: self.warnings.clone(), ..limited })
    }

    /// How the surface leans as a whole: the mean slopes of its normals towards +x and +y. A sample that did not lie flat in its capture leans.
    pub fn tilt(&self) -> [f64; 2] {
        let normals = self.normal.data().chunks_exact(3);
        let pixels = normals.len().max(1) as f64;
        [0, 1].map(|axis| normals.clone().map(|n| f64::from(slope(n[axis], n[2]))).sum::<f64>() / pixels)
    }

    /// The material lying flat, its maps limited as [`Material::limited`] does: without its [`Material::tilt`], so that tiles of it make a plane.
    ///
    /// # Errors
    /// As [`Material::to_maps`].
    pub fn leveled(&self) -> Result<Self> {
        self.check_ranges()?;
        let mut maps = self.planes()?;
        let (tilt, pixels) = (self.tilt(), self.width() * self.height());
        let (before, up) = maps.data_mut().split_at_mut((NORMAL_PLANE + 2) * pixels);
        for (axis, plane) in before[NORMAL_PLANE * pixels..].chunks_exact_mut(pixels).enumerate() {
            for (component, up) in plane.iter_mut().zip(&*up) {
                *component -= tilt[axis] as f32 * up;
            }
        }
        self.with_maps(&maps)
    }

    /// Bytes of its maps in memory.
    pub fn memory(&self) -> u64 {
        let maps = [&self.diffuse_albedo, &self.specular_albedo, &self.roughness, &self.normal];
        let values = maps.into_iter().chain(&self.tangent).map(|map| map.data().len()).sum::<usize>();
        (values * size_of::<f32>()) as u64
    }

    /// The maps as planes, albedos and roughness limited to [0, 1].
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if an image's size or channels do not fit; [`Error::InvalidArgument`] if a value is not finite, an albedo or roughness lies outside
    /// [0, 1] by more than 1e-3 (values of 0 to 255, say), the length of a normal or tangent is off by more than a tenth (a normal map that is still
    /// encoded, say), or `patch_size` is not positive and finite.
    pub fn to_maps(&self) -> Result<Maps<f32>> {
        self.check_ranges()?;
        self.planes()
    }

    /// Fails for values that are no albedos, roughness, normals or tangents, but something that has yet to be made so.
    fn check_ranges(&self) -> Result<()> {
        check_range(
            "diffuse_albedo",
            &self.diffuse_albedo,
            "decode an image first: divide by its largest code, then undo its gamma",
        )?;
        check_range(
            "specular_albedo",
            &self.specular_albedo,
            "decode an image first: divide by its largest code, then undo its gamma",
        )?;
        check_range("roughness", &self.roughness, "divide an image by its largest code first")?;
        check_lengths("normal", &self.normal)?;
        self.tangent.iter().try_for_each(|tangent| check_lengths("tangent", tangent))
    }

    fn planes(&self) -> Result<Maps<f32>> {
        check_patch_size(self.patch_size)?;
        let lobe = self.lobe();
        let (width, height) = (self.normal.width(), self.normal.height());
        let mut data = memory::reserved(lobe.planes().saturating_mul(width * height))?;
        let mut push = |name: &str, image: &Image, channels: usize, limited: bool| {
            if (image.width(), image.height(), image.channels()) != (width, height, channels) {
                let got = format!("({}, {}, {})", image.height(), image.width(), image.channels());
                return Err(Error::shape(name, format!("shape ({height}, {width}, {channels})"), got));
            }
            if let Some(value) = image.data().iter().find(|value| !value.is_finite()) {
                return Err(Error::invalid(name, format!("expected finite values, got {value}")));
            }
            let limit = |value: f32| if limited { value.clamp(0.0, 1.0) } else { value };
            data.extend(image.to_planar()?.into_iter().map(limit));
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

/// How far outside [0, 1] an albedo or a roughness may lie, which rounding explains.
const RANGE_SLACK: f32 = 1e-3;
/// How far from 1 the length of a vector may be, which rounding to 8 bits and resampling explain.
const LENGTH_SLACK: f64 = 0.1;

/// Fails if a finite value lies outside [0, 1].
fn check_range(name: &str, image: &Image, advice: &str) -> Result<()> {
    let off = |value: f32| (value - 1.0).max(-value);
    let values = image.data().iter().copied().filter(|value| value.is_finite());
    match values.max_by(|&a, &b| off(a).total_cmp(&off(b))) {
        Some(worst) if off(worst) > RANGE_SLACK => {
            Err(Error::invalid(name, format!("expected linear values from 0 to 1, got {worst}: {advice}")))
        }
        _ => Ok(()),
    }
}

/// Fails if a finite vector is not about of unit length.
fn check_lengths(name: &str, image: &Image) -> Result<()> {
    let length = |vector: &[f32]| vector.iter().map(|&component| f64::from(component).powi(2)).sum::<f64>().sqrt();
    let vectors = image.data().chunks_exact(3).filter(|vector| vector.iter().all(|component| component.is_finite()));
    let off = |vector: &&[f32]| (length(vector) - 1.0).abs();
    match vectors.max_by(|a, b| off(a).total_cmp(&off(b))) {
        Some(worst) if image.channels() == 3 && off(&worst) > LENGTH_SLACK => {
            let got = format!("got {worst:?} of length {:.3}", length(worst));
            Err(Error::invalid(
                name,
                format!("expected vectors of length 1, {got}: make vectors of an encoded map first, 2 n - 1"),
            ))
        }
        _ => Ok(()),
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

#[cfg(test)]
mod tests {
    use super::*;

    fn maps(lobe: Lobe) -> Maps<f32> {
        let data = (0..lobe.planes() * 6).map(|i| 0.5 + 0.6 * (i as f32 * 1.3).sin()).collect();
        Maps::new(lobe, 3, 2, data).unwrap()
    }

    #[test]
    fn a_material_holds_maps_in_range() {
        for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
            let material = Material::from_maps(&maps(lobe), 2.0).unwrap();
            for image in [&material.diffuse_albedo, &material.specular_albedo, &material.roughness] {
                assert!(image.data().iter().all(|value| (0.0..=1.0).contains(value)));
            }
            assert_eq!(material.roughness.channels(), lobe.roughness_planes());
            assert_eq!(material.tangent.is_some(), lobe == Lobe::Anisotropic);
            let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
            for normal in material.normal.data().chunks(3) {
                assert!((dot(normal, normal) - 1.0).abs() < 1e-6);
            }
            for (t, n) in material.tangent.iter().flat_map(|t| t.data().chunks(3)).zip(material.normal.data().chunks(3))
            {
                assert!((dot(t, t) - 1.0).abs() < 1e-6 && dot(t, n).abs() < 1e-6);
            }
            // What is in range and of unit length already goes through unchanged, but for the last bit.
            let again = Material::from_maps(&material.to_maps().unwrap(), 2.0).unwrap();
            let (first, second) = (material.to_maps().unwrap(), again.to_maps().unwrap());
            for (a, b) in first.data().iter().zip(second.data()) {
                assert!((a - b).abs() < 2e-7, "{a} {b}");
            }
        }
    }

    #[test]
    fn a_level_material_leans_nowhere() {
        let mut maps = maps(Lobe::Anisotropic);
        let pixels = maps.width() * maps.height();
        let slopes: Vec<[f32; 2]> =
            (0..pixels).map(|p| [0.2 + 0.1 * (p as f32).sin(), -0.1 + 0.05 * (p as f32).cos()]).collect();
        for (p, [x, y]) in slopes.iter().enumerate() {
            for (i, component) in [*x, *y, 1.0].into_iter().enumerate() {
                maps.data_mut()[(NORMAL_PLANE + i) * pixels + p] = component;
            }
        }
        let leaning = Material::from_maps(&maps, 1.0).unwrap();
        let mean = [0, 1].map(|axis| slopes.iter().map(|slope| f64::from(slope[axis])).sum::<f64>() / pixels as f64);
        let level = leaning.leveled().unwrap();
        for axis in 0..2 {
            assert!((leaning.tilt()[axis] - mean[axis]).abs() < 1e-6, "{:?} {mean:?}", leaning.tilt());
            assert!(level.tilt()[axis].abs() < 1e-6, "{:?}", level.tilt());
        }
        let vectors = level.normal.data().chunks_exact(3).zip(level.tangent.as_ref().unwrap().data().chunks_exact(3));
        for ((n, t), slope) in vectors.zip(&slopes) {
            assert!((0..2).all(|i| (f64::from(n[i] / n[2]) - (f64::from(slope[i]) - mean[i])).abs() < 1e-6));
            assert!((0..3).map(|i| n[i] * t[i]).sum::<f32>().abs() < 1e-6);
        }
        assert_eq!((&level.roughness, &level.diffuse_albedo), (&leaning.roughness, &leaning.diffuse_albedo));
    }

    #[test]
    fn degenerate_vectors_are_replaced() {
        let mut maps = maps(Lobe::Anisotropic);
        let tangent = Lobe::Anisotropic.tangent_plane();
        let mut set = |pixel: usize, normal: [f32; 3], along: [f32; 3]| {
            for i in 0..3 {
                maps.plane_mut(NORMAL_PLANE + i)[pixel] = normal[i];
                maps.plane_mut(tangent + i)[pixel] = along[i];
            }
        };
        set(0, [0.0; 3], [0.0; 3]);
        set(1, [2.0, 0.0, 0.0], [-3.0, 0.0, 0.0]);
        set(2, [0.0, 0.0, 0.5], [0.3, 0.4, 7.0]);
        let material = Material::from_maps(&maps, 1.0).unwrap();
        let tangent = material.tangent.unwrap();
        assert_eq!(material.normal.data()[..9], [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        assert_eq!(tangent.data()[..6], [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        for (got, expected) in tangent.data()[6..9].iter().zip([0.6, 0.8, 0.0]) {
            assert!((got - expected).abs() < 1e-6);
        }
    }

    #[test]
    fn what_is_still_encoded_is_refused() {
        let good = Material::from_maps(&maps(Lobe::Anisotropic), 1.0).unwrap();
        let image = |channels: usize, value: f32| Image::new(3, 2, channels, vec![value; 6 * channels]).unwrap();
        let normals = |vector: [f32; 3]| Image::new(3, 2, 3, vector.repeat(6)).unwrap();
        let message = |material: Material| {
            let message = material.to_maps().unwrap_err().to_string();
            assert_eq!(material.limited().unwrap_err().to_string(), message);
            assert_eq!(
                crate::render::render(
                    &material,
                    &crate::Shot { camera: [0.0, 0.0, 2.0], light: [0.0, 0.0, 2.0], light_intensity: [1.0; 3] }
                )
                .unwrap_err()
                .to_string(),
                message
            );
            message
        };
        for (material, parts) in [
            (
                Material { diffuse_albedo: image(3, 255.0), ..good.clone() },
                ["diffuse_albedo: ", "from 0 to 1, got 255"],
            ),
            (Material { specular_albedo: image(3, -0.002), ..good.clone() }, ["specular_albedo: ", "got -0.002"]),
            (Material { roughness: image(2, 1.002), ..good.clone() }, ["roughness: ", "got 1.002"]),
            (Material { normal: normals([0.5, 0.5, 1.0]), ..good.clone() }, ["normal: ", "length 1.225"]),
            (Material { normal: normals([0.0; 3]), ..good.clone() }, ["normal: ", "length 0.000"]),
            (Material { tangent: Some(normals([1.0, 0.5, 0.5])), ..good.clone() }, ["tangent: ", "2 n - 1"]),
        ] {
            let message = message(material);
            assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        }
        // Rounding is none of that.
        let rounded = Material { diffuse_albedo: image(3, 1.0009), normal: normals([0.0, 0.05, 0.94]), ..good };
        assert!(rounded.to_maps().unwrap().plane(DIFFUSE_PLANE).iter().all(|&value| value == 1.0));
    }

    #[test]
    fn bad_values_are_named() {
        let good = Material::from_maps(&maps(Lobe::Anisotropic), 1.0).unwrap();
        let name = |material: &Material| match material.to_maps().unwrap_err() {
            Error::InvalidArgument { name, .. } | Error::ShapeMismatch { name, .. } => name,
            other => panic!("{other}"),
        };
        let image = |channels: usize| Image::new(3, 2, channels, vec![0.5; 6 * channels]).unwrap();
        assert_eq!(name(&Material { diffuse_albedo: image(4), ..good.clone() }), "diffuse_albedo");
        assert_eq!(name(&Material { roughness: image(1), ..good.clone() }), "roughness");
        assert_eq!(name(&Material { tangent: Some(image(1)), ..good.clone() }), "tangent");
        let mut specular_albedo = image(3);
        specular_albedo.data_mut()[4] = f32::NAN;
        assert_eq!(name(&Material { specular_albedo, ..good.clone() }), "specular_albedo");
        assert_eq!(name(&Material { patch_size: 0.0, ..good }), "patch_size");
        let mut maps = maps(Lobe::Isotropic);
        maps.data_mut()[7] = f32::INFINITY;
        assert!(matches!(Material::from_maps(&maps, 1.0), Err(Error::NonFinite { .. })));
    }
}
