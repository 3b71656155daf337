//! How parameters move: AdamW, clipping of the gradient, moving average.

use std::collections::BTreeMap;

use crate::nn::Scalar;

/// Keeps the step finite where the gradient has been zero all along.
const EPSILON: f64 = 1e-8;
/// Added to a norm that is divided by.
const NORM_EPSILON: f64 = 1e-6;

/// The Euclidean norm of all `gradients` together.
pub(crate) fn norm<E: Scalar>(gradients: &BTreeMap<String, Vec<E>>) -> f64 {
    let square = |value: &E| value.wide() * value.wide();
    gradients.values().map(|gradient| gradient.iter().map(square).sum::<f64>()).sum::<f64>().sqrt()
}

/// The factor that shortens a gradient of length `norm` to `longest`, 1 if it is no longer.
pub(crate) fn clip(norm: f64, longest: f64) -> f64 {
    (longest / (norm + NORM_EPSILON)).min(1.0)
}

/// The weight of what a moving average has been so far, at step `step` from 0: `most`, less in the first steps, in which it would hold on to the start.
pub(crate) fn average_weight(most: f64, step: usize) -> f64 {
    most.min((1.0 + step as f64) / (10.0 + step as f64))
}

/// `average = weight average + (1 - weight) values`.
pub(crate) fn take_into_average<E: Scalar>(average: &mut [E], values: &[E], weight: f64) {
    let (old, new) = (E::of(weight), E::of(1.0 - weight));
    average.iter_mut().zip(values).for_each(|(average, &value)| *average = *average * old + value * new);
}

/// One step of AdamW: Adam with bias correction, and weights that decay apart from it.
///
/// # Source
/// Loshchilov and Hutter, "Decoupled Weight Decay Regularization", ICLR 2019, algorithm 2, with the schedule's multiplier as learning rate, as in PyTorch's `AdamW`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AdamW {
    pub rate: f64,
    pub betas: [f64; 2],
    /// Which step it is, from 1.
    pub count: usize,
}

/// The running means of a tensor's gradient and of its square.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Moments<E> {
    pub first: Vec<E>,
    pub second: Vec<E>,
}

impl<E: Scalar> Moments<E> {
    /// Of no gradients yet, for `len` values.
    pub fn new(len: usize) -> Self {
        Self { first: vec![E::default(); len], second: vec![E::default(); len] }
    }
}

impl AdamW {
    /// Moves `values` against `factor` times `gradient`, and by `decay` towards 0.
    pub fn step<E: Scalar>(&self, values: &mut [E], moments: &mut Moments<E>, gradient: &[E], factor: f64, decay: f64) {
        let [beta1, beta2] = self.betas;
        let correction = |beta: f64| 1.0 - beta.powf(self.count as f64);
        let size = E::of(self.rate / correction(beta1));
        let (root, epsilon) = (E::of(correction(beta2).sqrt()), E::of(EPSILON));
        let (kept, factor) = (E::of(1.0 - self.rate * decay), E::of(factor));
        let [(old1, new1), (old2, new2)] = self.betas.map(|beta| (E::of(beta), E::of(1.0 - beta)));
        let moments = moments.first.iter_mut().zip(&mut moments.second);
        for ((value, &gradient), (first, second)) in values.iter_mut().zip(gradient).zip(moments) {
            let gradient = gradient * factor;
            *first = *first * old1 + gradient * new1;
            *second = *second * old2 + gradient * gradient * new2;
            *value = *value * kept - size * *first / (second.root() / root + epsilon);
        }
    }
}
