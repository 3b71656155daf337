//! Against PyTorch (`python/training/fixture_data.py`) where nothing is random, and in the mean where something is.

use std::path::PathBuf;

use safetensors::SafeTensors;

use super::camera::{Captured, Geometry, Habits, Window, draw_geometry, draw_views, network_input, photograph};
use super::dice::{Dice, Purpose};
use super::noise::Transform;
use super::texture::{Crop, Texture};
use super::{augment, procedural};
use crate::capture::Shot;
use crate::maps::{Lobe, Maps, NORMAL_PLANE};
use crate::nn::INPUTS;

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
