//! One pixel in one photo: the encoded value that a renderer of the shading model gives, and its derivatives by the nine raw values.
//!
//! The model is that of [`crate::brdf`], isotropic, in the form that a pixel-by-pixel solver wants: everything that does not depend on
//! the material stands in [`Sight`], and derivatives come out as rows of a Jacobian instead of as the gradient of a loss.

use crate::capture::Shot;

/// Raw values of a pixel, in the order of the network's outputs: diffuse 3, normal x and y, roughness, specular 3.
pub const RAW: usize = 9;
/// Places of the raw values.
pub const NORMAL: usize = 3;
pub const ROUGHNESS: usize = 5;
pub const SPECULAR: usize = 6;

/// Exponent of the codes of photos, albedos and roughness.
const GAMMA: f64 = 2.2;
/// Radiance below which a photo's code is continued as a line: an eighth of what the first code of an 8-bit file stands for.
const DARK: f64 = 6e-7;
/// Largest x^2 + y^2 of a normal.
pub const FLAT_LIMIT: f64 = 0.998;

/// What a pixel's position and a photo's camera and light make of the shading model.
#[derive(Clone, Copy, Debug)]
pub struct Sight {
    view: [f64; 3],
    light: [f64; 3],
    half: [f64; 3],
    irradiance: [f64; 3],
    /// Weight of white in Schlick's term.
    fresnel: f64,
}

/// A pixel's material: raw values decoded, and the slopes of the decoding.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    diffuse: [f64; 3],
    specular: [f64; 3],
    d_diffuse: [f64; 3],
    d_specular: [f64; 3],
    normal: [f64; 3],
    /// GGX width, the square of the perceptual roughness.
    alpha: f64,
    d_alpha: f64,
}

/// See [`Sight::parts`].
#[derive(Clone, Copy, Debug)]
pub struct Parts {
    pub diffuse: [f64; 3],
    pub specular: [f64; 3],
    pub fresnel: f64,
}

/// An encoded colour and the derivatives of each channel by that channel's diffuse value, normal x and y, roughness, specular value.
#[derive(Clone, Copy, Debug, Default)]
pub struct Seen {
    pub code: [f64; 3],
    pub slopes: [[f64; 5]; 3],
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn scaled(a: [f64; 3], factor: f64) -> [f64; 3] {
    a.map(|x| x * factor)
}

fn between(from: [f64; 3], to: [f64; 3]) -> [f64; 3] {
    [to[0] - from[0], to[1] - from[1], to[2] - from[2]]
}

fn unit(a: [f64; 3]) -> [f64; 3] {
    scaled(a, 1.0 / dot(a, a).sqrt().max(f64::MIN_POSITIVE))
}

impl Sight {
    /// The point (x, y, 0) in the photo `shot`, all in one unit of length.
    pub fn new(shot: &Shot, x: f64, y: f64) -> Self {
        let point = [x, y, 0.0];
        let to_light = between(point, shot.light);
        let distance2 = dot(to_light, to_light).max(f64::MIN_POSITIVE);
        let light = scaled(to_light, 1.0 / distance2.sqrt());
        let view = unit(between(point, shot.camera));
        let half = unit([view[0] + light[0], view[1] + light[1], view[2] + light[2]]);
        let v_dot_h = dot(view, half).clamp(0.0, 1.0);
        Self {
            view,
            light,
            half,
            irradiance: shot.light_intensity.map(|intensity| intensity / distance2),
            fresnel: ((-5.55473 * v_dot_h - 6.98316) * v_dot_h).exp2(),
        }
    }

    /// What a surface with this unit normal and GGX width sends to the camera, as parts: the radiance that the diffuse albedo `d` and the specular
    /// albedo `s` give is `diffuse d (1 - s) + specular (s + (1 - s) fresnel)`, per channel. All 0 where it is turned away.
    pub fn parts(&self, normal: [f64; 3], alpha: f64) -> Parts {
        let (n_dot_l, n_dot_v) = (dot(normal, self.light).max(0.0), dot(normal, self.view));
        let facing = if n_dot_v > 0.0 { 1.0 } else { 0.0 };
        let n_dot_h = dot(normal, self.half);
        let narrow = (1.0 - alpha) * (1.0 + alpha);
        let q = (1.0 - n_dot_h * n_dot_h).max(0.0) * narrow + alpha * alpha;
        let k = 0.5 * alpha;
        let (a, b) = (n_dot_v * (1.0 - k) + k, n_dot_l * (1.0 - k) + k);
        let lobe = alpha * alpha / (std::f64::consts::PI * q * q * 4.0 * a * b) * n_dot_l * facing;
        let matt = n_dot_l * facing / std::f64::consts::PI;
        Parts {
            diffuse: self.irradiance.map(|e| e * matt),
            specular: self.irradiance.map(|e| e * lobe),
            fresnel: self.fresnel,
        }
    }

    /// What the photo shows of `surface`.
    pub fn look(&self, surface: &Surface) -> Seen {
        let Surface { normal, alpha, .. } = *surface;
        let (n_dot_l, n_dot_v) = (dot(normal, self.light), dot(normal, self.view));
        if n_dot_l <= 0.0 || n_dot_v <= 0.0 {
            return Seen::default();
        }
        let h = self.half;
        let cross = [
            normal[1] * h[2] - normal[2] * h[1],
            normal[2] * h[0] - normal[0] * h[2],
            normal[0] * h[1] - normal[1] * h[0],
        ];
        let n_dot_h = dot(normal, h);
        let narrow = (1.0 - alpha) * (1.0 + alpha);
        let q = dot(cross, cross).min(1.0) * narrow + alpha * alpha;
        let k = 0.5 * alpha;
        let (a, b) = (n_dot_v * (1.0 - k) + k, n_dot_l * (1.0 - k) + k);
        let gain = alpha * alpha / (std::f64::consts::PI * q * q * 4.0 * a * b);
        let lobe = gain * n_dot_l;

        // By the components of the normal, z following from x and y; |n x h|^2 is 1 - (n.h)^2.
        let (tx, ty) = (normal[0] / normal[2], normal[1] / normal[2]);
        let along = |w: [f64; 3]| [w[0] - w[2] * tx, w[1] - w[2] * ty];
        let (d_l, d_v, d_h) = (along(self.light), along(self.view), along(h));
        let of_q = 4.0 * n_dot_h * narrow / q;
        let d_normal = [0, 1].map(|i| lobe * (of_q * d_h[i] - (1.0 - k) * (d_v[i] / a + d_l[i] / b)) + gain * d_l[i]);
        let d_alpha = lobe
            * (2.0 / alpha - 4.0 * alpha * n_dot_h * n_dot_h / q - 0.5 * ((1.0 - n_dot_v) / a + (1.0 - n_dot_l) / b));

        let mut seen = Seen::default();
        for c in 0..3 {
            let (d, s, e) = (surface.diffuse[c], surface.specular[c], self.irradiance[c]);
            let matt = d * (1.0 - s) / std::f64::consts::PI;
            let reflectance = s + (1.0 - s) * self.fresnel;
            let radiance = (matt * n_dot_l + reflectance * lobe) * e;
            let (code, slope) = encode(radiance);
            let slope = slope * e;
            seen.code[c] = code;
            seen.slopes[c] = [
                slope * (1.0 - s) / std::f64::consts::PI * n_dot_l * surface.d_diffuse[c],
                slope * (matt * d_l[0] + reflectance * d_normal[0]),
                slope * (matt * d_l[1] + reflectance * d_normal[1]),
                slope * reflectance * d_alpha * surface.d_alpha,
                slope * ((1.0 - self.fresnel) * lobe - d / std::f64::consts::PI * n_dot_l) * surface.d_specular[c],
            ];
        }
        seen
    }
}

/// Gamma 2.2 code of a radiance and its slope.
fn encode(radiance: f64) -> (f64, f64) {
    let bright = radiance.max(DARK);
    let code = bright.powf(1.0 / GAMMA);
    let slope = code / (GAMMA * bright);
    (code + slope * (radiance - bright), slope)
}

/// The inverse of an albedo's or roughness's code, `((raw + 1) / 2)^2.2`, and its slope.
fn power(raw: f64) -> (f64, f64) {
    let code = 0.5 * (raw + 1.0);
    let steep = code.max(0.0).powf(GAMMA - 1.0);
    (steep * code.max(0.0), 0.5 * GAMMA * steep)
}

impl Surface {
    /// The surface of raw values within their limits.
    pub fn new(raw: &[f64; RAW]) -> Self {
        let (mut diffuse, mut specular, mut d_diffuse, mut d_specular) = ([0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3]);
        for c in 0..3 {
            (diffuse[c], d_diffuse[c]) = power(raw[c]);
            (specular[c], d_specular[c]) = power(raw[SPECULAR + c]);
        }
        let (x, y) = (raw[NORMAL], raw[NORMAL + 1]);
        let (roughness, d_roughness) = power(raw[ROUGHNESS]);
        let roughness = roughness.max(crate::brdf::ROUGHNESS_MIN);
        Self {
            diffuse,
            specular,
            d_diffuse,
            d_specular,
            normal: [x, y, (1.0 - x * x - y * y).max(1.0 - FLAT_LIMIT).sqrt()],
            alpha: roughness * roughness,
            d_alpha: 2.0 * roughness * d_roughness,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{RAW, Sight, Surface};
    use crate::capture::Shot;
    use crate::maps::{Lobe, Maps};
    use crate::nn::Decoding;
    use crate::render::{encode_radiance, render_maps};

    fn shots() -> [Shot; 3] {
        let intensity = [20.0, 18.0, 22.0];
        [
            Shot { camera: [0.1, -0.2, 2.3], light: [0.1, -0.2, 2.3], light_intensity: intensity },
            Shot { camera: [1.2, 0.3, 2.0], light: [-0.8, 0.4, 1.5], light_intensity: intensity },
            Shot { camera: [-2.0, 1.0, 4.0], light: [-2.0, 1.1, 4.2], light_intensity: intensity },
        ]
    }

    fn random(rng: &mut fastrand::Rng) -> [f64; RAW] {
        let mut raw = [(); RAW].map(|()| 1.8 * rng.f64() - 0.9);
        raw[3] *= 0.6;
        raw[4] *= 0.6;
        raw
    }

    #[test]
    fn agrees_with_the_renderer() {
        let mut rng = fastrand::Rng::with_seed(5);
        for _ in 0..50 {
            let raw = random(&mut rng);
            let mut maps = Maps::new(Lobe::Isotropic, 1, 1, vec![0.0f64; 10]).unwrap();
            Decoding::new(Lobe::Isotropic).decode(&raw, &mut maps).unwrap();
            for shot in shots() {
                let expected = render_maps(&maps, 2.0, &shot).unwrap();
                let seen = Sight::new(&shot, 0.0, 0.0).look(&Surface::new(&raw));
                for c in 0..3 {
                    let expected: f64 = encode_radiance(expected[c]);
                    assert!((seen.code[c] - expected).abs() < 1e-6 * (1.0 + expected), "{raw:?} {shot:?}");
                }
            }
        }
    }

    #[test]
    fn parts_add_up() {
        let mut rng = fastrand::Rng::with_seed(8);
        for _ in 0..50 {
            let surface = Surface::new(&random(&mut rng));
            for shot in shots() {
                let sight = Sight::new(&shot, 0.3, -0.4);
                let parts = sight.parts(surface.normal, surface.alpha);
                for (c, code) in sight.look(&surface).code.into_iter().enumerate() {
                    let (d, s) = (surface.diffuse[c], surface.specular[c]);
                    let sum = parts.diffuse[c] * d * (1.0 - s) + parts.specular[c] * (s + (1.0 - s) * parts.fresnel);
                    let expected = code.powf(2.2);
                    assert!((sum - expected).abs() < 1e-6 * (1e-3 + expected), "{sum} {expected}");
                }
            }
        }
    }

    #[test]
    fn slopes_are_those_of_finite_differences() {
        let mut rng = fastrand::Rng::with_seed(6);
        let step = 1e-6;
        for _ in 0..50 {
            let raw = random(&mut rng);
            for shot in shots() {
                let sight = Sight::new(&shot, 0.3, -0.4);
                let seen = sight.look(&Surface::new(&raw));
                for i in 0..RAW {
                    let at = |by: f64| {
                        let mut moved = raw;
                        moved[i] += by;
                        sight.look(&Surface::new(&moved)).code
                    };
                    let (above, below) = (at(step), at(-step));
                    for c in 0..3 {
                        let expected = (above[c] - below[c]) / (2.0 * step);
                        let column = match i {
                            3..6 => Some(i - 2),
                            _ if i % 3 == c => Some(if i < 3 { 0 } else { 4 }),
                            _ => None,
                        };
                        let got = column.map_or(0.0, |column| seen.slopes[c][column]);
                        assert!((got - expected).abs() < 1e-5 * (1.0 + expected.abs()), "{i} {c}: {got} {expected}");
                    }
                }
            }
        }
    }
}
