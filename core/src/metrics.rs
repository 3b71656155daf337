//! How far a rendering is from a photo, and maps from the true ones.

use std::fmt;

use serde::Serialize;

use crate::cholesky::Cholesky;
use crate::color::Transfer;
use crate::error::{Error, Result};
use crate::image::Image;
use crate::material::Material;

/// Root mean square error of a re-rendered photo: over all values, encoded with gamma 2.2 and clamped to [0, 1], as the literature has it.
///
/// # Errors
/// [`Error::ShapeMismatch`] if the images differ in size or channels.
pub fn photo_rmse(rendering: &Image, photo: &Image) -> Result<f64> {
    rmse("rendering", rendering, photo, gamma22)
}

/// [`photo_rmse`] after a smooth gain: each channel of the rendering, encoded, is multiplied by the quadratic in x and y that brings it nearest to
/// the photo. What light that is stated roughly adds to an error is gone; what the maps miss stays.
///
/// # Errors
/// As [`photo_rmse`]; for images that have not three channels, too.
pub fn photo_rmse_smooth_gain(rendering: &Image, photo: &Image) -> Result<f64> {
    rmse("rendering", rendering, photo, gamma22)?;
    if photo.channels() != 3 {
        return Err(Error::shape("photo", "3 channels", photo.channels().to_string()));
    }
    let codes = |image: &Image| image.data().chunks_exact(3).map(|rgb| [0, 1, 2].map(|c| gamma22(rgb[c]))).collect();
    let (rendered, seen): (Vec<_>, Vec<_>) = (codes(rendering), codes(photo));
    Ok(code_rmse_smooth_gain(&rendered, &seen, photo.width()))
}

/// [`photo_rmse_smooth_gain`] of encoded colours in rows of `width`.
pub(crate) fn code_rmse_smooth_gain(rendered: &[[f64; 3]], seen: &[[f64; 3]], width: usize) -> f64 {
    let height = rendered.len() / width;
    let places: Vec<[f64; TERMS]> = (0..rendered.len())
        .map(|p| {
            let along = |place: usize, count: usize| 2.0 * (place as f64 + 0.5) / count as f64 - 1.0;
            let (x, y) = (along(p % width, width), along(p / width, height));
            [1.0, x, y, x * x, x * y, y * y]
        })
        .collect();
    let mut sum = 0.0;
    for c in 0..3 {
        // Least squares, held near a gain of 1 where the photo says nothing.
        let (mut matrix, mut vector) = ([[0.0; TERMS]; TERMS], [0.0; TERMS]);
        let held = HELD * rendered.len() as f64;
        matrix.iter_mut().enumerate().for_each(|(i, row)| row[i] = held);
        vector[0] = held;
        for ((terms, rendered), seen) in places.iter().zip(rendered).zip(seen) {
            let terms = terms.map(|term| term * rendered[c]);
            for i in 0..TERMS {
                vector[i] += terms[i] * seen[c];
                for j in 0..=i {
                    matrix[i][j] += terms[i] * terms[j];
                }
            }
        }
        let gain = Cholesky::of(&matrix).map(|factor| factor.solve(vector));
        let gain = gain.unwrap_or([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        for ((terms, rendered), seen) in places.iter().zip(rendered).zip(seen) {
            let gain: f64 = terms.iter().zip(gain).map(|(term, gain)| term * gain).sum();
            sum += ((gain * rendered[c]).clamp(0.0, 1.0) - seen[c]).powi(2);
        }
    }
    (sum / (3 * rendered.len()) as f64).sqrt()
}

/// Coefficients of a quadratic in x and y, and how much a gain of 1 counts against a pixel of code 1.
const TERMS: usize = 6;
const HELD: f64 = 1e-6;

/// Errors of one map of values in [0, 1].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct MapError {
    /// RMSE of the linear values.
    pub linear: f64,
    /// RMSE of the values encoded with gamma 2.2.
    pub gamma22: f64,
}

/// Errors of a material's maps against the true ones.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct MapErrors {
    /// Diffuse albedo.
    pub diffuse: MapError,
    /// Specular albedo.
    pub specular: MapError,
    /// Perceptual roughness.
    pub roughness: MapError,
    /// RMSE of (n + 1) / 2.
    pub normal: f64,
    /// Mean angle between the normals, in degrees.
    pub normal_angle_deg: f64,
}

impl MapErrors {
    /// Errors of `material`'s maps against those of `truth`. Tangents are not compared: their sign means nothing.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if the maps differ in size or channels.
    pub fn between(material: &Material, truth: &Material) -> Result<Self> {
        let map = |name: &str, map: &Image, truth: &Image| -> Result<MapError> {
            Ok(MapError { linear: rmse(name, map, truth, f64::from)?, gamma22: rmse(name, map, truth, gamma22)? })
        };
        let normals = (&material.normal, &truth.normal);
        let normal = rmse("normal", normals.0, normals.1, |component| (f64::from(component) + 1.0) / 2.0)?;
        let angles = normals.0.data().chunks_exact(3).zip(normals.1.data().chunks_exact(3));
        let count = angles.len() as f64;
        Ok(Self {
            diffuse: map("diffuse_albedo", &material.diffuse_albedo, &truth.diffuse_albedo)?,
            specular: map("specular_albedo", &material.specular_albedo, &truth.specular_albedo)?,
            roughness: map("roughness", &material.roughness, &truth.roughness)?,
            normal,
            normal_angle_deg: angles.map(|(a, b)| angle(a, b).to_degrees()).sum::<f64>() / count,
        })
    }
}

impl fmt::Display for MapErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{:<24}{:<10}gamma 2.2", "map RMSE", "linear")?;
        for (name, error) in [("diffuse", self.diffuse), ("specular", self.specular), ("roughness", self.roughness)] {
            writeln!(f, "{name:<24}{:<10.4}{:.4}", error.linear, error.gamma22)?;
        }
        write!(f, "{:<24}{:<10.4}{:.2} degrees", "normal", self.normal, self.normal_angle_deg)
    }
}

fn gamma22(value: f32) -> f64 {
    f64::from(Transfer::Gamma22.encode(value).clamp(0.0, 1.0))
}

fn rmse(name: &str, image: &Image, truth: &Image, value: impl Fn(f32) -> f64) -> Result<f64> {
    let shape = |image: &Image| (image.height(), image.width(), image.channels());
    if shape(image) != shape(truth) {
        return Err(Error::shape(name, format!("shape {:?}", shape(truth)), format!("{:?}", shape(image))));
    }
    let squares = image.data().iter().zip(truth.data()).map(|(&a, &b)| (value(a) - value(b)).powi(2));
    Ok((squares.sum::<f64>() / image.data().len() as f64).sqrt())
}

/// The angle between two vectors in radians; from both products, so that it is right for small angles too.
fn angle(a: &[f32], b: &[f32]) -> f64 {
    let at = |v: &[f32], i: usize| f64::from(v[i % 3]);
    let dot: f64 = (0..3).map(|i| at(a, i) * at(b, i)).sum();
    let cross = (0..3).map(|i| (at(a, i + 1) * at(b, i + 2) - at(a, i + 2) * at(b, i + 1)).powi(2)).sum::<f64>().sqrt();
    cross.atan2(dot)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(channels: usize, data: &[f32]) -> Image {
        Image::new(data.len() / channels, 1, channels, data.to_vec()).unwrap()
    }

    #[test]
    fn photos() {
        // Above 1 and below 0 count as 1 and 0; 0.25 is stored as 0.25^(1/2.2).
        let (a, b) = (image(1, &[7.0, -1.0, 0.25, 0.5]), image(1, &[1.0, 0.0, 0.0, 0.5]));
        let expected = (0.25f64.powf(2.0 / 2.2) / 4.0).sqrt();
        assert!((photo_rmse(&a, &b).unwrap() - expected).abs() < 1e-7);
        let error = photo_rmse(&a, &image(1, &[0.0; 3])).unwrap_err().to_string();
        assert!(error.contains("(1, 4, 1)") && error.contains("(1, 3, 1)"), "{error}");
    }

    #[test]
    fn smooth_gains_are_granted() {
        let (width, height) = (9, 7);
        let mut random = fastrand::Rng::with_seed(1);
        let truth: Vec<f32> = (0..3 * width * height).map(|_| 0.1 + 0.3 * random.f32()).collect();
        let lit = |by: &dyn Fn(f32, f32) -> f32| {
            let gain = |p: usize| {
                by(
                    2.0 * ((p % width) as f32 + 0.5) / width as f32 - 1.0,
                    2.0 * ((p / width) as f32 + 0.5) / height as f32 - 1.0,
                )
            };
            let data = truth.iter().enumerate().map(|(i, value)| value * gain(i / 3).powf(2.2)).collect();
            Image::new(width, height, 3, data).unwrap()
        };
        let photo = lit(&|_, _| 1.0);
        let uneven = lit(&|x, y| 1.1 + 0.1 * x - 0.05 * y + 0.04 * x * y - 0.03 * y * y);
        assert!(photo_rmse(&uneven, &photo).unwrap() > 0.05);
        assert!(photo_rmse_smooth_gain(&photo, &uneven).unwrap() < 1e-4);
        // A grain is none.
        let grain = lit(&|x, y| 1.0 + 0.1 * (40.0 * x + 17.0 * y).sin());
        assert!(photo_rmse_smooth_gain(&grain, &photo).unwrap() > 0.8 * photo_rmse(&grain, &photo).unwrap());
        let black = lit(&|_, _| 0.0);
        assert_eq!(photo_rmse_smooth_gain(&black, &black).unwrap(), 0.0);
        assert!(photo_rmse_smooth_gain(&image(1, &[0.0]), &image(1, &[0.0])).is_err());
    }

    #[test]
    fn maps() {
        let (s, c) = 0.02f32.sin_cos();
        let truth = Material {
            diffuse_albedo: image(3, &[0.5, 0.5, 0.5, 0.2, 0.2, 0.2]),
            specular_albedo: image(3, &[0.04; 6]),
            roughness: image(1, &[0.3, 0.6]),
            normal: image(3, &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]),
            tangent: None,
            patch_size: 1.0,
            unit: None,
            warnings: Vec::new(),
        };
        let mut other = truth.clone();
        other.diffuse_albedo.data_mut()[0] = 0.75;
        other.roughness.data_mut()[1] = 0.8;
        other.normal.data_mut()[3..].copy_from_slice(&[s, 0.0, c]);
        let errors = MapErrors::between(&other, &truth).unwrap();
        let gamma = |v: f64| v.powf(1.0 / 2.2);
        assert!((errors.diffuse.linear - 0.25 / 6f64.sqrt()).abs() < 1e-7);
        assert!((errors.diffuse.gamma22 - (gamma(0.75) - gamma(0.5)) / 6f64.sqrt()).abs() < 1e-6);
        assert_eq!(errors.specular, MapError { linear: 0.0, gamma22: 0.0 });
        assert!((errors.roughness.linear - 0.2 / 2f64.sqrt()).abs() < 1e-7);
        // A chord of 2 sin(0.01), halved, over six components.
        assert!((errors.normal - (0.01f64).sin() / 6f64.sqrt()).abs() < 1e-7);
        assert!((errors.normal_angle_deg - 0.01f64.to_degrees()).abs() < 1e-5);
        let text = errors.to_string();
        assert!(text.contains("diffuse                 0.1021") && text.ends_with("0.57 degrees"), "{text}");
        other.roughness = image(1, &[0.5]);
        assert!(MapErrors::between(&other, &truth).unwrap_err().to_string().contains("roughness"));
    }
}
