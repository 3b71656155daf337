//! One lens and where it stood for every photo, from points of the sheet's plane and where they are in the photos.
//!
//! The lens is a pinhole in the middle of the picture with two radial terms; photos that were taken with it share it. Minimised over all of it is
//!
//! `sum of rho(|seen - projected|^2 / sigma^2) + priors`, `rho(e) = log(1 + e)`,
//!
//! with `sigma` the typical distance, by Levenberg-Marquardt on the reweighted sum. A photo's six unknowns meet the lens's three only: its block is eliminated first.
//!
//! # Source
//! Zhang, "A Flexible New Technique for Camera Calibration", PAMI 2000, for the closed-form start; Triggs et al., "Bundle Adjustment - A Modern Synthesis", 1999.
#![allow(clippy::needless_range_loop, reason = "the indices are those of the textbook")]

use super::geometry::{Homography, cross, norm, product};
use super::median;
use crate::cholesky::Cholesky;

/// Unknowns of a lens, and of a photo's place.
const LENS: usize = 3;
const PLACE: usize = 6;

const STEPS_MAX: usize = 60;
/// A step that gains less than this share ends the search.
const GAIN_MIN: f64 = 1e-9;
/// Widths of the priors of the logarithm of the focal length, about EXIF's and about a usual one.
const FOCAL_PRIOR_EXIF: f64 = 0.1;
const FOCAL_PRIOR: f64 = 0.5;
/// Focal length of a usual lens, in longer sides of the picture.
const USUAL_FOCAL_LENGTH: f64 = 0.8;
/// Focal lengths that lenses have, in longer sides of the picture.
const FOCAL_LENGTHS: std::ops::Range<f64> = 0.3..10.0;

/// How well points are known, and how much they may tell of the lens.
#[derive(Clone, Copy, Debug)]
pub struct Precision {
    /// The least typical distance, in pixels: better is not measured.
    sigma_min: f64,
    /// Widths of the priors of the radial terms, about 0.
    radial_prior: [f64; 2],
    /// A photo whose points are farther off than this, in shares of the longer side, does not agree with the others.
    pub error_max: f64,
}

impl Precision {
    /// Many corners in every photo, measured along edges.
    pub const TAGS: Self = Self { sigma_min: 0.02, radial_prior: [0.2, 0.2], error_max: 1e-3 };
    /// Four corners in every photo, given by hand.
    pub const CORNERS: Self = Self { sigma_min: 0.5, radial_prior: [0.05, 0.01], error_max: 5e-3 };
}

/// A pinhole with radial distortion; pixels are square, its axis meets the middle of the picture, from which pixels are counted (x right, y down).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Focal length in pixels.
    pub focal_length: f64,
    /// Coefficients of r^2 and r^4, where r is the tangent of the angle to the axis.
    pub radial: [f64; 2],
}

impl Lens {
    /// Where a direction (its x and y divided by z; x right, y down) is in the picture.
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let r2 = x * x + y * y;
        let factor = self.focal_length * (1.0 + r2 * (self.radial[0] + r2 * self.radial[1]));
        [factor * x, factor * y]
    }

    /// The inverse of [`Lens::distort`].
    pub fn undistort(&self, pixel: [f64; 2]) -> [f64; 2] {
        let seen = pixel.map(|x| x / self.focal_length);
        let mut direction = seen;
        // A fixed point that real lenses approach within a few rounds.
        for _ in 0..20 {
            let r2 = direction[0] * direction[0] + direction[1] * direction[1];
            let factor = 1.0 + r2 * (self.radial[0] + r2 * self.radial[1]);
            direction = seen.map(|x| x / factor.max(0.2));
        }
        direction
    }
}

/// Where a camera stood: a point p of the sheet is at `rotation p + translation` in the camera's frame (x right, y down, z forward).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    pub rotation: [[f64; 3]; 3],
    pub translation: [f64; 3],
}

impl Place {
    /// Where a point of the sheet is in the camera's frame.
    pub fn apply(&self, point: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|i| (0..3).map(|k| self.rotation[i][k] * point[k]).sum::<f64>() + self.translation[i])
    }

    /// Where a point of the camera's frame is in the sheet's.
    pub fn in_sheet(&self, point: [f64; 3]) -> [f64; 3] {
        let moved = [0, 1, 2].map(|k| point[k] - self.translation[k]);
        std::array::from_fn(|i| (0..3).map(|k| self.rotation[k][i] * moved[k]).sum())
    }

    /// The position of the camera in the sheet's frame.
    pub fn position(&self) -> [f64; 3] {
        self.in_sheet([0.0; 3])
    }

    /// Where a point of the sheet is in the picture.
    pub fn project(&self, lens: &Lens, point: [f64; 3]) -> [f64; 2] {
        let [x, y, z] = self.apply(point);
        lens.distort([x / z, y / z])
    }

    /// From the map of the sheet's plane to directions, (x, y, 1); `None` for maps that no camera makes.
    fn from_homography(map: &Homography) -> Option<Self> {
        let column = |j: usize| [0, 1, 2].map(|i| map.0[i][j]);
        let (first, second, third) = (column(0), column(1), column(2));
        let scale = (norm(first) * norm(second)).sqrt();
        // The sheet is in front of the camera.
        let scale = if third[2] < 0.0 { -scale } else { scale };
        if !(scale.is_finite() && scale.abs() > 0.0) {
            return None;
        }
        let unit = |v: [f64; 3], length: f64| v.map(|x| x / length);
        let (a, b) = (unit(first, scale), unit(second, scale));
        // The two nearest vectors of length one at a right angle.
        let sum = [0, 1, 2].map(|i| a[i] / norm(a) + b[i] / norm(b));
        let difference = [0, 1, 2].map(|i| a[i] / norm(a) - b[i] / norm(b));
        let (sum, difference) = (unit(sum, norm(sum)), unit(difference, norm(difference)));
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let x = [0, 1, 2].map(|i| half * (sum[i] + difference[i]));
        let y = [0, 1, 2].map(|i| half * (sum[i] - difference[i]));
        let z = cross(x, y);
        let rotation = std::array::from_fn(|i| [x[i], y[i], z[i]]);
        let place = Self { rotation, translation: unit(third, scale) };
        place.rotation.iter().flatten().chain(&place.translation).all(|x| x.is_finite()).then_some(place)
    }

    /// Turned by a small rotation and moved.
    fn moved(&self, step: [f64; PLACE]) -> Self {
        let [a, b, c, x, y, z] = step;
        Self {
            rotation: product(rotation([a, b, c]), self.rotation),
            translation: std::array::from_fn(|i| self.translation[i] + [x, y, z][i]),
        }
    }
}

/// The rotation about `axis` by its length.
///
/// # Source
/// Rodrigues' formula.
fn rotation(axis: [f64; 3]) -> [[f64; 3]; 3] {
    let angle = norm(axis);
    if angle < 1e-12 {
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    }
    let [x, y, z] = axis.map(|value| value / angle);
    let (sin, cos) = angle.sin_cos();
    let rest = 1.0 - cos;
    [
        [cos + x * x * rest, x * y * rest - z * sin, x * z * rest + y * sin],
        [y * x * rest + z * sin, cos + y * y * rest, y * z * rest - x * sin],
        [z * x * rest - y * sin, z * y * rest + x * sin, cos + z * z * rest],
    ]
}

/// A photo's points: where they are on the sheet, and in the photo, in pixels from its middle.
pub type Points = Vec<([f64; 2], [f64; 2])>;

/// A lens, the places of its photos, and how far points are from where they should be.
#[derive(Clone, Debug)]
pub struct Calibration {
    pub lens: Lens,
    pub places: Vec<Place>,
    /// Of each photo, the root mean squared distance of its points from where they should be, in pixels.
    pub errors: Vec<f64>,
    /// Standard deviation of the logarithm of the focal length.
    pub focal_length_deviation: f64,
}

/// Finds the lens of photos whose longer side is `longer` pixels, and where it stood for each; `None` if a photo's points leave its place open.
///
/// `focal_length` is what EXIF says, in pixels.
pub fn calibrate(
    photos: &[Points],
    longer: usize,
    focal_length: Option<f64>,
    precision: Precision,
) -> Option<Calibration> {
    let longer = longer as f64;
    let maps: Vec<Homography> = photos.iter().map(|points| Homography::between(points)).collect::<Option<_>>()?;
    let in_range = |focal_length: &f64| FOCAL_LENGTHS.contains(&(focal_length / longer));
    let expected = focal_length.unwrap_or(USUAL_FOCAL_LENGTH * longer);
    let prior = if focal_length.is_some() { FOCAL_PRIOR_EXIF } else { FOCAL_PRIOR };
    let starts = [closed_form(&maps).filter(in_range), Some(expected)];
    // The closed form is at a loss where all photos were taken from straight above; the better of both ends counts.
    starts
        .into_iter()
        .flatten()
        .filter_map(|start| {
            let places = maps
                .iter()
                .map(|map| {
                    let [a, b, c] = map.0;
                    Place::from_homography(&Homography([a.map(|x| x / start), b.map(|x| x / start), c]))
                })
                .collect::<Option<Vec<_>>>()?;
            let lens = Lens { focal_length: start, radial: [0.0; 2] };
            Some(Search { photos, expected, prior, precision, lens, places }.run())
        })
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(calibration, _)| calibration)
}

/// The focal length with which the maps of all photos turn the sheet's axes into ones at a right angle and of one length.
fn closed_form(maps: &[Homography]) -> Option<f64> {
    // Least squares for 1 / f^2.
    let (mut up, mut down) = (0.0, 0.0);
    for map in maps {
        let [[a, b, _], [c, d, _], [e, f, _]] = map.0;
        let scale = (a * a + b * b + c * c + d * d).sqrt();
        for (plane, depth) in [(a * b + c * d, e * f), (a * a + c * c - b * b - d * d, e * e - f * f)] {
            let (plane, depth) = (plane / (scale * scale), depth / (scale * scale));
            up -= plane * depth;
            down += plane * plane;
        }
    }
    let inverse = up / down;
    (inverse.is_finite() && inverse > 0.0).then(|| 1.0 / inverse.sqrt())
}

struct Search<'a> {
    photos: &'a [Points],
    expected: f64,
    prior: f64,
    precision: Precision,
    lens: Lens,
    places: Vec<Place>,
}

/// The sum's second derivatives and gradient, block by block.
struct System {
    lens: [[f64; LENS]; LENS],
    lens_gradient: [f64; LENS],
    places: Vec<PlaceBlock>,
}

struct PlaceBlock {
    own: [[f64; PLACE]; PLACE],
    with_lens: [[f64; PLACE]; LENS],
    gradient: [f64; PLACE],
}

/// The system of the lens after the places were eliminated, and what solves for those.
struct Reduced {
    core: [[f64; LENS]; LENS],
    right: [f64; LENS],
    factors: Vec<Cholesky<f64, PLACE>>,
}

impl Search<'_> {
    /// The calibration, and the sum at its end.
    fn run(mut self) -> (Calibration, f64) {
        let mut damping = 1e-3;
        let mut sigma = self.typical();
        let mut sum = self.sum(sigma, self.lens, &self.places);
        for _ in 0..STEPS_MAX {
            let system = self.system(sigma);
            let mut improved = None;
            for _ in 0..12 {
                if let Some((lens, places)) = self.step(&system, damping) {
                    let next = self.sum(sigma, lens, &places);
                    if next < sum {
                        improved = Some((lens, places, next));
                        break;
                    }
                }
                damping *= 10.0;
            }
            let Some((lens, places, next)) = improved else { break };
            let gain = (sum - next) / sum;
            (self.lens, self.places) = (lens, places);
            damping = (damping / 10.0).max(1e-12);
            sigma = self.typical();
            sum = self.sum(sigma, self.lens, &self.places);
            if gain < GAIN_MIN {
                break;
            }
        }
        let errors = self.photos.iter().zip(&self.places).map(|(points, place)| {
            let squares: f64 = points.iter().map(|&pair| self.distance2(place, &self.lens, pair)).sum();
            (squares / points.len() as f64).sqrt()
        });
        let errors = errors.collect();
        let focal_length_deviation = self.focal_length_deviation(&self.system(sigma));
        (Calibration { lens: self.lens, errors, places: self.places.clone(), focal_length_deviation }, self.typical())
    }

    fn distance2(&self, place: &Place, lens: &Lens, (on, at): ([f64; 2], [f64; 2])) -> f64 {
        let [u, v] = place.project(lens, [on[0], on[1], 0.0]);
        let squared = (u - at[0]).powi(2) + (v - at[1]).powi(2);
        if squared.is_finite() { squared } else { f64::MAX.sqrt() }
    }

    /// The median distance, as a standard deviation along one axis.
    fn typical(&self) -> f64 {
        let all = self.photos.iter().zip(&self.places);
        let squares =
            all.flat_map(|(points, place)| points.iter().map(|&pair| self.distance2(place, &self.lens, pair)));
        // The median of the squared distance of a Gaussian in the plane is 2 ln 2.
        (median(squares).unwrap_or_default() / (2.0 * std::f64::consts::LN_2)).sqrt().max(self.precision.sigma_min)
    }

    fn priors(&self, lens: &Lens) -> [(f64, f64); LENS] {
        [
            ((lens.focal_length / self.expected).ln(), self.prior),
            (lens.radial[0], self.precision.radial_prior[0]),
            (lens.radial[1], self.precision.radial_prior[1]),
        ]
    }

    fn sum(&self, sigma: f64, lens: Lens, places: &[Place]) -> f64 {
        let all = self.photos.iter().zip(places);
        let points = all.flat_map(|(points, place)| points.iter().map(move |&pair| (place, pair)));
        let data: f64 =
            points.map(|(place, pair)| (self.distance2(place, &lens, pair) / (sigma * sigma)).ln_1p()).sum();
        data + self.priors(&lens).iter().map(|(value, width)| (value / width).powi(2)).sum::<f64>()
    }

    fn system(&self, sigma: f64) -> System {
        let mut system = System { lens: [[0.0; LENS]; LENS], lens_gradient: [0.0; LENS], places: Vec::new() };
        for (points, place) in self.photos.iter().zip(&self.places) {
            let mut block =
                PlaceBlock { own: [[0.0; PLACE]; PLACE], with_lens: [[0.0; PLACE]; LENS], gradient: [0.0; PLACE] };
            for &(on, at) in points {
                let (projected, by_lens, by_place) = self.derivatives(place, on);
                let weight = 1.0 / (sigma * sigma + self.distance2(place, &self.lens, (on, at)));
                for axis in 0..2 {
                    let off = projected[axis] - at[axis];
                    for i in 0..LENS {
                        system.lens_gradient[i] += weight * by_lens[axis][i] * off;
                        for j in 0..LENS {
                            system.lens[i][j] += weight * by_lens[axis][i] * by_lens[axis][j];
                        }
                        for j in 0..PLACE {
                            block.with_lens[i][j] += weight * by_lens[axis][i] * by_place[axis][j];
                        }
                    }
                    for i in 0..PLACE {
                        block.gradient[i] += weight * by_place[axis][i] * off;
                        for j in 0..PLACE {
                            block.own[i][j] += weight * by_place[axis][i] * by_place[axis][j];
                        }
                    }
                }
            }
            system.places.push(block);
        }
        for (i, (value, width)) in self.priors(&self.lens).into_iter().enumerate() {
            system.lens[i][i] += 1.0 / (width * width);
            system.lens_gradient[i] += value / (width * width);
        }
        system
    }

    /// Where a point is in the picture, and how that changes with the lens (logarithm of the focal length, radial terms) and with the place.
    fn derivatives(&self, place: &Place, on: [f64; 2]) -> ([f64; 2], [[f64; LENS]; 2], [[f64; PLACE]; 2]) {
        let lens = &self.lens;
        let turned: [f64; 3] = std::array::from_fn(|i| place.rotation[i][0] * on[0] + place.rotation[i][1] * on[1]);
        let [px, py, pz] = [0, 1, 2].map(|i| turned[i] + place.translation[i]);
        let (x, y) = (px / pz, py / pz);
        let r2 = x * x + y * y;
        let factor = 1.0 + r2 * (lens.radial[0] + r2 * lens.radial[1]);
        let slope = lens.radial[0] + 2.0 * r2 * lens.radial[1];
        let f = lens.focal_length;
        let by_lens = [x, y].map(|x| [f * factor * x, f * r2 * x, f * r2 * r2 * x]);
        // By x and y, then by the point in the camera's frame.
        let by_direction = [
            [f * (factor + 2.0 * x * x * slope), f * 2.0 * x * y * slope],
            [f * 2.0 * x * y * slope, f * (factor + 2.0 * y * y * slope)],
        ];
        let by_point = by_direction.map(|[a, b]| [a / pz, b / pz, -(a * x + b * y) / pz]);
        let by_place = by_point.map(|g| {
            let [a, b, c] = cross(turned, g);
            [a, b, c, g[0], g[1], g[2]]
        });
        (lens.distort([x, y]), by_lens, by_place)
    }

    /// From the curvature of the sum along the focal length, where everything else follows.
    fn focal_length_deviation(&self, system: &System) -> f64 {
        let variance = || Some(Cholesky::<_, LENS>::of(&Self::reduced(system, 0.0)?.core)?.solve([1.0, 0.0, 0.0])[0]);
        variance().map_or(self.prior, f64::sqrt)
    }

    /// The lens and the places after one damped step.
    fn step(&self, system: &System, damping: f64) -> Option<(Lens, Vec<Place>)> {
        let Reduced { core, right, factors } = Self::reduced(system, damping)?;
        let lens_step = Cholesky::<_, LENS>::of(&core)?.solve(right.map(|x| -x));
        let lens = Lens {
            focal_length: self.lens.focal_length * lens_step[0].clamp(-0.5, 0.5).exp(),
            radial: [self.lens.radial[0] + lens_step[1], self.lens.radial[1] + lens_step[2]],
        };
        let places = self.places.iter().zip(&system.places).zip(factors).map(|((place, block), factor)| {
            let right = std::array::from_fn(|k| {
                -block.gradient[k] - (0..LENS).map(|i| block.with_lens[i][k] * lens_step[i]).sum::<f64>()
            });
            place.moved(factor.solve(right))
        });
        Some((lens, places.collect()))
    }

    /// The damped system of the lens alone.
    fn reduced(system: &System, damping: f64) -> Option<Reduced> {
        let damped = |i: usize, j: usize, value: f64| if i == j { value * (1.0 + damping) + 1e-12 } else { value };
        let mut core: [[f64; LENS]; LENS] =
            std::array::from_fn(|i| std::array::from_fn(|j| damped(i, j, system.lens[i][j])));
        let mut right = system.lens_gradient;
        let mut factors = Vec::with_capacity(system.places.len());
        for block in &system.places {
            let own = std::array::from_fn(|i| std::array::from_fn(|j| damped(i, j, block.own[i][j])));
            let factor = Cholesky::<_, PLACE>::of(&own)?;
            let solved = block.with_lens.map(|row| factor.solve(row));
            for i in 0..LENS {
                right[i] -= (0..PLACE).map(|k| solved[i][k] * block.gradient[k]).sum::<f64>();
                for j in 0..LENS {
                    core[i][j] -= (0..PLACE).map(|k| solved[i][k] * block.with_lens[j][k]).sum::<f64>();
                }
            }
            factors.push(factor);
        }
        Some(Reduced { core, right, factors })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acquire::sheet::Sheet;

    const LONGER: usize = 4000;

    /// A camera at `position` that looks at the middle of the sheet, turned about its axis.
    fn looking_down(position: [f64; 3], turned: f64) -> Place {
        let length = norm(position);
        let forward = position.map(|x| -x / length);
        let right = cross(forward, [0.0, 1.0, 0.2]);
        let right = right.map(|x| x / norm(right));
        let down = cross(forward, right);
        let rotation = product(rotation([0.0, 0.0, turned]), [right, down, forward]);
        let place = Place { rotation, translation: [0.0; 3] };
        Place { translation: place.apply(position).map(|x| -x), ..place }
    }

    fn truth() -> (Lens, Vec<Place>) {
        let lens = Lens { focal_length: 3100.0, radial: [0.08, -0.12] };
        let places = [
            [0.0, 5.0, 260.0],
            [110.0, 20.0, 230.0],
            [-90.0, 70.0, 240.0],
            [30.0, -120.0, 210.0],
            [-60.0, -60.0, 250.0],
        ];
        (lens, places.iter().enumerate().map(|(i, &position)| looking_down(position, 1.3 * i as f64)).collect())
    }

    /// Corners of all tags in all photos, each `noise` pixels off in a direction that looks random.
    fn seen(lens: &Lens, places: &[Place], noise: f64) -> Vec<Points> {
        let sheet = Sheet::new(100.0).unwrap();
        let corners: Vec<[f64; 2]> = sheet.tags.iter().flat_map(|tag| tag.corners).collect();
        let point = |place: &Place, i: usize, on: [f64; 2]| {
            let [u, v] = place.project(lens, [on[0], on[1], 0.0]);
            let angle = (i * i % 97) as f64 + 10.0 * place.translation[0];
            (on, [u + noise * angle.cos(), v + noise * angle.sin()])
        };
        places.iter().map(|place| corners.iter().enumerate().map(|(i, &on)| point(place, i, on)).collect()).collect()
    }

    fn position_error(calibration: &Calibration, places: &[Place]) -> f64 {
        let off =
            |(a, b): (&Place, &Place)| norm([0, 1, 2].map(|i| a.position()[i] - b.position()[i])) / norm(b.position());
        calibration.places.iter().zip(places).map(off).fold(0.0, f64::max)
    }

    #[test]
    fn directions_and_pixels() {
        let (lens, places) = truth();
        for pixel in [[-1900.0, -1300.0], [0.0, 0.0], [1900.0, 500.0]] {
            let back = lens.distort(lens.undistort(pixel));
            assert!((back[0] - pixel[0]).abs() < 1e-6 && (back[1] - pixel[1]).abs() < 1e-6, "{back:?}");
        }
        assert!((places[1].position()[0] - 110.0).abs() < 1e-9);
    }

    #[test]
    fn lens_and_places_are_found_without_exif() {
        let (lens, places) = truth();
        let exact = calibrate(&seen(&lens, &places, 0.0), LONGER, None, Precision::TAGS).unwrap();
        assert!((exact.lens.focal_length / lens.focal_length - 1.0).abs() < 1e-4, "{:?}", exact.lens);
        assert!(position_error(&exact, &places) < 1e-4 && exact.errors.iter().all(|error| *error < 1e-2), "{exact:?}");
        let noisy = calibrate(&seen(&lens, &places, 0.3), LONGER, None, Precision::TAGS).unwrap();
        assert!(position_error(&noisy, &places) < 3e-3, "{}", position_error(&noisy, &places));
        // Wrong EXIF data do not lead astray.
        let misled =
            calibrate(&seen(&lens, &places, 0.1), LONGER, Some(1.05 * lens.focal_length), Precision::TAGS).unwrap();
        assert!(position_error(&misled, &places) < 2e-3, "{}", position_error(&misled, &places));
    }

    #[test]
    fn points_far_off_count_little() {
        let (lens, places) = truth();
        let mut points = seen(&lens, &places, 0.1);
        for photo in &mut points {
            for pair in photo.iter_mut().step_by(9) {
                pair.1[0] += 25.0;
            }
        }
        let found = calibrate(&points, LONGER, None, Precision::TAGS).unwrap();
        assert!(position_error(&found, &places) < 3e-3, "{}", position_error(&found, &places));
    }

    #[test]
    fn one_photo_from_straight_above_takes_the_focal_length_of_exif() {
        let (lens, _) = truth();
        let places = [looking_down([0.0, 0.0, 250.0], 0.2)];
        let found = calibrate(&seen(&lens, &places, 0.05), LONGER, Some(lens.focal_length), Precision::TAGS).unwrap();
        assert!(position_error(&found, &places) < 0.03, "{}", position_error(&found, &places));
    }

    /// Four corners a photo, as near as a hand clicks, of a telephone's lens: what bends lines little.
    #[test]
    fn four_corners_tell_places_and_where_photos_lean_the_focal_length() {
        let (_, places) = truth();
        let lens = Lens { focal_length: 3100.0, radial: [0.02, -0.02] };
        let corners = [[-48.0, 48.0], [48.0, 48.0], [48.0, -48.0], [-48.0, -48.0]];
        let clicked = |places: &[Place]| -> Vec<Points> {
            let point = |place: &Place, [x, y]: [f64; 2]| ([x, y], place.project(&lens, [x, y, 0.0]).map(f64::round));
            places.iter().map(|place| corners.iter().map(|&on| point(place, on)).collect()).collect()
        };
        let found = calibrate(&clicked(&places), LONGER, None, Precision::CORNERS).unwrap();
        assert!(position_error(&found, &places) < 0.01, "{} {found:?}", position_error(&found, &places));
        assert!(found.focal_length_deviation < 0.02, "{found:?}");
        // From straight above nothing tells the focal length but EXIF data.
        let above = [looking_down([2.0, -3.0, 250.0], 0.2)];
        let found = calibrate(&clicked(&above), LONGER, Some(lens.focal_length), Precision::CORNERS).unwrap();
        assert!(position_error(&found, &above) < 0.01, "{}", position_error(&found, &above));
        let guessed = calibrate(&clicked(&above), LONGER, None, Precision::CORNERS).unwrap();
        assert!(guessed.focal_length_deviation > 0.1, "{guessed:?}");
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        let (lens, places) = truth();
        let search = |lens: Lens, place: Place| Search {
            photos: &[],
            expected: 1.0,
            prior: 1.0,
            precision: Precision::TAGS,
            lens,
            places: vec![place],
        };
        let (on, step) = ([40.0, -70.0], 1e-6);
        let (_, by_lens, by_place) = search(lens, places[1]).derivatives(&places[1], on);
        let project = |lens: Lens, place: Place| place.project(&lens, [on[0], on[1], 0.0]);
        for k in 0..LENS + PLACE {
            let at = |step: f64| {
                let mut moved = [0.0; PLACE];
                let mut lens = lens;
                match k {
                    0 => lens.focal_length *= step.exp(),
                    1 | 2 => lens.radial[k - 1] += step,
                    _ => moved[k - LENS] = step,
                }
                project(lens, places[1].moved(moved))
            };
            let (after, before) = (at(step), at(-step));
            for axis in 0..2 {
                let numeric = (after[axis] - before[axis]) / (2.0 * step);
                let exact = if k < LENS { by_lens[axis][k] } else { by_place[axis][k - LENS] };
                assert!((numeric - exact).abs() < 1e-4 * (1.0 + exact.abs()), "{k} {axis}: {numeric} {exact}");
            }
        }
    }
}
