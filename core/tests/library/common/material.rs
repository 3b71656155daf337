//! A material for tests that only need one.

use svbrdf_gcn::{Image, Material};

/// A flat material of `side` x `side` pixels, whose albedos and roughness are noise.
pub fn noise(side: usize) -> Material {
    let image = |channels: usize, value: fn(usize) -> f32| {
        Image::new(side, side, channels, (0..side * side * channels).map(value).collect()).unwrap()
    };
    let noise = |i: usize| (i * 7919 % 1009) as f32 / 1009.0;
    Material {
        diffuse_albedo: image(3, noise),
        specular_albedo: image(3, noise),
        roughness: image(1, noise),
        normal: image(3, |i| f32::from(u8::from(i % 3 == 2))),
        tangent: None,
        patch_size: 1.0,
        unit: None,
        warnings: Vec::new(),
    }
}
