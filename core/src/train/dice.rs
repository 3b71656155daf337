//! Random numbers: what a step, an example or a material draws follows from the seed and its number alone.

use std::f32::consts::TAU;

/// What random numbers are for; each purpose has numbers of its own.
#[derive(Clone, Copy)]
pub(super) enum Purpose {
    /// How many photos a step has, and which examples are mixed.
    Step,
    /// Crop and variation of an example.
    Crop,
    /// Mixture, capture and views of an example.
    Capture,
    /// A procedural material.
    Procedural,
    /// Captures and views for validation.
    Validation,
}

/// A source of random numbers.
pub(super) struct Dice {
    rng: fastrand::Rng,
}

impl Dice {
    /// The numbers of `purpose` at the place `numbers`, such as step and example.
    pub fn new(seed: u64, purpose: Purpose, numbers: [u64; 2]) -> Self {
        let parts = [purpose as u64, numbers[0], numbers[1]];
        // SplitMix64's finaliser after each part: neighbouring places have nothing in common.
        let mixed = parts.into_iter().fold(seed, |state, part| {
            let mut bits = (state ^ part).wrapping_add(0x9e37_79b9_7f4a_7c15);
            bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            bits ^ (bits >> 31)
        });
        Self { rng: fastrand::Rng::with_seed(mixed) }
    }

    /// From 0 to 1, without 1.
    fn unit(&mut self) -> f32 {
        self.rng.f32()
    }

    pub fn uniform(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// The exponential of a uniform value between the logarithms of `low` and `high`.
    pub fn log_uniform(&mut self, low: f32, high: f32) -> f32 {
        self.uniform(low.ln(), high.ln()).exp()
    }

    /// A whole number from `low` to `high`, both included.
    pub fn integer(&mut self, low: usize, high: usize) -> usize {
        self.rng.usize(low..=high)
    }

    pub fn chance(&mut self, probability: f32) -> bool {
        self.unit() < probability
    }

    /// Two independent Gaussian values with mean 0 and deviation 1 (Box and Muller).
    pub fn normals(&mut self) -> [f32; 2] {
        // 1 - [0, 1): the logarithm stays finite.
        let radius = (-2.0 * (1.0 - self.rng.f32()).ln()).sqrt();
        let (sine, cosine) = (TAU * self.rng.f32()).sin_cos();
        [radius * cosine, radius * sine]
    }

    pub fn normal(&mut self, deviation: f32) -> f32 {
        deviation * self.normals()[0]
    }

    /// An index, each as often as its weight says.
    pub fn weighted(&mut self, weights: &[f64]) -> usize {
        let mut at = self.rng.f64() * weights.iter().sum::<f64>();
        // Rounding may leave a little behind the last.
        let last = weights.iter().rposition(|&weight| weight > 0.0).unwrap_or(0);
        weights
            .iter()
            .position(|&weight| {
                at -= weight;
                at < 0.0
            })
            .unwrap_or(last)
    }

    pub fn shuffle<T>(&mut self, values: &mut [T]) {
        self.rng.shuffle(values);
    }
}

#[cfg(test)]
mod tests {
    use super::{Dice, Purpose};

    #[test]
    fn moments_and_places() {
        let mut dice = Dice::new(1, Purpose::Step, [3, 0]);
        let values: Vec<f64> = (0..40_000).map(|_| dice.normal(2.0).into()).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let deviation = (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt();
        // Four standard errors: 2 / sqrt(40000), and that over sqrt(2).
        assert!(mean.abs() < 0.04 && (deviation - 2.0).abs() < 0.03, "{mean} {deviation}");
        let mut counts = [0; 4];
        (0..30_000).for_each(|_| counts[dice.weighted(&[3.0, 0.0, 1.5, 0.0])] += 1);
        assert_eq!((counts[1], counts[3]), (0, 0));
        assert!((f64::from(counts[0]) - 20_000.0).abs() < 350.0, "{counts:?}");

        let first = |seed, purpose, numbers| Dice::new(seed, purpose, numbers).uniform(0.0, 1.0);
        let one = first(1, Purpose::Crop, [2, 3]);
        assert_eq!(one, first(1, Purpose::Crop, [2, 3]));
        for other in [
            first(2, Purpose::Crop, [2, 3]),
            first(1, Purpose::Step, [2, 3]),
            first(1, Purpose::Crop, [3, 2]),
            first(1, Purpose::Crop, [2, 4]),
        ] {
            assert_ne!(one, other);
        }
    }
}
