//! How bright the light of every photo was, and how a telephone's codes relate to it, from white paper and grey patches whose place is known.
//!
//! Paper of diffuse albedo `rho` at distance d from a light that meets it at an angle t has the radiance `rho I cos t / (pi d^2)`, times what is lost towards the edges of the
//! picture: `exp(a r^2 + b r^4)` for the lens, r the tangent of the angle to its axis, and `exp(c s^2 + e s^4)` for the flash, s the same about the flash. The camera wrote a code u of
//! it, of which sRGB's curve makes the radiance once `u + sum of t_k sin(k pi u)` is taken for u: a monotone curve that keeps black and white.
//!
//! Minimised are the squares of differences between logarithms of both sides, over all places, photos and channels of a lens: for `t`, `a`, `b`, `c`, `e`, the flash's place beside the lens (where
//! it is not stated) and the albedos of the greys, which all photos share; and for I of every photo and channel, which is eliminated first. Priors are weak: none of all that, and sRGB. Places that
//! are far off (a shadow, a reflection) count less and less.
#![allow(clippy::needless_range_loop, reason = "the indices are those of the textbook")]

use std::f64::consts::PI;

use super::geometry::norm;
use super::median;
use crate::cholesky::Cholesky;
use crate::color::double::{srgb_decode, srgb_encode};

/// Rounds of reweighting.
const ROUNDS: usize = 15;
/// Deviations of the logarithm beyond this count less and less.
const OUTLIER: f64 = 0.03;
/// Against which the priors are held: places deviate together where paper reflects, so that many say little more than one.
const NOISE: f64 = 0.1;
/// Radiance, where white is 1, below which noise and reflections on toner matter.
const DARK: f64 = 0.02;
/// Widths of the priors: of the tone curve, of the fall-offs, of the flash's place in millimetres, of the logarithm of the greys' albedos.
const TONE_PRIOR: f64 = 0.03;
const FALL_OFF_PRIOR: f64 = 3.0;
const OFFSET_PRIOR: f64 = 100.0;
const GREY_PRIOR: f64 = 3.0;
/// The least slope of the tone curve, where sRGB's is 1.
const SLOPE_MIN: f64 = 0.2;
/// Places that a photo needs.
pub const PLACES_MIN: usize = 4;
/// Greys that are darker than paper, at most.
pub const GREYS: usize = 7;

/// Unknowns that photos share, in this order.
pub const TONE: usize = 4;
const FALL_OFF: usize = TONE;
const OFFSET: usize = FALL_OFF + 4;
const GREY: usize = OFFSET + 2;
const SHARED: usize = GREY + 3 * GREYS;

/// How codes differ from sRGB's: `u + sum of t_k sin(k pi u)` is sRGB's code for the radiance that u was written for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tone(pub [f64; TONE]);

impl Tone {
    fn code(&self, code: f64) -> f64 {
        code + (0..TONE).map(|k| self.0[k] * ((k + 1) as f64 * PI * code).sin()).sum::<f64>()
    }

    /// The radiance of a code.
    pub fn radiance(&self, code: f64) -> f64 {
        srgb_decode(self.code(code))
    }

    /// The radiance of a code, and how it changes with the curve.
    fn derivatives(&self, code: f64) -> (f64, [f64; TONE]) {
        let u = self.code(code).max(1e-4);
        let radiance = srgb_decode(u);
        let slope = radiance * if u <= 0.04045 { 1.0 / u } else { 2.4 / (u + 0.055) };
        (radiance, std::array::from_fn(|k| slope * ((k + 1) as f64 * PI * code).sin()))
    }

    /// The logarithm of the flash's part of the radiance of a code, and how it changes with the curve; `share` of the radiance of the code `dark` is there without flash.
    fn log_radiance(&self, code: f64, dark: f64, share: f64) -> (f64, [f64; TONE]) {
        let ((all, by_tone), (rest, rest_by_tone)) = (self.derivatives(code), self.derivatives(dark));
        let rest = if dark > 0.0 { share * rest } else { 0.0 };
        // Where nothing is left the logarithm stays finite, and counts next to nothing.
        let flash = (all - rest).max(1e-6);
        let share = if dark > 0.0 { share } else { 0.0 };
        (flash.ln(), std::array::from_fn(|k| (by_tone[k] - share * rest_by_tone[k]) / flash))
    }

    /// Nearer to sRGB, until it rises everywhere.
    fn made_monotone(self) -> Self {
        let slope = |tone: &Self, code: f64| {
            1.0 + (0..TONE).map(|k| tone.0[k] * (k + 1) as f64 * PI * ((k + 1) as f64 * PI * code).cos()).sum::<f64>()
        };
        let mut tone = self;
        while (0..=64).any(|i| slope(&tone, f64::from(i) / 64.0) < SLOPE_MIN) {
            tone = Self(tone.0.map(|t| 0.8 * t));
        }
        tone
    }

    /// What a value that was decoded as sRGB stands for.
    pub fn corrected(&self, value: f64) -> f64 {
        if *self == Self::default() || !(0.0..=1.0).contains(&value) {
            value
        } else {
            self.radiance(srgb_encode(value))
        }
    }
}

/// A place of paper or of a grey patch in a photo.
#[derive(Clone, Copy, Debug)]
pub struct Paper {
    /// The code that the camera wrote, 0 to 1.
    pub code: [f64; 3],
    /// The code that it wrote without flash, and by what its radiance is to be multiplied for this photo's exposure; zeros where that is not known.
    pub dark: [f64; 3],
    pub dark_share: f64,
    /// The grey patch that it is on; white paper if `None`.
    pub grey: Option<usize>,
    /// Where it is in the camera's frame: x right, y down, z forward; in millimetres.
    pub point: [f64; 3],
    /// The direction that it faces, in the camera's frame.
    pub normal: [f64; 3],
}

impl Paper {
    /// The logarithm of `cos t / d^2` under a flash to the right and up of the lens.
    fn log_irradiance(&self, [right, up]: [f64; 2]) -> f64 {
        let to_light = [right - self.point[0], -up - self.point[1], -self.point[2]];
        let distance = norm(to_light);
        let cos = (0..3).map(|i| to_light[i] * self.normal[i]).sum::<f64>() / distance;
        cos.max(1e-6).ln() - 2.0 * distance.ln()
    }
}

/// What lens and flash lose towards the edges.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FallOff {
    /// Coefficients of r^2 and r^4 of the lens.
    pub lens: [f64; 2],
    /// Coefficients of s^2 and s^4 of the flash.
    pub flash: [f64; 2],
}

impl FallOff {
    /// `r^2, r^4, s^2, s^4` of a point of the camera's frame, the flash to the right and up of the lens.
    fn terms([x, y, z]: [f64; 3], [right, up]: [f64; 2]) -> [f64; 4] {
        let r2 = (x * x + y * y) / (z * z);
        let s2 = ((x - right).powi(2) + (y + up).powi(2)) / (z * z);
        [r2, r2 * r2, s2, s2 * s2]
    }

    /// The share that is left at a point of the camera's frame.
    pub fn share(&self, point: [f64; 3], offset: [f64; 2]) -> f64 {
        let [r2, r4, s2, s4] = Self::terms(point, offset);
        (self.lens[0] * r2 + self.lens[1] * r4 + self.flash[0] * s2 + self.flash[1] * s4).exp()
    }
}

/// The light of all photos of a lens.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// Intensity of each photo's light.
    pub intensities: Vec<[f64; 3]>,
    pub tone: Tone,
    pub fall_off: FallOff,
    /// The flash, seen from the lens: to the right and up, in millimetres.
    pub offset: [f64; 2],
    /// Of each photo, the third quartile of its paper's deviations from that, as a share: what lies on the paper in a few places does not show.
    pub errors: Vec<f64>,
    /// Of each photo, the share of the light on its paper that does not come from the flash, as far as it can be told apart.
    pub ambient: Vec<f64>,
}

/// What is known before.
#[derive(Clone, Copy, Debug)]
pub struct Known {
    /// Diffuse albedo of the paper.
    pub white: f64,
    /// Where the flash is; `None` if it is to be found.
    pub offset: Option<[f64; 2]>,
    /// Whether codes are sRGB's, or linear values were made codes by it.
    pub is_srgb: bool,
}

/// One equation: the logarithm of what the light would be, and how that changes with the shared unknowns.
struct Row {
    value: f64,
    gradient: [f64; SHARED],
    weight: f64,
}

/// The light of photos from their paper and greys; each has [`PLACES_MIN`] places of paper or more.
pub fn estimate(photos: &[Vec<Paper>], known: Known) -> Light {
    let mut shared = [0.0; SHARED];
    if let Some(offset) = known.offset {
        shared[OFFSET..GREY].copy_from_slice(&offset);
    }
    let mut logs = vec![[0.0; 3]; photos.len()];
    for round in 0..ROUNDS {
        let mut matrix = [[0.0; SHARED]; SHARED];
        let mut right = [0.0; SHARED];
        for (papers, logs) in photos.iter().zip(&mut logs) {
            for c in 0..3 {
                let mut rows: Vec<Row> = papers.iter().map(|paper| row(paper, c, &shared)).collect();
                if round > 0 {
                    rows.iter_mut().for_each(|row| row.weight /= 1.0 + ((row.value - logs[c]) / OUTLIER).powi(2));
                }
                let total: f64 = rows.iter().map(|row| row.weight).sum();
                logs[c] = rows.iter().map(|row| row.weight * row.value).sum::<f64>() / total;
                let mean: [f64; SHARED] =
                    std::array::from_fn(|i| rows.iter().map(|row| row.weight * row.gradient[i]).sum::<f64>() / total);
                for row in &rows {
                    let gradient: [f64; SHARED] = std::array::from_fn(|i| row.gradient[i] - mean[i]);
                    for i in 0..SHARED {
                        right[i] -= row.weight * gradient[i] * (row.value - logs[c]);
                        for j in 0..SHARED {
                            matrix[i][j] += row.weight * gradient[i] * gradient[j];
                        }
                    }
                }
            }
        }
        let Some(next) = step(matrix, right, &shared, known) else { break };
        shared = next;
    }
    finished(photos, &shared, &logs, known)
}

/// The shared unknowns after a step of Gauss and Newton, under the priors.
fn step(
    mut matrix: [[f64; SHARED]; SHARED],
    mut right: [f64; SHARED],
    shared: &[f64; SHARED],
    known: Known,
) -> Option<[f64; SHARED]> {
    // What is known stays.
    const FIXED: f64 = 1e-9;
    for i in 0..SHARED {
        let (mean, width) = match i {
            0..TONE => (0.0, if known.is_srgb { FIXED } else { TONE_PRIOR }),
            FALL_OFF..OFFSET => (0.0, FALL_OFF_PRIOR),
            OFFSET..GREY => match known.offset {
                Some(offset) => (offset[i - OFFSET], FIXED),
                None => (0.0, OFFSET_PRIOR),
            },
            _ => (0.0, GREY_PRIOR),
        };
        let precision = (NOISE / width).powi(2);
        matrix[i][i] += precision;
        right[i] -= precision * (shared[i] - mean);
    }
    let change = Cholesky::<_, SHARED>::of(&matrix)?.solve(right);
    let mut next: [f64; SHARED] = std::array::from_fn(|i| shared[i] + change[i]);
    let tone = Tone(std::array::from_fn(|k| next[k])).made_monotone();
    next[..TONE].copy_from_slice(&tone.0);
    next.iter().all(|x| x.is_finite()).then_some(next)
}

fn parts(shared: &[f64; SHARED]) -> (Tone, FallOff, [f64; 2]) {
    let tone = Tone(std::array::from_fn(|k| shared[k]));
    let [a, b, c, e] = [0, 1, 2, 3].map(|i| shared[FALL_OFF + i]);
    (tone, FallOff { lens: [a, b], flash: [c, e] }, [shared[OFFSET], shared[OFFSET + 1]])
}

/// The logarithm of the light that a place asks for, but for the paper's albedo.
fn row(paper: &Paper, channel: usize, shared: &[f64; SHARED]) -> Row {
    let (tone, fall_off, offset) = parts(shared);
    let (log_radiance, by_tone) = tone.log_radiance(paper.code[channel], paper.dark[channel], paper.dark_share);
    let terms = FallOff::terms(paper.point, offset);
    let coefficients = [fall_off.lens[0], fall_off.lens[1], fall_off.flash[0], fall_off.flash[1]];
    let loss = |terms: [f64; 4]| (0..4).map(|i| coefficients[i] * terms[i]).sum::<f64>();
    let mut gradient = [0.0; SHARED];
    gradient[..TONE].copy_from_slice(&by_tone);
    (0..4).for_each(|i| gradient[FALL_OFF + i] = -terms[i]);
    let without = |offset: [f64; 2]| paper.log_irradiance(offset) + loss(FallOff::terms(paper.point, offset));
    for axis in 0..2 {
        // A thousandth of a millimetre.
        let (mut after, mut before) = (offset, offset);
        after[axis] += 1e-3;
        before[axis] -= 1e-3;
        gradient[OFFSET + axis] = -(without(after) - without(before)) / 2e-3;
    }
    let mut value = log_radiance - without(offset);
    if let Some(grey) = paper.grey {
        let i = GREY + 3 * grey + channel;
        value -= shared[i];
        gradient[i] = -1.0;
    }
    let radiance = log_radiance.exp();
    Row { value, gradient, weight: (radiance / (radiance + DARK)).powi(2) }
}

fn finished(photos: &[Vec<Paper>], shared: &[f64; SHARED], logs: &[[f64; 3]], known: Known) -> Light {
    let (tone, fall_off, offset) = parts(shared);
    let error = |(papers, logs): (&Vec<Paper>, &[f64; 3])| {
        let off = |paper: &Paper| (0..3).map(|c| row(paper, c, shared).value - logs[c]).sum::<f64>().abs() / 3.0;
        let mut deviations: Vec<f64> = papers.iter().filter(|paper| paper.grey.is_none()).map(off).collect();
        let at = (deviations.len() - 1) * 3 / 4;
        *deviations.select_nth_unstable_by(at, f64::total_cmp).1
    };
    let intensity = |logs: &[f64; 3]| logs.map(|log| log.exp() * PI / known.white);
    Light {
        intensities: logs.iter().map(intensity).collect(),
        tone,
        fall_off,
        offset,
        errors: photos.iter().zip(logs).map(error).collect(),
        ambient: photos.iter().map(|papers| ambient(papers, shared)).collect(),
    }
}

/// The share of light on white paper that is the same everywhere: what is left where a line through radiance over the flash's light meets none of it.
fn ambient(papers: &[Paper], shared: &[f64; SHARED]) -> f64 {
    let (tone, fall_off, offset) = parts(shared);
    let places: Vec<[f64; 2]> = papers
        .iter()
        .filter(|paper| paper.grey.is_none())
        .map(|paper| {
            let flash = paper.log_irradiance(offset).exp() * fall_off.share(paper.point, offset);
            let radiance = (0..3).map(|c| tone.log_radiance(paper.code[c], paper.dark[c], paper.dark_share).0.exp());
            [flash, radiance.sum::<f64>() / 3.0]
        })
        .collect();
    // The median slope of pairs and the median intercept: a quarter of the places may be wrong.
    let pairs = places.iter().enumerate().flat_map(|(i, a)| places[..i].iter().map(move |b| (a, b)));
    // Pairs as bright as each other say nothing of the slope.
    let far = pairs.filter(|(a, b)| (a[0] - b[0]).abs() > 0.1 * a[0].max(b[0]));
    let slope = median(far.map(|(a, b)| (a[1] - b[1]) / (a[0] - b[0]))).unwrap_or_default();
    if slope <= 0.0 {
        return 0.0;
    }
    let rest = median(places.iter().map(|place| place[1] - slope * place[0])).unwrap_or_default();
    let all = median(places.iter().map(|place| place[1])).unwrap_or_default();
    if all > 0.0 { (rest / all).max(0.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acquire::geometry::cross;

    /// A telephone: its curve from radiance to codes, by the inverse of a curve with more contrast in the middle.
    fn telephone(radiance: f64) -> f64 {
        let code = srgb_encode(radiance.clamp(0.0, 1.0));
        code - 0.03 * (2.0 * PI * code).sin()
    }

    struct Truth {
        fall_off: FallOff,
        offset: [f64; 2],
        intensities: Vec<[f64; 3]>,
        albedos: [f64; GREYS],
        curve: fn(f64) -> f64,
    }

    fn truth() -> Truth {
        Truth {
            fall_off: FallOff { lens: [-1.9, 1.1], flash: [-0.9, 0.2] },
            offset: [12.0, -5.0],
            intensities: (0..6).map(|i| [90_000.0, 84_000.0, 75_000.0].map(|x| x * [1.0, 0.7, 1.4][i % 3])).collect(),
            albedos: [0.04, 0.13, 0.25, 0.36, 0.47, 0.6, 0.72],
            curve: telephone,
        }
    }

    /// What photos from around a sheet measure.
    fn photos(truth: &Truth) -> Vec<Vec<Paper>> {
        let photo = |(i, intensity): (usize, &[f64; 3])| {
            let angle = 1.1 * i as f64;
            let lean: f64 = if i == 0 { 0.0 } else { 0.42 };
            let camera = [250.0 * angle.cos() * lean.sin(), 250.0 * angle.sin() * lean.sin(), 250.0 * lean.cos()];
            let forward = camera.map(|x| -x / norm(camera));
            let right = cross(forward, [0.1, 1.0, 0.0]);
            let right = right.map(|x| x / norm(right));
            let axes = [right, cross(forward, right), forward];
            let seen = |v: [f64; 3]| axes.map(|axis| (0..3).map(|k| axis[k] * v[k]).sum::<f64>());
            let paper = |[x, y]: [f64; 2], grey: Option<usize>| {
                let mut paper = Paper {
                    code: [0.0; 3],
                    dark: [0.0; 3],
                    dark_share: 0.0,
                    grey,
                    point: seen([x - camera[0], y - camera[1], -camera[2]]),
                    normal: seen([0.0, 0.0, 1.0]),
                };
                let albedo = grey.map_or(0.8, |grey| truth.albedos[grey]);
                let light = paper.log_irradiance(truth.offset).exp() * truth.fall_off.share(paper.point, truth.offset);
                paper.code = intensity.map(|intensity| (truth.curve)(albedo / PI * intensity * light));
                paper
            };
            let ring = (0..16usize).map(|k| {
                let along = 33.5 * (k % 4) as f64 - 50.0;
                paper([[along, 67.0], [67.0, -along], [-along, -67.0], [-67.0, along]][k / 4], None)
            });
            let greys = (0..GREYS).map(|j| paper([9.0 * j as f64 - 31.5, -86.5], Some(j)));
            ring.chain(greys).collect()
        };
        truth.intensities.iter().enumerate().map(photo).collect()
    }

    /// The largest error of intensities up to one common factor.
    fn light_error(found: &Light, truth: &Truth) -> f64 {
        let ratio = |i: usize, c: usize| found.intensities[i][c] / truth.intensities[i][c];
        let all = (0..truth.intensities.len()).flat_map(|i| (0..3).map(move |c| (i, c)));
        all.map(|(i, c)| (ratio(i, c) / ratio(0, 0) - 1.0).abs()).fold(0.0, f64::max)
    }

    fn curve_error(found: &Light, truth: &Truth) -> f64 {
        let code = |i: u32| f64::from(i) / 20.0;
        let errors = (2..20).map(|i| found.tone.radiance((truth.curve)(code(i))) / code(i) - 1.0);
        let errors: Vec<f64> = errors.collect();
        // Up to one factor, which the light has.
        let middle = errors[10];
        errors.iter().map(|error| (error - middle).abs()).fold(0.0, f64::max)
    }

    const KNOWN: Known = Known { white: 0.8, offset: None, is_srgb: false };

    #[test]
    fn light_curve_fall_off_and_flash_are_found_past_a_shadow() {
        let truth = truth();
        let mut photos = photos(&truth);
        photos[1][3].code = photos[1][3].code.map(|code| 0.6 * code);
        let found = estimate(&photos, KNOWN);
        assert!(light_error(&found, &truth) < 0.02, "{found:?}");
        assert!(curve_error(&found, &truth) < 0.05, "{} {found:?}", curve_error(&found, &truth));
        for paper in &photos[4] {
            let share = |fall_off: FallOff, offset: [f64; 2]| {
                fall_off.share(paper.point, offset) / fall_off.share(photos[4][0].point, offset)
            };
            let (found, known) = (share(found.fall_off, found.offset), share(truth.fall_off, truth.offset));
            assert!((found / known - 1.0).abs() < 0.03, "{found} {known}");
        }
        assert!((0..2).all(|i| (found.offset[i] - truth.offset[i]).abs() < 2.0), "{found:?}");
        // One place in shadow is no fault of the light.
        assert!(found.errors.iter().all(|error| *error < 0.02), "{found:?}");
        assert!(found.ambient.iter().all(|share| *share < 0.04), "{found:?}");
    }

    #[test]
    fn srgb_stays_srgb() {
        let mut truth = truth();
        truth.curve = |radiance| srgb_encode(radiance.clamp(0.0, 1.0));
        let found = estimate(&photos(&truth), Known { offset: Some(truth.offset), ..KNOWN });
        assert!(curve_error(&found, &truth) < 0.01 && found.offset == truth.offset, "{found:?}");
        let found = estimate(&photos(&truth), Known { is_srgb: true, ..KNOWN });
        assert!(found.tone.0.iter().all(|t| t.abs() < 1e-9) && light_error(&found, &truth) < 0.005, "{found:?}");
    }

    #[test]
    fn other_light_shows_in_the_photo_that_has_it() {
        let mut truth = truth();
        truth.curve = |radiance| srgb_encode(radiance.clamp(0.0, 1.0));
        let mut photos = photos(&truth);
        let radiances: Vec<f64> = photos[1].iter().map(|paper| srgb_decode(paper.code[0])).collect();
        let mean = radiances.iter().sum::<f64>() / radiances.len() as f64;
        for paper in &mut photos[1] {
            paper.code = paper.code.map(|code| srgb_encode(srgb_decode(code) + 0.3 * mean));
        }
        let found = estimate(&photos, Known { offset: Some(truth.offset), ..KNOWN });
        let others = (0..photos.len()).filter(|&i| i != 1).map(|i| found.ambient[i]).fold(0.0, f64::max);
        assert!(found.ambient[1] > 0.1 && others < 0.05, "{found:?}");
    }

    /// Without flash only the room's light is there: with that known, everything is found as without it.
    #[test]
    fn a_photo_without_flash_takes_out_other_light() {
        let truth = truth();
        let clean = estimate(&photos(&truth), KNOWN);
        let mut photos = photos(&truth);
        for (i, papers) in photos.iter_mut().enumerate() {
            for paper in papers {
                let albedo = paper.grey.map_or(0.8, |grey| truth.albedos[grey]);
                let light = paper.log_irradiance(truth.offset).exp() * truth.fall_off.share(paper.point, truth.offset);
                let radiance = |c: usize| albedo / PI * truth.intensities[i][c] * light;
                paper.code = [0, 1, 2].map(|c| telephone(radiance(c) + 0.2 * albedo));
                (paper.dark, paper.dark_share) = ([telephone(0.1 * albedo); 3], 2.0);
            }
        }
        let found = estimate(&photos, KNOWN);
        for (found, clean) in found.intensities.iter().zip(&clean.intensities) {
            assert!((0..3).all(|c| (found[c] / clean[c] - 1.0).abs() < 0.02), "{found:?} {clean:?}");
        }
        assert!(curve_error(&found, &truth) < 0.06, "{}", curve_error(&found, &truth));
    }

    #[test]
    fn curves_rise_and_keep_black_and_white() {
        let tone = Tone([0.5, -0.3, 0.2, 0.1]).made_monotone();
        let values: Vec<f64> = (0..=200).map(|i| tone.radiance(f64::from(i) / 200.0)).collect();
        assert!(values.windows(2).all(|pair| pair[1] > pair[0]), "{tone:?}");
        assert!(values[0].abs() < 1e-12 && (values[200] - 1.0).abs() < 1e-9);
        assert_eq!(Tone::default().corrected(0.3), 0.3);
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        let paper = Paper {
            code: [0.5, 0.3, 0.02],
            dark: [0.2, 0.0, 0.01],
            dark_share: 0.7,
            grey: Some(2),
            point: [40.0, -60.0, 240.0],
            normal: [0.1, 0.2, -0.97],
        };
        let mut shared: [f64; SHARED] = std::array::from_fn(|i| 0.01 * (i % 5) as f64);
        shared[OFFSET] = 7.0;
        for channel in 0..3 {
            let exact = row(&paper, channel, &shared).gradient;
            for i in 0..SHARED {
                let at = |step: f64| {
                    let mut moved = shared;
                    moved[i] += step;
                    row(&paper, channel, &moved).value
                };
                let numeric = (at(1e-5) - at(-1e-5)) / 2e-5;
                assert!((numeric - exact[i]).abs() < 1e-4 * (1.0 + exact[i].abs()), "{i}: {numeric} {}", exact[i]);
            }
        }
    }
}
