//! Radiance and gradient of the shading model against expected values computed elsewhere in double precision.

#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

#[allow(dead_code, reason = "shared by several tests")]
mod common;

use safetensors::SafeTensors;
use svbrdf_gcn::brdf::real::Real;
use svbrdf_gcn::brdf::{ROUGHNESS_MIN, Surface, shade_point, shade_point_gradient};
use svbrdf_gcn::{Lobe, Shot};

/// One point of a fixture: inputs, and what should come out. Gradients by alpha are by roughness here.
struct Case {
    surface: Surface<f64>,
    position: [f64; 3],
    shot: Shot,
    weight: [f64; 3],
    radiance: [f64; 3],
    gradient: Surface<f64>,
}

fn cases(lobe: Lobe) -> Vec<Case> {
    let name = match lobe {
        Lobe::Isotropic => "brdf/isotropic.safetensors",
        Lobe::Anisotropic => "brdf/anisotropic.safetensors",
    };
    let bytes = std::fs::read(common::fixture(name)).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let read = |name: &str| -> Vec<f64> {
        let data = file.tensor(name).unwrap();
        data.data().chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect()
    };
    let vectors = |name: &str| -> Vec<[f64; 3]> { read(name).chunks_exact(3).map(|v| v.try_into().unwrap()).collect() };
    let (diffuse, specular, normal) = (vectors("diffuse"), vectors("specular"), vectors("normal"));
    let (d_diffuse, d_specular, d_normal) = (vectors("grad_diffuse"), vectors("grad_specular"), vectors("grad_normal"));
    let (position, camera, light) = (vectors("position"), vectors("camera"), vectors("light"));
    let (power, weight, radiance) = (vectors("power"), vectors("weight"), vectors("radiance"));
    let count = radiance.len();
    let zero = vec![[0.0; 3]; count];
    let (roughness, d_roughness, tangent, d_tangent): (Vec<[f64; 2]>, Vec<[f64; 2]>, _, _) = match lobe {
        Lobe::Isotropic => (
            read("roughness").iter().map(|&r| [r, 0.0]).collect(),
            read("grad_roughness").iter().map(|&g| [g, 0.0]).collect(),
            zero.clone(),
            zero,
        ),
        Lobe::Anisotropic => {
            let alpha: Vec<[f64; 2]> = read("alpha").chunks_exact(2).map(|a| a.try_into().unwrap()).collect();
            let d_alpha = read("grad_alpha");
            let roughness: Vec<[f64; 2]> = alpha.iter().map(|a| a.map(f64::sqrt)).collect();
            let d_roughness = roughness.iter().zip(d_alpha.chunks_exact(2));
            let d_roughness = d_roughness.map(|(r, d)| [d[0] * 2.0 * r[0], d[1] * 2.0 * r[1]]).collect();
            (roughness, d_roughness, vectors("tangent"), vectors("grad_tangent"))
        }
    };
    (0..count)
        .map(|i| Case {
            surface: Surface {
                diffuse: diffuse[i],
                normal: normal[i],
                roughness: roughness[i],
                specular: specular[i],
                tangent: tangent[i],
            },
            position: position[i],
            shot: Shot { camera: camera[i], light: light[i], light_intensity: power[i] },
            weight: weight[i],
            radiance: radiance[i],
            gradient: Surface {
                diffuse: d_diffuse[i],
                normal: d_normal[i],
                roughness: d_roughness[i],
                specular: d_specular[i],
                tangent: d_tangent[i],
            },
        })
        .collect()
}

/// Largest deviations, each on its point's own scale.
#[derive(Clone, Copy, Debug, Default)]
struct Deviation {
    radiance: f64,
    diffuse: f64,
    specular: f64,
    normal: f64,
    roughness: f64,
    tangent: f64,
}

impl Deviation {
    fn worst(self) -> f64 {
        [self.radiance, self.diffuse, self.specular, self.normal, self.roughness, self.tangent]
            .into_iter()
            .fold(0.0, f64::max)
    }

    fn include(&mut self, other: Self) {
        self.radiance = self.radiance.max(other.radiance);
        self.diffuse = self.diffuse.max(other.diffuse);
        self.specular = self.specular.max(other.specular);
        self.normal = self.normal.max(other.normal);
        self.roughness = self.roughness.max(other.roughness);
        self.tangent = self.tangent.max(other.tangent);
    }
}

/// `got` against `expected` on the scales of the fixtures: the point's largest radiance; for gradients the larger of their own
/// size and sum |radiance * weight|, per unit of albedo, of roughness, or of an angle as small as the lobe is wide.
fn deviation(
    lobe: Lobe,
    case: &Case,
    expected: &([f64; 3], Surface<f64>),
    got: &([f64; 3], Surface<f64>),
) -> Deviation {
    fn relative<const N: usize>(expected: [f64; N], got: [f64; N], scale: f64) -> f64 {
        let size = expected.iter().fold(scale, |size, value| size.max(value.abs()));
        let error = expected.iter().zip(got).map(|(e, g)| (e - g).abs()).fold(0.0, f64::max);
        if error == 0.0 { 0.0 } else { error / size }
    }
    let weighted: f64 = expected.0.iter().zip(case.weight).map(|(r, w)| (r * w).abs()).sum();
    let roughness = case.surface.roughness.map(|roughness| roughness.max(ROUGHNESS_MIN));
    let alpha = match lobe {
        Lobe::Isotropic => roughness[0] * roughness[0],
        Lobe::Anisotropic => (roughness[0] * roughness[0]).min(roughness[1] * roughness[1]),
    };
    let (e, g) = (&expected.1, &got.1);
    Deviation {
        radiance: relative(expected.0, got.0, 0.0),
        diffuse: relative(e.diffuse, g.diffuse, weighted),
        specular: relative(e.specular, g.specular, weighted),
        normal: relative(e.normal, g.normal, weighted / alpha),
        roughness: (0..lobe.roughness_planes())
            .map(|i| relative([e.roughness[i]], [g.roughness[i]], weighted / roughness[i]))
            .fold(0.0, f64::max),
        tangent: relative(e.tangent, g.tangent, weighted / alpha),
    }
}

#[test]
fn double_precision_meets_the_expected_values() {
    for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
        let mut worst = Deviation::default();
        for case in cases(lobe) {
            let got = shade_point_gradient(lobe, &case.surface, case.position, &case.shot, case.weight);
            assert_eq!(got.0, shade_point(lobe, &case.surface, case.position, &case.shot));
            worst.include(deviation(lobe, &case, &(case.radiance, case.gradient), &got));
        }
        eprintln!("{lobe:?} f64: {worst:?}");
        assert!(worst.worst() < 1e-9, "{lobe:?} {worst:?}");
    }
}

fn to_f32<const N: usize>(values: [f64; N]) -> [f32; N] {
    values.map(|value| value as f32)
}

fn to_f64<T: Real, const N: usize>(values: [T; N]) -> [f64; N] {
    values.map(T::to_f64)
}

fn surface_to_f64<T: Real>(surface: &Surface<T>) -> Surface<f64> {
    Surface {
        diffuse: to_f64(surface.diffuse),
        normal: to_f64(surface.normal),
        roughness: to_f64(surface.roughness),
        specular: to_f64(surface.specular),
        tangent: to_f64(surface.tangent),
    }
}

#[test]
fn single_precision_follows_double_precision() {
    for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
        let (mut worst, mut worst_sharp) = (Deviation::default(), Deviation::default());
        for case in cases(lobe) {
            let surface = Surface {
                diffuse: to_f32(case.surface.diffuse),
                normal: to_f32(case.surface.normal),
                roughness: to_f32(case.surface.roughness),
                specular: to_f32(case.surface.specular),
                tangent: to_f32(case.surface.tangent),
            };
            let weight = to_f32(case.weight);
            let rounded = |values| to_f64(to_f32(values));
            let position = rounded(case.position);
            let shot = Shot {
                camera: rounded(case.shot.camera),
                light: rounded(case.shot.light),
                light_intensity: rounded(case.shot.light_intensity),
            };
            let (radiance, gradient) = shade_point_gradient(lobe, &surface, position, &shot, weight);
            let got = (to_f64(radiance), surface_to_f64(&gradient));
            let expected = shade_point_gradient(lobe, &surface_to_f64(&surface), position, &shot, to_f64(weight));
            let deviation = deviation(lobe, &case, &expected, &got);
            let sharpest = case.surface.roughness[..lobe.roughness_planes()].iter().fold(1.0_f64, |a, &r| a.min(r));
            if sharpest >= 0.05 { worst.include(deviation) } else { worst_sharp.include(deviation) }
        }
        eprintln!("{lobe:?} f32: {worst:?}\n    roughness below 0.05: {worst_sharp:?}");
        assert!(worst.worst() < 1e-4, "{lobe:?} {worst:?}");
    }
}
