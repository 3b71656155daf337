//! One pixel in one photo: the encoded value that a renderer of the shading model gives, and its derivatives by the nine raw values.
//!
//! The model is [`crate::brdf`], whose parts are put together here in the form that a pixel-by-pixel solver wants: everything that does not
//! depend on the material stands in [`Geometry`], and derivatives come out as rows of a Jacobian instead of as the gradient of a loss. It is written for
//! [`Lanes`]: several pixels at a time. What touches a bundle is a loop or an inlined function, never a closure: those would be compiled for any processor.

#![allow(
    clippy::manual_map,
    clippy::needless_range_loop,
    reason = "closures would not be compiled for the processor's lanes"
)]

use crate::brdf::{self, Directions, Frame, Response};
use crate::capture::Capture;
use crate::color::GAMMA;
use crate::raw::{NORMAL, RAW, ROUGHNESS, SPECULAR};
use crate::real::{LANES_MAX, Lanes, Real, scale};
use crate::render::{encode, offset};
use crate::shot::Shot;

/// Largest x^2 + y^2 of a normal.
pub const FLAT_LIMIT: f64 = 0.998;
const INVERSE_PI: f64 = std::f64::consts::FRAC_1_PI;

/// What a pixel's position and a photo's camera and light make of the shading model.
#[derive(Clone, Copy)]
pub struct Geometry<L: Lanes> {
    directions: Directions<L>,
    intensity: [L; 3],
}

/// A pixel's material: raw values decoded, and the derivatives of the decoding.
#[derive(Clone, Copy)]
pub struct Surface<L: Lanes> {
    maps: brdf::Surface<L>,
    frame: LobeFrame<L>,
    d_diffuse: [L; 3],
    d_specular: [L; 3],
    d_roughness: [L; 2],
}

/// The frame of a lobe, round or stretched.
#[derive(Clone, Copy)]
pub enum LobeFrame<L: Lanes> {
    Round(Frame<L, false>),
    Stretched(Frame<L, true>),
}

/// A lobe that is narrower along the tangent and wider across.
#[derive(Clone, Copy, Debug)]
pub struct Stretch<L> {
    /// What the roughness is multiplied by along the tangent and across.
    factors: [L; 2],
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
        let across = (length * L::splat(0.5 * std::f64::consts::LOG2_E)).exp2();
        Self { factors: [one / across, across], tangent: [cosine, sine] }
    }
}

/// Length below which an anisotropy has no direction.
const ROUND: f64 = 1e-6;

/// A black surface with this unit normal and roughness, and the frame of its lobe.
#[inline(always)]
pub fn shape<L: Lanes>(normal: [L; 3], roughness: L, stretch: Option<Stretch<L>>) -> (brdf::Surface<L>, LobeFrame<L>) {
    let zero = L::splat(0.0);
    let mut maps = brdf::Surface {
        diffuse: [zero; 3],
        normal,
        roughness: [roughness; 2],
        specular: [zero; 3],
        tangent: [zero; 3],
    };
    let frame = match stretch {
        None => LobeFrame::Round(Frame::new(&maps)),
        Some(Stretch { factors, tangent: [x, y] }) => {
            maps.roughness = [roughness * factors[0], roughness * factors[1]];
            maps.tangent = [x, y, zero];
            LobeFrame::Stretched(Frame::new(&maps))
        }
    };
    (maps, frame)
}

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
        let camera = offset::<L>(shot.camera.map(|along| along / length), x.widen(), y.widen());
        let light = offset::<L>(shot.light.map(|along| along / length), x.widen(), y.widen());
        let mut intensity = [x; 3];
        for c in 0..3 {
            intensity[c] = L::splat(shot.light_intensity[c] / (length * length));
        }
        Self { directions: brdf::directions(camera, light, shot), intensity }
    }

    /// What a surface with a lobe of this frame sends to the camera, as parts: the radiance that the diffuse albedo `d` and the
    /// specular albedo `s` give is `diffuse d (1 - s) + specular (s + (1 - s) fresnel)`, per channel. All 0 where it is turned away.
    #[inline(always)]
    pub fn parts(&self, frame: &LobeFrame<L>) -> Parts<L> {
        match frame {
            LobeFrame::Round(frame) => self.parts_of(&Response::new(frame, &self.directions)),
            LobeFrame::Stretched(frame) => self.parts_of(&Response::new(frame, &self.directions)),
        }
    }

    #[inline(always)]
    fn parts_of(&self, response: &Response<L>) -> Parts<L> {
        let irradiance = scale(self.intensity, response.falloff);
        Parts {
            diffuse: scale(irradiance, response.cosine * L::splat(INVERSE_PI)),
            specular: scale(irradiance, response.lobe),
            fresnel: response.fresnel,
        }
    }

    /// What the photo shows of `surface`.
    #[inline(always)]
    pub fn observe(&self, surface: &Surface<L>) -> CodeJacobian<L> {
        match &surface.frame {
            LobeFrame::Round(frame) => self.observe_lobe(surface, frame),
            LobeFrame::Stretched(frame) => self.observe_lobe(surface, frame),
        }
    }

    #[inline(always)]
    fn observe_lobe<const ANISOTROPIC: bool>(
        &self,
        surface: &Surface<L>,
        frame: &Frame<L, ANISOTROPIC>,
    ) -> CodeJacobian<L> {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let brdf::Surface { diffuse, specular, normal, .. } = surface.maps;
        let response = Response::new(frame, &self.directions);
        let radiance = response.radiance(&surface.maps, self.intensity);
        let d_cosine = along(response.cosine_by_normal, normal);
        let d_lobe = along(response.lobe_by_stored_normal(frame), normal);
        let [x, y] = response.lobe_by_roughness;
        let d_roughness = x.mul_add(surface.d_roughness[0], y * surface.d_roughness[1]);
        let matt_part = response.cosine * L::splat(INVERSE_PI);

        let mut seen = CodeJacobian { code: [zero; 3], jacobian: [[zero; 5]; 3] };
        for c in 0..3 {
            let (d, s) = (diffuse[c], specular[c]);
            let matt = d * (one - s) * L::splat(INVERSE_PI);
            let reflectance = (one - s).mul_add(response.fresnel, s);
            let (code, slope) = encode(radiance[c]);
            let slope = slope * self.intensity[c] * response.falloff;
            seen.code[c] = code;
            seen.jacobian[c] = [
                slope * (one - s) * matt_part * surface.d_diffuse[c],
                slope * (matt * d_cosine[0] + reflectance * d_lobe[0]),
                slope * (matt * d_cosine[1] + reflectance * d_lobe[1]),
                slope * reflectance * d_roughness,
                slope * ((one - response.fresnel) * response.lobe - d * matt_part) * surface.d_specular[c],
            ];
        }
        seen
    }
}

/// Of the derivative by a unit normal that by its x and y, z following from them.
#[inline(always)]
fn along<L: Lanes>(slope: [L; 3], normal: [L; 3]) -> [L; 2] {
    let by_z = slope[2] / normal[2];
    [slope[0] - by_z * normal[0], slope[1] - by_z * normal[1]]
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
        let (x, y) = (raw[NORMAL], raw[NORMAL + 1]);
        let z2 = (L::splat(1.0) - x * x - y * y).max(L::splat(1.0 - FLAT_LIMIT));
        let (roughness, d_roughness) = power(raw[ROUGHNESS]);
        let (stretch, d_roughness) = match anisotropy {
            None => (None, [d_roughness; 2]),
            Some(vector) => {
                let stretch = Stretch::new(vector);
                (Some(stretch), [d_roughness * stretch.factors[0], d_roughness * stretch.factors[1]])
            }
        };
        let (mut maps, frame) = shape([x, y, z2.sqrt()], roughness, stretch);
        let zero = [L::splat(0.0); 3];
        let (mut d_diffuse, mut d_specular) = (zero, zero);
        for c in 0..3 {
            (maps.diffuse[c], d_diffuse[c]) = power(raw[c]);
            (maps.specular[c], d_specular[c]) = power(raw[SPECULAR + c]);
        }
        Self { maps, frame, d_diffuse, d_specular, d_roughness }
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
                let parts = geometry.parts(&surface.frame);
                for (c, code) in geometry.observe(&surface).code.into_iter().enumerate() {
                    let (d, s) = (surface.maps.diffuse[c], surface.maps.specular[c]);
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
