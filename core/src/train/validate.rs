//! Errors on held-out materials: the same crops, geometry and noise every time, as `python/training/validate.py`.

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::ops::Range;

use serde::Serialize;

use super::config::ValidationSettings;
use super::data::camera::{Captured, Family, Habits, clean_photos, draw_geometry, photograph};
use super::data::{Crop, Dice, Purpose, Texture};
use crate::capture::{Capture, Photo};
use crate::color::Transfer;
use crate::error::Result;
use crate::image::Image;
use crate::maps::{DIFFUSE_PLANE, Lobe, Maps, NORMAL_PLANE, ROUGHNESS_PLANE};
use crate::nn::{PhotoGraph, Prediction};
use crate::progress::Control;
use crate::render::render_maps;
use crate::shot::Shot;

const SEED: u64 = 20_240_101;
/// Width of the patch in the unit of positions.
const PATCH_SIZE: f64 = 2.0;

/// Scores by kind of capture and number of photos, such as `near 4`: `near` by a perfect camera above a level sample, `real` with every
/// defect and tilt.
pub type Validation = BTreeMap<String, Scores>;

/// Means over materials. RMSE of albedos and roughness are of linear values and of those in gamma 2.2, that of normals is of (n + 1) / 2.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Scores {
    /// RMSE of the diffuse albedo.
    #[serde(rename = "D")]
    pub diffuse: f64,
    /// The same in gamma 2.2.
    #[serde(rename = "D_gamma")]
    pub diffuse_gamma: f64,
    /// RMSE of the roughness.
    #[serde(rename = "R")]
    pub roughness: f64,
    /// The same in gamma 2.2.
    #[serde(rename = "R_gamma")]
    pub roughness_gamma: f64,
    /// RMSE of the specular albedo.
    #[serde(rename = "S")]
    pub specular: f64,
    /// The same in gamma 2.2.
    #[serde(rename = "S_gamma")]
    pub specular_gamma: f64,
    /// RMSE of the normals.
    #[serde(rename = "N")]
    pub normal: f64,
    /// Mean angle between the normals, in degrees.
    #[serde(rename = "N_deg")]
    pub normal_deg: f64,
    /// RMSE of re-renderings, gamma 2.2.
    pub rendering: f64,
    /// Share of the diffuse albedo whose error is below the predicted standard deviation.
    pub cover_diffuse: f64,
    /// The same of normals.
    pub cover_normal: f64,
    /// The same of roughness.
    pub cover_roughness: f64,
    /// The same of the specular albedo.
    pub cover_specular: f64,
}

impl Scores {
    fn values(&mut self) -> [&mut f64; 13] {
        let Self {
            diffuse,
            diffuse_gamma,
            roughness,
            roughness_gamma,
            specular,
            specular_gamma,
            normal,
            normal_deg,
            rendering,
            cover_diffuse,
            cover_normal,
            cover_roughness,
            cover_specular,
        } = self;
        [
            diffuse,
            diffuse_gamma,
            roughness,
            roughness_gamma,
            specular,
            specular_gamma,
            normal,
            normal_deg,
            rendering,
            cover_diffuse,
            cover_normal,
            cover_roughness,
            cover_specular,
        ]
    }

    /// Scores of one material.
    fn of(prediction: &Prediction, predicted: &Maps<f32>, truth: &Maps<f32>, shots: &[Shot]) -> Result<Self> {
        let pixels = truth.width() * truth.height();
        let rmse = |planes: Range<usize>, value: fn(f32) -> f64| {
            let range = planes.start * pixels..planes.end * pixels;
            root_mean_square(&predicted.data()[range.clone()], &truth.data()[range], value)
        };
        // Of raw planes, which hold no z of normals; the unit of sigma is the encoded map.
        let cover = |raw: Range<usize>, plane: usize, value: fn(f32) -> f64| {
            let at = plane * pixels..(plane + raw.len()) * pixels;
            let pairs = predicted.data()[at.clone()].iter().zip(&truth.data()[at]);
            let log_sigma = &prediction.log_sigma[raw.start * pixels..raw.end * pixels];
            let inside = pairs
                .zip(log_sigma)
                .filter(|((a, b), log_sigma)| (value(**a) - value(**b)).abs() < f64::from(**log_sigma).exp());
            inside.count() as f64 / log_sigma.len() as f64
        };
        let angles: f64 = (0..pixels)
            .map(|at| {
                let normal = |maps: &Maps<f32>| [0, 1, 2].map(|axis| f64::from(maps.plane(NORMAL_PLANE + axis)[at]));
                let (a, b) = (normal(predicted), normal(truth));
                (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]).clamp(-1.0, 1.0).acos().to_degrees()
            })
            .sum();
        let mut errors = 0.0;
        for shot in shots {
            let (a, b) = (render_maps(predicted, PATCH_SIZE, shot)?, render_maps(truth, PATCH_SIZE, shot)?);
            errors += root_mean_square(&a, &b, gamma).powi(2);
        }
        let specular = Lobe::Isotropic.specular_plane();
        Ok(Self {
            diffuse: rmse(DIFFUSE_PLANE..NORMAL_PLANE, f64::from),
            diffuse_gamma: rmse(DIFFUSE_PLANE..NORMAL_PLANE, gamma),
            roughness: rmse(ROUGHNESS_PLANE..specular, f64::from),
            roughness_gamma: rmse(ROUGHNESS_PLANE..specular, gamma),
            specular: rmse(specular..specular + 3, f64::from),
            specular_gamma: rmse(specular..specular + 3, gamma),
            normal: rmse(NORMAL_PLANE..ROUGHNESS_PLANE, f64::from) / 2.0,
            normal_deg: angles / pixels as f64,
            rendering: (errors / shots.len() as f64).sqrt(),
            cover_diffuse: cover(0..3, DIFFUSE_PLANE, gamma),
            cover_normal: cover(3..5, NORMAL_PLANE, f64::from),
            cover_roughness: cover(5..6, ROUGHNESS_PLANE, gamma),
            cover_specular: cover(6..9, specular, gamma),
        })
    }
}

/// As an 8-bit file in gamma 2.2 would hold it, without rounding.
fn gamma(value: f32) -> f64 {
    f64::from(value).clamp(0.0, 1.0).powf(1.0 / 2.2)
}

fn root_mean_square(a: &[f32], b: &[f32], value: fn(f32) -> f64) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(&a, &b)| (value(a) - value(b)).powi(2)).sum();
    (sum / a.len() as f64).sqrt()
}

/// Maps of whole materials, upright, `size` x `size` pixels.
pub(crate) fn held_out(textures: &[Texture], size: usize) -> Result<Vec<Maps<f32>>> {
    let crop = |texture: &Texture| {
        let step = texture.side() as f32 / size as f32;
        texture.sample(size, &Crop { step, angle: 0.0, centre: [0.5; 2], mirrored: false })
    };
    textures.iter().map(crop).collect()
}

/// Where re-renderings are compared, the same for every material: above the patch, light and camera together.
fn fixed_shots(views: usize) -> Vec<Shot> {
    // Distance, reach and the reading of a white patch that the PyTorch trainer happens to have drawn: so scores can be compared.
    const DISTANCE: f64 = 2.25;
    const REACH: f64 = 0.7;
    const WHITE: f64 = 0.444;
    let mut dice = Dice::new(SEED, Purpose::Validation, [u64::MAX, 0]);
    let mut uniform = |low: f64, high: f64| low + (high - low) * f64::from(dice.uniform(0.0, 1.0));
    let places: Vec<[f64; 3]> = (0..views)
        .map(|_| {
            let (radius, angle) = (REACH * uniform(0.0, 1.0).sqrt(), uniform(0.0, TAU));
            [radius * angle.cos(), radius * angle.sin(), DISTANCE * uniform(0.9, 1.1)]
        })
        .collect();
    let irradiance = |[x, y, z]: &[f64; 3]| z / (x * x + y * y + z * z).powf(1.5);
    let mean = places.iter().map(irradiance).sum::<f64>() / views as f64;
    let shot = |place| Shot { camera: place, light: place, light_intensity: [WHITE * PI / mean; 3] };
    places.into_iter().map(shot).collect()
}

/// A capture of material `number`; the same numbers give the same capture.
fn captured(maps: &Maps<f32>, family: Family, photos: usize, number: usize) -> Captured {
    let kind = u64::from(family == Family::Real) << 32 | photos as u64;
    let mut dice = Dice::new(SEED, Purpose::Validation, [kind, number as u64]);
    let geometry = draw_geometry(&mut dice, photos, &Habits::validation(family));
    match family {
        Family::Near => clean_photos(maps.clone(), geometry),
        Family::Real => photograph(maps.clone(), geometry, &mut dice),
    }
}

/// The capture as a user would give it.
fn capture(captured: &Captured) -> Result<Capture> {
    let size = captured.maps.width();
    let pixels = size * size;
    let photos = captured.photos.chunks_exact(3 * pixels).zip(captured.saturated.chunks_exact(pixels));
    let photos = photos.zip(&captured.stated.shots).enumerate().map(|(index, ((photo, saturated), shot))| {
        let linear: Vec<f32> = photo.iter().map(|&code| Transfer::Gamma22.decode(code)).collect();
        Ok(Photo {
            name: index.to_string(),
            shot: *shot,
            image: Image::from_planar(size, size, 3, &linear)?,
            saturated: saturated.iter().map(|&saturated| u8::from(saturated)).collect(),
        })
    });
    Capture::new(photos.collect::<Result<_>>()?, PATCH_SIZE, Transfer::Gamma22)
}

/// Pixels of all photos that [`validate`] shows the network.
pub(crate) fn work(materials: usize, settings: &ValidationSettings) -> f64 {
    let photos: usize = settings.photos.iter().sum();
    2.0 * materials as f64 * photos as f64 * (settings.size * settings.size) as f64
}

/// Scores of `network` on `maps` by kind of captures and number of photos.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled) if `control` says so; else as [`PhotoGraph::predict`].
pub(crate) fn validate(
    network: &PhotoGraph,
    maps: &[Maps<f32>],
    settings: &ValidationSettings,
    control: &mut Control<'_>,
) -> Result<Validation> {
    let shots = fixed_shots(settings.views);
    let mut results = Validation::new();
    for (family, name) in [(Family::Near, "near"), (Family::Real, "real")] {
        for &photos in &settings.photos {
            let mut means = Scores::default();
            for (number, maps) in maps.iter().enumerate() {
                let captured = captured(maps, family, photos, number);
                let prediction = network.predict(&capture(&captured)?, control)?;
                let predicted = network.maps(&prediction)?;
                let mut scores = Scores::of(&prediction, &predicted, &captured.maps, &shots)?;
                for (mean, value) in means.values().into_iter().zip(scores.values()) {
                    *mean += *value;
                }
            }
            for mean in means.values() {
                *mean = (1e5 * *mean / maps.len() as f64).round() / 1e5;
            }
            results.insert(format!("{name} {photos}"), means);
        }
    }
    Ok(results)
}
