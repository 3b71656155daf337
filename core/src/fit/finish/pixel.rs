//! Pixels by Levenberg-Marquardt, as many at a time as the processor has lanes.
#![allow(clippy::needless_range_loop, reason = "indices of raw values are those of vectors and matrices alike")]

use super::weighting::Weighting;
use super::{Problem, View};
use crate::cholesky::Cholesky;
use crate::fit::options::Reflectance;
use crate::fit::shading::{CodeJacobian, FLAT_LIMIT, Geometry, Surface, bundle, saturated, unbundle};
use crate::raw::{NORMAL, RAW, ROUGHNESS, SPECULAR};
use crate::real::{Kernel, Lanes, Real};
use crate::shot::Shot;

/// Residuals beyond so many deviations count less and less (Cauchy).
const OUTLIER: f64 = 3.0;
/// Smallest deviation of the network that is believed, raw.
const PRIOR_MIN: f64 = 0.02;
/// Damping of the first step, and where a pixel's fit ends because no step leads on.
const DAMPING: f64 = 1e-2;
const DAMPING_MIN: f64 = 1e-6;
const DAMPING_MAX: f64 = 1e4;
/// A step that lowers the cost by less than this, or than this share of a cost below 1, is the last.
const GAIN_MIN: f64 = 1e-3;

/// A pixel of the capture, and its place in the maps so far.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub pixel: usize,
    pub so_far: usize,
}

/// Some pixels to be fitted.
#[derive(Clone, Copy)]
pub(super) struct Pixels<'p> {
    pub problem: &'p Problem<'p>,
    pub places: &'p [Place],
    /// Nine planes of the maps so far.
    pub so_far: &'p [f32],
    /// The anisotropy of their pixels; none where lobes are round.
    pub anisotropy: &'p [[f32; 2]],
    /// How the photos are taken to be lit, one for each.
    pub shots: &'p [Shot],
    /// A photo that does not count.
    pub without: Option<usize>,
    pub weighting: Weighting,
    /// Levenberg-Marquardt steps at most.
    pub steps: usize,
}

/// Pixels that were fitted: nine values each, their standard deviations, and the sums of the costs before and after.
#[derive(Default)]
pub(super) struct Fitted {
    pub raw: Vec<[f32; RAW]>,
    pub deviation: Vec<[f32; RAW]>,
    pub first_cost: f64,
    pub last_cost: f64,
}

/// [`Pixels`] with their deviations.
pub(super) struct Fit<'p>(pub Pixels<'p>);

/// What a photo taken as the shot says would show of [`Pixels`]: codes.
pub(super) struct Predict<'p>(pub Pixels<'p>, pub &'p Shot);

/// What photos taken as the shots say would show of raw values: codes and Jacobians of these pixels, one after the other for each shot.
pub(super) struct Look<'p> {
    pub problem: &'p Problem<'p>,
    pub places: &'p [Place],
    pub raw: &'p [f32],
    pub anisotropy: &'p [[f32; 2]],
    pub shots: &'p [Shot],
}

/// Pixels in one photo.
struct Datum<L: Lanes> {
    geometry: Geometry<L>,
    code: [L; 3],
    saturated: [L::Mask; 3],
}

/// What is known of pixels before the photos: the mean, and inverse variances.
struct Prior<L> {
    mean: [L; RAW],
    weight: [L; RAW],
    /// Where lobes are not round.
    anisotropy: Option<[L; 2]>,
}

/// Normal equations of pixels at one place.
struct System<L> {
    cost: L,
    /// Half the gradient, and the Gauss-Newton matrix (lower triangle), prior included.
    gradient: [L; RAW],
    matrix: [[L; RAW]; RAW],
}

/// Where the derivatives of channel `c` belong among the raw values, in ascending order.
pub(super) fn places(c: usize) -> [usize; 5] {
    [c, NORMAL, NORMAL + 1, ROUGHNESS, SPECULAR + c]
}

impl Problem<'_> {
    /// The least and the largest value of the raw value `i`.
    fn range(&self, i: usize) -> [f64; 2] {
        match i {
            // Kept short by their common length.
            NORMAL..ROUGHNESS => [-2.0, 2.0],
            ROUGHNESS => [self.roughness_floor, 1.0],
            _ => [-0.999, 1.0],
        }
    }

    /// Whether the raw value `i` stays what the maps so far have.
    #[inline(always)]
    fn fixed(&self, i: usize) -> bool {
        match self.reflectance {
            Reflectance::Diffuse => (ROUGHNESS..RAW).contains(&i),
            Reflectance::Dielectric => (SPECULAR..RAW).contains(&i),
            _ => false,
        }
    }

    /// Moves values into their ranges.
    #[inline(always)]
    fn limit<L: Lanes>(&self, raw: &mut [L; RAW]) {
        for (i, value) in raw.iter_mut().enumerate() {
            let [low, high] = self.range(i);
            *value = value.max(L::splat(low)).min(L::splat(high));
        }
        let limit = L::splat(FLAT_LIMIT);
        let length2 = raw[NORMAL] * raw[NORMAL] + raw[NORMAL + 1] * raw[NORMAL + 1];
        let factor = L::select(length2.gt(limit), (limit / length2).sqrt(), L::splat(1.0));
        raw[NORMAL] = raw[NORMAL] * factor;
        raw[NORMAL + 1] = raw[NORMAL + 1] * factor;
    }
}

/// The anisotropy of pixels, by that of the maps so far.
#[inline(always)]
fn anisotropy_of<L: Lanes>(vectors: &[[f32; 2]], places: &[Place]) -> Option<[L; 2]> {
    if vectors.is_empty() {
        return None;
    }
    Some([bundle(places, |place| vectors[place.so_far][0]), bundle(places, |place| vectors[place.so_far][1])])
}

impl Pixels<'_> {
    /// The prior of pixels.
    #[inline(always)]
    fn prior<L: Lanes>(&self, places: &[Place]) -> Prior<L> {
        let Self { problem, so_far, weighting, .. } = *self;
        let (pixels, so_far_pixels) = (problem.pixels(), so_far.len() / RAW);
        let mut prior = Prior {
            mean: [L::splat(0.0); RAW],
            weight: self.weights(places, weighting),
            anisotropy: anisotropy_of(self.anisotropy, places),
        };
        for i in 0..RAW {
            let share = match i {
                _ if problem.fixed(i) => 0.0,
                NORMAL..ROUGHNESS => weighting.network_normal,
                _ => weighting.network,
            };
            let so_far: L = bundle(places, |place| so_far[i * so_far_pixels + place.so_far]);
            let network: L = bundle(places, |place| problem.network[i * pixels + place.pixel]);
            prior.mean[i] = L::splat(1.0 - share) * so_far + L::splat(share) * network;
        }
        problem.limit(&mut prior.mean);
        prior
    }

    /// Inverse variances of the prior under `weighting`.
    #[inline(always)]
    fn weights<L: Lanes>(&self, places: &[Place], weighting: Weighting) -> [L; RAW] {
        let pixels = self.problem.pixels();
        let mut weights = [L::splat(0.0); RAW];
        for i in 0..RAW {
            let share = match i {
                ..NORMAL => 1.0,
                NORMAL..ROUGHNESS => weighting.normal,
                ROUGHNESS.. => weighting.specular,
            };
            let deviation: L = bundle(places, |place| self.problem.deviation[i * pixels + place.pixel]);
            let deviation = L::splat(share) * deviation.max(L::splat(PRIOR_MIN));
            weights[i] = L::splat(1.0) / (deviation * deviation);
        }
        weights
    }

    /// The pixels in every photo that counts.
    #[inline(always)]
    fn data<L: Lanes>(&self, places: &[Place], data: &mut Vec<Datum<L>>) {
        data.clear();
        for (index, (view, shot)) in self.problem.views.iter().zip(self.shots).enumerate() {
            if self.without == Some(index) {
                continue;
            }
            let View { photo, code } = view;
            data.push(Datum {
                geometry: Geometry::of_pixels(self.problem.capture, shot, places, |place| place.pixel),
                code: [
                    bundle(places, |place| code[place.pixel][0]),
                    bundle(places, |place| code[place.pixel][1]),
                    bundle(places, |place| code[place.pixel][2]),
                ],
                saturated: saturated::<L, _>(places, |place| photo.saturated[place.pixel]),
            });
        }
    }

    #[inline(always)]
    fn system<L: Lanes>(&self, data: &[Datum<L>], raw: &[L; RAW], prior: &Prior<L>) -> System<L> {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let scale = L::splat((OUTLIER * self.weighting.photo).powi(-2));
        let (weight, cost_of_log) =
            (L::splat(self.weighting.photo.powi(-2)), L::splat(OUTLIER * OUTLIER * std::f64::consts::LN_2));
        let surface = Surface::new(raw, prior.anisotropy);
        let mut system = System { cost: zero, gradient: [zero; RAW], matrix: [[zero; RAW]; RAW] };
        let System { cost, gradient, matrix } = &mut system;
        for datum in data {
            let CodeJacobian { code, jacobian } = datum.geometry.observe(&surface);
            for c in 0..3 {
                let residual = code[c] - datum.code[c];
                // Where the photo is saturated, brighter is right.
                let residual = L::select(datum.saturated[c], residual.min(zero), residual);
                let grown = (residual * residual).mul_add(scale, one);
                *cost = grown.log2().mul_add(cost_of_log, *cost);
                let ignored = datum.saturated[c] & residual.ge(zero);
                let weight = L::select(ignored, zero, weight / grown);
                let places = places(c);
                for (a, &i) in places.iter().enumerate() {
                    let slope = weight * jacobian[c][a];
                    gradient[i] = slope.mul_add(residual, gradient[i]);
                    for (b, &j) in places[..=a].iter().enumerate() {
                        matrix[i][j] = slope.mul_add(jacobian[c][b], matrix[i][j]);
                    }
                }
            }
        }
        for i in 0..RAW {
            let off = raw[i] - prior.mean[i];
            let pull = prior.weight[i] * off;
            *cost = pull.mul_add(off, *cost);
            gradient[i] = gradient[i] + pull;
            matrix[i][i] = matrix[i][i] + prior.weight[i];
        }
        system
    }

    /// Moves `raw` by Levenberg-Marquardt steps; gives the cost where it begins and the system where it ends.
    #[inline(always)]
    fn descend<L: Lanes>(&self, data: &[Datum<L>], raw: &mut [L; RAW], prior: &Prior<L>) -> (L, System<L>) {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let mut system = self.system(data, raw, prior);
        let first = system.cost;
        let mut damping = L::splat(DAMPING);
        let mut going = one.gt(zero);
        for _ in 0..self.steps {
            let mut matrix = system.matrix;
            let mut gradient = system.gradient;
            for i in 0..RAW {
                // At a limit and pushed against it: held.
                let [low, high] = self.problem.range(i);
                let (low, high) = (L::splat(low), L::splat(high));
                let mut held = (low.ge(raw[i]) & gradient[i].gt(zero)) | (raw[i].ge(high) & zero.gt(gradient[i]));
                if self.problem.fixed(i) {
                    held = one.gt(zero);
                }
                gradient[i] = L::select(held, zero, gradient[i]);
                matrix[i][i] = matrix[i][i] * (one + damping) * L::select(held, L::splat(1e6), one);
            }
            let (cholesky, definite) = Cholesky::new(&matrix);
            let step = cholesky.solve(gradient);
            let mut moved = *raw;
            for i in 0..RAW {
                moved[i] = moved[i] - step[i];
            }
            self.problem.limit(&mut moved);
            let next = self.system(data, &moved, prior);
            let better = going & definite & system.cost.gt(next.cost);
            let gain = system.cost - next.cost;
            let little = L::splat(GAIN_MIN) * next.cost.min(one);
            for i in 0..RAW {
                raw[i] = L::select(better, moved[i], raw[i]);
                system.gradient[i] = L::select(better, next.gradient[i], system.gradient[i]);
                for j in 0..=i {
                    system.matrix[i][j] = L::select(better, next.matrix[i][j], system.matrix[i][j]);
                }
            }
            system.cost = L::select(better, next.cost, system.cost);
            let shorter = damping * L::splat(8.0);
            damping = L::select(better, (damping * L::splat(0.2)).max(L::splat(DAMPING_MIN)), shorter);
            let done = (better & little.gt(gain)) | (!better & damping.gt(L::splat(DAMPING_MAX)));
            going = going & !done;
            if !L::any(going) {
                break;
            }
        }
        (first, system)
    }
}

impl<R: Real> Kernel<R> for Fit<'_> {
    type Output = Fitted;

    #[inline(always)]
    fn run<L: Lanes<Scalar = R>>(self) -> Fitted {
        let pixels = self.0;
        let mut fitted = Fitted::default();
        let mut data = Vec::with_capacity(pixels.shots.len());
        for places in pixels.places.chunks(L::LANES) {
            pixels.data::<L>(places, &mut data);
            let prior = pixels.prior(places);
            let mut raw = prior.mean;
            let (first, System { cost, mut matrix, .. }) = pixels.descend(&data, &mut raw, &prior);
            // Around its minimum the cost is that of a Gaussian with this inverse covariance, but for the prior: shares of the network's deviation hold a
            // pixel near the maps so far, which are no surer for that.
            let sure = pixels.weights(places, Weighting { normal: 1.0, specular: 1.0, ..pixels.weighting });
            for i in 0..RAW {
                matrix[i][i] = matrix[i][i] + (sure[i] - prior.weight[i]);
            }
            let (cholesky, definite) = Cholesky::new(&matrix);
            let variances = cholesky.inverse_diagonal();
            let mut deviation = variances;
            for i in 0..RAW {
                deviation[i] = L::select(definite, variances[i], L::splat(1.0) / sure[i]).sqrt();
            }
            fitted.raw.extend(unbundle(raw, places.len()));
            fitted.deviation.extend(unbundle(deviation, places.len()));
            for [first, last] in unbundle([first, cost], places.len()) {
                fitted.first_cost += f64::from(first);
                fitted.last_cost += f64::from(last);
            }
        }
        fitted
    }
}

impl<R: Real> Kernel<R> for Predict<'_> {
    type Output = Vec<[f32; 3]>;

    #[inline(always)]
    fn run<L: Lanes<Scalar = R>>(self) -> Self::Output {
        let Self(pixels, shot) = self;
        let mut codes = Vec::with_capacity(pixels.places.len());
        let mut data = Vec::with_capacity(pixels.shots.len());
        for places in pixels.places.chunks(L::LANES) {
            pixels.data::<L>(places, &mut data);
            let prior = pixels.prior(places);
            let mut raw = prior.mean;
            pixels.descend(&data, &mut raw, &prior);
            let seen = Geometry::<L>::of_pixels(pixels.problem.capture, shot, places, |place| place.pixel)
                .observe(&Surface::new(&raw, prior.anisotropy));
            codes.extend(unbundle(seen.code, places.len()));
        }
        codes
    }
}

impl<R: Real> Kernel<R> for Look<'_> {
    type Output = Vec<([f32; 3], [[f32; 5]; 3])>;

    #[inline(always)]
    fn run<L: Lanes<Scalar = R>>(self) -> Self::Output {
        let Self { problem, places: all, raw, anisotropy, shots } = self;
        let length = raw.len() / RAW;
        let mut seen = Vec::with_capacity(all.len() * shots.len());
        for shot in shots {
            for places in all.chunks(L::LANES) {
                let mut bundles = [L::splat(0.0); RAW];
                for i in 0..RAW {
                    bundles[i] = bundle(places, |place| raw[i * length + place.so_far]);
                }
                let CodeJacobian { code, jacobian } =
                    Geometry::<L>::of_pixels(problem.capture, shot, places, |place| place.pixel)
                        .observe(&Surface::new(&bundles, anisotropy_of(anisotropy, places)));
                let [r, g, b] = jacobian;
                let codes = unbundle(code, places.len());
                let (r, g, b) = (unbundle(r, places.len()), unbundle(g, places.len()), unbundle(b, places.len()));
                seen.extend(codes.zip(r.zip(g.zip(b))).map(|(code, (r, (g, b)))| (code, [r, g, b])));
            }
        }
        seen
    }
}

#[cfg(test)]
mod tests {
    use super::super::Problem;
    use super::super::weighting::Weighting;
    use super::{Fit, Fitted, Pixels, Place};
    use crate::capture::{Capture, Photo};
    use crate::color::Transfer;
    use crate::fit::options::Reflectance;
    use crate::image::Image;
    use crate::raw::RAW;
    use crate::real::Real;
    use crate::shot::Shot;

    /// Pixels that are not a whole number of bundles, one of them saturated.
    const PIXELS: usize = 21;
    const UNIT: f64 = 1e20;

    #[test]
    fn lanes_agree_with_single_numbers_in_double_precision() {
        let mut random = fastrand::Rng::with_seed(3);
        let photo = |i: usize| {
            // In a small unit of length: what is squared must not leave single precision.
            let place = [0.5 * i as f64 - 0.7, 0.3, 2.2].map(|value| value * UNIT);
            let shot = Shot { camera: place, light: place, light_intensity: [14.0 * UNIT * UNIT; 3] };
            let data = (0..3 * PIXELS).map(|_| 0.1 + 0.4 * random.f32()).collect();
            let image = Image::new(PIXELS, 1, 3, data).unwrap();
            Photo { name: i.to_string(), shot, image, saturated: vec![u8::from(i == 1) * 5; PIXELS] }
        };
        let capture = Capture::new((0..4).map(photo).collect(), 2.0 * UNIT, Transfer::Linear).unwrap();
        let shots: Vec<Shot> = capture.photos().iter().map(|photo| photo.shot).collect();
        let raw: Vec<f32> = (0..RAW * PIXELS).map(|i| 0.3 * (i as f32).sin()).collect();
        let deviation = vec![0.15; raw.len()];
        let problem = Problem::new(&capture, &raw, &deviation, Reflectance::Isotropic, -0.9).unwrap();
        let places: Vec<Place> = (0..PIXELS).map(|pixel| Place { pixel, so_far: pixel }).collect();
        let weighting = Weighting { photo: 0.05, normal: 0.3, specular: 1.0, network_normal: 0.0, network: 0.0 };
        let pixels = Pixels {
            anisotropy: &[],
            problem: &problem,
            places: &places,
            so_far: &raw,
            shots: &shots,
            without: Some(2),
            weighting,
            steps: 60,
        };
        let (single, double) = (f32::run(Fit(pixels)), f64::run(Fit(pixels)));
        let Fitted { first_cost, last_cost, .. } = double;
        assert!(last_cost < 0.8 * first_cost, "{first_cost} {last_cost}");
        assert!((single.first_cost - first_cost).abs() < 1e-4 * first_cost);
        assert!((single.last_cost - last_cost).abs() < 1e-2 * last_cost, "{} {last_cost}", single.last_cost);
        let off = |a: &[[f32; RAW]], b: &[[f32; RAW]]| -> Vec<f32> {
            let mut all: Vec<f32> = a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (a - b).abs()).collect();
            all.sort_by(f32::total_cmp);
            all
        };
        for off in [off(&single.raw, &double.raw), off(&single.deviation, &double.deviation)] {
            // Where a pixel stops is decided by its last digits.
            assert!(off[off.len() * 9 / 10] < 2e-3 && off[off.len() - 1] < 0.05, "{off:?}");
        }
    }
}
