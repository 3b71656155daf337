//! Adam on a flat slice of parameters.

use rayon::prelude::*;

/// Decay of the running mean of the gradient.
const BETA1: f64 = 0.9;
/// Decay of the running mean of the squared gradient.
const BETA2: f64 = 0.999;
/// Parameters that one thread moves at a time.
const PART: usize = 1 << 15;
/// Keeps the step finite where the gradient has been zero all along.
const EPSILON: f32 = 1e-8;

/// The state of Adam (Kingma and Ba, "Adam: A Method for Stochastic Optimization", ICLR 2015, algorithm 1) with the
/// decays 0.9 and 0.999 and epsilon 1e-8 that the paper's optimisation uses.
#[derive(Clone, Debug)]
pub struct Adam {
    mean: Vec<f32>,
    square: Vec<f32>,
    steps: i32,
}

impl Adam {
    /// A fresh state for `len` parameters.
    pub fn new(len: usize) -> Self {
        Self { mean: vec![0.0; len], square: vec![0.0; len], steps: 0 }
    }

    /// Forgets the gradients seen so far.
    pub fn reset(&mut self) {
        self.mean.fill(0.0);
        self.square.fill(0.0);
        self.steps = 0;
    }

    /// Moves `params` one step against `gradient`; both hold as many values as the state (surplus ones are left alone).
    pub fn step(&mut self, params: &mut [f32], gradient: &[f32], learning_rate: f64) {
        self.steps = self.steps.saturating_add(1);
        let size = (learning_rate / (1.0 - BETA1.powi(self.steps))) as f32;
        let root = (1.0 / (1.0 - BETA2.powi(self.steps)).sqrt()) as f32;
        let (beta1, beta2) = (BETA1 as f32, BETA2 as f32);
        let (rest1, rest2) = ((1.0 - BETA1) as f32, (1.0 - BETA2) as f32);
        let state = self.mean.par_chunks_mut(PART).zip(self.square.par_chunks_mut(PART));
        let parts = params.par_chunks_mut(PART).zip(gradient.par_chunks(PART)).zip(state);
        parts.for_each(|((params, gradient), (mean, square))| {
            for ((param, &g), (mean, square)) in params.iter_mut().zip(gradient).zip(mean.iter_mut().zip(square)) {
                *mean = *mean * beta1 + g * rest1;
                *square = *square * beta2 + g * g * rest2;
                *param -= size * *mean / (square.sqrt() * root + EPSILON);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::Adam;

    /// The algorithm as printed, in f64.
    fn reference(start: f64, gradients: &[f64], rate: f64) -> f64 {
        let (mut x, mut m, mut v) = (start, 0.0, 0.0);
        for (t, g) in gradients.iter().enumerate() {
            m = 0.9 * m + 0.1 * g;
            v = 0.999 * v + 0.001 * g * g;
            let t = t as i32 + 1;
            x -= rate * (m / (1.0 - 0.9f64.powi(t))) / ((v / (1.0 - 0.999f64.powi(t))).sqrt() + 1e-8);
        }
        x
    }

    #[test]
    fn follows_the_published_algorithm() {
        let gradients: Vec<f64> = (0..200).map(|i| (i as f64 * 0.7).sin() + 0.3).collect();
        for scale in [1e-6, 1.0, 1e5] {
            let mut adam = Adam::new(1);
            let mut x = [0.5f32];
            for g in &gradients {
                adam.step(&mut x, &[(g * scale) as f32], 1e-2);
            }
            let scaled: Vec<f64> = gradients.iter().map(|g| g * scale).collect();
            let expected = reference(0.5, &scaled, 1e-2);
            assert!((f64::from(x[0]) - expected).abs() < 1e-5, "{scale}: {} {expected}", x[0]);
        }
    }

    #[test]
    fn zero_gradient_moves_nothing_and_reset_forgets() {
        let mut adam = Adam::new(2);
        let mut x = [1.0f32, -2.0];
        adam.step(&mut x, &[0.0, 0.0], 0.1);
        assert_eq!(x, [1.0, -2.0]);
        adam.step(&mut x, &[3.0, -3.0], 0.1);
        let mut fresh = [1.0f32, -2.0];
        adam.reset();
        adam.step(&mut fresh, &[3.0, -3.0], 0.1);
        assert!((fresh[0] - 0.9).abs() < 1e-6 && (fresh[1] + 1.9).abs() < 1e-6, "the first step has the full length");
    }
}
