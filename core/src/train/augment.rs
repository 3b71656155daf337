//! Variation of crops: everything is drawn per material.

use std::f32::consts::PI;

use super::dice::Dice;
use crate::maps::{DIFFUSE_PLANE, Lobe, Maps, NORMAL_PLANE, ROUGHNESS_PLANE};

/// First plane of the specular albedo.
const SPECULAR_PLANE: usize = Lobe::Isotropic.specular_plane();
/// Smallest z of a normal that slopes are read from.
const GRAZING: f32 = 0.1;

/// Varies colours, gloss and relief of a crop.
pub(super) fn vary(maps: &mut Maps<f32>, dice: &mut Dice) {
    recolour(maps, dice);
    respecular(maps, dice);
    reroughen(maps, dice);
    rebump(maps, dice);
}

fn rgb(maps: &Maps<f32>, plane: usize, at: usize) -> [f32; 3] {
    let pixels = maps.width() * maps.height();
    std::array::from_fn(|channel| maps.data()[(plane + channel) * pixels + at])
}

fn set_rgb(maps: &mut Maps<f32>, plane: usize, at: usize, values: [f32; 3]) {
    let pixels = maps.width() * maps.height();
    for (channel, value) in values.into_iter().enumerate() {
        maps.data_mut()[(plane + channel) * pixels + at] = value;
    }
}

fn mean(values: &[f32]) -> f32 {
    (values.iter().map(|&value| f64::from(value)).sum::<f64>() / values.len() as f64) as f32
}

/// Mean of three planes from `plane` on.
fn mean_rgb(maps: &Maps<f32>, plane: usize) -> f32 {
    let pixels = maps.width() * maps.height();
    mean(&maps.data()[plane * pixels..(plane + 3) * pixels])
}

/// Linear RGB turned about the grey axis by the angle of this sine and cosine, not below 0.
fn hue_turned([r, g, b]: [f32; 3], (sine, cosine): (f32, f32)) -> [f32; 3] {
    let grey = (r + g + b) / 3.0;
    let cross = [b - g, r - b, g - r].map(|value| value / 3f32.sqrt());
    std::array::from_fn(|c| ([r, g, b][c] * cosine + cross[c] * sine + grey * (1.0 - cosine)).max(0.0))
}

/// Hue, saturation, brightness and contrast of the albedos.
fn recolour(maps: &mut Maps<f32>, dice: &mut Dice) {
    if !dice.chance(0.6) {
        return;
    }
    let angle = if dice.chance(0.4) { dice.uniform(-PI, PI) } else { dice.normal(0.1) };
    let saturation = dice.uniform(0.0, 1.5);
    let bright = dice.normal(0.4).exp();
    let gain = [0; 3].map(|_| bright * dice.normal(0.08).exp());
    let contrast = dice.normal(0.2).exp();
    let turn = angle.sin_cos();
    let change = |color: [f32; 3], gain: [f32; 3]| -> [f32; 3] {
        let color = hue_turned(color, turn);
        let grey = color.iter().sum::<f32>() / 3.0;
        std::array::from_fn(|c| ((grey + saturation * (color[c] - grey)) * gain[c]).clamp(0.0, 1.0))
    };
    let mean = mean_rgb(maps, DIFFUSE_PLANE).max(1e-3);
    for at in 0..maps.width() * maps.height() {
        let diffuse = rgb(maps, DIFFUSE_PLANE, at).map(|value| mean * (value / mean).max(1e-4).powf(contrast));
        set_rgb(maps, DIFFUSE_PLANE, at, change(diffuse, gain).map(|value| value.min(0.95)));
        // Metals keep their brightness; dielectrics have no hue to turn.
        let specular = change(rgb(maps, SPECULAR_PLANE, at), [1.0; 3]);
        set_rgb(maps, SPECULAR_PLANE, at, specular);
    }
}

/// Strength and tint of the specular albedo, and conversions to metal.
fn respecular(maps: &mut Maps<f32>, dice: &mut Dice) {
    let strength = if dice.chance(0.5) { dice.uniform(0.6, 1.4) } else { dice.normal(0.6).exp() };
    let tint = if dice.chance(0.3) { [0; 3].map(|_| dice.uniform(0.6, 1.0)) } else { [1.0; 3] };
    // Coats of any strength over the diffuse albedo: photographed surfaces read as 0.02 to 0.5, libraries of dielectrics hold 0.04 alone.
    let coat = if dice.chance(0.45) { Some(dice.log_uniform(0.02, 0.5)) } else { None };
    // The pattern of the diffuse albedo carried over into a metal's reflectance.
    let pixels = maps.width() * maps.height();
    let most = maps.data()[..3 * pixels].iter().copied().fold(0.02, f32::max);
    let metal = dice.uniform(0.4, 1.0) / most;
    let was_metal = mean_rgb(maps, SPECULAR_PLANE) > 0.2;
    let converted = dice.chance(0.08);
    let amount = if dice.chance(0.7) { 1.0 } else { dice.uniform(0.0, 1.0) };
    let amount = if converted && !was_metal { amount } else { 0.0 };
    for at in 0..pixels {
        let (diffuse, specular) = (rgb(maps, DIFFUSE_PLANE, at), rgb(maps, SPECULAR_PLANE, at));
        let dielectric = 1.0 - ((specular.iter().sum::<f32>() / 3.0 - 0.05) / 0.15).clamp(0.0, 1.0);
        let specular = std::array::from_fn(|c| {
            let mut value = (specular[c] * strength * tint[c]).clamp(0.01, 1.0);
            if let Some(coat) = coat {
                value += dielectric * (coat * tint[c] - value);
            }
            value + amount * ((diffuse[c] * metal).clamp(0.04, 1.0) - value)
        });
        set_rgb(maps, SPECULAR_PLANE, at, specular);
        set_rgb(maps, DIFFUSE_PLANE, at, diffuse.map(|value| value * (1.0 - amount)));
    }
}

/// Level, contrast and direction of roughness.
fn reroughen(maps: &mut Maps<f32>, dice: &mut Dice) {
    let mean = mean(maps.plane(ROUGHNESS_PLANE));
    let contrast = dice.normal(0.4).exp() * if dice.chance(0.1) { -1.0 } else { 1.0 };
    let level = if dice.chance(0.45) { dice.uniform(0.1, 0.8) } else { mean + dice.normal(0.08) };
    let changed = dice.chance(0.7);
    for value in maps.plane_mut(ROUGHNESS_PLANE) {
        let new = if changed { level + (*value - mean) * contrast } else { *value };
        *value = new.clamp(0.07, 1.0);
    }
}

/// Slopes to the right and upwards of a normal; grazing ones are limited.
fn slopes([x, y, z]: [f32; 3]) -> [f32; 2] {
    let z = z.max(GRAZING);
    [-x / z, -y / z]
}

/// The inverse of [`slopes`].
fn normal([x, y]: [f32; 2]) -> [f32; 3] {
    let length = (x * x + y * y + 1.0).sqrt();
    [-x / length, -y / length, 1.0 / length]
}

/// Normals strengthened or flattened, and gentle undulation as of cloth or a warped board.
fn rebump(maps: &mut Maps<f32>, dice: &mut Dice) {
    let (width, height) = (maps.width(), maps.height());
    let mut relief: Vec<[f32; 2]> = (0..width * height).map(|at| slopes(rgb(maps, NORMAL_PLANE, at))).collect();
    let power: f64 = relief.iter().map(|[x, y]| f64::from(x * x + y * y)).sum();
    let rms = ((power / relief.len() as f64).sqrt() as f32).max(1e-3);
    // One in four is brought to a drawn strength: most photographed libraries are too flat.
    let factor = if dice.chance(0.25) { dice.uniform(-3.2, -0.6).exp() / rms } else { dice.normal(0.5).exp() };
    let factor = if dice.chance(0.7) { factor.clamp(0.1, 8.0) } else { 1.0 };
    let factor = factor.min(0.9 / rms);
    for slopes in &mut relief {
        *slopes = slopes.map(|slope| (slope * factor).clamp(-3.0, 3.0));
    }
    if dice.chance(0.3) {
        let amount = dice.uniform(0.0, 0.08);
        for axis in 0..2 {
            let wave = smooth(dice, 3, width, height);
            relief.iter_mut().zip(wave).for_each(|(slopes, wave)| slopes[axis] += amount * wave);
        }
    }
    for (at, slopes) in relief.into_iter().enumerate() {
        set_rgb(maps, NORMAL_PLANE, at, normal(slopes));
    }
}

/// One in four materials is mixed with `other`, of the same size: by a mask with soft or hard edges, or evenly.
pub(super) fn mix(maps: &mut Maps<f32>, other: &Maps<f32>, dice: &mut Dice) {
    if !dice.chance(0.25) {
        return;
    }
    let (width, height) = (maps.width(), maps.height());
    let mask: Vec<f32> = if dice.chance(0.3) {
        vec![dice.uniform(0.2, 0.8); width * height]
    } else {
        let cells = if dice.chance(0.5) { 2 } else { 9 };
        let mut field = smooth(dice, cells, width, height);
        // The relief of the first material may decide where the second lies: in the dents or on the tops.
        if dice.chance(0.4) {
            let bright: Vec<f32> =
                (0..field.len()).map(|at| rgb(maps, DIFFUSE_PLANE, at).iter().sum::<f32>() / 3.0).collect();
            let mean = mean(&bright);
            let power: f64 = bright.iter().map(|value| f64::from(value - mean).powi(2)).sum();
            let amount = dice.uniform(0.0, 1.5) / ((power / bright.len() as f64).sqrt() as f32).max(1e-3);
            field.iter_mut().zip(bright).for_each(|(field, bright)| *field += amount * (bright - mean));
        }
        let (edge, width) = (dice.uniform(-1.0, 1.0), dice.uniform(-4.6, 0.0).exp());
        field.into_iter().map(|field| ((field - edge) / width + 0.5).clamp(0.0, 1.0)).collect()
    };
    let normals: Vec<[f32; 3]> = mask
        .iter()
        .enumerate()
        .map(|(at, mask)| {
            let (a, b) = (slopes(rgb(maps, NORMAL_PLANE, at)), slopes(rgb(other, NORMAL_PLANE, at)));
            normal(std::array::from_fn(|axis| a[axis] + mask * (b[axis] - a[axis])))
        })
        .collect();
    let planes = maps.data_mut().chunks_exact_mut(mask.len()).zip(other.data().chunks_exact(mask.len()));
    for (plane, other) in planes {
        plane.iter_mut().zip(other).zip(&mask).for_each(|((value, other), mask)| *value += mask * (other - *value));
    }
    for (at, normal) in normals.into_iter().enumerate() {
        set_rgb(maps, NORMAL_PLANE, at, normal);
    }
}

/// A smooth random field with mean 0 and deviation about 1, `cells` bumps across.
fn smooth(dice: &mut Dice, cells: usize, width: usize, height: usize) -> Vec<f32> {
    let side = cells + 3;
    let coarse: Vec<f32> = (0..side * side).map(|_| dice.normal(1.0)).collect();
    enlarged(&coarse, side, width, height)
}

/// A square field enlarged by cubic convolution, corner on corner.
///
/// # Source
/// Keys, "Cubic convolution interpolation for digital image processing" (1981), with the parameter -0.75 of PyTorch's `interpolate`; beyond the
/// edge the field goes on as it is there.
fn enlarged(coarse: &[f32], side: usize, width: usize, height: usize) -> Vec<f32> {
    const A: f32 = -0.75;
    // Four places and their weights for every pixel along an axis.
    let taps = |length: usize| -> Vec<[(usize, f32); 4]> {
        (0..length)
            .map(|at| {
                let place = at as f32 * (side - 1) as f32 / (length.max(2) - 1) as f32;
                let t = place - place.floor();
                let near = |t: f32| ((A + 2.0) * t - (A + 3.0)) * t * t + 1.0;
                let far = |t: f32| ((A * t - 5.0 * A) * t + 8.0 * A) * t - 4.0 * A;
                let weights = [far(t + 1.0), near(t), near(1.0 - t), far(2.0 - t)];
                std::array::from_fn(|tap| ((place as usize + tap).saturating_sub(1).min(side - 1), weights[tap]))
            })
            .collect()
    };
    let (columns, rows) = (taps(width), taps(height));
    let wide: Vec<f32> = coarse
        .chunks_exact(side)
        .flat_map(|row| columns.iter().map(|taps| taps.iter().map(|&(place, weight)| weight * row[place]).sum()))
        .collect();
    rows.iter()
        .flat_map(|taps| {
            let wide = &wide;
            (0..width)
                .map(move |column| taps.iter().map(|&(place, weight)| weight * wide[place * width + column]).sum())
        })
        .collect()
}
