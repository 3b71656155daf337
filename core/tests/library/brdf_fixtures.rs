//! Radiance and gradient of the shading model against expected values computed elsewhere in double precision.

use crate::common;
use safetensors::SafeTensors;
use svbrdf_gcn::brdf::{ROUGHNESS_MIN, Surface, shade_point, shade_point_gradient};
use svbrdf_gcn::real::Real;
use svbrdf_gcn::render::{Target, encode_radiance, photo_loss, render_maps};
use svbrdf_gcn::{Lobe, Maps, Shot};

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

fn to_f32<const N: usize>(values: [f64; N]) -> [f32; N] {
    values.map(|value| value as f32)
}

fn to_f64<const N: usize>(values: [f32; N]) -> [f64; N] {
    values.map(f64::from)
}

fn surface_to_f32(surface: &Surface<f64>) -> Surface<f32> {
    Surface {
        diffuse: to_f32(surface.diffuse),
        normal: to_f32(surface.normal),
        roughness: to_f32(surface.roughness),
        specular: to_f32(surface.specular),
        tangent: to_f32(surface.tangent),
    }
}

fn surface_to_f64(surface: &Surface<f32>) -> Surface<f64> {
    Surface {
        diffuse: to_f64(surface.diffuse),
        normal: to_f64(surface.normal),
        roughness: to_f64(surface.roughness),
        specular: to_f64(surface.specular),
        tangent: to_f64(surface.tangent),
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

/// A case with all its inputs rounded to single precision.
fn rounded(case: &Case) -> Case {
    fn round<const N: usize>(values: [f64; N]) -> [f64; N] {
        to_f64(to_f32(values))
    }
    let surface = &case.surface;
    Case {
        surface: Surface {
            diffuse: round(surface.diffuse),
            normal: round(surface.normal),
            roughness: round(surface.roughness),
            specular: round(surface.specular),
            tangent: round(surface.tangent),
        },
        position: round(case.position),
        shot: Shot {
            camera: round(case.shot.camera),
            light: round(case.shot.light),
            light_intensity: round(case.shot.light_intensity),
        },
        weight: round(case.weight),
        ..*case
    }
}

/// Single precision must stay within this of double precision at the same inputs, for all roughnesses from 1e-3.
///
/// That is no more than some roundings: what would cancel is computed in double precision. Measured are 3e-6 at most.
const SINGLE_PRECISION: f64 = 5e-6;

#[test]
fn single_precision_follows_double_precision() {
    for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
        let mut worst = Deviation::default();
        for case in cases(lobe).iter().map(rounded) {
            let surface = surface_to_f32(&case.surface);
            let (radiance, gradient) =
                shade_point_gradient(lobe, &surface, case.position, &case.shot, to_f32(case.weight));
            let got = (to_f64(radiance), surface_to_f64(&gradient));
            let expected = shade_point_gradient(lobe, &case.surface, case.position, &case.shot, case.weight);
            worst.include(deviation(lobe, &case, &expected, &got));
        }
        eprintln!("{lobe:?} f32: {worst:?}");
        assert!(worst.worst() < SINGLE_PRECISION, "{lobe:?} {worst:?}");
    }
}

/// The planes of one pixel.
fn planes<T: Real>(lobe: Lobe, surface: &Surface<T>) -> Maps<T> {
    let mut planes = [surface.diffuse, surface.normal].concat();
    planes.extend(&surface.roughness[..lobe.roughness_planes()]);
    planes.extend(surface.specular);
    if lobe == Lobe::Anisotropic {
        planes.extend(surface.tangent);
    }
    Maps::new(lobe, 1, 1, planes).unwrap()
}

/// The inverse of [`planes`].
fn surface_of(maps: &Maps<f32>) -> Surface<f64> {
    let lobe = maps.lobe();
    let at = |plane: usize| f64::from(maps.plane(plane)[0]);
    let three = |first: usize| [at(first), at(first + 1), at(first + 2)];
    let anisotropic = lobe == Lobe::Anisotropic;
    Surface {
        diffuse: three(0),
        normal: three(3),
        roughness: [at(6), if anisotropic { at(7) } else { 0.0 }],
        specular: three(lobe.specular_plane()),
        tangent: if anisotropic { three(lobe.tangent_plane()) } else { [0.0; 3] },
    }
}

/// The same through the renderer and the loss, which compute on bundles of pixels: maps of one pixel, at the origin.
#[test]
fn rendering_and_loss_follow_double_precision() {
    for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
        let mut worst = Deviation::default();
        for case in cases(lobe).iter().map(rounded) {
            let from_origin = |place: [f64; 3]| std::array::from_fn(|i| place[i] - case.position[i]);
            let shot = Shot { camera: from_origin(case.shot.camera), light: from_origin(case.shot.light), ..case.shot };
            let maps = planes(lobe, &surface_to_f32(&case.surface));
            let radiance = render_maps(&maps, 1.0, &shot).unwrap();
            // Half as bright a photo: the error is as large as what is compared.
            let exact = shade_point(lobe, &case.surface, [0.0; 3], &shot);
            let photo = exact.map(|radiance| 0.5 * encode_radiance(radiance) as f32);
            let target = Target::new(1, 1, shot, &photo, &[0]).unwrap();
            let mut gradient = maps.clone();
            photo_loss(&maps, 1.0, &[target], Some(&mut gradient)).unwrap();
            // The loss of one pixel as a weighted sum of radiances; the slope of the encoding by differences.
            let weight = std::array::from_fn(|c| {
                let value = encode_radiance(exact[c]);
                let step = 1e-4 * exact[c].max(1e-9);
                let slope = (encode_radiance(exact[c] + step) - encode_radiance(exact[c] - step)) / (2.0 * step);
                2000.0 / 3.0 * (value - f64::from(photo[c])) * slope
            });
            let case = Case { weight, ..case };
            let expected = shade_point_gradient(lobe, &case.surface, [0.0; 3], &shot, weight);
            let got = (to_f64([radiance[0], radiance[1], radiance[2]]), surface_of(&gradient));
            worst.include(deviation(lobe, &case, &expected, &got));
        }
        eprintln!("{lobe:?} f32, rendered: {worst:?}");
        assert!(worst.worst() < SINGLE_PRECISION, "{lobe:?} {worst:?}");
    }
}
