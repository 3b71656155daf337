//! Where [`direct`](super) begins: which specular albedo, roughness and common tilt explain the photos of a flat surface best.
//!
//! For fixed roughness and specular albedo the diffuse albedo of a pixel is a linear least-squares problem, so that a colour group's two
//! values can be searched on a grid. A descent from a dielectric of 4 % alone stays there where the photos show metal or gloss.
//!
//! Not from the paper.

#![allow(
    clippy::manual_map,
    clippy::needless_range_loop,
    reason = "closures would not be compiled for the processor's lanes"
)]

use rayon::prelude::*;

use super::groups::Membership;
use crate::capture::{Capture, Photo};
use crate::color::GAMMA;
use crate::fit::options::Reflectance;
use crate::fit::shading::{Geometry, LobeFrame, Parts, Stretch, bundle, saturated, shape, unbundle};
use crate::real::{Kernel, LANES_MAX, Lanes, Real, Wide};
use crate::render::encode;

/// Pixels of a group that are looked at.
const GROUP_PIXELS: usize = 96;
/// While the tilt is searched, one in so many of them in green, and every second candidate of the values.
const TILT_STRIDE: usize = 4;
/// Photos that are looked at.
const PHOTOS: usize = 16;
/// Candidates.
const ROUGHNESSES: [f64; 9] = [0.12, 0.17, 0.23, 0.3, 0.38, 0.47, 0.58, 0.72, 0.9];
const SPECULARS: [f64; 9] = [0.01, 0.02, 0.04, 0.07, 0.12, 0.2, 0.35, 0.6, 0.85];
/// Candidates for either slope of the common tilt.
const TILTS: [f64; 5] = [-0.14, -0.07, 0.0, 0.07, 0.14];
/// Candidates for the length of the anisotropy, and directions of it.
const ANISOTROPIES: [f64; 3] = [0.5, 1.0, 1.6];
const DIRECTIONS: usize = 8;
const ANISOTROPIC_ROUNDS: usize = 2;
/// Differences of codes beyond this count less and less (Cauchy).
const OUTLIER: f64 = 0.1;
/// Largest diffuse albedo.
const DIFFUSE_MAX: f64 = 0.95;
/// Exponent of the squared slope of a code, by radiance; and the least radiance for which it is taken.
const SLOPE_EXPONENT: f64 = 2.0 / GAMMA - 2.0;
const SLOPE_DARK: f64 = 1e-3;
/// Pixels whose diffuse albedo one thread computes at a time.
const PART: usize = 1024;

/// How unlikely a specular albedo and a roughness are before the photos, in sums of squared differences of codes per pixel.
pub(super) struct Prior<'a> {
    pub specular: &'a (dyn Fn(f64) -> f64 + Sync),
    pub roughness: &'a (dyn Fn(f64) -> f64 + Sync),
    pub tilt: &'a (dyn Fn([f64; 2]) -> f64 + Sync),
    /// By the length of the anisotropy.
    pub anisotropy: &'a (dyn Fn(f64) -> f64 + Sync),
}

/// The lobe of a colour group.
#[derive(Clone, Copy, Debug)]
pub(super) struct GroupLobe {
    pub specular: [f64; 3],
    pub roughness: f64,
    /// 0 for a round lobe.
    pub anisotropy: [f64; 2],
}

impl GroupLobe {
    /// Of a group of which nothing is seen: a dielectric's.
    const UNKNOWN: Self = Self { specular: [0.04; 3], roughness: 0.5, anisotropy: [0.0; 2] };
}

/// How a surface leans, and the anisotropy of its lobe; `None` for the isotropic model, whose masking is another.
#[derive(Clone, Copy)]
struct Shape {
    tilt: [f64; 2],
    anisotropy: Option<[f64; 2]>,
}

/// Pixels in one photo.
struct View<L: Lanes> {
    geometry: Geometry<L>,
    code: [L; 3],
    radiance: [L; 3],
    /// Squared slopes of the codes, by radiance; 0 where that is not known.
    weight: [L; 3],
    saturated: [L::Mask; 3],
}

impl<L: Lanes> View<L> {
    #[inline(always)]
    fn new(capture: &Capture, photo: usize, pixels: &[usize]) -> Self {
        let photo = &capture.photos()[photo];
        let zero = [L::splat(0.0); 3];
        let saturated = saturated::<L, _>(pixels, |&pixel| photo.saturated[pixel]);
        let (mut radiance, mut code, mut weight) = (zero, zero, zero);
        for c in 0..3 {
            radiance[c] = bundle(pixels, |&pixel| photo.image.data()[3 * pixel + c]);
            code[c] = encode(radiance[c]).0;
            let slope2 = radiance[c].max(L::splat(SLOPE_DARK)).pow_normal(SLOPE_EXPONENT);
            weight[c] = L::select(saturated[c], zero[c], slope2);
        }
        let geometry = Geometry::of_pixels(capture, &photo.shot, pixels, |&pixel| pixel);
        Self { geometry, code, radiance, weight, saturated }
    }

    /// The pixels in each of `photos`.
    #[inline(always)]
    fn all(capture: &Capture, photos: &[usize], pixels: &[usize]) -> Vec<Self> {
        let mut views = Vec::with_capacity(photos.len());
        for &photo in photos {
            views.push(Self::new(capture, photo, pixels));
        }
        views
    }
}

/// What a surface sends to the camera in each of `views`, in `parts`.
#[inline(always)]
fn shade<L: Lanes>(views: &[View<L>], frame: &LobeFrame<L>, parts: &mut Vec<Parts<L>>) {
    parts.clear();
    for view in views {
        parts.push(view.geometry.parts(frame));
    }
}

impl Shape {
    /// The lobe's frame on pixels with these slopes.
    #[inline(always)]
    fn frame<L: Lanes>(&self, slopes: [L; 2], roughness: L) -> LobeFrame<L> {
        let stretch = match self.anisotropy {
            None => None,
            Some([p, q]) => Some(Stretch::new([L::splat(p), L::splat(q)])),
        };
        shape(normal(slopes, self.tilt), roughness, stretch).1
    }
}

/// The slopes of the relief at some pixels, 0 where there is none.
#[inline(always)]
fn slopes_of<L: Lanes>(relief: Option<&[f32]>, pixels: &[usize]) -> [L; 2] {
    match relief {
        None => [L::splat(0.0); 2],
        Some(relief) => {
            let (x, y) = relief.split_at(relief.len() / 2);
            [bundle(pixels, |&pixel| x[pixel]), bundle(pixels, |&pixel| y[pixel])]
        }
    }
}

/// The unit normal of slopes and a tilt.
#[inline(always)]
fn normal<L: Lanes>(slopes: [L; 2], tilt: [f64; 2]) -> [L; 3] {
    let (x, y) = (slopes[0] + L::splat(tilt[0]), slopes[1] + L::splat(tilt[1]));
    let scale = L::splat(1.0) / x.mul_add(x, y.mul_add(y, L::splat(1.0))).sqrt();
    [x * scale, y * scale, scale]
}

/// The diffuse albedo in channel `c` that fits best beside specular albedo `s`: least squares with differences of codes to first order.
#[inline(always)]
fn diffuse_beside<L: Lanes>(views: &[View<L>], parts: &[Parts<L>], c: usize, s: L) -> L {
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let (mut up, mut down) = (zero, zero);
    for (view, parts) in views.iter().zip(parts) {
        let matt = parts.diffuse[c] * (one - s);
        let weighted = view.weight[c] * matt;
        let shine = parts.specular[c] * (one - s).mul_add(parts.fresnel, s);
        up = weighted.mul_add(view.radiance[c] - shine, up);
        down = weighted.mul_add(matt, down);
    }
    let most = L::splat(DIFFUSE_MAX);
    L::select(down.gt(zero), (up / down).max(zero).min(most), L::splat(0.5) * most)
}

/// How far pixels' channel is from the photos with these albedos.
#[inline(always)]
fn misfit<L: Lanes>(views: &[View<L>], parts: &[Parts<L>], c: usize, d: L, s: L) -> L {
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let mut logs = zero;
    for (view, parts) in views.iter().zip(parts) {
        let radiance = parts.diffuse[c] * d * (one - s) + parts.specular[c] * (one - s).mul_add(parts.fresnel, s);
        let off = encode(radiance).0 - view.code[c];
        let off = L::select(view.saturated[c], off.min(zero), off) * L::splat(1.0 / OUTLIER);
        logs = logs + off.mul_add(off, one).log2();
    }
    logs * L::splat(OUTLIER * OUTLIER * std::f64::consts::LN_2)
}

/// The best values of some pixels on surfaces of each of `shapes`, and how far from the photos they are per pixel.
struct Explain<'a> {
    capture: &'a Capture,
    photos: &'a [usize],
    pixels: &'a [usize],
    relief: Option<&'a [f32]>,
    shapes: &'a [Shape],
    /// Every so many-th candidate, in these channels.
    step: usize,
    channels: &'a [usize],
    prior: &'a Prior<'a>,
}

impl<R: Real> Kernel<R> for Explain<'_> {
    type Output = Vec<(f64, GroupLobe)>;

    #[inline(always)]
    fn run<L: Lanes<Scalar = R>>(self) -> Self::Output {
        let Self { capture, photos, pixels, relief, shapes, step, channels, prior } = self;
        let mut bundles = Vec::with_capacity(pixels.len().div_ceil(L::LANES));
        for pixels in pixels.chunks(L::LANES) {
            // The last bundle may hold its last pixel more than once.
            let counted: L = L::load_f32(&[1.0; LANES_MAX][..pixels.len()]);
            bundles.push((View::all(capture, photos, pixels), slopes_of::<L>(relief, pixels), counted));
        }
        let surprises = SPECULARS.map(|specular| (prior.specular)(specular));
        let mut parts: Vec<Parts<L>> = Vec::with_capacity(photos.len());
        let mut best_of_shapes = Vec::with_capacity(shapes.len());
        for &shape in shapes {
            let anisotropy = shape.anisotropy.unwrap_or_default();
            let mut best = (f64::INFINITY, GroupLobe { anisotropy, ..GroupLobe::UNKNOWN });
            for roughness in ROUGHNESSES.into_iter().step_by(step) {
                let mut sums = [[L::splat(0.0); SPECULARS.len()]; 3];
                for (views, slopes, counted) in &bundles {
                    shade(views, &shape.frame(*slopes, L::splat(roughness)), &mut parts);
                    for &c in channels {
                        for i in (0..SPECULARS.len()).step_by(step) {
                            let s = L::splat(SPECULARS[i]);
                            let d = diffuse_beside(views, &parts, c, s);
                            sums[c][i] = misfit(views, &parts, c, d, s).mul_add(*counted, sums[c][i]);
                        }
                    }
                }
                let mut found = GroupLobe { specular: [0.04; 3], roughness, anisotropy };
                let mut total = (prior.roughness)(roughness) + (prior.anisotropy)(anisotropy[0].hypot(anisotropy[1]));
                for &c in channels {
                    let mut least = f64::INFINITY;
                    for i in (0..SPECULARS.len()).step_by(step) {
                        let mean = sums[c][i].widen().sum() / pixels.len() as f64;
                        let cost = mean + surprises[i];
                        if cost < least {
                            (least, found.specular[c]) = (cost, SPECULARS[i]);
                        }
                    }
                    total += least;
                }
                if total < best.0 {
                    best = (total, found);
                }
            }
            best_of_shapes.push(best);
        }
        best_of_shapes
    }
}

/// Estimated bytes that [`search`] takes on each thread.
pub(super) fn memory(photos: usize) -> u64 {
    // Of the widest bundles.
    const VIEW: usize = 4 * (13 + 3 * 4);
    (GROUP_PIXELS * photos.min(PHOTOS) * VIEW) as u64
}

/// For each of `groups` colour groups the values that explain the photos best, and the tilt that all share, on a surface with this `relief`. An anisotropic group's lobe is round or the one that suits
/// all best.
pub(super) fn search(
    capture: &Capture,
    memberships: &[Membership],
    groups: usize,
    relief: Option<&[f32]>,
    reflectance: Reflectance,
    prior: &Prior<'_>,
) -> (Vec<GroupLobe>, [f64; 2]) {
    let count = capture.len().min(PHOTOS);
    let photos: Vec<usize> = (0..count).map(|i| i * capture.len() / count).collect();
    let mut members = vec![Vec::new(); groups];
    for (pixel, [(group, _), _]) in memberships.iter().enumerate() {
        members[*group as usize].push(pixel);
    }
    let samples: Vec<Vec<usize>> = members
        .iter()
        .map(|pixels| {
            let taken = pixels.len().min(GROUP_PIXELS);
            (0..taken).map(|i| pixels[(2 * i + 1) * pixels.len() / (2 * taken)]).collect()
        })
        .collect();
    let explain = |pixels: &[usize], shapes: &[Shape], step: usize, channels: &[usize]| {
        f32::run(Explain { capture, photos: &photos, pixels, relief, shapes, step, channels, prior })
    };
    // The shape that suits all groups best, a group counting by its size.
    let best_of = |shapes: &[Shape], cost: &dyn Fn(&Shape) -> f64| -> Shape {
        let quick = |sample: &Vec<usize>| {
            let pixels: Vec<usize> = sample.iter().step_by(TILT_STRIDE).copied().collect();
            explain(&pixels, shapes, 2, &[1])
        };
        let of_groups: Vec<Vec<(f64, GroupLobe)>> = samples.par_iter().map(quick).collect();
        let mut best = (f64::INFINITY, shapes[0]);
        for (i, shape) in shapes.iter().enumerate() {
            let costs = of_groups.iter().zip(&members).filter(|(_, members)| !members.is_empty());
            let misfit = costs.map(|(costs, members)| members.len() as f64 * costs[i].0).sum::<f64>();
            let total = misfit / memberships.len() as f64 + cost(shape);
            if total < best.0 {
                best = (total, *shape);
            }
        }
        best.1
    };
    let anisotropic = reflectance == Reflectance::Anisotropic;
    let leaning = |tilt: [f64; 2]| Shape { tilt, anisotropy: anisotropic.then_some([0.0; 2]) };
    let tilts: Vec<Shape> = TILTS.iter().flat_map(|&x| TILTS.map(|y| leaning([x, y]))).collect();
    let mut shape = best_of(&tilts, &|shape| (prior.tilt)(shape.tilt));
    let mut shapes = vec![shape];
    if anisotropic {
        let vector = |s: f64, i: usize| {
            let angle = std::f64::consts::TAU * i as f64 / DIRECTIONS as f64;
            [s * angle.cos(), s * angle.sin()]
        };
        let turned = ANISOTROPIES.iter().flat_map(|&s| (0..DIRECTIONS).map(move |i| vector(s, i)));
        let lobes: Vec<Option<[f64; 2]>> = [[0.0; 2]].into_iter().chain(turned).map(Some).collect();
        // A stretched highlight looks like a tilt of a round one: one after the other, twice.
        for _ in 0..ANISOTROPIC_ROUNDS {
            shape =
                best_of(&lobes.iter().map(|&anisotropy| Shape { anisotropy, ..shape }).collect::<Vec<_>>(), &|_| 0.0);
            let tilted: Vec<Shape> = tilts.iter().map(|tilted| Shape { tilt: tilted.tilt, ..shape }).collect();
            shape = best_of(&tilted, &|shape| (prior.tilt)(shape.tilt));
        }
        shapes = vec![leaning(shape.tilt), shape];
    }
    let of_group = |sample: &Vec<usize>| {
        let lobes = explain(sample, &shapes, 1, &[0, 1, 2]);
        let best = lobes.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
        let mut lobe = best.map_or(GroupLobe::UNKNOWN, |(_, lobe)| lobe);
        if reflectance == Reflectance::Dielectric {
            lobe.specular = [lobe.specular[1]; 3];
        }
        lobe
    };
    (samples.par_iter().map(of_group).collect(), shape.tilt)
}

/// The diffuse albedo of all pixels beside what was `found` for their groups, on a surface that has this `relief` and leans by `tilt`.
pub(super) fn diffuse(
    capture: &Capture,
    memberships: &[Membership],
    found: &[GroupLobe],
    relief: Option<&[f32]>,
    tilt: [f64; 2],
) -> Vec<[f32; 3]> {
    let pixels: Vec<usize> = (0..memberships.len()).collect();
    let parts: Vec<Vec<[f32; 3]>> = pixels
        .par_chunks(PART)
        .map(|pixels| f32::run(Beside { capture, pixels, memberships, found, relief, tilt }))
        .collect();
    parts.concat()
}

struct Beside<'a> {
    capture: &'a Capture,
    pixels: &'a [usize],
    memberships: &'a [Membership],
    found: &'a [GroupLobe],
    relief: Option<&'a [f32]>,
    tilt: [f64; 2],
}

impl<R: Real> Kernel<R> for Beside<'_> {
    type Output = Vec<[f32; 3]>;

    #[inline(always)]
    fn run<L: Lanes<Scalar = R>>(self) -> Self::Output {
        let Self { capture, pixels, memberships, found, relief, tilt } = self;
        let photos: Vec<usize> = (0..capture.len()).collect();
        let mixed = |pixel: usize, value: &dyn Fn(&GroupLobe) -> f64| {
            let [(a, of_a), (b, of_b)] = memberships[pixel];
            let (a, b) = (value(&found[a as usize]), value(&found[b as usize]));
            (f64::from(of_a) * a + f64::from(of_b) * b) as f32
        };
        let mut parts: Vec<Parts<L>> = Vec::with_capacity(photos.len());
        let mut albedos = Vec::with_capacity(pixels.len());
        for pixels in pixels.chunks(L::LANES) {
            let views = View::all(capture, &photos, pixels);
            let roughness: L = bundle(pixels, |&pixel| mixed(pixel, &|found| found.roughness));
            let shape = Shape { tilt, anisotropy: None };
            shade(&views, &shape.frame(slopes_of(relief, pixels), roughness), &mut parts);
            let mut albedo = [L::splat(0.0); 3];
            for c in 0..3 {
                let specular = bundle(pixels, |&pixel| mixed(pixel, &|found| found.specular[c]));
                albedo[c] = diffuse_beside(&views, &parts, c, specular);
            }
            albedos.extend(unbundle(albedo, pixels.len()));
        }
        albedos
    }
}

/// A first diffuse albedo, three planes: each photo divided by the irradiance of a flat surface, and of these the mean over the darker
/// ones, which highlights reach least.
pub(super) fn diffuse_start(capture: &Capture) -> Vec<f32> {
    let (width, height) = (capture.width(), capture.height());
    let pixels = width * height;
    let photos = capture.photos();
    let darker = (photos.len() / 2).max(2).saturating_sub(1).clamp(1, photos.len());
    let mut albedo = vec![0.0; 3 * pixels];
    let rows: Vec<Vec<[f32; 3]>> = (0..height)
        .into_par_iter()
        .map(|row| {
            (0..width)
                .map(|column| {
                    let mut values: [Vec<f32>; 3] = Default::default();
                    for photo in photos {
                        let seen = flat_albedo(photo, capture.position(row, column), row * width + column);
                        values.iter_mut().zip(seen).for_each(|(values, seen)| values.push(seen));
                    }
                    values.map(|mut values| {
                        values.sort_by(f32::total_cmp);
                        let sum: f64 = values[..darker].iter().copied().map(f64::from).sum();
                        (sum as f32 / darker as f32).clamp(1e-3, 0.95)
                    })
                })
                .collect()
        })
        .collect();
    for (p, color) in rows.into_iter().flatten().enumerate() {
        color.into_iter().enumerate().for_each(|(c, value)| albedo[c * pixels + p] = value);
    }
    albedo
}

/// The albedo a flat Lambertian surface would need for what `photo` shows at `pixel`.
pub(super) fn flat_albedo(photo: &Photo, position: [f64; 2], pixel: usize) -> [f32; 3] {
    let fall_off = photo.shot.fall_off(position);
    let seen = &photo.image.data()[3 * pixel..3 * pixel + 3];
    [0, 1, 2].map(|c| {
        let irradiance = photo.shot.light_intensity[c] * fall_off;
        // An unlit channel says nothing: grey.
        if irradiance > 0.0 { (f64::from(seen[c]) * std::f64::consts::PI / irradiance) as f32 } else { 0.5 }
    })
}

#[cfg(test)]
mod tests {
    use super::{Explain, Prior, Shape, diffuse, search};
    use crate::capture::Capture;
    use crate::color::Transfer;
    use crate::fit::options::Reflectance;
    use crate::fit::testing::photo;
    use crate::maps::{Lobe, Maps};
    use crate::real::Real;
    use crate::shot::Shot;

    const SIDE: usize = 12;
    const PIXELS: usize = SIDE * SIDE;
    const FLAT: Prior<'static> =
        Prior { specular: &|_| 0.0, roughness: &|_| 0.0, tilt: &|_| 0.0, anisotropy: &|_| 0.0 };

    /// Seven photos of a surface that leans, of one material on the left and another on the right.
    fn capture(materials: [([f32; 3], f32, f32); 2], tilt: [f32; 2]) -> Capture {
        let mut data = vec![0.0; 10 * PIXELS];
        for p in 0..PIXELS {
            let (diffuse, specular, roughness) = materials[usize::from(p % SIDE >= SIDE / 2)];
            let normal = [tilt[0], tilt[1], 1.0];
            for c in 0..3 {
                data[c * PIXELS + p] = diffuse[c];
                data[(3 + c) * PIXELS + p] = normal[c];
                data[(7 + c) * PIXELS + p] = specular;
            }
            data[6 * PIXELS + p] = roughness;
        }
        let maps = Maps::new(Lobe::Isotropic, SIDE, SIDE, data).unwrap();
        let shown = |i: usize| {
            let angle = i as f64 * 2.4;
            let place = [0.3 * i as f64 * angle.cos(), 0.3 * i as f64 * angle.sin(), 2.4];
            let shot = Shot { camera: place, light: place, light_intensity: [14.0; 3] };
            photo(&maps, shot)
        };
        Capture::new((0..7).map(shown).collect(), 2.0, Transfer::Linear).unwrap()
    }

    #[test]
    fn materials_and_tilt_of_the_grid_are_found() {
        let materials = [([0.3, 0.4, 0.2], 0.04, 0.47), ([0.05, 0.1, 0.15], 0.35, 0.23)];
        let capture = capture(materials, [0.07, -0.14]);
        let memberships: Vec<_> =
            (0..PIXELS).map(|p| [(u16::from(p % SIDE >= SIDE / 2).into(), 1.0), (0, 0.0)]).collect();
        let (found, tilt) = search(&capture, &memberships, 2, None, Reflectance::Isotropic, &FLAT);
        assert_eq!(tilt, [0.07, -0.14]);
        for (found, (_, specular, roughness)) in found.iter().zip(materials) {
            assert!(found.specular.iter().all(|&s| (s - f64::from(specular)).abs() < 1e-6), "{found:?}");
            assert!((found.roughness - f64::from(roughness)).abs() < 1e-6, "{found:?}");
        }
        for (p, albedo) in diffuse(&capture, &memberships, &found, None, tilt).into_iter().enumerate() {
            let expected = materials[usize::from(p % SIDE >= SIDE / 2)].0;
            assert!((0..3).all(|c| (albedo[c] - expected[c]).abs() < 1e-3), "{p}: {albedo:?} {expected:?}");
        }
    }

    #[test]
    fn lanes_agree_with_single_numbers_in_double_precision() {
        let capture = capture([([0.3, 0.4, 0.2], 0.05, 0.4), ([0.05, 0.1, 0.15], 0.3, 0.25)], [0.02, 0.03]);
        let pixels: Vec<usize> = (0..PIXELS).step_by(7).collect();
        let shapes = [[0.0, 0.0], [0.1, -0.2]].map(|tilt| Shape { tilt, anisotropy: None });
        let explain = || Explain {
            capture: &capture,
            photos: &[0, 2, 5],
            pixels: &pixels,
            relief: None,
            shapes: &shapes,
            step: 1,
            channels: &[0, 2],
            prior: &FLAT,
        };
        for (single, double) in f32::run(explain()).iter().zip(f64::run(explain())) {
            assert!((single.0 - double.0).abs() < 1e-4 * double.0, "{single:?} {double:?}");
            assert_eq!((single.1.roughness, single.1.specular), (double.1.roughness, double.1.specular));
        }
    }
}
