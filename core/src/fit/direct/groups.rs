//! Grouping pixels by colour: a real surface is made of few materials.

use rayon::prelude::*;

use crate::color::Transfer;
use crate::fit::shading::{bundle, unbundle};
use crate::real::{Kernel, Lanes, Real};

/// Pixels looked at to find the groups; more would only take longer.
const SAMPLES: usize = 16_384;
/// Of them one thread takes so many at a time.
const PART: usize = 1024;
/// Rounds of Lloyd's iteration at most.
const ROUNDS: usize = 30;

/// How pixels are grouped.
#[derive(Clone, Copy)]
pub struct Groups {
    /// How many groups there are at most.
    pub most: usize,
    /// Distance between gamma 2.2 encoded colours within which a pixel counts to several groups.
    pub softness: f32,
}

/// A pixel's share in the two groups nearest to its colour: (group, weight), the weights summing to 1.
pub type Membership = [(u32, f32); 2];

/// Soft membership of every pixel in colour groups, and how many groups there are.
///
/// `colors`: three planes of `pixels` values, gamma 2.2 encoded. Fewer groups come back where there are fewer different colours.
///
/// # Source
/// Arthur and Vassilvitskii, "k-means++: The Advantages of Careful Seeding", SODA 2007.
pub fn soft_groups(colors: &[f32], pixels: usize, groups: Groups, seed: u64) -> (Vec<Membership>, usize) {
    let color = |p: usize| [colors[p], colors[pixels + p], colors[2 * pixels + p]];
    let stride = pixels.div_ceil(SAMPLES);
    let samples: Vec<[f32; 3]> = (0..pixels).step_by(stride).map(color).collect();
    let centers = lloyd(&samples, seed_centers(&samples, groups.most, seed));
    let of_part = |part: usize| {
        let colors: Vec<[f32; 3]> = (part * PART..pixels.min((part + 1) * PART)).map(color).collect();
        let nearest = f32::run(Nearest { colors: &colors, centers: &centers });
        nearest.into_iter().map(|nearest| membership(nearest, groups.softness)).collect::<Vec<_>>()
    };
    let memberships: Vec<Vec<Membership>> = (0..pixels.div_ceil(PART)).into_par_iter().map(of_part).collect();
    let memberships = memberships.concat();
    (memberships, centers.len())
}

fn distance2(a: [f32; 3], b: [f32; 3]) -> f32 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    x * x + y * y + z * z
}

/// The two nearest of `centers` to each of `colors`, and their squared distances; infinite where there is no second.
struct Nearest<'a> {
    colors: &'a [[f32; 3]],
    centers: &'a [[f32; 3]],
}

impl Kernel<f32> for Nearest<'_> {
    type Output = Vec<[(u32, f32); 2]>;

    #[inline(always)]
    fn run<L: Lanes<Scalar = f32>>(self) -> Self::Output {
        let mut found = Vec::with_capacity(self.colors.len());
        let far = L::splat(f64::INFINITY);
        for colors in self.colors.chunks(L::LANES) {
            let color: [L; 3] =
                [bundle(colors, |color| color[0]), bundle(colors, |color| color[1]), bundle(colors, |color| color[2])];
            // Indices are small enough for single precision.
            let mut nearest = [L::splat(0.0), far];
            let mut second = nearest;
            for (k, center) in self.centers.iter().enumerate() {
                let mut distance = L::splat(0.0);
                for c in 0..3 {
                    let off = color[c] - L::splat(center[c].into());
                    distance = off.mul_add(off, distance);
                }
                let candidate = [L::splat(k as f64), distance];
                let (first, next) = (nearest[1].gt(distance), second[1].gt(distance));
                for i in 0..2 {
                    second[i] = L::select(first, nearest[i], L::select(next, candidate[i], second[i]));
                    nearest[i] = L::select(first, candidate[i], nearest[i]);
                }
            }
            let [nearest_center, nearest_distance] = nearest;
            let [second_center, second_distance] = second;
            for values in unbundle([nearest_center, nearest_distance, second_center, second_distance], colors.len()) {
                found.push([(values[0] as u32, values[1]), (values[2] as u32, values[3])]);
            }
        }
        found
    }
}

/// Gaussian weights around the two nearest centers, relative to the nearest one so that none underflows to 0 / 0.
fn membership([nearest, second]: [(u32, f32); 2], softness: f32) -> Membership {
    let ratio = ((nearest.1 - second.1) / (2.0 * softness * softness)).exp();
    let weight = 1.0 / (1.0 + ratio);
    [(nearest.0, weight), (second.0, 1.0 - weight)]
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
        let of_part = |samples: &[[f32; 3]]| {
            let mut sums = vec![[0.0f64; 4]; centers.len()];
            let nearest = f32::run(Nearest { colors: samples, centers: &centers });
            for (sample, [(nearest, _), _]) in samples.iter().zip(nearest) {
                let sum = &mut sums[nearest as usize];
                sample.iter().zip(sum.iter_mut()).for_each(|(&value, sum)| *sum += f64::from(value));
                sum[3] += 1.0;
            }
            sums
        };
        let parts: Vec<Vec<[f64; 4]>> = samples.par_chunks(PART).map(of_part).collect();
        let mut moved = false;
        for (k, center) in centers.iter_mut().enumerate() {
            // Summed in order: the same bits on any number of threads.
            let sum = |i: usize| parts.iter().map(|sums| sums[k][i]).sum::<f64>();
            let count = sum(3);
            if count > 0.0 {
                let mean = [0, 1, 2].map(|c| (sum(c) / count) as f32);
                moved |= mean != *center;
                *center = mean;
            }
        }
        if !moved {
            break;
        }
    }
    centers
}

/// Pixels in groups by three planes of diffuse albedo, and how many groups there are.
pub(super) fn colour_groups(diffuse: &[f32], groups: Groups, seed: u64) -> (Vec<Membership>, usize) {
    let encoded: Vec<f32> = diffuse.par_iter().map(|&value| Transfer::Gamma22.encode(value)).collect();
    soft_groups(&encoded, diffuse.len() / 3, groups, seed)
}

#[cfg(test)]
mod tests {
    use super::{Groups, Membership};

    fn soft_groups(colors: &[f32], pixels: usize, most: usize, seed: u64) -> (Vec<Membership>, usize) {
        super::soft_groups(colors, pixels, Groups { most, softness: 0.05 }, seed)
    }

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
        let (memberships, groups) = soft_groups(&colors, pixels, 8, 1);
        assert_eq!(groups, 3, "no more groups than colours");
        for (p, [nearest, second]) in memberships.iter().enumerate() {
            assert_eq!(nearest.0, memberships[p % 3][0].0);
            assert!(nearest.1 > 0.99 && (nearest.1 + second.1 - 1.0).abs() < 1e-6);
        }
        assert_ne!(memberships[0][0].0, memberships[1][0].0);
        assert_eq!(memberships, soft_groups(&colors, pixels, 8, 1).0, "the seed decides");
    }

    #[test]
    fn halfway_between_two_colours_a_pixel_is_both() {
        let mut colors = [0.2f32; 303];
        for plane in colors.chunks_exact_mut(101) {
            plane[50..100].fill(0.3);
            plane[100] = 0.25;
        }
        let (memberships, groups) = soft_groups(&colors, 101, 2, 3);
        assert_eq!(groups, 2);
        assert!((memberships[100][0].1 - 0.5).abs() < 0.05, "{:?}", memberships[100]);
        assert!(memberships[0][0].1 > 0.95, "{:?}", memberships[0]);
    }

    #[test]
    fn one_colour_and_one_pixel() {
        assert_eq!(soft_groups(&[0.5; 300], 100, 8, 0), (vec![[(0, 1.0), (0, 0.0)]; 100], 1));
        assert_eq!(soft_groups(&[0.5; 3], 1, 8, 0), (vec![[(0, 1.0), (0, 0.0)]], 1));
    }
}
