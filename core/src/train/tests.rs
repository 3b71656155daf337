use std::collections::BTreeSet;
use std::f32::consts::{FRAC_PI_2, PI};
use std::path::Path;

use super::camera::{Habits, Lean, clean_photos, draw_geometry, draw_views, fixed_views, photograph};
use super::dice::{Dice, Purpose};
use super::noise::{Spectrum, Transform};
use super::texture::{Crop, Texture};
use super::{Batch, Captures, Data, KINDS, Library, Pool, Settings, augment, procedural, procedural_material};
use crate::maps::{Lobe, Maps};
use crate::nn::INPUTS;
use crate::render::render_maps;
use crate::shot::Shot;

fn is_material(maps: &Maps<f32>) {
    let data = maps.data();
    assert!(data.iter().all(|value| value.is_finite()));
    for at in 0..maps.width() * maps.height() {
        let [x, y, z] = [3, 4, 5].map(|plane| maps.plane(plane)[at]);
        assert!((x * x + y * y + z * z - 1.0).abs() < 4e-3 && z > 0.0, "{x} {y} {z}");
        let inside = |plane: usize| (0.0..=1.0).contains(&maps.plane(plane)[at]);
        assert!((0..3).chain(6..10).all(inside));
    }
}

fn mean(values: &[f32]) -> f32 {
    values.iter().sum::<f32>() / values.len() as f32
}

fn deviation(values: &[f32]) -> f32 {
    let mean = mean(values);
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f32>() / values.len() as f32).sqrt()
}

/// Periodic maps with a few waves in every plane.
fn smooth_material(side: usize) -> Maps<f32> {
    let (transform, mut dice) = (Transform::new(side), Dice::new(1, Purpose::Procedural, [1 << 40, 0]));
    let waves: Vec<Vec<f32>> = (0..9)
        .map(|_| {
            let wave = transform.noise(&mut dice, &Spectrum::new(3.0, 1.0, 0.02));
            wave.into_iter().map(|value| value.clamp(-2.0, 2.0)).collect()
        })
        .collect();
    let mut data = vec![0.0; 10 * side * side];
    for at in 0..side * side {
        let (x, y) = (0.2 * waves[0][at], 0.2 * waves[1][at]);
        let length = (x * x + y * y + 1.0).sqrt();
        let wave = |index: usize, middle: f32, amount: f32| middle + amount * waves[index][at];
        let [r, g, b] = [2, 3, 4].map(|index| wave(index, 0.4, 0.15));
        let [f, h, k] = [6, 7, 8].map(|index| wave(index, 0.3, 0.1));
        let values = [r, g, b, x / length, y / length, 1.0 / length, wave(5, 0.5, 0.1), f, h, k];
        values.into_iter().enumerate().for_each(|(plane, value)| data[plane * side * side + at] = value);
    }
    Maps::new(Lobe::Isotropic, side, side, data).unwrap()
}

#[test]
fn procedural_materials_are_materials_with_contents() {
    let transform = Transform::new(64);
    for kind in 0..KINDS as u64 {
        let [first, second] = [kind, kind + KINDS as u64].map(|n| procedural::material(3, n, &transform).unwrap());
        for maps in [&first, &second] {
            is_material(maps);
            let relief = deviation(maps.plane(3)).max(deviation(maps.plane(4)));
            assert!(relief > 1e-3, "{kind}: flat, {relief}");
            assert!(maps.plane(6).iter().all(|&roughness| roughness >= 0.07));
        }
        assert_eq!(first, procedural_material(3, kind, 64).unwrap());
        let apart = first.data().iter().zip(second.data()).map(|(a, b)| (a - b).abs()).sum::<f32>();
        assert!(apart > 1e-3 * first.data().len() as f32, "{kind}: two alike");
    }
    assert!(procedural_material(3, 0, 4).unwrap_err().to_string().contains("size: expected 8 to 4096, got 4"));
}

/// A turned (mirrored) material under camera and light turned (mirrored) with it gives the turned (mirrored) photo.
#[test]
fn turned_crops_look_as_under_a_turned_camera() {
    const SIDE: usize = 32;
    let texture = Texture::new(&smooth_material(SIDE));
    let crop = |angle: f32, mirrored: bool| {
        let middle = 0.5 - 0.5 / SIDE as f32;
        texture.sample(SIDE, &Crop { step: 1.0, angle, centre: [middle; 2], mirrored }).unwrap()
    };
    let shot = |turn: &dyn Fn([f64; 3]) -> [f64; 3]| Shot {
        camera: turn([0.7, 0.4, 2.2]),
        light: turn([-0.9, 1.1, 2.6]),
        light_intensity: [20.0; 3],
    };
    let photo = render_maps(&crop(0.0, false), 2.0, &shot(&|place| place)).unwrap();
    let most = photo.iter().copied().fold(0.0, f32::max);
    for quarter in 0..4 {
        for mirrored in [false, true] {
            let angle = quarter as f32 * FRAC_PI_2;
            let turn = |[x, y, z]: [f64; 3]| {
                let (sine, cosine) = f64::from(angle).sin_cos();
                let x_turned = cosine * x - sine * y;
                [if mirrored { -x_turned } else { x_turned }, sine * x + cosine * y, z]
            };
            let got = render_maps(&crop(angle, mirrored), 2.0, &shot(&turn)).unwrap();
            // Where a pixel of the turned photo was: rows and columns at the seam are interpolated across it.
            let mut largest = 0f32;
            for row in 2..SIDE - 2 {
                for column in 2..SIDE - 2 {
                    let (mut from, last) = ((row, if mirrored { SIDE - 1 - column } else { column }), SIDE - 1);
                    for _ in 0..quarter {
                        from = (from.1, last - from.0);
                    }
                    for channel in 0..3 {
                        let at = |(row, column): (usize, usize)| channel * SIDE * SIDE + row * SIDE + column;
                        largest = largest.max((got[at((row, column))] - photo[at(from)]).abs());
                    }
                }
            }
            assert!(largest < 0.02 * most, "{quarter} {mirrored}: {largest} of {most}");
        }
    }
}

#[test]
fn half_the_resolution_is_the_mean_of_the_whole() {
    let texture = Texture::new(&smooth_material(64));
    let crop = |size: usize, step: f32| {
        let centre = [0.5 - 0.5 / 64.0; 2];
        texture.sample(size, &Crop { step, angle: 0.0, centre, mirrored: false }).unwrap()
    };
    let (fine, coarse) = (crop(64, 1.0), crop(32, 2.0));
    for plane in 0..10 {
        for at in 0..32 * 32 {
            let (row, column) = (at / 32 * 2, at % 32 * 2);
            let near: Vec<f32> = [(0, 0), (0, 1), (1, 0), (1, 1)]
                .map(|(down, right)| fine.plane(plane)[(row + down) * 64 + column + right])
                .to_vec();
            let (got, expected) = (coarse.plane(plane)[at], mean(&near));
            assert!((got - expected).abs() < 0.03, "{plane} {at}: {got} {expected}");
        }
    }
}

#[test]
fn varied_and_mixed_materials_are_materials() {
    let transform = Transform::new(48);
    let materials: Vec<Maps<f32>> = (0..84).map(|n| procedural::material(1, n, &transform).unwrap()).collect();
    let (mut changed, mut mixed) = (0, 0);
    for (number, maps) in materials.iter().enumerate() {
        let mut dice = Dice::new(8, Purpose::Crop, [0, number as u64]);
        let mut varied = maps.clone();
        augment::vary(&mut varied, &mut dice);
        is_material(&varied);
        assert!(varied.plane(6).iter().all(|&roughness| roughness >= 0.07));
        let apart = |a: &Maps<f32>, b: &Maps<f32>| {
            a.data().iter().zip(b.data()).map(|(a, b)| (a - b).abs()).sum::<f32>() / a.data().len() as f32
        };
        changed += usize::from(apart(&varied, maps) > 0.01);
        let before = varied.clone();
        augment::mix(&mut varied, &materials[(number + 5) % 84], &mut dice);
        is_material(&varied);
        mixed += usize::from(varied != before);
    }
    // Four fifths change visibly; one in four is mixed (four standard errors: 16).
    assert!(changed > 67, "{changed}");
    assert!((5..=37).contains(&mixed), "{mixed}");
}

#[test]
fn strengthened_normals_are_steeper_in_the_same_direction() {
    let maps = smooth_material(48);
    let tilt =
        |maps: &Maps<f32>| mean(&(0..48 * 48).map(|at| maps.plane(3)[at].hypot(maps.plane(4)[at])).collect::<Vec<_>>());
    let ratios: Vec<f32> = (0..64)
        .map(|number| {
            let mut varied = maps.clone();
            augment::vary(&mut varied, &mut Dice::new(3, Purpose::Crop, [1, number]));
            let along: f32 =
                (3..5).flat_map(|plane| varied.plane(plane).iter().zip(maps.plane(plane))).map(|(a, b)| a * b).sum();
            assert!(along > 0.0, "{number}");
            tilt(&varied) / tilt(&maps)
        })
        .collect();
    let (low, high) = ratios.iter().fold((9f32, 0f32), |(low, high), &ratio| (low.min(ratio), high.max(ratio)));
    assert!(low < 0.6 && high > 1.6, "{low} {high}");
}

#[test]
fn geometry_keeps_to_its_ranges() {
    for (near, low, high, reach) in [(1.0, 2.0, 3.0, 1.2), (0.0, 3.0, 9.0, 2.4)] {
        let (mut straight, mut tiles) = (0, 0);
        for number in 0..400 {
            let mut dice = Dice::new(9, Purpose::Capture, [number, 0]);
            let geometry = draw_geometry(&mut dice, 3, &Habits::validation(near));
            let mut white = 0.0;
            for shot in &geometry.shots {
                let [x, y, z] = shot.camera;
                assert!((0.9 * low - 1e-4..1.1 * high + 1e-3).contains(&z) && x.hypot(y) <= reach + 1e-4, "{shot:?}");
                let [x, y, z] = shot.light;
                white += z / (x * x + y * y + z * z).powf(1.5) * shot.light_intensity[0] / f64::from(3.0 * PI);
                straight += usize::from(shot.camera == shot.light);
            }
            assert!((0.39..1.61).contains(&white), "{white}");
            let trained = draw_geometry(&mut dice, 3, &Habits::TRAINING).window;
            tiles += usize::from(trained.share < 0.999);
            assert!(trained.centre.iter().all(|centre| centre.abs() <= 1.0 - trained.share + 1e-6));
        }
        // Three in four have lamp and lens at one place; about two in three are tiles.
        assert!((820..980).contains(&straight), "{straight}");
        assert!((220..300).contains(&tiles), "{tiles}");
    }
    let captured = Captures::Paper.of(smooth_material(16), 5, &mut Dice::new(9, Purpose::Capture, [0, 0]));
    for shot in &captured.stated.shots {
        assert_eq!(shot.camera, shot.light);
        assert!((shot.camera[2] - 2.146).abs() < 1e-6 && shot.camera[0].hypot(shot.camera[1]) <= 1.2);
        assert!((shot.light_intensity[0] / (2.146f64.powi(2) * f64::from(PI)) - 1.0).abs() < 1e-6);
    }
}

#[test]
fn a_leaning_sample_has_leaning_normals() {
    let flat = |plane: usize| if plane == 5 { 1.0 } else { f32::from(u8::from(!(3..5).contains(&plane))) };
    let data = (0..10).flat_map(|plane| [flat(plane); 4]).collect();
    let level = Maps::new(Lobe::Isotropic, 2, 2, data).unwrap();
    for degrees in [0f32, 3.0, 9.0] {
        for towards in [0f32, 1.0, 4.0] {
            let lean = Lean { angle: degrees.to_radians(), towards };
            let mut maps = level.clone();
            lean.tilt(&mut maps);
            let [x, y, z] = [3, 4, 5].map(|plane| maps.plane(plane)[0]);
            assert!((z.acos().to_degrees() - degrees).abs() < 0.05, "{degrees}: {z}");
            // The surface's slope and its normal say the same.
            let [rise_x, rise_y] = lean.rise();
            assert!((rise_x + x / z).abs() < 1e-5 && (rise_y + y / z).abs() < 1e-5);
            assert!(degrees == 0.0 || ((y / z).atan2(x / z) - towards).sin().abs() < 1e-3);
        }
    }
}

#[test]
fn photos_are_those_of_a_camera() {
    let transform = Transform::new(32);
    let (mut errors, mut saturated, mut narrow) = (Vec::new(), 0, 0);
    for number in 0..32 {
        let mut dice = Dice::new(1, Purpose::Capture, [5, number]);
        let maps = procedural::material(2, number, &transform).unwrap();
        let geometry = draw_geometry(&mut dice, 4, &Habits::TRAINING);
        let captured = photograph(maps, geometry, &mut dice);
        is_material(&captured.maps);
        assert_eq!((captured.photos.len(), captured.saturated.len()), (4 * 3 * 1024, 4 * 1024));
        for value in &captured.photos {
            let code = value * 255.0;
            assert!((0.0..=255.0).contains(&code) && (code - code.round()).abs() < 1e-3);
        }
        let full: Vec<bool> = captured
            .photos
            .chunks_exact(3 * 1024)
            .flat_map(|photo| (0..1024).map(|at| (0..3).any(|channel| photo[channel * 1024 + at] == 1.0)))
            .collect();
        assert!(full.iter().zip(&captured.saturated).all(|(full, saturated)| !full || *saturated));
        narrow += usize::from(full == captured.saturated);
        saturated += full.iter().filter(|&&full| full).count();
        // What the camera saw is the material under about the stated geometry.
        let perfect = clean_photos(captured.maps.clone(), captured.stated.clone());
        let square: f32 = perfect.photos.iter().zip(&captured.photos).map(|(a, b)| (a - b).powi(2)).sum();
        errors.push((square / captured.photos.len() as f32).sqrt());
    }
    errors.sort_by(f32::total_cmp);
    assert!(errors[0] > 1e-3 && errors[16] < 0.08, "{errors:?}");
    assert!((12..32).contains(&narrow), "{narrow}");
    assert!((1..32 * 4 * 1024 / 2).contains(&saturated), "{saturated}");
}

/// A white matt patch, photographed by a perfect camera, is shown to the network as white: its ratio is its own albedo.
#[test]
fn the_network_sees_a_matt_surface_its_albedo() {
    let plane = |plane: usize| match plane {
        0..3 => 0.25,
        5 | 6 => 1.0,
        _ => 0.0,
    };
    let data = (0..10).flat_map(|at| [plane(at); 64]).collect();
    let maps = Maps::new(Lobe::Isotropic, 8, 8, data).unwrap();
    let mut dice = Dice::new(4, Purpose::Capture, [0, 0]);
    let captured = clean_photos(maps, draw_geometry(&mut dice, 5, &Habits::validation(1.0)));
    let mut inputs = vec![0.0; 5 * INPUTS * 64];
    super::camera::write_input(&captured, true, &mut inputs);
    for photo in inputs.chunks_exact(INPUTS * 64) {
        // What is left above the albedo is a faint lobe of roughness 1; and 8 bits.
        assert!(photo[3 * 64..6 * 64].iter().all(|ratio| (ratio - 0.25f32.powf(1.0 / 2.2)).abs() < 0.03));
        for first in [7, 10] {
            for at in 0..64 {
                let square: f32 = (first..first + 3).map(|plane| photo[plane * 64 + at].powi(2)).sum();
                assert!((square - 1.0).abs() < 1e-5);
            }
        }
    }
    super::camera::write_input(&captured, false, &mut inputs);
    for photo in inputs.chunks_exact(INPUTS * 64) {
        assert!(photo[..3 * 64].iter().any(|value| *value > 0.0));
        assert!(photo[3 * 64..6 * 64].iter().chain(&photo[7 * 64..]).all(|value| *value == 0.0));
    }
}

#[test]
fn renderings_are_compared_above_the_patch_and_where_it_mirrors() {
    let views = draw_views(&mut Dice::new(2, Purpose::Capture, [0, 0]), 9);
    for (index, view) in views.iter().enumerate() {
        let [[cx, cy, cz], [lx, ly, lz]] = [view.camera, view.light];
        assert!(cz > 0.0 && lz > 0.0);
        if index.is_multiple_of(3) {
            assert_eq!(view.camera, view.light);
            continue;
        }
        // The point at which light is mirrored into the camera divides their way as their heights do.
        let share = cz / (cz + lz);
        let point = [cx + share * (lx - cx), cy + share * (ly - cy)];
        assert!(point.iter().all(|place| place.abs() < 0.91), "{point:?}");
    }
    let fixed = fixed_views(20);
    assert!(fixed.iter().all(|view| view.camera == view.light && (2.0..2.5).contains(&view.camera[2])));
    assert_eq!(fixed.iter().map(|view| format!("{view:?}")).collect::<BTreeSet<_>>().len(), 20);
}

fn settings() -> Settings {
    Settings {
        seed: 1,
        photos: vec![1.0, 1.0, 1.0],
        procedural: 0.5,
        groups: 3,
        per_group: 2,
        refresh: 3,
        size: 32,
        captures: Captures::Any,
        directions: true,
        views: 5,
    }
}

/// A folder of three materials of 24 x 24 pixels, of which one is held out.
fn library(folder: &Path) -> Library {
    let mut rng = fastrand::Rng::with_seed(1);
    for name in ["a", "b", "c"] {
        let material = folder.join(name);
        std::fs::create_dir_all(&material).unwrap();
        for kind in ["basecolor", "normal", "roughness"] {
            let pixels: Vec<u8> = (0..24 * 24 * 3).map(|_| rng.u8(100..200)).collect();
            let file = material.join(format!("{kind}.png"));
            image::save_buffer(file, &pixels, 24, 24, image::ColorType::Rgb8).unwrap();
        }
    }
    Library::open(folder).unwrap()
}

#[test]
fn the_pool_follows_from_the_step() {
    let whole = Crop { step: 1.0, angle: 0.0, centre: [0.5; 2], mirrored: false };
    let see = |pool: &mut Pool, step: u64| -> Vec<Maps<f32>> {
        pool.at(step).unwrap().iter().map(|texture| texture.sample(32, &whole).unwrap()).collect()
    };
    let mut pool = Pool::new(&settings());
    let first = see(&mut pool, 0);
    assert_eq!(first.len(), 6);
    // Two materials in three steps: the first after two of them.
    let differ = |a: &[Maps<f32>], b: &[Maps<f32>]| a.iter().zip(b).filter(|(a, b)| a != b).count();
    for (step, replaced) in [(1, 0), (2, 1), (3, 2), (8, 5), (9, 6), (40, 6)] {
        let later = see(&mut pool, step);
        assert_eq!(differ(&first, &later), replaced, "{step}");
        assert_eq!(differ(&later, &see(&mut Pool::new(&settings()), step)), 0, "{step}");
    }
    // Back to an earlier step.
    assert_eq!(differ(&first, &see(&mut pool, 0)), 0);
}

#[test]
fn a_batch_follows_from_the_step() {
    let folder = tempfile::tempdir().unwrap();
    let data = |threads| Data::new(library(folder.path()), settings(), Some(threads)).unwrap();
    let (mut running, mut photos) = (data(1), BTreeSet::new());
    for step in 0..6 {
        let batch = running.batch(step, 4, 16).unwrap();
        let Batch { count, photos: of, size, compared, .. } = batch;
        photos.insert(of);
        assert_eq!((count, size, compared), (4, 16, 5));
        assert_eq!((batch.inputs.len(), batch.maps.len()), (4 * of * INPUTS * 256, 4 * 10 * 256));
        assert_eq!((batch.shots.len(), batch.views.len()), (4 * of * 9, 4 * 5 * 9));
        assert!(batch.inputs.iter().chain(&batch.maps).chain(&batch.views).all(|value| value.is_finite()));
        assert_eq!(batch, data(2).batch(step, 4, 16).unwrap());
        if step > 0 {
            assert_ne!(batch, data(2).batch(step - 1, 4, 16).unwrap());
        }
    }
    assert!(photos.len() > 1, "{photos:?}");
}

#[test]
fn materials_held_out_are_photographed_the_same_way_every_time() {
    let folder = tempfile::tempdir().unwrap();
    let data = Data::new(library(folder.path()), settings(), Some(2)).unwrap();
    let draw = |captures, photos| data.validation(captures, photos, 16, 0..1, 7).unwrap();
    for (_, captures) in Captures::ALL {
        assert_eq!(draw(captures, 2), draw(captures, 2));
        assert_ne!(draw(captures, 2).shots, draw(captures, 3).shots[..18]);
    }
    let (near, real) = (draw(Captures::Near, 2), draw(Captures::Real, 2));
    assert_eq!((near.views.len(), &near.views), (7 * 9, &real.views));
    assert_ne!(near.inputs, real.inputs);
    for materials in [0..0, 0..2, 1..2] {
        let message = data.validation(Captures::Near, 1, 16, materials, 7).unwrap_err().to_string();
        assert!(message.contains("materials: expected some of the 1 held out"), "{message}");
    }
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |change: &dyn Fn(&mut Settings), named: &str| {
        let mut settings = settings();
        change(&mut settings);
        let message = Data::new(library(folder.path()), settings, None).err().unwrap().to_string();
        assert!(message.contains(named), "{message}");
    };
    refused(&|s| s.procedural = 1.1, "procedural: expected 0 to 1, got 1.1");
    refused(&|s| s.procedural = f64::NAN, "procedural");
    refused(&|s| s.groups = 0, "groups: expected 1 to 65536, got 0");
    refused(&|s| s.per_group = 0, "per_group");
    refused(&|s| s.refresh = 0, "refresh");
    refused(&|s| s.size = 5000, "size: expected 8 to 4096, got 5000");
    refused(&|s| s.views = 0, "views");
    refused(&|s| s.photos = vec![], "photos");
    refused(&|s| s.photos = vec![0.0, 0.0], "photos");
    refused(&|s| s.photos = vec![1.0, -1.0], "photos");
    refused(&|s| (s.groups, s.per_group, s.size) = (65536, 65536, 4096), "procedural materials");
    let mut data = Data::new(library(folder.path()), settings(), None).unwrap();
    for (count, size, named) in [(0, 16, "count"), (5000, 16, "count"), (4, 4, "size"), (4, 5000, "size")] {
        assert!(data.batch(0, count, size).unwrap_err().to_string().contains(named));
    }
    assert!(data.batch(0, 4096, 4096).is_err());
}
