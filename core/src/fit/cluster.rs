//! Grouping pixels by colour: a real surface is made of few materials.

use rayon::prelude::*;

/// Pixels looked at to find the groups; more would only take longer.
const SAMPLES: usize = 16_384;
/// Rounds of Lloyd's iteration.
const ROUNDS: usize = 30;
/// Distance between gamma 2.2 encoded colours within which a pixel counts to several groups.
const SOFTNESS: f32 = 0.05;

/// Soft membership of every pixel in at most `groups` colour groups.
///
/// `colors`: three planes of `pixels` values, gamma 2.2 encoded. Returns one plane of weights per group, the weights of a pixel summing to 1.
/// Fewer groups come back where there are fewer different colours.
///
/// # Source
/// Arthur and Vassilvitskii, "k-means++: The Advantages of Careful Seeding", SODA 2007.
pub fn soft_groups(colors: &[f32], pixels: usize, groups: usize, seed: u64) -> Vec<Vec<f32>> {
    let color = |p: usize| [colors[p], colors[pixels + p], colors[2 * pixels + p]];
    let stride = pixels.div_ceil(SAMPLES);
    let samples: Vec<[f32; 3]> = (0..pixels).step_by(stride).map(color).collect();
    let centers = lloyd(&samples, seed_centers(&samples, groups, seed));
    let weights: Vec<Vec<f32>> = (0..pixels).into_par_iter().map(|p| memberships(color(p), &centers)).collect();
    (0..centers.len()).map(|k| weights.iter().map(|w| w[k]).collect()).collect()
}

fn distance2(a: [f32; 3], b: [f32; 3]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// Gaussian weights around the centers, relative to the nearest one so that none underflows to 0 / 0.
fn memberships(color: [f32; 3], centers: &[[f32; 3]]) -> Vec<f32> {
    let distances: Vec<f32> = centers.iter().map(|&center| distance2(color, center)).collect();
    let nearest = distances.iter().copied().fold(f32::INFINITY, f32::min);
    let weights: Vec<f32> =
        distances.iter().map(|distance| ((nearest - distance) / (2.0 * SOFTNESS * SOFTNESS)).exp()).collect();
    let sum: f32 = weights.iter().sum();
    weights.into_iter().map(|weight| weight / sum).collect()
}

/// k-means++: each further center is drawn with probability proportional to the squared distance from those chosen.
fn seed_centers(samples: &[[f32; 3]], groups: usize, seed: u64) -> Vec<[f32; 3]> {
    let mut random = fastrand::Rng::with_seed(seed);
    let mut centers = vec![samples[random.usize(..samples.len())]];
    let mut distances = vec![f32::INFINITY; samples.len()];
    while centers.len() < groups {
        let newest = centers[centers.len() - 1];
        for (distance, &sample) in distances.iter_mut().zip(samples) {
            *distance = distance.min(distance2(sample, newest));
        }
        let total: f64 = distances.iter().map(|&d| f64::from(d)).sum();
        // Colours a thousandth apart are the same.
        if total < 1e-6 * samples.len() as f64 {
            break;
        }
        let mut rest = random.f64() * total;
        let drawn = distances.iter().position(|&distance| {
            rest -= f64::from(distance);
            rest < 0.0
        });
        centers.push(samples[drawn.unwrap_or(samples.len() - 1)]);
    }
    centers
}

fn lloyd(samples: &[[f32; 3]], mut centers: Vec<[f32; 3]>) -> Vec<[f32; 3]> {
    for _ in 0..ROUNDS {
        let mut sums = vec![[0.0f64; 4]; centers.len()];
        for &sample in samples {
            let nearest = (0..centers.len())
                .min_by(|&a, &b| distance2(sample, centers[a]).total_cmp(&distance2(sample, centers[b])))
                .unwrap_or(0);
            let sum = &mut sums[nearest];
            sample.iter().zip(sum.iter_mut()).for_each(|(&value, sum)| *sum += f64::from(value));
            sum[3] += 1.0;
        }
        for (center, sum) in centers.iter_mut().zip(&sums).filter(|(_, sum)| sum[3] > 0.0) {
            *center = [0, 1, 2].map(|c| (sum[c] / sum[3]) as f32);
        }
    }
    centers
}

#[cfg(test)]
mod tests {
    use super::soft_groups;

    #[test]
    fn three_colours_make_three_groups() {
        let palette = [[0.1f32, 0.1, 0.1], [0.8, 0.2, 0.1], [0.2, 0.3, 0.9]];
        let pixels = 300;
        let mut colors = vec![0.0; 3 * pixels];
        for p in 0..pixels {
            for c in 0..3 {
                colors[c * pixels + p] = palette[p % 3][c];
            }
        }
        let weights = soft_groups(&colors, pixels, 8, 1);
        assert_eq!(weights.len(), 3, "no more groups than colours");
        let group = |p: usize| (0..3).max_by(|&a, &b| weights[a][p].total_cmp(&weights[b][p])).unwrap();
        for p in 0..pixels {
            assert_eq!(group(p), group(p % 3));
            assert!((weights.iter().map(|w| w[p]).sum::<f32>() - 1.0).abs() < 1e-6);
            assert!(weights[group(p)][p] > 0.99);
        }
        assert_ne!(group(0), group(1));
        assert_eq!(weights, soft_groups(&colors, pixels, 8, 1), "the seed decides");
    }

    #[test]
    fn one_colour_and_one_pixel() {
        assert_eq!(soft_groups(&[0.5; 300], 100, 8, 0), vec![vec![1.0; 100]]);
        assert_eq!(soft_groups(&[0.5; 3], 1, 8, 0), vec![vec![1.0]]);
    }
}
