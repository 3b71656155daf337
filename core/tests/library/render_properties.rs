//! What the renderer promises for all inputs in its ranges.

use proptest::prelude::*;
use svbrdf_gcn::brdf::{Surface, shade_point, shade_point_gradient};
use svbrdf_gcn::real::Real;
use svbrdf_gcn::render::{Target, encode_radiance, photo_loss, render_maps};
use svbrdf_gcn::{Lobe, Maps, Shot};

/// A number of [low, high], the ends more often than chance has it.
fn number(low: f64, high: f64) -> impl Strategy<Value = f64> + Clone {
    prop_oneof![8 => low..=high, 1 => Just(low), 1 => Just(high)]
}

fn three(component: impl Strategy<Value = f64> + Clone) -> impl Strategy<Value = [f64; 3]> {
    [component.clone(), component.clone(), component]
}

/// Roughness over its whole range, the sharp end on a logarithmic scale.
fn roughness() -> impl Strategy<Value = f64> {
    prop_oneof![number(0.0, 1.0), (-5.0..0.0).prop_map(|x: f64| 10.0_f64.powf(x))]
}

fn lobe() -> impl Strategy<Value = Lobe> {
    prop_oneof![Just(Lobe::Isotropic), Just(Lobe::Anisotropic)]
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    v.map(|x| x / length)
}

/// A point at least 0.05 from the origin, now and then below the surface or grazing it.
fn place() -> impl Strategy<Value = [f64; 3]> {
    let height = prop_oneof![6 => 0.05..5.0, 1 => -3.0..0.0, 2 => -1e-6..1e-6];
    (number(-4.0, 4.0), number(-4.0, 4.0), height)
        .prop_map(|(x, y, z)| [x, y, z])
        .prop_filter("too near the point", |p: &[f64; 3]| p.iter().map(|x| x * x).sum::<f64>() > 0.0025)
}

fn shot() -> impl Strategy<Value = Shot> {
    let intensity = three(prop_oneof![(-6.0..6.0).prop_map(|x: f64| 10.0_f64.powf(x)), Just(0.0)]);
    // The smallest distance is 1e-3, and intensity over squared distance up to 1e12.
    let scale = (-1.7..2.0).prop_map(|x: f64| 10.0_f64.powf(x));
    (place(), place(), any::<bool>(), scale, intensity).prop_map(
        |(camera, light, collocated, scale, light_intensity)| {
            let light = if collocated { camera } else { light };
            Shot { camera: camera.map(|x| x * scale), light: light.map(|x| x * scale), light_intensity }
        },
    )
}

fn surface() -> impl Strategy<Value = Surface<f64>> {
    let normal = prop_oneof![
        4 => (number(-1.0, 1.0), number(-1.0, 1.0), number(0.05, 1.0)).prop_map(|(x, y, z)| [x, y, z]),
        1 => three(number(-1.0, 1.0)),
    ];
    let albedo = || three(number(0.0, 1.0));
    (albedo(), normal, [roughness(), roughness()], albedo(), three(number(-1.0, 1.0))).prop_map(
        |(diffuse, normal, roughness, specular, tangent)| Surface { diffuse, normal, roughness, specular, tangent },
    )
}

/// Turns the normal into the mirror direction of `shot` exactly.
fn mirror(surface: &mut Surface<f64>, shot: &Shot) {
    let (v, l) = (unit(shot.camera), unit(shot.light));
    surface.normal = std::array::from_fn(|i| v[i] + l[i]);
}

fn map<T: Real, U: Real>(surface: &Surface<T>) -> Surface<U> {
    let to = |x: T| U::splat(x.to_f64());
    Surface {
        diffuse: surface.diffuse.map(to),
        normal: surface.normal.map(to),
        roughness: surface.roughness.map(to),
        specular: surface.specular.map(to),
        tangent: surface.tangent.map(to),
    }
}

fn values<T: Real>(surface: &Surface<T>, lobe: Lobe) -> Vec<T> {
    let mut values = surface.diffuse.to_vec();
    values.extend(surface.normal);
    values.extend(&surface.roughness[..lobe.roughness_planes()]);
    values.extend(surface.specular);
    if lobe == Lobe::Anisotropic {
        values.extend(surface.tangent);
    }
    values
}

/// Maps of one row of points.
fn maps_of<T: Real>(lobe: Lobe, points: &[Surface<f64>]) -> Maps<T> {
    let columns: Vec<Vec<T>> = points.iter().map(|point| values(&map(point), lobe)).collect();
    let data = (0..lobe.planes()).flat_map(|plane| columns.iter().map(move |column| column[plane])).collect();
    Maps::new(lobe, points.len(), 1, data).unwrap()
}

fn finite<T: Real>(values: &[T]) -> bool {
    values.iter().all(|value| value.to_f64().is_finite())
}

fn check_finite<T: Real>(lobe: Lobe, surface: &Surface<f64>, shot: &Shot) -> Result<(), TestCaseError> {
    let weight = [T::splat(1.0); 3];
    let (radiance, gradient) = shade_point_gradient(lobe, &map::<_, T>(surface), [0.0; 3], shot, weight);
    prop_assert!(finite(&radiance) && radiance.iter().all(|r| r.to_f64() >= 0.0), "{radiance:?}");
    prop_assert!(finite(&values(&gradient, lobe)), "{gradient:?}");

    let maps = maps_of::<T>(lobe, std::slice::from_ref(surface));
    let radiance = render_maps(&maps, 1.0, shot).unwrap();
    prop_assert!(finite(&radiance) && radiance.iter().all(|r| r.to_f64() >= 0.0), "{radiance:?}");
    for photo in [0.0, 0.5] {
        let target = Target::new(1, 1, *shot, &[photo; 3], &[2]).unwrap();
        let mut gradient = maps.clone();
        let loss = photo_loss(&maps, 1.0, &[target], Some(&mut gradient)).unwrap();
        prop_assert!(loss.is_finite() && finite(gradient.data()), "{loss} {gradient:?}");
    }
    Ok(())
}

/// Radiance divided by what the light brings: the value of the reflectance function.
fn reflectance(lobe: Lobe, surface: &Surface<f64>, camera: [f64; 3], light: [f64; 3]) -> [f64; 3] {
    let n_dot_l: f64 = unit(surface.normal).iter().zip(unit(light)).map(|(n, l)| n * l).sum();
    let distance2: f64 = light.iter().map(|x| x * x).sum();
    let shot = Shot { camera, light, light_intensity: [distance2; 3] };
    shade_point(lobe, surface, [0.0; 3], &shot).map(|radiance| radiance / n_dot_l)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn everything_is_finite_and_nothing_negative(
        lobe in lobe(), mut surface in surface(), shot in shot(), at_mirror in any::<bool>()
    ) {
        if at_mirror {
            mirror(&mut surface, &shot);
        }
        check_finite::<f64>(lobe, &surface, &shot)?;
        check_finite::<f32>(lobe, &surface, &shot)?;
    }

    #[test]
    fn degenerate_vectors_are_harmless(lobe in lobe(), mut surface in surface(), shot in shot(), kind in 0..4) {
        match kind {
            0 => surface.normal = [0.0; 3],
            1 => surface.tangent = [0.0; 3],
            2 => surface.tangent = surface.normal,
            _ => surface.tangent = surface.normal.map(|n| -1e3 * n),
        }
        check_finite::<f64>(lobe, &surface, &shot)?;
        check_finite::<f32>(lobe, &surface, &shot)?;
    }

    #[test]
    fn light_and_camera_can_be_exchanged(lobe in lobe(), surface in surface(), camera in place(), light in place()) {
        // Where a cosine is 0 but for rounding there is nothing to divide by.
        let cosine = |p| unit(surface.normal).iter().zip(unit(p)).map(|(n, p)| n * p).sum::<f64>();
        prop_assume!(cosine(camera).abs() > 1e-6 && cosine(light).abs() > 1e-6);
        let forth = reflectance(lobe, &surface, camera, light);
        let back = reflectance(lobe, &surface, light, camera);
        for (forth, back) in forth.into_iter().zip(back) {
            prop_assert!((forth - back).abs() <= 1e-9 * forth.abs(), "{forth} {back}");
        }
    }

    #[test]
    fn radiance_is_linear_in_the_intensity(lobe in lobe(), surface in surface(), shot in shot(), factor in 1e-3..1e3) {
        let brighter = Shot { light_intensity: shot.light_intensity.map(|i| i * factor), ..shot };
        let (one, other) = (shade_point(lobe, &surface, [0.0; 3], &shot), shade_point(lobe, &surface, [0.0; 3], &brighter));
        for (one, other) in one.into_iter().zip(other) {
            prop_assert!(f64::abs(one * factor - other) <= 1e-13 * other, "{one} {other}");
        }
    }

    #[test]
    fn below_the_horizon_it_is_black(lobe in lobe(), surface in surface(), shot in shot()) {
        let n = unit(surface.normal);
        let above = |p: [f64; 3]| n.iter().zip(p).map(|(n, p)| n * p).sum::<f64>() > 0.0;
        let radiance = shade_point(lobe, &surface, [0.0; 3], &shot);
        if !above(shot.camera) || !above(shot.light) {
            prop_assert_eq!(radiance, [0.0; 3]);
        }
    }

    #[test]
    fn roughness_below_the_smallest_changes_nothing(
        lobe in lobe(), mut surface in surface(), shot in shot(), below in [0.0..1e-3, 0.0..1e-3]
    ) {
        mirror(&mut surface, &shot);
        surface.roughness = below;
        let (radiance, gradient) = shade_point_gradient(lobe, &surface, [0.0; 3], &shot, [1.0; 3]);
        prop_assert_eq!(gradient.roughness, [0.0; 2]);
        surface.roughness = [1e-3; 2];
        prop_assert_eq!(radiance, shade_point(lobe, &surface, [0.0; 3], &shot));
    }

    /// Eight lanes against one: the same formulas, but fused multiply-adds and other powers of two.
    #[test]
    fn bundles_agree_with_single_pixels(
        lobe in lobe(), points in prop::collection::vec(surface(), 1..140), mut shot in shot(), seed in any::<u64>()
    ) {
        shot.light_intensity = [3.0, 2.0, 1.0];
        let width = points.len();
        let maps = maps_of::<f32>(lobe, &points);
        let radiance = render_maps(&maps, 2.0, &shot).unwrap();
        for (column, point) in points.iter().enumerate() {
            let x = ((column as f64 + 0.5) / width as f64 - 0.5) * 2.0;
            let expected = shade_point(lobe, &map::<_, f32>(point), [x, 0.0, 0.0], &shot);
            let scale = expected.iter().fold(0.0_f32, |a, &b| a.max(b));
            for c in 0..3 {
                let got = radiance[c * width + column];
                prop_assert!((got - expected[c]).abs() <= 3e-6 * scale, "{column} {c}: {got} {}",
                    expected[c]
                );
            }
        }

        // The loss and its gradient against double precision at the same values, on each pixel's own scale.
        let encoded: Vec<f32> = (0..3 * width).map(|i| ((seed.rotate_left(i as u32) & 0xff) as f32) / 255.0).collect();
        let target = Target::new(width, 1, shot, &encoded, &vec![0; width]).unwrap();
        let exact_maps = Maps::new(lobe, width, 1, maps.data().iter().map(|&x| f64::from(x)).collect()).unwrap();
        let exact_radiance = render_maps(&exact_maps, 2.0, &shot).unwrap();
        let (mut gradient, mut exact) = (maps.clone(), exact_maps.clone());
        let loss = photo_loss(&maps, 2.0, std::slice::from_ref(&target), Some(&mut gradient)).unwrap();
        let exact_loss = photo_loss(&exact_maps, 2.0, &[target], Some(&mut exact)).unwrap();
        // A rounding of what is compared moves a square by twice its root times the rounding.
        let squares = exact_radiance.iter().map(|&r| encode_radiance(r).powi(2)).chain(encoded.iter().map(|&e| f64::from(e * e)));
        let size = 1000.0 * squares.sum::<f64>() / (3.0 * width as f64);
        prop_assert!((loss - exact_loss).abs() <= 1e-6 * (exact_loss * size).sqrt() + 1e-12 * size, "{loss} {exact_loss}");
        for column in 0..width {
            // Sum of |d loss / d radiance| * radiance, as if the photo differed by at least the encoded radiance itself.
            let sensitivity: f64 = (0..3)
                .map(|c| {
                    let radiance = exact_radiance[c * width + column];
                    let value = encode_radiance(radiance);
                    (value - f64::from(encoded[c * width + column])).abs().max(value) * value
                })
                .sum::<f64>()
                * 2000.0
                / (3.0 * width as f64);
            let surface = map::<f64, f64>(&points[column]);
            let sharpest = surface.roughness[..lobe.roughness_planes()].iter().fold(1.0_f64, |a, &r| a.min(r)).max(1e-3);
            for plane in 0..lobe.planes() {
                let (got, expected) = (f64::from(gradient.plane(plane)[column]), exact.plane(plane)[column]);
                let per_unit = match plane {
                    3..6 => 1.0 / (sharpest * sharpest * length(surface.normal)),
                    6.. if plane < lobe.specular_plane() => 1.0 / sharpest,
                    _ if plane >= lobe.tangent_plane() => 1.0 / (sharpest * sharpest * across(surface.tangent, surface.normal)),
                    _ => 1.0,
                };
                let vector = match plane {
                    3..6 => 3..6,
                    _ if plane >= lobe.tangent_plane() => lobe.tangent_plane()..lobe.planes(),
                    _ => plane..plane + 1,
                };
                let scale = vector.map(|plane| exact.plane(plane)[column].abs()).fold(sensitivity * per_unit, f64::max);
                prop_assert!((got - expected).abs() <= 3e-5 * scale, "{column} plane {plane}: {got} {expected} {scale}");
            }
        }
    }
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Length of `v` at right angles to `n`.
fn across(v: [f64; 3], n: [f64; 3]) -> f64 {
    let n = unit(n);
    let along: f64 = v.iter().zip(n).map(|(v, n)| v * n).sum();
    length(std::array::from_fn(|i| v[i] - along * n[i])).max(1e-5)
}

/// Light reflected to all sides from direction `view`, as a share of what comes in from there: the lobe is sampled by its half vectors.
fn specular_albedo(lobe: Lobe, surface: &Surface<f64>, view: [f64; 3], steps: usize) -> f64 {
    let alpha = match lobe {
        Lobe::Isotropic => [surface.roughness[0].powi(2); 2],
        Lobe::Anisotropic => surface.roughness.map(|r| r * r),
    };
    let mut sum = 0.0;
    for i in 0..steps * steps {
        let u = ((i / steps) as f64 + 0.5) / steps as f64;
        let phi = std::f64::consts::TAU * ((i % steps) as f64 + 0.5) / steps as f64;
        // Slopes of GGX: h is distributed as D (n.h).
        let slope = (u / (1.0 - u)).sqrt();
        let h = unit([alpha[0] * slope * phi.cos(), alpha[1] * slope * phi.sin(), 1.0]);
        let v_dot_h: f64 = view.iter().zip(h).map(|(v, h)| v * h).sum();
        let light: [f64; 3] = std::array::from_fn(|k| 2.0 * v_dot_h * h[k] - view[k]);
        if v_dot_h <= 0.0 || light[2] <= 1e-9 {
            continue;
        }
        let q = (h[0] / alpha[0]).powi(2) + (h[1] / alpha[1]).powi(2) + h[2] * h[2];
        let density = h[2] / (std::f64::consts::PI * alpha[0] * alpha[1] * q * q) / (4.0 * v_dot_h);
        let shot = Shot { camera: view, light, light_intensity: [1.0; 3] };
        sum += shade_point(lobe, surface, [0.0; 3], &shot)[0] / density;
    }
    sum / (steps * steps) as f64
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, failure_persistence: None, ..ProptestConfig::default() })]

    /// The lobe alone reflects no more than it receives: Smith's masking makes D G1(v) / (4 n.v) integrate to 1, its counterpart for
    /// the light only takes away, and Schlick's form with k = alpha/2 lies below Smith's. Diffuse light comes on top: the model
    /// takes (1 - F0), not (1 - F), of it, so the whole is bounded by 1 + d (1 - s), and not by 1.
    #[test]
    fn the_lobe_reflects_at_most_what_it_receives(
        lobe in lobe(), roughness in [0.05..1.0, 0.05..1.0], elevation in 0.02..1.0, azimuth in 0.0..std::f64::consts::TAU
    ) {
        let mut surface = Surface {
            diffuse: [0.0; 3],
            normal: [0.0, 0.0, 1.0],
            roughness,
            specular: [1.0; 3],
            tangent: [1.0, 0.0, 0.0],
        };
        let sine = f64::sqrt(1.0 - elevation * elevation);
        let view = [sine * f64::cos(azimuth), sine * f64::sin(azimuth), elevation];
        let albedo = specular_albedo(lobe, &surface, view, 96);
        prop_assert!(albedo < 1.01, "{albedo}");
        // And hardly less where masking and the horizon do not matter.
        if elevation > 0.7 && roughness.iter().all(|&r| r < 0.4) {
            prop_assert!(albedo > 0.9, "{albedo}");
        }
        // A smaller F0 reflects less, by Fresnel's term at most the same.
        surface.specular = [0.04; 3];
        let dielectric = specular_albedo(lobe, &surface, view, 96);
        prop_assert!(dielectric < albedo && dielectric > 0.04 * albedo * 0.99, "{dielectric} {albedo}");
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
        let (width, height) = (150, 131);
        let data = (0..lobe.planes() * width * height).map(|i| 0.5 + 0.45 * (i as f32 * 0.37).sin()).collect();
        let maps = Maps::new(lobe, width, height, data).unwrap();
        let targets: Vec<Target> = (0..3)
            .map(|i| {
                let camera = [f64::from(i), 0.5, 3.0];
                let shot = Shot { camera, light: [0.3, f64::from(i), 2.5], light_intensity: [9.0; 3] };
                Target::new(width, height, shot, &vec![0.4; 3 * width * height], &vec![1; width * height]).unwrap()
            })
            .collect();
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut gradient = maps.clone();
                let loss = photo_loss(&maps, 2.0, &targets, Some(&mut gradient)).unwrap();
                assert_eq!(loss, photo_loss(&maps, 2.0, &targets, None).unwrap());
                (loss, gradient, render_maps(&maps, 2.0, targets[0].shot()).unwrap())
            })
        };
        let one = run(1);
        for threads in [2, 3, 5] {
            assert!(run(threads) == one);
        }
    }
}

#[test]
fn what_is_not_a_number_does_not_vanish() {
    let shot = Shot { camera: [0.3, 0.0, 2.0], light: [0.0, 0.0, 2.0], light_intensity: [9.0; 3] };
    for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
        for plane in 0..lobe.planes() {
            let mut data = vec![0.5; lobe.planes()];
            data[plane] = f32::NAN;
            let maps = Maps::new(lobe, 1, 1, data).unwrap();
            let target = Target::new(1, 1, shot, &[0.5; 3], &[0]).unwrap();
            assert!(photo_loss(&maps, 1.0, &[target], None).unwrap().is_nan(), "{lobe:?} plane {plane}");
        }
    }
}
