//! The renderer and the loss against the shading of single points, and their gradients against central differences in f64.

use svbrdf_gcn::brdf::{Surface, shade_point, shade_point_gradient};
use svbrdf_gcn::render::{TOE, Target, encode_radiance, photo_loss, render_maps};
use svbrdf_gcn::{Error, Lobe, Maps, Shot};

/// A small generator of reproducible numbers (xorshift64*).
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }
}

const PATCH: f64 = 7.5;

fn shots(numbers: &mut Numbers) -> Vec<Shot> {
    let mut at = |height: f64| [numbers.between(-4.0, 4.0), numbers.between(-4.0, 4.0), height];
    let collocated = at(12.0);
    let (camera, light) = (at(10.0), at(6.0));
    let grazing = [9.0, 0.3, 0.05];
    let intensity = [310.0, 290.0, 200.0];
    vec![
        Shot { camera: collocated, light: collocated, light_intensity: intensity },
        Shot { camera, light, light_intensity: intensity },
        Shot { camera, light: grazing, light_intensity: intensity },
        Shot { camera: grazing, light: grazing, light_intensity: intensity },
    ]
}

fn random_maps(lobe: Lobe, width: usize, height: usize, numbers: &mut Numbers) -> Maps<f64> {
    let pixels = width * height;
    let data = (0..lobe.planes() * pixels)
        .map(|i| match i / pixels {
            3 | 4 => numbers.between(-0.4, 0.4),
            5 => numbers.between(0.7, 1.3),
            plane if plane >= lobe.tangent_plane() => numbers.between(-1.0, 1.0),
            plane if (6..lobe.specular_plane()).contains(&plane) => numbers.between(0.1, 1.0),
            _ => numbers.next(),
        })
        .collect();
    Maps::new(lobe, width, height, data).unwrap()
}

fn surface_at(maps: &Maps<f64>, pixel: usize) -> Surface<f64> {
    let lobe = maps.lobe();
    let three = |first: usize| [0, 1, 2].map(|i| maps.plane(first + i)[pixel]);
    Surface {
        diffuse: three(0),
        normal: three(3),
        roughness: [maps.plane(6)[pixel], if lobe == Lobe::Anisotropic { maps.plane(7)[pixel] } else { 0.0 }],
        specular: three(lobe.specular_plane()),
        tangent: if lobe == Lobe::Anisotropic { three(lobe.tangent_plane()) } else { [0.0; 3] },
    }
}

#[test]
fn pixels_are_shaded_where_they_lie() {
    let mut numbers = Numbers(1);
    for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
        let (width, height) = (5, 3);
        let maps = random_maps(lobe, width, height, &mut numbers);
        for shot in shots(&mut numbers) {
            let radiance = render_maps(&maps, PATCH, &shot).unwrap();
            for (row, column) in (0..height).flat_map(|row| (0..width).map(move |column| (row, column))) {
                let x = ((column as f64 + 0.5) / width as f64 - 0.5) * PATCH;
                let y = -((row as f64 + 0.5) / height as f64 - 0.5) * PATCH * height as f64 / width as f64;
                let pixel = row * width + column;
                let expected = shade_point(lobe, &surface_at(&maps, pixel), [x, y, 0.0], &shot);
                for c in 0..3 {
                    let got = radiance[c * width * height + pixel];
                    assert!(
                        (got - expected[c]).abs() <= 1e-11 * expected[c],
                        "{row} {column} {c}: {got} {}",
                        expected[c]
                    );
                }
            }
        }
    }
}

/// A photo of other maps, partly saturated, partly black.
fn targets(lobe: Lobe, width: usize, height: usize, numbers: &mut Numbers) -> Vec<Target> {
    let mut shots = shots(numbers);
    shots.truncate(3);
    shots
        .into_iter()
        .map(|shot| {
            let radiance = render_maps(&random_maps(lobe, width, height, numbers), PATCH, &shot).unwrap();
            let encoded: Vec<f32> = radiance.into_iter().map(|r| encode_radiance(r.min(1.0)) as f32).collect();
            let saturated: Vec<u8> = (0..width * height).map(|_| (numbers.next() * 8.0) as u8).collect();
            Target::new(width, height, shot, &encoded, &saturated).unwrap()
        })
        .collect()
}

#[test]
fn gradient_of_the_loss_is_its_difference_quotient() {
    let mut numbers = Numbers(2);
    for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
        let (width, height) = (3, 2);
        let targets = targets(lobe, width, height, &mut numbers);
        let mut maps = random_maps(lobe, width, height, &mut numbers);
        // A pixel in the toe: dark and rough, with no specular reflection to speak of.
        for (plane, value) in [(0, 1e-7), (1, 2e-7), (2, 0.0)] {
            maps.plane_mut(plane)[1] = value;
        }
        let mut gradient = maps.clone();
        let loss = photo_loss(&maps, PATCH, &targets, Some(&mut gradient)).unwrap();
        assert_eq!(loss, photo_loss(&maps, PATCH, &targets, None).unwrap());
        for i in 0..maps.data().len() {
            let at = |step: f64| {
                let mut moved = maps.clone();
                moved.data_mut()[i] += step;
                photo_loss(&moved, PATCH, &targets, None).unwrap()
            };
            let quotient = |h: f64| (at(h) - at(-h)) / (2.0 * h);
            // Richardson's extrapolation removes the error of second order.
            let h = 1e-5;
            let expected = (4.0 * quotient(h) - quotient(2.0 * h)) / 3.0;
            let got = gradient.data()[i];
            let tolerance = 1e-6 * expected.abs().max(1.0);
            assert!((got - expected).abs() < tolerance, "{lobe:?} plane {} {got} {expected}", i / (width * height));
        }
    }
}

#[test]
fn gradient_of_a_point_is_its_difference_quotient() {
    let mut numbers = Numbers(3);
    for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
        for trial in 0..400 {
            let maps = random_maps(lobe, 1, 1, &mut numbers);
            let mut values = maps.data().to_vec();
            let shot = shots(&mut numbers)[trial % 4];
            // Hard points: a sharp lobe seen on its flank, near the mirror direction.
            if trial % 2 == 1 {
                let narrow = if trial % 4 == 1 { 0.02 } else { 0.1 };
                let unit = |p: [f64; 3]| p.map(|x| x / p.iter().map(|x| x * x).sum::<f64>().sqrt());
                let (v, l) = (unit(shot.camera), unit(shot.light));
                for i in 0..3 {
                    values[3 + i] = v[i] + l[i] + narrow * narrow * numbers.between(-1.0, 1.0);
                }
                for roughness in &mut values[6..lobe.specular_plane()] {
                    *roughness = narrow * numbers.between(0.7, 1.4);
                }
            }
            let weight = [numbers.between(-1.0, 1.0), numbers.between(-1.0, 1.0), numbers.between(-1.0, 1.0)];
            let surface = |values: &[f64]| surface_at(&Maps::new(lobe, 1, 1, values.to_vec()).unwrap(), 0);
            let at = |values: &[f64]| -> f64 {
                let radiance = shade_point(lobe, &surface(values), [0.0; 3], &shot);
                radiance.iter().zip(weight).map(|(r, w)| r * w).sum()
            };
            let (radiance, gradient) = shade_point_gradient(lobe, &surface(&values), [0.0; 3], &shot, weight);
            let size: f64 = radiance.iter().zip(weight).map(|(r, w)| (r * w).abs()).sum();
            let mut analytic = gradient.diffuse.to_vec();
            analytic.extend(gradient.normal);
            analytic.extend(&gradient.roughness[..lobe.roughness_planes()]);
            analytic.extend(gradient.specular);
            if lobe == Lobe::Anisotropic {
                analytic.extend(gradient.tangent);
            }
            let longest = |vector: &[f64]| vector.iter().fold(0.0_f64, |a, t| a.max(t.abs()));
            let alpha = values[6..lobe.specular_plane()].iter().fold(1.0_f64, |a, &r| a.min(r * r));
            for i in 0..values.len() {
                // Length over which the radiance changes: the lobe's width for normal and tangent, the value itself for roughness.
                let length = match i {
                    3..6 => alpha,
                    _ if i >= lobe.tangent_plane() => alpha * longest(&values[lobe.tangent_plane()..]),
                    6.. if i < lobe.specular_plane() => values[i],
                    _ => 1.0,
                };
                let quotient = |h: f64| {
                    let moved = |step: f64| {
                        let mut moved = values.clone();
                        moved[i] += step;
                        at(&moved)
                    };
                    (moved(h) - moved(-h)) / (2.0 * h)
                };
                let h = 1e-3 * length;
                let expected = (4.0 * quotient(h) - quotient(2.0 * h)) / 3.0;
                let scale = expected.abs().max(size / length);
                let error = (analytic[i] - expected).abs() / scale.max(1e-30);
                assert!(error < 1e-6, "{lobe:?} trial {trial} value {i}: {} {expected} {error:e}", analytic[i]);
            }
        }
    }
}

#[test]
fn encoding_is_the_power_law_above_the_toe_and_smooth_below() {
    for i in 1..=255 {
        let code = f64::from(i) / 255.0;
        assert!((encode_radiance(code.powf(2.2)) - code).abs() < 1e-15);
    }
    assert_eq!(encode_radiance(0.0), 0.0);
    let slope = |x: f64, h: f64| (encode_radiance(x + h) - encode_radiance(x - h)) / (2.0 * h);
    // Value and slope continue at both ends of the toe.
    assert!((encode_radiance(TOE * (1.0 + 1e-12)) - encode_radiance(TOE)).abs() < 1e-14);
    let (below, above) = (slope(TOE * (1.0 - 1e-4), TOE * 1e-5), slope(TOE * (1.0 + 1e-4), TOE * 1e-5));
    assert!((below / above - 1.0).abs() < 1e-3, "{below} {above}");
    assert!((slope(0.0, 1e-12) - 2896.0).abs() < 1.0, "{}", slope(0.0, 1e-12));
    // Strictly rising everywhere.
    let mut last = encode_radiance(-1e-3);
    for i in -100..300 {
        let value = encode_radiance(f64::from(i) * TOE / 100.0);
        assert!(value > last);
        last = value;
    }
}

#[test]
fn saturated_pixels_ask_for_no_less() {
    let shot = Shot { camera: [0.0, 0.0, 2.0], light: [0.0, 0.0, 2.0], light_intensity: [30.0; 3] };
    let maps = Maps::new(Lobe::Isotropic, 1, 1, vec![0.5, 0.5, 0.5, 0.0, 0.0, 1.0, 0.6, 0.04, 0.04, 0.04]).unwrap();
    let radiance = render_maps(&maps, 1.0, &shot).unwrap();
    let loss = |offset: f32, saturated: u8| {
        let encoded: Vec<f32> = radiance.iter().map(|&r| encode_radiance(r) as f32 + offset).collect();
        let target = Target::new(1, 1, shot, &encoded, &[saturated]).unwrap();
        let mut gradient = maps.clone();
        (photo_loss(&maps, 1.0, &[target], Some(&mut gradient)).unwrap(), gradient)
    };
    // Brighter than a saturated photo: nothing to correct. Darker: the usual error.
    let (value, gradient) = loss(-0.1, 7);
    assert_eq!(value, 0.0);
    assert!(gradient.data().iter().all(|&g| g == 0.0));
    assert!((loss(-0.1, 5).0 - 10.0 / 3.0).abs() < 1e-3);
    assert!((loss(-0.1, 0).0 - 10.0).abs() < 1e-3);
    assert!((loss(0.1, 7).0 - 10.0).abs() < 1e-3);
}

#[test]
fn bad_arguments_are_named() {
    let shot = Shot { camera: [0.0, 0.0, 2.0], light: [0.0, 0.0, 2.0], light_intensity: [1.0; 3] };
    let maps = Maps::new(Lobe::Isotropic, 1, 1, vec![0.5_f32; 10]).unwrap();
    let name = |error: Error| match error {
        Error::InvalidArgument { name, .. } | Error::ShapeMismatch { name, .. } => name,
        other => panic!("{other}"),
    };
    for patch_size in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(name(render_maps(&maps, patch_size, &shot).unwrap_err()), "patch_size");
    }
    let nan = [0.0, f64::NAN, 1.0];
    assert_eq!(name(render_maps(&maps, 1.0, &Shot { camera: nan, ..shot }).unwrap_err()), "camera");
    assert_eq!(name(render_maps(&maps, 1.0, &Shot { light: nan, ..shot }).unwrap_err()), "light");
    for intensity in [nan, [-1.0, 0.0, 0.0]] {
        let shot = Shot { light_intensity: intensity, ..shot };
        assert_eq!(name(render_maps(&maps, 1.0, &shot).unwrap_err()), "light_intensity");
    }
    assert_eq!(name(photo_loss(&maps, 1.0, &[], None).unwrap_err()), "targets");
    let target = Target::new(2, 1, shot, &[0.0; 6], &[0; 2]).unwrap();
    assert_eq!(name(photo_loss(&maps, 1.0, &[target], None).unwrap_err()), "target");
    let target = Target::new(1, 1, shot, &[0.0; 3], &[0]).unwrap();
    let mut gradient = Maps::new(Lobe::Anisotropic, 1, 1, vec![0.0; 14]).unwrap();
    assert_eq!(name(photo_loss(&maps, 1.0, &[target], Some(&mut gradient)).unwrap_err()), "gradient");
    assert_eq!(name(Target::new(1, 1, shot, &[0.0; 2], &[0]).unwrap_err()), "target");
    assert_eq!(name(Target::new(1, 1, shot, &[f32::NAN; 3], &[0]).unwrap_err()), "target");
}
