//! From the adapters' raw planes to material maps, with the gradient.

use rayon::prelude::*;

use crate::color::GAMMA;
use crate::error::{Error, Result};
use crate::maps::{DIFFUSE_PLANE, Lobe, Maps, NORMAL_PLANE, ROUGHNESS_PLANE};
use crate::real::{Arithmetic, Kernel, Lanes, Real};

/// Largest x^2 + y^2 of a normal given by x and y; its z is then 1e-3.
const FLAT_LIMIT: f64 = 1.0 - 1e-6;
/// Smallest squared length of a vector that is normalised; a shorter one becomes the default.
const SHORT_LIMIT: f64 = 1e-12;
/// Pixels one task works on.
const PART: usize = 16_384;

/// How raw planes become maps.
///
/// Raw planes come in the order of the maps (see [`Maps`]); an isotropic normal has two, x and y, all else as many as its map.
/// - Albedos and roughness: `((clamp(o, floor, 1) + 1) / 2)^2.2`. The gradient is zero outside of [floor, 1], as the value is constant there.
/// - Isotropic normal: (x, y, sqrt(1 - x^2 - y^2)). Where x^2 + y^2 exceeds 1 - 1e-6, (x, y) is scaled to that and z is 1e-3:
///   the gradient then turns the direction of (x, y) and leaves its length alone.
/// - Anisotropic normal and tangent: normalised. One shorter than 1e-6 becomes +z (tangent: +x), without gradient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decoding {
    lobe: Lobe,
    roughness_floor: f64,
}

/// Planes that are decoded alike: where they begin in raw planes and maps, how many maps there are, and how.
struct Group {
    raw: usize,
    map: usize,
    kind: Kind,
}

#[derive(Clone, Copy)]
enum Kind {
    /// So many planes of albedo or roughness with a floor.
    Power { planes: usize, floor: f64 },
    /// A vector of which two components are given.
    Flat,
    /// A vector of any length, and the axis that replaces a short one.
    Vector { axis: usize },
}

impl Kind {
    const fn raw_planes(self) -> usize {
        match self {
            Self::Power { planes, .. } => planes,
            Self::Flat => 2,
            Self::Vector { .. } => 3,
        }
    }

    const fn map_planes(self) -> usize {
        match self {
            Self::Power { planes, .. } => planes,
            Self::Flat | Self::Vector { .. } => 3,
        }
    }
}

impl Decoding {
    /// The decoding of maps of `lobe` with all of [-1, 1] in use.
    pub const fn new(lobe: Lobe) -> Self {
        Self { lobe, roughness_floor: -1.0 }
    }

    /// With raw roughness clamped at `floor` from below; the released models use -0.3, which is a roughness of 0.0993.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] if `floor` is not in [-1, 1).
    pub fn with_roughness_floor(self, floor: f64) -> Result<Self> {
        if !(-1.0..1.0).contains(&floor) {
            return Err(Error::invalid("roughness_floor", format!("expected a value in [-1, 1), got {floor}")));
        }
        Ok(Self { roughness_floor: floor, ..self })
    }

    /// The reflectance model of the maps.
    pub const fn lobe(&self) -> Lobe {
        self.lobe
    }

    /// Number of raw planes: 9, anisotropic 14.
    pub const fn raw_planes(&self) -> usize {
        match self.lobe {
            Lobe::Isotropic => 9,
            Lobe::Anisotropic => 14,
        }
    }

    fn groups(&self) -> Vec<Group> {
        let albedo = Kind::Power { planes: 3, floor: -1.0 };
        let roughness = Kind::Power { planes: self.lobe.roughness_planes(), floor: self.roughness_floor };
        let specular = self.lobe.specular_plane();
        let kinds = match self.lobe {
            Lobe::Isotropic => {
                vec![
                    (DIFFUSE_PLANE, albedo),
                    (NORMAL_PLANE, Kind::Flat),
                    (ROUGHNESS_PLANE, roughness),
                    (specular, albedo),
                ]
            }
            Lobe::Anisotropic => vec![
                (DIFFUSE_PLANE, albedo),
                (NORMAL_PLANE, Kind::Vector { axis: 2 }),
                (ROUGHNESS_PLANE, roughness),
                (specular, albedo),
                (self.lobe.tangent_plane(), Kind::Vector { axis: 0 }),
            ],
        };
        let mut raw = 0;
        kinds
            .into_iter()
            .map(|(map, kind)| {
                raw += kind.raw_planes();
                Group { raw: raw - kind.raw_planes(), map, kind }
            })
            .collect()
    }

    fn check<R: Real>(&self, raw: &[R], name: &str, maps: &Maps<R>) -> Result<()> {
        let pixels = maps.width() * maps.height();
        if maps.lobe() != self.lobe {
            return Err(Error::shape("maps", format!("{:?}", self.lobe), format!("{:?}", maps.lobe())));
        }
        if raw.len() != self.raw_planes() * pixels {
            let expected = format!("{} planes of {} x {}", self.raw_planes(), maps.height(), maps.width());
            return Err(Error::shape(name, expected, format!("{} values", raw.len())));
        }
        Ok(())
    }

    /// Overwrites `maps` with what `raw` means.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if `maps` are of the other lobe or `raw` does not hold [`Decoding::raw_planes`] planes of their size.
    pub fn decode<R: Real>(&self, raw: &[R], maps: &mut Maps<R>) -> Result<()> {
        self.check(raw, "raw", maps)?;
        let pixels = maps.width() * maps.height();
        for Group { raw: from, map, kind } in self.groups() {
            let raw = &raw[from * pixels..][..kind.raw_planes() * pixels];
            let maps = &mut maps.data_mut()[map * pixels..][..kind.map_planes() * pixels];
            match kind {
                Kind::Power { floor, .. } => {
                    let parts = raw.par_chunks(PART).zip(maps.par_chunks_mut(PART));
                    parts.for_each(|(raw, values)| R::run(Power { raw, floor, values }));
                }
                Kind::Flat => {
                    parts(maps, pixels)
                        .into_par_iter()
                        .enumerate()
                        .for_each(|(part, values)| R::run(Flat { raw: planes(raw, pixels, part), values }));
                }
                Kind::Vector { axis } => {
                    parts(maps, pixels)
                        .into_par_iter()
                        .enumerate()
                        .for_each(|(part, values)| R::run(Normalize { raw: planes(raw, pixels, part), axis, values }));
                }
            }
        }
        Ok(())
    }

    /// Overwrites `d_raw` with the gradient of a loss with respect to `raw`, given its gradient `d_maps` with respect to the maps.
    ///
    /// # Errors
    /// As [`Decoding::decode`], for `raw` and `d_raw`.
    pub fn backward<R: Real>(&self, raw: &[R], d_maps: &Maps<R>, d_raw: &mut [R]) -> Result<()> {
        self.check(raw, "raw", d_maps)?;
        self.check(d_raw, "d_raw", d_maps)?;
        let pixels = d_maps.width() * d_maps.height();
        for Group { raw: from, map, kind } in self.groups() {
            let of = from * pixels..(from + kind.raw_planes()) * pixels;
            let (raw, d_raw) = (&raw[of.clone()], &mut d_raw[of]);
            let d_maps = &d_maps.data()[map * pixels..][..kind.map_planes() * pixels];
            match kind {
                Kind::Power { floor, .. } => {
                    let parts = raw.par_chunks(PART).zip(d_maps.par_chunks(PART)).zip(d_raw.par_chunks_mut(PART));
                    parts.for_each(|((raw, slopes), values)| R::run(PowerBackward { raw, slopes, floor, values }));
                }
                Kind::Flat => {
                    parts(d_raw, pixels).into_par_iter().enumerate().for_each(|(part, values)| {
                        let (raw, slopes) = (planes(raw, pixels, part), planes(d_maps, pixels, part));
                        R::run(FlatBackward { raw, slopes, values });
                    });
                }
                Kind::Vector { .. } => {
                    parts(d_raw, pixels).into_par_iter().enumerate().for_each(|(part, values)| {
                        let (raw, slopes) = (planes(raw, pixels, part), planes(d_maps, pixels, part));
                        R::run(NormalizeBackward { raw, slopes, values });
                    });
                }
            }
        }
        Ok(())
    }
}

/// Part `part` of each of `N` planes.
fn planes<R, const N: usize>(values: &[R], pixels: usize, part: usize) -> [&[R]; N] {
    let (start, end) = (part * PART, pixels.min((part + 1) * PART));
    std::array::from_fn(|plane| &values[plane * pixels + start..plane * pixels + end])
}

/// The parts of `N` planes: each part has its pixels of all planes.
fn parts<R, const N: usize>(values: &mut [R], pixels: usize) -> Vec<[&mut [R]; N]> {
    let mut planes = values.chunks_mut(pixels).map(|plane| plane.chunks_mut(PART)).collect::<Vec<_>>();
    let take = |_| {
        let parts: Vec<&mut [R]> = planes.iter_mut().filter_map(Iterator::next).collect();
        parts.try_into().ok()
    };
    (0..pixels.div_ceil(PART)).filter_map(take).collect()
}

struct Power<'a, R> {
    raw: &'a [R],
    floor: f64,
    values: &'a mut [R],
}

impl<R: Real> Kernel<R> for Power<'_, R> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes<Scalar = R>>(self) {
        for (raw, value) in self.raw.chunks(L::LANES).zip(self.values.chunks_mut(L::LANES)) {
            unit(L::load(raw), self.floor).pow(GAMMA).store(value);
        }
    }
}

struct PowerBackward<'a, R> {
    raw: &'a [R],
    slopes: &'a [R],
    floor: f64,
    values: &'a mut [R],
}

impl<R: Real> Kernel<R> for PowerBackward<'_, R> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes<Scalar = R>>(self) {
        let inputs = self.raw.chunks(L::LANES).zip(self.slopes.chunks(L::LANES));
        for ((raw, slope), value) in inputs.zip(self.values.chunks_mut(L::LANES)) {
            let raw = L::load(raw);
            let slope = L::load(slope) * L::splat(GAMMA / 2.0) * unit(raw, self.floor).pow(GAMMA - 1.0);
            let outside = L::splat(self.floor).gt(raw) | raw.gt(L::splat(1.0));
            L::select(outside, L::splat(0.0), slope).store(value);
        }
    }
}

/// `(clamp(raw, floor, 1) + 1) / 2`.
#[inline(always)]
fn unit<L: Lanes>(raw: L, floor: f64) -> L {
    let clamped = raw.max(L::splat(floor)).min(L::splat(1.0));
    clamped.mul_add(L::splat(0.5), L::splat(0.5))
}

struct Flat<'a, R> {
    raw: [&'a [R]; 2],
    values: [&'a mut [R]; 3],
}

impl<R: Real> Kernel<R> for Flat<'_, R> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes<Scalar = R>>(self) {
        let [xs, ys, zs] = self.values;
        for at in (0..xs.len()).step_by(L::LANES) {
            let (x, y) = (L::load(&self.raw[0][at..]), L::load(&self.raw[1][at..]));
            let square = x.mul_add(x, y * y);
            let limit = L::splat(FLAT_LIMIT);
            let scale = L::select(square.gt(limit), (limit / square).sqrt(), L::splat(1.0));
            (x * scale).store(&mut xs[at..]);
            (y * scale).store(&mut ys[at..]);
            (L::splat(1.0) - square.min(limit)).sqrt().store(&mut zs[at..]);
        }
    }
}

struct FlatBackward<'a, R> {
    raw: [&'a [R]; 2],
    slopes: [&'a [R]; 3],
    values: [&'a mut [R]; 2],
}

impl<R: Real> Kernel<R> for FlatBackward<'_, R> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes<Scalar = R>>(self) {
        let [xs, ys] = self.values;
        for at in (0..xs.len()).step_by(L::LANES) {
            let (x, y) = (L::load(&self.raw[0][at..]), L::load(&self.raw[1][at..]));
            let [dx, dy, dz] = load_vector(&self.slopes, at);
            let square = x.mul_add(x, y * y);
            let limit = L::splat(FLAT_LIMIT);
            let steep = square.gt(limit);
            // Inside, z falls by x / z; outside, only the direction of (x, y) counts.
            let scale = L::select(steep, (limit / square).sqrt(), L::splat(1.0));
            let inside = dz / (L::splat(1.0) - square.min(limit)).sqrt();
            let outside = scale * x.mul_add(dx, y * dy) / square;
            let along = L::select(steep, outside, inside);
            (scale * dx - along * x).store(&mut xs[at..]);
            (scale * dy - along * y).store(&mut ys[at..]);
        }
    }
}

struct Normalize<'a, R> {
    raw: [&'a [R]; 3],
    axis: usize,
    values: [&'a mut [R]; 3],
}

impl<R: Real> Kernel<R> for Normalize<'_, R> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes<Scalar = R>>(self) {
        let mut values = self.values;
        for at in (0..self.raw[0].len()).step_by(L::LANES) {
            let vector: [L; 3] = load_vector(&self.raw, at);
            let (unit, long) = (inverse_length(vector), is_long(vector));
            for (component, (vector, values)) in vector.into_iter().zip(&mut values).enumerate() {
                let default = L::splat(if component == self.axis { 1.0 } else { 0.0 });
                L::select(long, vector * unit, default).store(&mut values[at..]);
            }
        }
    }
}

struct NormalizeBackward<'a, R> {
    raw: [&'a [R]; 3],
    slopes: [&'a [R]; 3],
    values: [&'a mut [R]; 3],
}

impl<R: Real> Kernel<R> for NormalizeBackward<'_, R> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes<Scalar = R>>(self) {
        let mut values = self.values;
        for at in (0..self.raw[0].len()).step_by(L::LANES) {
            let vector: [L; 3] = load_vector(&self.raw, at);
            let slopes: [L; 3] = load_vector(&self.slopes, at);
            let (inverse, long) = (inverse_length(vector), is_long(vector));
            let unit = [vector[0] * inverse, vector[1] * inverse, vector[2] * inverse];
            let along = dot(slopes, unit);
            for ((slope, unit), values) in slopes.into_iter().zip(unit).zip(&mut values) {
                L::select(long, (slope - along * unit) * inverse, L::splat(0.0)).store(&mut values[at..]);
            }
        }
    }
}

// Without a closure: it would be compiled for any processor, and its loads would become calls.
#[inline(always)]
fn load_vector<L: Lanes>(planes: &[&[L::Scalar]; 3], at: usize) -> [L; 3] {
    [L::load(&planes[0][at..]), L::load(&planes[1][at..]), L::load(&planes[2][at..])]
}

#[inline(always)]
fn dot<A: Arithmetic>(a: [A; 3], b: [A; 3]) -> A {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

/// 1 / length, of a vector that is not short.
#[inline(always)]
fn inverse_length<L: Lanes>(vector: [L; 3]) -> L {
    L::splat(1.0) / dot(vector, vector).max(L::splat(SHORT_LIMIT)).sqrt()
}

#[inline(always)]
fn is_long<L: Lanes>(vector: [L; 3]) -> L::Mask {
    dot(vector, vector).gt(L::splat(SHORT_LIMIT))
}

#[cfg(test)]
mod tests {
    use super::Decoding;
    use crate::maps::{Lobe, Maps};

    const LOBES: [Lobe; 2] = [Lobe::Isotropic, Lobe::Anisotropic];

    fn maps<T: Clone + Default>(lobe: Lobe, pixels: usize) -> Maps<T> {
        Maps::new(lobe, pixels, 1, vec![T::default(); lobe.planes() * pixels]).unwrap()
    }

    /// Values over [-1.3, 1.3] without pattern.
    fn noise(len: usize) -> Vec<f64> {
        (0..len).map(|i| ((i as f64 * 0.754_877_666 + 0.1).fract() - 0.5) * 2.6).collect()
    }

    #[test]
    fn known_values() {
        let raw = [-1.5, -1.0, 0.0, 0.6, -0.8, -0.5, 1.0, 2.0, 0.5f64];
        let mut out = maps(Lobe::Isotropic, 1);
        Decoding::new(Lobe::Isotropic).decode(&raw, &mut out).unwrap();
        let expected = [0.0, 0.0, 0.5f64.powf(2.2), 0.6, -0.8, 1e-3, 0.25f64.powf(2.2), 1.0, 1.0, 0.75f64.powf(2.2)];
        for (i, (got, expected)) in out.data().iter().zip(expected).enumerate() {
            // 0.6^2 + 0.8^2 is over the limit by 1e-6.
            assert!((got - expected).abs() < 1e-6, "{i}: {got} {expected}");
        }
        let floored = Decoding::new(Lobe::Isotropic).with_roughness_floor(-0.3).unwrap();
        floored.decode(&raw, &mut out).unwrap();
        assert!((out.plane(6)[0] - 0.35f64.powf(2.2)).abs() < 1e-12);
        assert!(Decoding::new(Lobe::Isotropic).with_roughness_floor(1.0).is_err());
        assert!(Decoding::new(Lobe::Isotropic).with_roughness_floor(f64::NAN).is_err());
    }

    #[test]
    fn normals_have_unit_length_and_short_vectors_a_default() {
        for lobe in LOBES {
            let decoding = Decoding::new(lobe);
            let pixels = 1003;
            let mut raw = noise(decoding.raw_planes() * pixels);
            (0..decoding.raw_planes()).for_each(|plane| raw[plane * pixels] = 0.0);
            let mut out = maps(lobe, pixels);
            decoding.decode(&raw, &mut out).unwrap();
            let first = if lobe == Lobe::Isotropic { vec![3] } else { vec![3, lobe.tangent_plane()] };
            for plane in first {
                for p in 0..pixels {
                    let [x, y, z] = [0, 1, 2].map(|c| out.plane(plane + c)[p]);
                    assert!((x * x + y * y + z * z - 1.0).abs() < 1e-12, "{x} {y} {z}");
                }
                assert_eq!(out.plane(if plane == 3 { 5 } else { plane })[0], 1.0);
            }
        }
    }

    #[test]
    fn gradient_matches_differences() {
        for lobe in LOBES {
            let decoding = Decoding::new(lobe).with_roughness_floor(-0.3).unwrap();
            let pixels = 501;
            let mut raw = noise(decoding.raw_planes() * pixels);
            let weights = Maps::new(lobe, pixels, 1, noise(lobe.planes() * pixels)).unwrap();
            let mut gradient = vec![f64::NAN; raw.len()];
            decoding.backward(&raw, &weights, &mut gradient).unwrap();
            let mut out = maps(lobe, pixels);
            let mut pixel_loss = |raw: &[f64], p: usize| -> f64 {
                decoding.decode(raw, &mut out).unwrap();
                (0..lobe.planes()).map(|plane| out.plane(plane)[p] * weights.plane(plane)[p]).sum()
            };
            for i in (0..raw.len()).step_by(7) {
                let (at, delta) = (raw[i], 1e-7);
                raw[i] = at + delta;
                let above = pixel_loss(&raw, i % pixels);
                raw[i] = at - delta;
                let below = pixel_loss(&raw, i % pixels);
                raw[i] = at;
                let expected = (above - below) / (2.0 * delta);
                assert!(
                    (gradient[i] - expected).abs() < 1e-6 * expected.abs().max(1.0),
                    "{lobe:?} {i} {at}: {} {expected}",
                    gradient[i]
                );
            }
        }
    }

    #[test]
    fn single_precision_follows_double() {
        for lobe in LOBES {
            let decoding = Decoding::new(lobe);
            // More than one part, and no whole number of vectors.
            let pixels = super::PART + 37;
            let raw = noise(decoding.raw_planes() * pixels);
            let slopes = noise(lobe.planes() * pixels);
            let single = |values: &[f64]| values.iter().map(|&x| x as f32).collect::<Vec<f32>>();
            let double = |values: &[f32]| values.iter().map(|&x| f64::from(x)).collect::<Vec<f64>>();
            let (raw32, slopes32) = (single(&raw), single(&slopes));
            let (raw, slopes) = (double(&raw32), double(&slopes32));
            let (mut out, mut out32) = (maps::<f64>(lobe, pixels), maps::<f32>(lobe, pixels));
            decoding.decode(&raw, &mut out).unwrap();
            decoding.decode(&raw32, &mut out32).unwrap();
            for (i, (a, b)) in out.data().iter().zip(out32.data()).enumerate() {
                // z of a normal at the limit is 1e-3 and loses half of the digits.
                assert!((a - f64::from(*b)).abs() < if i / pixels == 5 { 3e-5 } else { 2e-6 }, "{i}: {a} {b}");
            }
            let (mut d_raw, mut d_raw32) = (vec![0.0; raw.len()], vec![0.0; raw.len()]);
            decoding.backward(&raw, &Maps::new(lobe, pixels, 1, slopes).unwrap(), &mut d_raw).unwrap();
            decoding.backward(&raw32, &Maps::new(lobe, pixels, 1, slopes32).unwrap(), &mut d_raw32).unwrap();
            for (i, (a, b)) in d_raw.iter().zip(&d_raw32).enumerate() {
                let p = i % pixels;
                // dz/dx is x/z: near the limit it is large and as inexact as z.
                let z = out.plane(5)[p];
                let tolerance = if z < 0.05 { continue } else { 1e-5 / (z * z) };
                assert!((a - f64::from(*b)).abs() < tolerance * a.abs().max(1.0), "{i}: {a} {b} {z}");
            }
        }
    }

    #[test]
    fn wrong_shapes_are_errors() {
        let decoding = Decoding::new(Lobe::Isotropic);
        let mut out = maps(Lobe::Isotropic, 4);
        assert!(decoding.decode(&[0.0; 40], &mut out).is_err());
        assert!(decoding.decode(&[0.0; 36], &mut maps(Lobe::Anisotropic, 4)).is_err());
        assert!(decoding.backward(&[0.0; 36], &out, &mut [0.0; 35]).is_err());
    }
}
