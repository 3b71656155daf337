//! The nine raw planes of isotropic maps: what the default network predicts and the finish fits. Albedos and roughness are gamma 2.2 codes `c` as `2 c - 1`, the
//! normal is its x and y. [`Decoding`](crate::nn::Decoding) makes maps of them.

use crate::color::Transfer;
use crate::deviations::Deviations;
use crate::error::Result;
use crate::image::Image;
use crate::maps::{DIFFUSE_PLANE, Maps, NORMAL_PLANE, ROUGHNESS_PLANE};

/// Raw values of a pixel, in the order of the network's outputs: diffuse 3, normal x and y, roughness, specular 3.
pub const RAW: usize = 9;
/// Places of the raw values.
pub const NORMAL: usize = 3;
pub const ROUGHNESS: usize = 5;
pub const SPECULAR: usize = 6;

/// The raw planes of isotropic maps: the inverse of [`Decoding`](crate::nn::Decoding).
pub fn encode(maps: &Maps<f32>, floor: f32, raw: &mut [f32]) {
    let pixels = maps.width() * maps.height();
    for (i, plane) in raw.chunks_exact_mut(pixels).enumerate() {
        let map = match i {
            ..5 => i,
            _ => i + 1,
        };
        match i {
            3 | 4 => {
                for (p, value) in plane.iter_mut().enumerate() {
                    let [x, y, z] = [0, 1, 2].map(|c| maps.plane(NORMAL_PLANE + c)[p]);
                    *value = maps.plane(map)[p] / (x * x + y * y + z * z).sqrt().max(f32::MIN_POSITIVE);
                }
            }
            _ => {
                let low = if map == ROUGHNESS_PLANE { floor } else { -1.0 };
                let code = |value: f32| 2.0 * Transfer::Gamma22.encode(value) - 1.0;
                plane.iter_mut().zip(maps.plane(map)).for_each(|(raw, &value)| *raw = code(value).clamp(low, 1.0));
            }
        }
    }
}

/// Standard deviations of `maps` from those of nine planes of raw values.
pub fn deviations(maps: &Maps<f32>, raw: &[f32]) -> Result<Deviations> {
    let (width, height) = (maps.width(), maps.height());
    let pixels = width * height;
    // A raw value is twice a gamma 2.2 code, less 1.
    let linear = |value: f32, raw: f32| 0.5 * 2.2 * Transfer::Gamma22.encode(value).powf(1.2) * raw;
    let image = |at: &dyn Fn(usize) -> f32| Image::new(width, height, 1, (0..pixels).map(at).collect());
    let color = |first: usize, first_raw: usize| {
        image(&|p| {
            let of = |c: usize| linear(maps.plane(first + c)[p], raw[(first_raw + c) * pixels + p]);
            ((of(0).powi(2) + of(1).powi(2) + of(2).powi(2)) / 3.0).sqrt()
        })
    };
    Ok(Deviations {
        diffuse_albedo: color(DIFFUSE_PLANE, 0)?,
        specular_albedo: color(maps.lobe().specular_plane(), SPECULAR)?,
        roughness: image(&|p| linear(maps.plane(ROUGHNESS_PLANE)[p], raw[ROUGHNESS * pixels + p]))?,
        normal: image(&|p| raw[NORMAL * pixels + p].hypot(raw[(NORMAL + 1) * pixels + p]))?,
    })
}
