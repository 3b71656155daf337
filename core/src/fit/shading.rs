//! One pixel in one photo: the encoded value that a renderer of the shading model gives, and its derivatives by the nine raw values.
//!
//! The model is that of [`crate::brdf`], isotropic, in the form that a pixel-by-pixel solver wants: everything that does not depend on
//! the material stands in [`Geometry`], and derivatives come out as rows of a Jacobian instead of as the gradient of a loss. It is written for
//! [`Lanes`]: several pixels at a time. What touches a bundle is a loop or an inlined function, never a closure: those would be compiled for any processor.

#![allow(
    clippy::manual_map,
    clippy::needless_range_loop,
    reason = "closures would not be compiled for the processor's lanes"
)]

use crate::brdf::real::{LANES_MAX, Lanes, Real, cross, dot, scale};
use crate::capture::Capture;
use crate::raw::{NORMAL, RAW, ROUGHNESS, SPECULAR};
use crate::render::encode;
use crate::shot::Shot;

/// Exponent of the codes of albedos and roughness.
const GAMMA: f64 = 2.2;
/// Largest x^2 + y^2 of a normal.
pub const FLAT_LIMIT: f64 = 0.998;
const INVERSE_PI: f64 = std::f64::consts::FRAC_1_PI;

/// What a pixel's position and a photo's camera and light make of the shading model.
#[derive(Clone, Copy, Debug)]
pub struct Geometry<L> {
    view: [L; 3],
    light: [L; 3],
    half: [L; 3],
    irradiance: [L; 3],
    /// Weight of white in Schlick's term.
    fresnel: L,
}

/// A pixel's material: raw values decoded, and the derivatives of the decoding.
#[derive(Clone, Copy, Debug)]
pub struct Surface<L> {
    diffuse: [L; 3],
    specular: [L; 3],
    d_diffuse: [L; 3],
    d_specular: [L; 3],
    normal: [L; 3],
    /// GGX width, the square of the perceptual roughness.
    alpha: L,
    d_alpha: L,
    /// Of a lobe that is not round.
    stretch: Option<Stretch<L>>,
}

/// A lobe that is narrower by `factor` along the tangent and wider by it across.
#[derive(Clone, Copy, Debug)]
pub struct Stretch<L> {
    factor: L,
    /// The tangent's x and y; it lies in the plane of the patch.
    tangent: [L; 2],
}

impl<L: Lanes> Stretch<L> {
    /// Of the vector that [`crate::fit::anisotropy`] describes.
    #[inline(always)]
    pub fn new([p, q]: [L; 2]) -> Self {
        let (zero, one, half) = (L::splat(0.0), L::splat(1.0), L::splat(0.5));
        let length = p.mul_add(p, q * q).sqrt();
        let cosine2 = p / length.max(L::splat(ROUND));
        let cosine = (half * (one + cosine2)).max(zero).sqrt();
        let sine = (half * (one - cosine2)).max(zero).sqrt();
        let sine = L::select(zero.gt(q), zero - sine, sine);
        Self { factor: (length * L::splat(std::f64::consts::LOG2_E)).exp2(), tangent: [cosine, sine] }
    }
}

/// Length below which an anisotropy has no direction.
const ROUND: f64 = 1e-6;

/// See [`Geometry::parts`].
#[derive(Clone, Copy, Debug)]
pub struct Parts<L> {
    pub diffuse: [L; 3],
    pub specular: [L; 3],
    pub fresnel: L,
}

/// An encoded colour and the derivatives of each channel by that channel's diffuse value, normal x and y, roughness, specular value.
#[derive(Clone, Copy, Debug)]
pub struct CodeJacobian<L> {
    pub code: [L; 3],
    pub jacobian: [[L; 5]; 3],
}

/// From (x, y, 0) to `place`, whose coordinates are divided by `length`.
#[inline(always)]
fn from_point<L: Lanes>(place: [f64; 3], length: f64, [x, y]: [L; 2]) -> [L; 3] {
    [L::splat(place[0] / length) - x, L::splat(place[1] / length) - y, L::splat(place[2] / length)]
}

#[inline(always)]
fn unit<L: Lanes>(a: [L; 3]) -> [L; 3] {
    scale(a, L::splat(1.0) / dot(a, a).sqrt().max(L::splat(L::NORMAL_RANGE[0])))
}

/// What `value` says of `items`, of which there is at least one, for the elements of a bundle; where there are fewer the last one again.
#[inline(always)]
fn gather<L: Lanes, T, V: Copy + Default>(items: &[T], value: impl Fn(&T) -> V) -> [V; LANES_MAX] {
    let mut values = [V::default(); LANES_MAX];
    for (i, out) in values.iter_mut().take(L::LANES).enumerate() {
        *out = value(&items[i.min(items.len() - 1)]);
    }
    values
}

/// A bundle of what `value` says of `items`, of which there is at least one; where there are fewer than it has elements the last one again.
#[inline(always)]
pub fn bundle<L: Lanes, T>(items: &[T], value: impl Fn(&T) -> f32) -> L {
    L::load_f32(&gather::<L, T, f32>(items, value))
}

/// Likewise which channels are saturated, of bytes with a bit for each.
#[inline(always)]
pub fn saturated<L: Lanes, T>(items: &[T], value: impl Fn(&T) -> u8) -> [L::Mask; 3] {
    let bytes = gather::<L, T, u8>(items, value);
    [L::bits_set(&bytes, 0), L::bits_set(&bytes, 1), L::bits_set(&bytes, 2)]
}

/// The first `count` elements of bundles.
#[inline(always)]
pub fn unbundle<L: Lanes<Scalar = R>, R: Real, const N: usize>(
    bundles: [L; N],
    count: usize,
) -> impl Iterator<Item = [f32; N]> {
    let mut values = [[R::default(); LANES_MAX]; N];
    for i in 0..N {
        bundles[i].store(&mut values[i]);
    }
    (0..count).map(move |lane| std::array::from_fn(|i| values[i][lane].to_f64() as f32))
}

impl<L: Lanes> Geometry<L> {
    /// Pixels of `capture`, as `pixel` says which, in a photo taken as `shot` says.
    #[inline(always)]
    pub fn of_pixels<T>(capture: &Capture, shot: &Shot, items: &[T], pixel: impl Fn(&T) -> usize) -> Self {
        // In the unit of half the patch single precision has range for whatever the capture's is.
        let length = 0.5 * capture.patch_size();
        let along = |item: &T, axis: usize| {
            let pixel = pixel(item);
            (capture.position(pixel / capture.width(), pixel % capture.width())[axis] / length) as f32
        };
        Self::new(shot, length, [bundle(items, |item| along(item, 0)), bundle(items, |item| along(item, 1))])
    }

    /// The points (x, y, 0) in the photo `shot`. `length` is what x and y count in, in the unit of `shot`.
    #[inline(always)]
    pub fn new(shot: &Shot, length: f64, [x, y]: [L; 2]) -> Self {
        let to_light = from_point(shot.light, length, [x, y]);
        let distance2 = dot(to_light, to_light).max(L::splat(L::NORMAL_RANGE[0]));
        let light = scale(to_light, L::splat(1.0) / distance2.sqrt());
        let view = unit(from_point(shot.camera, length, [x, y]));
        let half = unit([view[0] + light[0], view[1] + light[1], view[2] + light[2]]);
        let v_dot_h = dot(view, half).max(L::splat(0.0)).min(L::splat(1.0));
        let mut irradiance = [distance2; 3];
        for c in 0..3 {
            irradiance[c] = L::splat(shot.light_intensity[c] / (length * length)) / distance2;
        }
        let fresnel = (v_dot_h.mul_add(L::splat(-5.55473), L::splat(-6.98316)) * v_dot_h).exp2();
        Self { view, light, half, irradiance, fresnel }
    }

    /// What a surface with this unit normal and GGX width sends to the camera, its lobe round or stretched, as parts: the radiance that the diffuse albedo `d` and the
    /// specular albedo `s` give is `diffuse d (1 - s) + specular (s + (1 - s) fresnel)`, per channel. All 0 where it is turned away.
    #[inline(always)]
    pub fn parts(&self, normal: [L; 3], alpha: L, stretch: Option<Stretch<L>>) -> Parts<L> {
        let zero = L::splat(0.0);
        let (n_dot_l, n_dot_v) = (dot(normal, self.light), dot(normal, self.view));
        let facing = n_dot_l.gt(zero) & n_dot_v.gt(zero);
        let lobe = match stretch {
            None => {
                let across = cross(normal, self.half);
                gain(dot(across, across), n_dot_l, n_dot_v, alpha).0 * n_dot_l
            }
            // Nobody asks for its derivatives here, and nothing computes them.
            Some(stretch) => self.stretched_lobe(normal, alpha, stretch, [n_dot_l, n_dot_v], [zero; 2]).lobe,
        };
        let lobe = L::select(facing, lobe, zero);
        let matt = L::select(facing, n_dot_l * L::splat(INVERSE_PI), zero);
        Parts { diffuse: scale(self.irradiance, matt), specular: scale(self.irradiance, lobe), fresnel: self.fresnel }
    }

    /// What the photo shows of `surface`.
    #[inline(always)]
    pub fn observe(&self, surface: &Surface<L>) -> CodeJacobian<L> {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let Surface { normal, alpha, .. } = *surface;
        let (n_dot_l, n_dot_v) = (dot(normal, self.light), dot(normal, self.view));
        let facing = n_dot_l.gt(zero) & n_dot_v.gt(zero);
        // By the components of the normal, z following from x and y.
        let (tx, ty) = (normal[0] / normal[2], normal[1] / normal[2]);
        let d_l = along(self.light, tx, ty);
        let Lobe { lobe, d_normal, d_alpha } = match surface.stretch {
            None => self.round_lobe(normal, alpha, [n_dot_l, n_dot_v], [tx, ty]),
            Some(stretch) => self.stretched_lobe(normal, alpha, stretch, [n_dot_l, n_dot_v], [tx, ty]),
        };

        let matt_part = n_dot_l * L::splat(INVERSE_PI);
        let mut seen = CodeJacobian { code: [zero; 3], jacobian: [[zero; 5]; 3] };
        for c in 0..3 {
            let (d, s, e) = (surface.diffuse[c], surface.specular[c], self.irradiance[c]);
            let matt = d * (one - s) * L::splat(INVERSE_PI);
            let reflectance = (one - s).mul_add(self.fresnel, s);
            let (code, slope) = encode((matt * n_dot_l + reflectance * lobe) * e);
            let slope = slope * e;
            seen.code[c] = L::select(facing, code, zero);
            let derivatives = [
                slope * (one - s) * matt_part * surface.d_diffuse[c],
                slope * (matt * d_l[0] + reflectance * d_normal[0]),
                slope * (matt * d_l[1] + reflectance * d_normal[1]),
                slope * reflectance * d_alpha * surface.d_alpha,
                slope * ((one - self.fresnel) * lobe - d * matt_part) * surface.d_specular[c],
            ];
            for i in 0..5 {
                seen.jacobian[c][i] = L::select(facing, derivatives[i], zero);
            }
        }
        seen
    }

    /// A round lobe at a unit normal whose slopes are `tx` and `ty`.
    #[inline(always)]
    fn round_lobe(&self, normal: [L; 3], alpha: L, [n_dot_l, n_dot_v]: [L; 2], [tx, ty]: [L; 2]) -> Lobe<L> {
        let (zero, one, two, four) = (L::splat(0.0), L::splat(1.0), L::splat(2.0), L::splat(4.0));
        let h = self.half;
        let n_dot_h = dot(normal, h);
        // |n x h|^2 is 1 - (n.h)^2.
        let across = cross(normal, h);
        let (gain, q, a, b) = gain(dot(across, across), n_dot_l, n_dot_v, alpha);
        let lobe = gain * n_dot_l;
        let (d_l, d_v, d_h) = (along(self.light, tx, ty), along(self.view, tx, ty), along(h, tx, ty));
        let narrow = (one - alpha) * (one + alpha);
        let of_q = four * n_dot_h * narrow / q;
        let masked = L::splat(0.5).mul_add(-alpha, one);
        let mut d_normal = [zero; 2];
        for i in 0..2 {
            let of_masking = masked * (d_v[i] / a + d_l[i] / b);
            d_normal[i] = lobe * (of_q * d_h[i] - of_masking) + gain * d_l[i];
        }
        let d_alpha = lobe
            * (two / alpha
                - four * alpha * n_dot_h * n_dot_h / q
                - L::splat(0.5) * ((one - n_dot_v) / a + (one - n_dot_l) / b));
        Lobe { lobe, d_normal, d_alpha }
    }

    /// Likewise one that is not round: anisotropic GGX, separable Smith.
    #[inline(always)]
    fn stretched_lobe(
        &self,
        normal: [L; 3],
        alpha: L,
        stretch: Stretch<L>,
        [n_dot_l, n_dot_v]: [L; 2],
        [tx, ty]: [L; 2],
    ) -> Lobe<L> {
        let (zero, one, two) = (L::splat(0.0), L::splat(1.0), L::splat(2.0));
        let alphas = [alpha / stretch.factor, alpha * stretch.factor];
        let stored = [stretch.tangent[0], stretch.tangent[1], zero];
        let across = cross(normal, stored);
        let length = dot(across, across).sqrt();
        let bitangent = scale(across, one / length);
        let tangent = cross(bitangent, normal);
        // Moving the normal along the bitangent, the stored tangent held, turns the frame about the normal by so much.
        let turn = dot(normal, stored) / length;

        let half = [dot(tangent, self.half), dot(bitangent, self.half), dot(normal, self.half)];
        let [x, y] = [half[0] / alphas[0], half[1] / alphas[1]];
        let wide = x.mul_add(x, y * y);
        let q = half[2].mul_add(half[2], wide);
        let mut value = L::splat(INVERSE_PI) / (alphas[0] * alphas[1] * q * q);
        // Derivatives of the logarithm of the lobe without its cosine.
        let mut d_ln_alpha = L::splat(4.0) * wide / q - two;
        let mut d_ln = [zero; 2];
        let moves = [[one, zero, zero - tx], [zero, one, zero - ty]];
        for i in 0..2 {
            let along = dot(tangent, moves[i]);
            let across = dot(bitangent, moves[i]);
            let turned = zero - across * turn;
            let d_t = across_turn(half[1], turned, half[2], along);
            let d_b = zero - half[0] * turned - half[2] * across;
            let d_n = dot(self.half, moves[i]);
            let d_q = two * (x * d_t / alphas[0] + y * d_b / alphas[1] + half[2] * d_n);
            d_ln[i] = zero - two * d_q / q;
        }
        let (directions, cosines) = ([self.view, self.light], [n_dot_v, n_dot_l]);
        for k in 0..2 {
            let (direction, cosine) = (directions[k], cosines[k]);
            let [t, b] = [dot(tangent, direction), dot(bitangent, direction)];
            let [x, y] = [alphas[0] * t, alphas[1] * b];
            let wide = x.mul_add(x, y * y);
            let lambda = cosine.mul_add(cosine, wide).sqrt();
            let inverse = one / (cosine + lambda);
            value = value * inverse;
            d_ln_alpha = d_ln_alpha - wide * inverse / lambda;
            for i in 0..2 {
                let along = dot(tangent, moves[i]);
                let across = dot(bitangent, moves[i]);
                let turned = zero - across * turn;
                let d_t = across_turn(b, turned, cosine, along);
                let d_b = zero - t * turned - cosine * across;
                let d_n = dot(direction, moves[i]);
                let d_lambda = (x * alphas[0] * d_t + y * alphas[1] * d_b + cosine * d_n) / lambda;
                d_ln[i] = d_ln[i] - (d_n + d_lambda) * inverse;
            }
        }
        let lobe = value * n_dot_l;
        let d_l = along(self.light, tx, ty);
        Lobe {
            lobe,
            d_normal: [lobe * d_ln[0] + value * d_l[0], lobe * d_ln[1] + value * d_l[1]],
            d_alpha: lobe * d_ln_alpha / alpha,
        }
    }
}

/// How a direction's part along the tangent changes where the frame turns by `turned` about the normal and leans by `along` towards the tangent.
#[inline(always)]
fn across_turn<L: Lanes>(bitangent_part: L, turned: L, normal_part: L, along: L) -> L {
    bitangent_part * turned - normal_part * along
}

/// Distribution and masking over four times the cosines, times the light's cosine; its derivatives by the normal's x and y and by alpha.
struct Lobe<L> {
    lobe: L,
    d_normal: [L; 2],
    d_alpha: L,
}

/// How the product of `w` with the normal changes with the normal's x and y, where z follows from them.
#[inline(always)]
fn along<L: Lanes>(w: [L; 3], tx: L, ty: L) -> [L; 2] {
    [w[0] - w[2] * tx, w[1] - w[2] * ty]
}

/// Distribution and masking over four times the cosines, and the parts that its derivatives are made of: `q = |n x h|^2 (1 - alpha^2) + alpha^2`
/// and the two denominators of the masking.
#[inline(always)]
fn gain<L: Lanes>(sine2: L, n_dot_l: L, n_dot_v: L, alpha: L) -> (L, L, L, L) {
    let one = L::splat(1.0);
    let q = sine2.min(one).mul_add((one - alpha) * (one + alpha), alpha * alpha);
    let k = L::splat(0.5) * alpha;
    let (a, b) = (n_dot_v.mul_add(one - k, k), n_dot_l.mul_add(one - k, k));
    (alpha * alpha / (L::splat(4.0 / INVERSE_PI) * q * q * a * b), q, a, b)
}

/// The inverse of an albedo's or roughness's code, `((raw + 1) / 2)^2.2`, and its slope.
#[inline(always)]
fn power<L: Lanes>(raw: L) -> (L, L) {
    let code = L::splat(0.5).mul_add(raw, L::splat(0.5));
    let steep = code.pow(GAMMA - 1.0);
    (steep * code, L::splat(0.5 * GAMMA) * steep)
}

impl<L: Lanes> Surface<L> {
    /// The surface of raw values within their limits, its lobe round or with this anisotropy.
    #[inline(always)]
    pub fn new(raw: &[L; RAW], anisotropy: Option<[L; 2]>) -> Self {
        let zero = [L::splat(0.0); 3];
        let (mut diffuse, mut specular, mut d_diffuse, mut d_specular) = (zero, zero, zero, zero);
        for c in 0..3 {
            (diffuse[c], d_diffuse[c]) = power(raw[c]);
            (specular[c], d_specular[c]) = power(raw[SPECULAR + c]);
        }
        let (x, y) = (raw[NORMAL], raw[NORMAL + 1]);
        let (roughness, d_roughness) = power(raw[ROUGHNESS]);
        let roughness = roughness.max(L::splat(crate::brdf::ROUGHNESS_MIN));
        let z2 = (L::splat(1.0) - x * x - y * y).max(L::splat(1.0 - FLAT_LIMIT));
        Self {
            diffuse,
            specular,
            d_diffuse,
            d_specular,
            normal: [x, y, z2.sqrt()],
            alpha: roughness * roughness,
            d_alpha: L::splat(2.0) * roughness * d_roughness,
            stretch: match anisotropy {
                None => None,
                Some(vector) => Some(Stretch::new(vector)),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Geometry, RAW, Surface};
    use crate::fit::anisotropy;
    use crate::maps::{Lobe, Maps, ROUGHNESS_PLANE};
    use crate::nn::Decoding;
    use crate::render::{encode_radiance, render_maps};
    use crate::shot::Shot;

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
                let seen = Geometry::<f64>::new(&shot, 1.0, [0.0, 0.0]).observe(&Surface::new(&raw, None));
                for c in 0..3 {
                    let expected: f64 = encode_radiance(expected[c]);
                    assert!((seen.code[c] - expected).abs() < 1e-6 * (1.0 + expected), "{raw:?} {shot:?}");
                }
            }
        }
    }

    /// Anisotropies of which the last is nearly none.
    const VECTORS: [[f64; 2]; 4] = [[0.8, 0.3], [-0.5, -0.9], [-0.7, 0.0], [1e-3, -2e-3]];

    #[test]
    fn stretched_lobes_agree_with_the_renderer() {
        let mut rng = fastrand::Rng::with_seed(9);
        for vector in VECTORS.iter().cycle().take(48) {
            let raw = random(&mut rng);
            let mut maps = Maps::new(Lobe::Isotropic, 1, 1, vec![0.0f32; 10]).unwrap();
            Decoding::new(Lobe::Isotropic).decode(&raw.map(|value| value as f32), &mut maps).unwrap();
            let maps = anisotropy::join(maps, &[vector.map(|value| value as f32)]).unwrap();
            if maps.plane(ROUGHNESS_PLANE + 1)[0] >= 1.0 {
                // At its limit the lobe of maps is narrower.
                continue;
            }
            for shot in shots() {
                let expected = render_maps(&maps, 2.0, &shot).unwrap();
                let geometry = Geometry::<f64>::new(&shot, 1.0, [0.0, 0.0]);
                let seen = geometry.observe(&Surface::new(&raw, Some(*vector)));
                for c in 0..3 {
                    let expected = f64::from(encode_radiance(expected[c]));
                    assert!((seen.code[c] - expected).abs() < 2e-5 * (1.0 + expected), "{raw:?} {vector:?} {shot:?}");
                }
            }
        }
    }

    #[test]
    fn parts_add_up() {
        let mut rng = fastrand::Rng::with_seed(8);
        for _ in 0..50 {
            let surface = Surface::new(&random(&mut rng), None);
            for shot in shots() {
                let geometry = Geometry::<f64>::new(&shot, 1.0, [0.3, -0.4]);
                let parts = geometry.parts(surface.normal, surface.alpha, surface.stretch);
                for (c, code) in geometry.observe(&surface).code.into_iter().enumerate() {
                    let (d, s) = (surface.diffuse[c], surface.specular[c]);
                    let sum = parts.diffuse[c] * d * (1.0 - s) + parts.specular[c] * (s + (1.0 - s) * parts.fresnel);
                    // Above the encoding's toe.
                    let expected = code.powf(2.2);
                    assert!((sum - expected).abs() < 1e-6 * (1e-3 + expected), "{sum} {expected}");
                }
            }
        }
    }

    #[test]
    fn the_jacobian_is_that_of_finite_differences() {
        let mut rng = fastrand::Rng::with_seed(6);
        let step = 1e-6;
        let mut vectors = VECTORS.into_iter().map(Some).chain([None]).cycle();
        for _ in 0..50 {
            let raw = random(&mut rng);
            for shot in shots() {
                let geometry = Geometry::<f64>::new(&shot, 1.0, [0.3, -0.4]);
                let vector = vectors.next().unwrap();
                let seen = geometry.observe(&Surface::new(&raw, vector));
                for i in 0..RAW {
                    let at = |by: f64| {
                        let mut moved = raw;
                        moved[i] += by;
                        geometry.observe(&Surface::new(&moved, vector)).code
                    };
                    let (above, below) = (at(step), at(-step));
                    for c in 0..3 {
                        let expected = (above[c] - below[c]) / (2.0 * step);
                        let column = match i {
                            3..6 => Some(i - 2),
                            _ if i % 3 == c => Some(if i < 3 { 0 } else { 4 }),
                            _ => None,
                        };
                        let got = column.map_or(0.0, |column| seen.jacobian[c][column]);
                        assert!((got - expected).abs() < 1e-5 * (1.0 + expected.abs()), "{i} {c}: {got} {expected}");
                    }
                }
            }
        }
    }
}
