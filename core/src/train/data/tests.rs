//! Against PyTorch (`python/training/fixture_data.py`) where nothing is random, and in the mean where something is.

use std::path::PathBuf;

use rayon::prelude::*;
use safetensors::SafeTensors;

use super::camera::{Captured, Habits, Window, draw_geometry, draw_views, network_input, photograph};
use super::dice::{Dice, Purpose};
use super::noise::Transform;
use super::texture::{Crop, Texture};
use super::{Data, Pool, augment, procedural};
use crate::maps::{Lobe, Maps, NORMAL_PLANE};
use crate::nn::INPUTS;
use crate::shot::Shot;
use crate::train::Configuration;
use crate::train::batch::Batch;

const SIZE: usize = 14;
const PIXELS: usize = SIZE * SIZE;

struct Expected(Vec<u8>);

impl Expected {
    fn open() -> Self {
        let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/training/data.safetensors");
        Self(std::fs::read(path).unwrap())
    }

    fn get(&self, name: &str) -> Vec<f32> {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        file.tensor(name).unwrap().data().as_chunks().0.iter().map(|&value| f32::from_le_bytes(value)).collect()
    }

    fn maps(&self, name: &str) -> Maps<f32> {
        Maps::new(Lobe::Isotropic, SIZE, SIZE, self.get(name)).unwrap()
    }

    /// For every pair of fixed numbers: its index, and dice that give them.
    fn draws(&self) -> impl Iterator<Item = (usize, Dice)> {
        self.get("draws").as_chunks().0.to_vec().into_iter().map(|[u, g]| Dice::fixed(u, g)).enumerate()
    }
}

fn compare(got: &[f32], expected: &[f32], tolerance: f32, what: &str) {
    assert_eq!(got.len(), expected.len(), "{what}");
    for (at, (got, expected)) in got.iter().zip(expected).enumerate() {
        let off = (got - expected).abs() / expected.abs().max(1.0);
        assert!(off <= tolerance, "{what} {at}: {got}, expected {expected}");
    }
}

fn numbers(shots: &[Shot]) -> Vec<f32> {
    shots
        .iter()
        .flat_map(|shot| [shot.camera, shot.light, shot.light_intensity].concat())
        .map(|value| value as f32)
        .collect()
}

#[test]
fn crops() {
    let expected = Expected::open();
    let texture = Texture::new(&expected.maps("maps"));
    for (number, &[step, angle, x, y, flip]) in expected.get("crops").as_chunks().0.iter().enumerate() {
        let crop = Crop { step, angle, centre: [x, y], mirrored: flip < 0.0 };
        let got = texture.sample(8, &crop).unwrap();
        // PyTorch's places in a texture come from a grid in [-1, 1].
        compare(got.data(), &expected.get(&format!("crop {number}")), 1e-4, "crop");
    }
}

#[test]
fn variation() {
    let expected = Expected::open();
    for (number, mut dice) in expected.draws() {
        let mut maps = expected.maps("maps");
        augment::vary(&mut maps, &mut dice);
        compare(maps.data(), &expected.get(&format!("varied {number}")), 1e-4, "varied");
        let mut maps = expected.maps("maps");
        augment::mix(&mut maps, &expected.maps("other"), &mut dice);
        compare(maps.data(), &expected.get(&format!("mixed {number}")), 1e-5, "mixed");
    }
}

#[test]
fn captures() {
    let expected = Expected::open();
    for (number, mut dice) in expected.draws() {
        let get = |name: &str| expected.get(&format!("{name} {number}"));
        compare(&numbers(&draw_views(&mut dice, 4)), &get("views"), 1e-5, "views");
        let geometry = draw_geometry(&mut dice, 2, &Habits::TRAINING);
        let captured = photograph(expected.maps("maps"), geometry, &mut dice);
        let Window { share, centre: [x, y] } = captured.stated.window;
        compare(&[share, x, y], &get("window"), 1e-5, "window");
        compare(&numbers(&captured.stated.shots), &get("shots"), 1e-4, "shots");
        let normals = NORMAL_PLANE * PIXELS..(NORMAL_PLANE + 3) * PIXELS;
        compare(&captured.maps.data()[normals], &get("normal"), 1e-5, "normal");
        // Codes of 8 bits: a few lie on the edge between two.
        compare(&captured.photos, &get("photos"), 1.01 / 255.0, "photos");
        let other = captured.photos.iter().zip(get("photos")).filter(|(got, expected)| (**got - expected).abs() > 1e-6);
        assert!(other.count() <= captured.photos.len() / 100);

        // From the photos that PyTorch has.
        let saturated: Vec<bool> = get("saturated").iter().map(|&value| value > 0.5).collect();
        let off = saturated.iter().zip(&captured.saturated).filter(|(a, b)| a != b).count();
        assert!(off <= saturated.len() / 100, "{off}");
        let captured = Captured { photos: get("photos"), saturated, ..captured };
        let inputs = network_input(&captured);
        assert_eq!(inputs.len(), 2 * INPUTS * PIXELS);
        compare(&inputs, &get("inputs"), 1e-4, "inputs");
    }
}

/// Means and deviations over materials of: mean diffuse albedo, roughness, specular albedo, root mean square of the slopes; and the mean
/// deviation of the roughness within a material.
#[derive(Debug, Default)]
struct Statistics(Vec<[f64; 5]>);

impl Statistics {
    fn add(&mut self, maps: &Maps<f32>) {
        let pixels = (maps.width() * maps.height()) as f64;
        let sum = |planes: std::ops::Range<usize>, value: &dyn Fn(f64) -> f64| {
            planes.flat_map(|plane| maps.plane(plane)).map(|&v| value(v.into())).sum::<f64>() / pixels
        };
        let rough = sum(6..7, &|value| value);
        let slopes: f64 = (0..maps.width() * maps.height())
            .map(|at| {
                let [x, y, z] = [3, 4, 5].map(|plane| f64::from(maps.plane(plane)[at]));
                (x * x + y * y) / z.max(0.1).powi(2)
            })
            .sum();
        let spread = sum(6..7, &|value| (value - rough).powi(2)).sqrt();
        let diffuse = sum(0..3, &|value| value) / 3.0;
        let specular = sum(7..10, &|value| value) / 3.0;
        self.0.push([diffuse, rough, specular, (slopes / pixels).sqrt(), spread]);
    }

    fn means(&self) -> [f64; 5] {
        std::array::from_fn(|index| self.0.iter().map(|row| row[index]).sum::<f64>() / self.0.len() as f64)
    }

    fn deviations(&self) -> [f64; 5] {
        let means = self.means();
        std::array::from_fn(|index| {
            let power: f64 = self.0.iter().map(|row| (row[index] - means[index]).powi(2)).sum();
            (power / self.0.len() as f64).sqrt()
        })
    }
}

/// Fails with all that is off. `expected` are means and deviations of `from` materials; means may be off by four standard errors, deviations,
/// whose own error depends on their distribution's tails, by a third.
fn agree(name: &str, got: &Statistics, expected: [[f64; 5]; 2], from: f64) -> Vec<String> {
    let (means, deviations) = (got.means(), got.deviations());
    let error = (1.0 / from + 1.0 / got.0.len() as f64).sqrt();
    let mut off = Vec::new();
    for index in 0..5 {
        let [mean, deviation] = expected.map(|values| values[index]);
        if (means[index] - mean).abs() > 4.0 * deviation * error + 1e-3 {
            off.push(format!("{name}, mean {index}: {:.4}, expected {mean}", means[index]));
        }
        if (deviations[index] - deviation).abs() > deviation / 3.0 + 1e-3 {
            off.push(format!("{name}, deviation {index}: {:.4}, expected {deviation}", deviations[index]));
        }
    }
    off
}

/// Measured with python/training: 1000 materials of each kind, 64 x 64 pixels; 8400 variations of 100 of each; and a capture of each of those.
const KINDS: [(&str, [[f64; 5]; 2]); 14] = [
    ("painted", [[0.2696, 0.3521, 0.0752, 0.0407, 0.0298], [0.2056, 0.142, 0.0733, 0.0373, 0.0167]]),
    ("brushed", [[0.0, 0.3209, 0.5639, 0.062, 0.0447], [0.0, 0.1015, 0.1551, 0.0359, 0.0143]]),
    ("hammered", [[0.0805, 0.281, 0.4013, 0.2369, 0.0494], [0.1707, 0.0918, 0.2367, 0.1179, 0.0277]]),
    ("rusted", [[0.0472, 0.4468, 0.4148, 0.1448, 0.1351], [0.0733, 0.1598, 0.1763, 0.087, 0.0788]]),
    ("chipped", [[0.2144, 0.3817, 0.1826, 0.1501, 0.0812], [0.1629, 0.1154, 0.119, 0.0664, 0.0511]]),
    ("scratched", [[0.1308, 0.2166, 0.3228, 0.066, 0.0373], [0.1984, 0.0771, 0.267, 0.0275, 0.0157]]),
    ("flakes", [[0.1192, 0.3192, 0.2036, 0.0994, 0.0666], [0.0969, 0.0941, 0.1142, 0.0721, 0.0497]]),
    ("woven", [[0.1785, 0.6044, 0.1186, 0.2857, 0.0491], [0.1228, 0.2091, 0.0938, 0.1458, 0.0031]]),
    ("leather", [[0.1459, 0.4253, 0.0805, 0.2241, 0.0267], [0.1063, 0.129, 0.0816, 0.1016, 0.0074]]),
    ("tiled", [[0.2409, 0.4146, 0.128, 0.2048, 0.1493], [0.148, 0.1295, 0.1576, 0.0891, 0.0658]]),
    ("grained", [[0.1699, 0.4733, 0.0785, 0.0928, 0.0417], [0.084, 0.1872, 0.0766, 0.0601, 0.0172]]),
    ("printed", [[0.2496, 0.4173, 0.1216, 0.0621, 0.0861], [0.1306, 0.1511, 0.1057, 0.0493, 0.0884]]),
    ("stucco", [[0.3651, 0.6528, 0.0814, 0.2754, 0.0281], [0.1943, 0.2008, 0.0815, 0.165, 0.0196]]),
    ("ribbed", [[0.1414, 0.4801, 0.2979, 0.3127, 0.03], [0.1959, 0.1944, 0.2679, 0.166, 0.0]]),
];
const VARIED: [[f64; 5]; 2] = [[0.1641, 0.4234, 0.2519, 0.1796, 0.0709], [0.1738, 0.1883, 0.2217, 0.1522, 0.0662]];
/// Mean and deviation of the photos, share of saturated pixels, mean ratio to white, mean difference between neighbours.
const CAPTURED: [[f64; 5]; 2] = [[0.4921, 0.1606, 0.0931, 0.5793, 0.0637], [0.1623, 0.0787, 0.1345, 0.2177, 0.0498]];

#[test]
fn materials_and_captures_in_the_mean() {
    const EACH: usize = 100;
    let transform = Transform::new(64);
    let materials: Vec<Maps<f32>> = (0..EACH * KINDS.len())
        .into_par_iter()
        .map(|number| procedural::material(7, number as u64, &transform).unwrap())
        .collect();
    let mut off = Vec::new();
    for (kind, (name, expected)) in KINDS.into_iter().enumerate() {
        let mut statistics = Statistics::default();
        materials.iter().skip(kind).step_by(KINDS.len()).for_each(|maps| statistics.add(maps));
        off.extend(agree(name, &statistics, expected, 1000.0));
    }
    let varied: Vec<Maps<f32>> = materials
        .par_iter()
        .enumerate()
        .map(|(number, maps)| {
            let mut maps = maps.clone();
            augment::vary(&mut maps, &mut Dice::new(1, Purpose::Crop, [0, number as u64]));
            maps
        })
        .collect();
    let results: Vec<([f64; 5], Maps<f32>)> = (0..varied.len())
        .into_par_iter()
        .map(|number| {
            let mut dice = Dice::new(1, Purpose::Capture, [0, number as u64]);
            let mut maps = varied[number].clone();
            augment::mix(&mut maps, &varied[(number * 37 + 11) % varied.len()], &mut dice);
            let mixed = maps.clone();
            let geometry = draw_geometry(&mut dice, 2, &Habits::TRAINING);
            let captured = photograph(maps, geometry, &mut dice);
            let inputs = network_input(&captured);
            assert!(inputs.iter().all(|value| value.is_finite()));
            let photos = &captured.photos;
            let mean = |values: &mut dyn Iterator<Item = f32>| {
                let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + f64::from(value), count + 1.0));
                sum / count
            };
            let bright = mean(&mut photos.iter().copied());
            let spread = mean(&mut photos.iter().map(|value| (value - bright as f32).powi(2))).sqrt();
            let saturated = mean(&mut captured.saturated.iter().map(|&saturated| f32::from(u8::from(saturated))));
            let planes = inputs.chunks_exact(64 * 64).enumerate();
            let ratio =
                mean(&mut planes.filter(|(plane, _)| (3..6).contains(&(plane % INPUTS))).flat_map(|(_, p)| p).copied());
            let rows = photos.chunks_exact(64);
            let step = mean(&mut rows.flat_map(|row| row.windows(2).map(|pair| (pair[1] - pair[0]).abs())));
            ([bright, spread, saturated, ratio, step], mixed)
        })
        .collect();
    let mut statistics = Statistics::default();
    results.iter().for_each(|(_, maps)| statistics.add(maps));
    off.extend(agree("varied", &statistics, VARIED, 1400.0));
    let captured = Statistics(results.into_iter().map(|(row, _)| row).collect());
    off.extend(agree("captured", &captured, CAPTURED, 1400.0));
    assert!(off.is_empty(), "{}", off.join("\n"));
}

/// Settings of a small pool.
fn settings() -> Configuration {
    let text = "[data]\ngroups = 3\nper_group = 2\nrefresh = 3\nsize = 32\nprocedural = 0.5";
    Configuration::parse("test", text, &[]).unwrap()
}

fn material(number: u64) -> Texture {
    Texture::new(&procedural::material(3, number, &Transform::new(32)).unwrap())
}

#[test]
fn the_pool_follows_from_the_step() {
    let whole = Crop { step: 1.0, angle: 0.0, centre: [0.5; 2], mirrored: false };
    let see = |pool: &mut Pool, step: u64| -> Vec<Maps<f32>> {
        pool.at(step).unwrap().iter().map(|texture| texture.sample(32, &whole).unwrap()).collect()
    };
    let mut pool = Pool::new(1, &settings().data);
    let first = see(&mut pool, 0);
    assert_eq!(first.len(), 6);
    // Two materials in three steps: the first after two of them.
    let differ = |a: &[Maps<f32>], b: &[Maps<f32>]| a.iter().zip(b).filter(|(a, b)| a != b).count();
    for (step, replaced) in [(1, 0), (2, 1), (3, 2), (8, 5), (9, 6), (40, 6)] {
        let later = see(&mut pool, step);
        assert_eq!(differ(&first, &later), replaced, "{step}");
        assert_eq!(differ(&later, &see(&mut Pool::new(1, &settings().data), step)), 0, "{step}");
    }
    // Back to an earlier step.
    assert_eq!(differ(&first, &see(&mut pool, 0)), 0);
}

#[test]
fn a_batch_follows_from_the_step() {
    let data = || Data::new(&settings(), vec![material(0), material(1)]);
    let values = |batch: &Batch| -> Vec<Vec<f32>> {
        batch.examples.iter().map(|example| [&example.inputs[..], &example.maps].concat()).collect()
    };
    let mut running = data();
    for step in 0..6 {
        let batch = running.batch(step, 4, 16).unwrap();
        assert_eq!((batch.height, batch.width, batch.examples.len()), (16, 16, 4));
        for example in &batch.examples {
            assert_eq!((example.inputs.len(), example.maps.len()), (batch.photos * INPUTS * 256, 10 * 256));
            assert_eq!(example.views.len(), 9);
            assert!(example.inputs.iter().chain(&example.maps).all(|value| value.is_finite()));
        }
        let again = data().batch(step, 4, 16).unwrap();
        assert_eq!(values(&batch), values(&again));
        let views = |batch: &Batch| batch.examples.iter().flat_map(|e| e.views.clone()).collect::<Vec<_>>();
        assert_eq!(views(&batch), views(&again));
        if step > 0 {
            assert_ne!(values(&batch), values(&data().batch(step - 1, 4, 16).unwrap()));
        }
    }
}
