//! The shading model: Lambertian diffuse and a GGX lobe, isotropic or anisotropic, with its gradient written out.
//!
//! Per point, with unit normal n, directions v to the camera and l to the light, h = (v + l)/|v + l|, alpha = roughness^2:
//!
//! `radiance = (d (1 - s)/pi + D F G / (4 (n.v)(n.l))) * n.l * light_intensity / distance_to_light^2`, zero where n.l <= 0 or n.v <= 0,
//!
//! d and s the diffuse and specular albedo, [`ndf`] D, [`fresnel`] F, [`masking`] G (isotropic: Schlick's form with k = alpha/2;
//! anisotropic: separable Smith). Normal and tangent are normalised inside, the tangent made orthogonal to the normal first,
//! and the gradient goes through that. Roughness below [`ROUGHNESS_MIN`] renders as [`ROUGHNESS_MIN`] and has no gradient;
//! there is no other floor. A normal of length 0 renders black; a tangent that is 0 or parallel to the normal (to 1e-5) is
//! replaced by one along x or y, without gradient.
//!
//! # How it stays exact
//! 1 - (n.h)^2 is |n x h|^2, (n.v)(n.l) of the denominator cancels against G, and the few products in which nearly equal numbers
//! meet (the cosines, n x h, n x t and the half vector) are formed in double precision from vectors that are not yet normalised.
//! All else is a chain of multiplications, divisions and sums of like signs: radiance and gradient in single precision stay within 5e-6 of
//! double precision at the same inputs (on the scale of the point's radiance; for gradients that times 1/roughness, or for normal and
//! tangent 1/alpha) down to the smallest roughness.
//!
//! Everything stays finite while light intensity over squared distance is below 1e12.

pub mod fresnel;
pub mod masking;
pub mod ndf;

use crate::maps::Lobe;
use crate::real::{Arithmetic, Lanes, Real, add_scaled, cross, dot, scale};
use crate::shot::Shot;
use fresnel::fresnel_spherical_gaussian_weight;
use masking::{masking_g1_smith_anisotropic, visibility_schlick};
use ndf::{ndf_ggx, ndf_ggx_anisotropic};

pub use ndf::ALPHA_MIN;

/// Smallest (perceptual) roughness the model renders; below it, it renders this one.
pub const ROUGHNESS_MIN: f64 = 1e-3;

/// What the maps say about one point; also the gradient with respect to it.
///
/// Isotropic shading reads `roughness[0]` and no tangent, and gives them no gradient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface<T> {
    /// Diffuse albedo, RGB, linear, [0, 1].
    pub diffuse: [T; 3],
    /// Normal, any length but 0.
    pub normal: [T; 3],
    /// Perceptual roughness (x, y), [0, 1].
    pub roughness: [T; 2],
    /// Specular albedo (F0), RGB, linear, [0, 1].
    pub specular: [T; 3],
    /// Tangent, any length but 0, not parallel to the normal.
    pub tangent: [T; 3],
}

/// Radiance that a camera sees at one point, RGB, in the unit of the light's intensity over length squared.
///
/// `position` is the point in the frame and unit of `shot`. See the [module's documentation](self) for the model.
pub fn shade_point<T: Real>(lobe: Lobe, surface: &Surface<T>, position: [f64; 3], shot: &Shot) -> [T; 3] {
    let (camera, light) = offsets::<T>(position, shot);
    match lobe {
        Lobe::Isotropic => shade::<T, false>(surface, camera, light, shot),
        Lobe::Anisotropic => shade::<T, true>(surface, camera, light, shot),
    }
}

/// [`shade_point`], and the gradient of `sum(radiance * weight)` with respect to all of `surface`.
pub fn shade_point_gradient<T: Real>(
    lobe: Lobe,
    surface: &Surface<T>,
    position: [f64; 3],
    shot: &Shot,
    weight: [T; 3],
) -> ([T; 3], Surface<T>) {
    let (camera, light) = offsets::<T>(position, shot);
    match lobe {
        Lobe::Isotropic => shade_gradient::<T, false>(surface, camera, light, shot, weight),
        Lobe::Anisotropic => shade_gradient::<T, true>(surface, camera, light, shot, weight),
    }
}

type Wide3<L> = [<L as Lanes>::Wide; 3];

fn offsets<L: Lanes>(position: [f64; 3], shot: &Shot) -> (Wide3<L>, Wide3<L>) {
    let to = |target: [f64; 3]| std::array::from_fn(|i| L::Wide::splat(target[i] - position[i]));
    (to(shot.camera), to(shot.light))
}

fn intensity<L: Lanes>(shot: &Shot) -> [L; 3] {
    shot.light_intensity.map(L::splat)
}

/// What the vectors from a point to the camera and to the light of `shot` make of the shading.
#[inline(always)]
pub(crate) fn directions<L: Lanes>(camera: Wide3<L>, light: Wide3<L>, shot: &Shot) -> Directions<L> {
    if shot.camera == shot.light { Directions::collocated(camera) } else { Directions::separate(camera, light) }
}

fn shade<T: Real, const ANISOTROPIC: bool>(
    surface: &Surface<T>,
    camera: Wide3<T>,
    light: Wide3<T>,
    shot: &Shot,
) -> [T; 3] {
    let frame = Frame::<T, ANISOTROPIC>::new(surface);
    Response::new(&frame, &directions::<T>(camera, light, shot)).radiance(surface, intensity::<T>(shot))
}

fn shade_gradient<T: Real, const ANISOTROPIC: bool>(
    surface: &Surface<T>,
    camera: Wide3<T>,
    light: Wide3<T>,
    shot: &Shot,
    weight: [T; 3],
) -> ([T; 3], Surface<T>) {
    let frame = Frame::<T, ANISOTROPIC>::new(surface);
    let response = Response::new(&frame, &directions::<T>(camera, light, shot));
    let intensity = intensity::<T>(shot);
    let mut gradient = FrameGradient::zero();
    gradient.add(surface, &response, std::array::from_fn(|c| weight[c] * intensity[c]));
    (response.radiance(surface, intensity), gradient.finish(&frame))
}

/// A direction as a vector of any length: it is normalised after the product in which it could cancel, not before.
#[derive(Clone, Copy)]
struct Direction<L: Lanes> {
    vector: Wide3<L>,
    /// One over the vector's length.
    inverse_length: L,
}

impl<L: Lanes> Direction<L> {
    #[inline(always)]
    fn new(vector: Wide3<L>) -> Self {
        let narrow = narrow::<L>(vector);
        Self { vector, inverse_length: inverse(dot(narrow, narrow).sqrt()) }
    }

    /// The unit vector.
    #[inline(always)]
    fn unit(&self) -> [L; 3] {
        scale(narrow::<L>(self.vector), self.inverse_length)
    }

    /// Cosine of the angle to `other`.
    #[inline(always)]
    fn cosine(&self, other: &Self) -> L {
        L::narrow(dot(self.vector, other.vector)) * (self.inverse_length * other.inverse_length)
    }

    /// Cross product of the unit vectors.
    #[inline(always)]
    fn cross(&self, other: &Self) -> [L; 3] {
        scale(narrow::<L>(cross(self.vector, other.vector)), self.inverse_length * other.inverse_length)
    }
}

/// Where camera and light are seen from a point: all that the shading needs of a photo, and independent of the maps.
#[derive(Clone, Copy)]
pub(crate) struct Directions<L: Lanes> {
    camera: Direction<L>,
    light: Direction<L>,
    half: Direction<L>,
    /// Weight of white in the Fresnel term.
    fresnel: L,
}

impl<L: Lanes> Directions<L> {
    /// Camera and light at the same place, `camera` away from the point.
    #[inline(always)]
    pub(crate) fn collocated(camera: Wide3<L>) -> Self {
        let camera = Direction::new(camera);
        let fresnel = L::splat(fresnel_spherical_gaussian_weight(1.0_f64));
        Self { camera, light: camera, half: camera, fresnel }
    }

    /// Camera and light at the ends of two vectors from the point.
    #[inline(always)]
    pub(crate) fn separate(camera: Wide3<L>, light: Wide3<L>) -> Self {
        let camera_length = dot(camera, camera).sqrt();
        let light_length = dot(light, light).sqrt();
        // v |l| + l |v| points along the half vector; its length is |v + l| |v| |l| for unit vectors v + l.
        let half = add_scaled(camera, light_length, scale(light, camera_length));
        let half_length = L::narrow(dot(half, half).sqrt());
        let camera = Direction { vector: camera, inverse_length: inverse(L::narrow(camera_length)) };
        let light = Direction { vector: light, inverse_length: inverse(L::narrow(light_length)) };
        let half = Direction { vector: half, inverse_length: inverse(half_length) };
        // v.h = |v + l| / 2 for unit vectors.
        let v_dot_h = half_length * camera.inverse_length * light.inverse_length * L::splat(0.5);
        Self { camera, light, half, fresnel: fresnel_spherical_gaussian_weight(v_dot_h.min(L::splat(1.0))) }
    }
}

/// Shortest length a vector is divided by; what is shorter counts as 0.
const LENGTH_MIN: f64 = 1e-15;
/// Largest squared sine of the angle at which a tangent counts as parallel to the normal.
const PARALLEL2: f64 = 1e-10;

#[inline(always)]
fn inverse<L: Lanes>(length: L) -> L {
    L::splat(1.0) / length.max(L::splat(LENGTH_MIN))
}

#[inline(always)]
fn widen<L: Lanes>(vector: [L; 3]) -> Wide3<L> {
    [vector[0].widen(), vector[1].widen(), vector[2].widen()]
}

#[inline(always)]
fn narrow<L: Lanes>(vector: Wide3<L>) -> [L; 3] {
    [L::narrow(vector[0]), L::narrow(vector[1]), L::narrow(vector[2])]
}

/// Local frame and microfacet widths of a point: what the shading needs of the maps besides the albedos, once for all photos.
#[derive(Clone, Copy)]
pub(crate) struct Frame<L: Lanes, const ANISOTROPIC: bool> {
    normal: Direction<L>,
    tangent: Direction<L>,
    bitangent: Direction<L>,
    /// Clamped roughness, its square, and 1 where it was not clamped, else 0.
    roughness: [L; 2],
    alpha: [L; 2],
    roughness_free: [L; 2],
    /// n.T / T.t and 1 / T.t of the stored tangent T: how far the frame turns about n when the normal or T move along b. 0 for a
    /// replaced tangent.
    turn_by_normal: L,
    turn_by_tangent: L,
}

impl<L: Lanes, const ANISOTROPIC: bool> Frame<L, ANISOTROPIC> {
    #[inline(always)]
    pub(crate) fn new(surface: &Surface<L>) -> Self {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let minimum = L::splat(ROUGHNESS_MIN);
        // Comparisons are written so that NaN in a map comes out as NaN instead of as the replacement.
        let (mut roughness, mut roughness_free) = ([zero; 2], [zero; 2]);
        for i in 0..2 {
            let sharp = minimum.gt(surface.roughness[i]);
            roughness[i] = L::select(sharp, minimum, surface.roughness[i]);
            roughness_free[i] = L::select(sharp, zero, one);
        }
        let normal = Direction::new(widen(surface.normal));
        let mut frame = Self {
            normal,
            tangent: normal,
            bitangent: normal,
            roughness,
            alpha: [roughness[0] * roughness[0], roughness[1] * roughness[1]],
            roughness_free,
            turn_by_normal: zero,
            turn_by_tangent: zero,
        };
        if ANISOTROPIC {
            let stored = surface.tangent;
            let across = cross(surface.normal, stored);
            let both = dot(surface.normal, surface.normal) * dot(stored, stored);
            let good = !(L::splat(PARALLEL2) * both).ge(dot(across, across));
            let [x, y] = {
                let steep = (surface.normal[0].abs() * normal.inverse_length).gt(L::splat(0.8));
                [L::select(steep, zero, one), L::select(steep, one, zero)]
            };
            let tangent =
                [L::select(good, stored[0], x), L::select(good, stored[1], y), L::select(good, stored[2], zero)];
            frame.bitangent = Direction::new(cross(normal.vector, widen(tangent)));
            frame.tangent = Direction {
                vector: cross(frame.bitangent.vector, normal.vector),
                inverse_length: frame.bitangent.inverse_length * normal.inverse_length,
            };
            // T.t = |n x T|.
            let length = dot(surface.normal, surface.normal) * normal.inverse_length;
            frame.turn_by_tangent = L::select(good, frame.bitangent.inverse_length * length, zero);
            frame.turn_by_normal =
                frame.turn_by_tangent * L::narrow(dot(normal.vector, widen(stored))) * normal.inverse_length;
        }
        frame
    }

    /// A derivative by the unit normal where the stored tangent is held, from that where the frame turns without twisting, and that by a turn about the normal:
    /// moving n along b turns the tangent by -n.T / T.t.
    #[inline(always)]
    fn hold_tangent(&self, by_turn: L, by_normal: [L; 3]) -> [L; 3] {
        add_scaled(self.bitangent.unit(), -by_turn * self.turn_by_normal, by_normal)
    }

    /// The unit vector of a direction in the frame (tangent, bitangent, normal), given its cosine.
    #[inline(always)]
    fn local(&self, direction: &Direction<L>, cosine: L) -> [L; 3] {
        [direction.cosine(&self.tangent), direction.cosine(&self.bitangent), cosine]
    }
}

/// What a function with the derivatives `slope` by a direction's components (tangent, bitangent, normal) gains when the frame turns:
/// n towards t, n towards b, t towards b. A turn of a towards b takes b to -a.
#[inline(always)]
fn turns<L: Lanes>(slope: [L; 3], direction: [L; 3]) -> [L; 3] {
    let [t, b, n] = direction;
    [slope[2] * t - slope[0] * n, slope[2] * b - slope[1] * n, slope[0] * b - slope[1] * t]
}

#[inline(always)]
fn add3<L: Lanes, const N: usize>(a: [L; N], b: [L; N], c: [L; N]) -> [L; N] {
    let mut sum = a;
    for i in 0..N {
        sum[i] = a[i] + b[i] + c[i];
    }
    sum
}

/// How a point answers to one light and camera.
///
/// The radiance of channel c is `irradiance_c * (d_c (1 - s_c)/pi * cosine + F_c * lobe)` with `F_c = s_c + (1 - s_c) * fresnel`:
/// only the scalars `cosine` and `lobe` depend on normal, roughness and tangent, and their derivatives are what this holds.
#[derive(Clone, Copy)]
pub(crate) struct Response<L: Lanes> {
    /// n.l where the point is lit and seen, else 0.
    pub(crate) cosine: L,
    /// D G / (4 (n.v) (n.l)) * n.l where the point is lit and seen, else 0.
    pub(crate) lobe: L,
    /// Weight of white in the Fresnel term.
    pub(crate) fresnel: L,
    /// 1 / distance_to_light^2 where the point is lit and seen, else 0.
    pub(crate) falloff: L,
    /// Derivative of `cosine` by the unit normal (to be projected on the tangent plane, as the next).
    pub(crate) cosine_by_normal: [L; 3],
    /// Derivative of `lobe` by the unit normal, the frame turning with it without twisting.
    pub(crate) lobe_by_normal: [L; 3],
    /// Derivative of `lobe` by the clamped roughness.
    pub(crate) lobe_by_roughness: [L; 2],
    /// Derivative of `lobe` by a turn of the frame about the normal, in radians from tangent to bitangent.
    pub(crate) lobe_by_turn: L,
}

impl<L: Lanes> Response<L> {
    #[inline(always)]
    pub(crate) fn new<const ANISOTROPIC: bool>(frame: &Frame<L, ANISOTROPIC>, to: &Directions<L>) -> Self {
        let (zero, one, two) = (L::splat(0.0), L::splat(1.0), L::splat(2.0));
        let n_dot_v = frame.normal.cosine(&to.camera);
        let n_dot_l = frame.normal.cosine(&to.light);
        let visible = !(zero.ge(n_dot_v) | zero.ge(n_dot_l));
        let n_dot_v = L::select(visible, n_dot_v, one);
        let n_dot_l = L::select(visible, n_dot_l, one);
        let light_dir = to.light.unit();

        let (lobe, lobe_by_normal, lobe_by_roughness, lobe_by_turn);
        if ANISOTROPIC {
            // Replaced like the other cosines: it is all that keeps the denominator from 0 where the normal or the half vector is.
            let n_dot_h = L::select(visible, frame.normal.cosine(&to.half), one);
            let half = frame.local(&to.half, n_dot_h);
            let view = frame.local(&to.camera, n_dot_v);
            let light = frame.local(&to.light, n_dot_l);
            let d = ndf_ggx_anisotropic(half, frame.alpha);
            let masking = masking_g1_smith_anisotropic(view, frame.alpha);
            let shadowing = masking_g1_smith_anisotropic(light, frame.alpha);
            let per_cosine = d.value * masking.value * shadowing.value;
            lobe = per_cosine * n_dot_l;

            let mut light_slope = shadowing.d_direction;
            light_slope[2] = zero;
            let [tangent_slope, bitangent_slope, turn_slope] =
                add3(turns(d.d_half, half), turns(masking.d_direction, view), turns(light_slope, light));
            let normal_slope = per_cosine * shadowing.d_with_cosine;
            let by_t = lobe.mul_add(tangent_slope, normal_slope * light[0]);
            let by_b = lobe.mul_add(bitangent_slope, normal_slope * light[1]);
            lobe_by_normal = add_scaled(frame.tangent.unit(), by_t, scale(frame.bitangent.unit(), by_b));
            lobe_by_turn = lobe * turn_slope;
            let by_ln_alpha = add3(d.d_ln_alpha, masking.d_ln_alpha, shadowing.d_ln_alpha);
            lobe_by_roughness =
                [lobe * by_ln_alpha[0] * two / frame.roughness[0], lobe * by_ln_alpha[1] * two / frame.roughness[1]];
        } else {
            let (roughness, alpha) = (frame.roughness[0], frame.alpha[0]);
            let n_cross_h = frame.normal.cross(&to.half);
            let d = ndf_ggx(dot(n_cross_h, n_cross_h), alpha);
            let visibility = visibility_schlick(n_dot_v, n_dot_l, L::splat(0.5) * alpha);
            let per_cosine = d.value * visibility.value;
            lobe = per_cosine * n_dot_l;
            // d |n x h|^2 / d n = 2 h x (n x h).
            let by_half = scale(cross(to.half.unit(), n_cross_h), two * d.d_sin2);
            lobe_by_normal = add_scaled(
                light_dir,
                per_cosine * visibility.d_n_dot_l,
                scale(add_scaled(to.camera.unit(), visibility.d_n_dot_v, by_half), lobe),
            );
            // d ln alpha / d roughness = 2 / roughness, d k / d roughness = roughness.
            let by_roughness = visibility.d_k.mul_add(roughness, two * d.d_ln_alpha / roughness);
            lobe_by_roughness = [lobe * by_roughness, zero];
            lobe_by_turn = zero;
        }
        Self {
            cosine: L::select(visible, n_dot_l, zero),
            lobe: L::select(visible, lobe, zero),
            fresnel: to.fresnel,
            falloff: L::select(visible, to.light.inverse_length * to.light.inverse_length, zero),
            cosine_by_normal: light_dir,
            lobe_by_normal,
            lobe_by_roughness,
            lobe_by_turn,
        }
    }

    /// The radiance, given the light's intensity.
    #[inline(always)]
    pub(crate) fn radiance(&self, surface: &Surface<L>, intensity: [L; 3]) -> [L; 3] {
        let mut radiance = [L::splat(0.0); 3];
        for c in 0..3 {
            let albedo = surface.diffuse[c] * (L::splat(1.0) - surface.specular[c]);
            let lambert = albedo * L::splat(std::f64::consts::FRAC_1_PI) * self.cosine;
            radiance[c] = self.fresnel_of(surface, c).mul_add(self.lobe, lambert) * (intensity[c] * self.falloff);
        }
        radiance
    }

    /// Derivative of `lobe` by the unit normal, the stored tangent held.
    #[inline(always)]
    pub(crate) fn lobe_by_stored_normal<const ANISOTROPIC: bool>(&self, frame: &Frame<L, ANISOTROPIC>) -> [L; 3] {
        if ANISOTROPIC { frame.hold_tangent(self.lobe_by_turn, self.lobe_by_normal) } else { self.lobe_by_normal }
    }

    #[inline(always)]
    fn fresnel_of(&self, surface: &Surface<L>, channel: usize) -> L {
        (L::splat(1.0) - surface.specular[channel]).mul_add(self.fresnel, surface.specular[channel])
    }
}

/// Gradient with respect to albedos, unit normal, clamped roughness and the frame's turn, summed over photos.
#[derive(Clone, Copy)]
pub(crate) struct FrameGradient<L: Lanes> {
    diffuse: [L; 3],
    specular: [L; 3],
    normal: [L; 3],
    roughness: [L; 2],
    turn: L,
}

impl<L: Lanes> FrameGradient<L> {
    #[inline(always)]
    pub(crate) fn zero() -> Self {
        let zero = L::splat(0.0);
        Self { diffuse: [zero; 3], specular: [zero; 3], normal: [zero; 3], roughness: [zero; 2], turn: zero }
    }

    /// Adds one photo's part, `weight` being the derivative of the loss by the radiance, times the light's intensity.
    #[inline(always)]
    pub(crate) fn add(&mut self, surface: &Surface<L>, response: &Response<L>, weight: [L; 3]) {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let (mut by_cosine, mut by_lobe) = (zero, zero);
        for c in 0..3 {
            let weight = weight[c] * response.falloff;
            let rest = one - surface.specular[c];
            let lambert = response.cosine * L::splat(std::f64::consts::FRAC_1_PI);
            self.diffuse[c] = (weight * rest).mul_add(lambert, self.diffuse[c]);
            let lobe_slope = response.lobe * (one - response.fresnel);
            self.specular[c] = weight.mul_add(lobe_slope - surface.diffuse[c] * lambert, self.specular[c]);
            by_cosine = weight.mul_add(surface.diffuse[c] * rest, by_cosine);
            by_lobe = weight.mul_add(response.fresnel_of(surface, c), by_lobe);
        }
        let by_cosine = by_cosine * L::splat(std::f64::consts::FRAC_1_PI);
        self.normal =
            add_scaled(response.cosine_by_normal, by_cosine, add_scaled(response.lobe_by_normal, by_lobe, self.normal));
        for i in 0..2 {
            self.roughness[i] = by_lobe.mul_add(response.lobe_by_roughness[i], self.roughness[i]);
        }
        self.turn = by_lobe.mul_add(response.lobe_by_turn, self.turn);
    }

    /// The gradient with respect to what is stored: through the normalisations and the clamp of the roughness.
    #[inline(always)]
    pub(crate) fn finish<const ANISOTROPIC: bool>(self, frame: &Frame<L, ANISOTROPIC>) -> Surface<L> {
        let unit = frame.normal.unit();
        let mut normal = add_scaled(unit, -dot(unit, self.normal), self.normal);
        let mut tangent = [L::splat(0.0); 3];
        if ANISOTROPIC {
            normal = frame.hold_tangent(self.turn, normal);
            tangent = scale(frame.bitangent.unit(), self.turn * frame.turn_by_tangent);
        }
        Surface {
            diffuse: self.diffuse,
            normal: scale(normal, frame.normal.inverse_length),
            roughness: [self.roughness[0] * frame.roughness_free[0], self.roughness[1] * frame.roughness_free[1]],
            specular: self.specular,
            tangent,
        }
    }
}

#[cfg(test)]
mod testing {
    /// Asserts that `slope` is the derivative of `f` at `x`, to 1e-6 of the larger of itself and `scale`.
    pub(super) fn assert_slope(f: impl Fn(f64) -> f64, x: f64, step: f64, slope: f64, scale: f64) {
        let quotient = |h: f64| (f(x + h) - f(x - h)) / (2.0 * h);
        // Richardson's extrapolation removes the error of second order.
        let expected = (4.0 * quotient(step) - quotient(2.0 * step)) / 3.0;
        let error = (slope - expected).abs() / expected.abs().max(scale);
        assert!(error < 1e-6, "at {x:e}: {slope:e}, by differences {expected:e}, error {error:e}");
    }
}
