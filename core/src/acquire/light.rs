//! How bright the light of every photo was, from the white paper between the tags.
//!
//! Paper of diffuse albedo `rho` at distance d from a light that meets it at an angle t has the radiance `rho I cos t / (pi d^2)`, times what lens and flash lose towards the edges of the picture:
//! `exp(a r^2 + b r^4)` with r the tangent of the angle to the camera's axis, the same in all photos of a lens. Logarithms of I, and a and b, are found by least squares; places that are far off
//! (a shadow, a reflection) count less and less.

use std::f64::consts::PI;

/// Rounds of reweighting.
const ROUNDS: usize = 10;
/// Deviations of the logarithm beyond this count less and less.
const OUTLIER: f64 = 0.03;
/// Width of the prior of `a` and `b` about none, so that photos from one place leave them alone.
const FALL_OFF_PRIOR: f64 = 1.0;
/// Places that a photo needs.
pub const PLACES_MIN: usize = 4;

/// A place of white paper in a photo.
#[derive(Clone, Copy, Debug)]
pub struct Paper {
    /// Its radiance.
    pub radiance: [f64; 3],
    /// `cos t / d^2`.
    pub irradiance: f64,
    /// Square of the tangent of its angle to the camera's axis.
    pub r2: f64,
}

/// The light of all photos of a lens.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// Intensity of each photo's light.
    pub intensities: Vec<[f64; 3]>,
    /// `a` and `b`.
    pub fall_off: [f64; 2],
    /// Of each photo, the third quartile of its paper's deviations from that, as a share: what lies on the paper in a few places does not show.
    pub errors: Vec<f64>,
}

/// What is lost at a square of the tangent `r2`.
pub fn loss(fall_off: [f64; 2], r2: f64) -> f64 {
    (r2 * (fall_off[0] + r2 * fall_off[1])).exp()
}

/// The light of photos from their paper of diffuse albedo `white`, each with [`PLACES_MIN`] places or more.
pub fn estimate(photos: &[Vec<Paper>], white: f64) -> Light {
    let levels = |paper: &Paper| paper.radiance.map(|radiance| (radiance * PI / (white * paper.irradiance)).ln());
    let mut fall_off = [0.0; 2];
    let mut logs = vec![[0.0; 3]; photos.len()];
    let off = |paper: &Paper, logs: &[f64; 3], fall_off: [f64; 2]| {
        let levels = levels(paper);
        (0..3).map(|c| levels[c] - logs[c] - loss(fall_off, paper.r2).ln()).sum::<f64>() / 3.0
    };
    for round in 0..ROUNDS {
        let (mut matrix, mut right) = ([[0.0; 2]; 2], [0.0; 2]);
        for (papers, logs) in photos.iter().zip(&mut logs) {
            let weights: Vec<f64> = papers
                .iter()
                .map(
                    |paper| if round == 0 { 1.0 } else { 1.0 / (1.0 + (off(paper, logs, fall_off) / OUTLIER).powi(2)) },
                )
                .collect();
            let total: f64 = weights.iter().sum();
            let mean = |value: &dyn Fn(&Paper) -> f64| {
                papers.iter().zip(&weights).map(|(paper, weight)| weight * value(paper)).sum::<f64>() / total
            };
            let terms = |paper: &Paper| [paper.r2, paper.r2 * paper.r2];
            let middle = [0, 1].map(|i| mean(&|paper| terms(paper)[i]));
            let level = [0, 1, 2].map(|c| mean(&|paper| levels(paper)[c]));
            for (paper, weight) in papers.iter().zip(&weights) {
                let term = [0, 1].map(|i| terms(paper)[i] - middle[i]);
                let deviation = (0..3).map(|c| levels(paper)[c] - level[c]).sum::<f64>() / 3.0;
                for i in 0..2 {
                    right[i] += weight * term[i] * deviation;
                    (0..2).for_each(|j| matrix[i][j] += weight * term[i] * term[j]);
                }
            }
            *logs = [0, 1, 2].map(|c| level[c] - fall_off[0] * middle[0] - fall_off[1] * middle[1]);
        }
        // In units of the deviations' square.
        let prior = (OUTLIER / FALL_OFF_PRIOR).powi(2);
        (0..2).for_each(|i| matrix[i][i] += prior);
        let determinant = matrix[0][0] * matrix[1][1] - matrix[0][1] * matrix[1][0];
        fall_off = [
            (right[0] * matrix[1][1] - right[1] * matrix[0][1]) / determinant,
            (right[1] * matrix[0][0] - right[0] * matrix[1][0]) / determinant,
        ];
    }
    let error = |(papers, logs): (&Vec<Paper>, &[f64; 3])| {
        let mut deviations: Vec<f64> = papers.iter().map(|paper| off(paper, logs, fall_off).abs()).collect();
        let at = (deviations.len() - 1) * 3 / 4;
        *deviations.select_nth_unstable_by(at, f64::total_cmp).1
    };
    let errors = photos.iter().zip(&logs).map(error).collect();
    Light { intensities: logs.iter().map(|logs| logs.map(f64::exp)).collect(), fall_off, errors }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn papers(intensity: [f64; 3], fall_off: [f64; 2], shift: f64) -> Vec<Paper> {
        let place = |i: usize| {
            let r2 = 0.02 + 0.3 * ((i as f64 * 0.37 + shift) % 1.0);
            let irradiance = 1e-5 * (1.0 + 0.1 * (i % 5) as f64);
            let radiance = intensity.map(|intensity| 0.8 / PI * intensity * irradiance * loss(fall_off, r2));
            Paper { radiance, irradiance, r2 }
        };
        (0..16).map(place).collect()
    }

    #[test]
    fn intensity_and_fall_off_are_found_past_a_shadow() {
        let fall_off = [-1.5, 0.8];
        let truth = [[30000.0, 28000.0, 20000.0], [60000.0, 56000.0, 40000.0], [31000.0, 29000.0, 21000.0]];
        let mut photos: Vec<_> =
            truth.iter().enumerate().map(|(i, &intensity)| papers(intensity, fall_off, 0.21 * i as f64)).collect();
        photos[1][3].radiance = photos[1][3].radiance.map(|value| 0.5 * value);
        let light = estimate(&photos, 0.8);
        for (found, truth) in light.intensities.iter().zip(&truth) {
            for c in 0..3 {
                assert!((found[c] / truth[c] - 1.0).abs() < 0.02, "{found:?} {truth:?}");
            }
        }
        for r2 in [0.05, 0.2, 0.3] {
            assert!((loss(light.fall_off, r2) / loss(fall_off, r2) - 1.0).abs() < 0.02, "{light:?}");
        }
        // One place in shadow is no fault of the light.
        assert!(light.errors.iter().all(|error| *error < 0.02), "{light:?}");
    }

    #[test]
    fn other_light_shows_in_the_photo_that_has_it() {
        let mut photos: Vec<_> = (0..3).map(|i| papers([30000.0; 3], [-1.5, 0.8], 0.21 * f64::from(i))).collect();
        let mean = photos[1].iter().map(|paper| paper.radiance[0]).sum::<f64>() / photos[1].len() as f64;
        for paper in &mut photos[1] {
            paper.radiance = paper.radiance.map(|value| value + 0.6 * mean);
        }
        let light = estimate(&photos, 0.8);
        assert!(light.errors[1] > 0.05 && light.errors[0] < 0.03 && light.errors[2] < 0.03, "{light:?}");
    }
}
