//! The priors of [`direct`](super).

use rayon::prelude::*;

use super::SPECULAR_LOGIT;
use super::parameters::{GROUP_STEP, Layout, TILT_STEP};
use crate::fit::anisotropy;
use crate::real::{Arithmetic, Kernel, Lanes, Real, Wide};

/// For [`Prior::photo`].
pub(crate) const PHOTO_DEVIATION: f64 = 0.2;
/// Likewise under an anisotropic lobe, which misses less: every pixel's slope is seen in it.
pub(super) const ANISOTROPIC_PHOTO_DEVIATION: f64 = 0.05;
/// Standard deviation of a pixel's slope (tangent of the angle) from the common tilt.
const SLOPE_DEVIATION: f64 = 0.01;
/// Standard deviation of the common tilt, as a slope: a few degrees.
pub(super) const TILT_DEVIATION: f64 = 0.1;
/// Standard deviation of a pixel's specular albedo and roughness from its group's, in logits.
const OWN_DEVIATION: f64 = 0.2;
/// Parameters that one thread takes at a time.
const PART: usize = 1 << 14;

/// How far values may be from where they start.
#[derive(Clone, Copy)]
pub(super) struct PriorSigmas {
    /// Standard deviation of a pixel's diffuse albedo, in logits.
    pub diffuse: f64,
    /// Standard deviation of a group's offsets, in logits.
    pub group: f64,
    /// Likewise, that of specular albedo.
    pub specular: f64,
    /// The prior of a group counts as if this share of its pixels spoke for it.
    pub evidence: f64,
}

/// From a flat start the diffuse albedo is free where a photo says anything, and groups may be anything.
pub(super) const FLAT: PriorSigmas = PriorSigmas { diffuse: 5.0, group: 2.0, specular: 2.0, evidence: 0.002 };
/// A dielectric's specular albedo lies between 2 and 8 %, which has to outweigh more than the prior of a group: as a deviation beside its evidence.
pub(super) const DIELECTRIC_DEVIATION: f64 = 0.1;
/// What metals reflect, 60 %, and what a group reflects at least that is one, 20 %, in logits.
pub(super) const METAL_LOGIT: f32 = 0.405;
pub(super) const METALLIC_LOGIT: f32 = -1.386;
/// A group that reflects this much, 40 %, in logits, has hardly a diffuse part: 1 %, in logits, and standard deviation from it.
pub(super) const BARE_LOGIT: f32 = -0.405;
const BARE_DIFFUSE: f64 = -4.595;
const BARE_DEVIATION: f64 = 1.0;
/// What surfaces are made of: its share, and mean and standard deviation of its specular albedo in logits. Dielectrics, metals, anything.
const KINDS: [(f64, f32, f64); 3] =
    [(0.75, SPECULAR_LOGIT, 0.7), (0.24, METAL_LOGIT, 0.8), (0.01, SPECULAR_LOGIT, 3.0)];

/// Minus twice the logarithm of the prior of a specular albedo, in logits.
pub(super) fn specular_surprise(logit: f64) -> f64 {
    let density = |(share, mean, deviation): (f64, f32, f64)| {
        share / deviation * (-0.5 * ((logit - f64::from(mean)) / deviation).powi(2)).exp()
    };
    -2.0 * KINDS.into_iter().map(density).sum::<f64>().ln()
}

/// Near a prediction a pixel's diffuse albedo stays what was predicted: a single photo would put its highlight there.
pub(super) const PREDICTED: PriorSigmas = PriorSigmas { diffuse: 0.3, group: 1.0, specular: 1.0, evidence: 0.02 };

/// Gaussian priors on the parameters.
pub(super) struct Prior {
    pub sigmas: PriorSigmas,
    /// Standard deviation of what the model cannot explain in a photo, gamma 2.2 encoded.
    pub photo: f64,
    /// Logits of the diffuse albedo at the start, three planes: its mean.
    pub diffuse: Vec<f32>,
    /// Means of the groups' offsets of specular albedo, as parameters, three times as many as groups.
    pub specular: Vec<f32>,
    /// How much of every pixel is bare metal; empty where none is.
    pub bare: Vec<f32>,
}

/// Where values are pulled to.
#[derive(Clone, Copy)]
enum Mean<'a> {
    /// To 0.
    None,
    /// Each to its own.
    Each(&'a [f32]),
    /// To the same, each as much as it has a share in it.
    Shared(f64, &'a [f32]),
}

impl<'a> Mean<'a> {
    /// That of the values from `begin` on, as many as there are before `end`.
    fn part(self, begin: usize, end: usize) -> Self {
        match self {
            Self::None => Self::None,
            Self::Each(means) => Self::Each(&means[begin..end]),
            Self::Shared(mean, shares) => Self::Shared(mean, &shares[begin..end]),
        }
    }
}

impl Prior {
    /// Minus the logarithm of the priors in the units of the photo loss, whose gradient is added to `gradient`.
    pub(super) fn cost(&self, params: &[f32], layout: Layout, photos: usize, mut gradient: Option<&mut [f32]>) -> f64 {
        let n = layout.pixels;
        // photo_loss is 1000 times a mean of squares; as a negative log likelihood it would be their sum over 2 sigma^2.
        let residuals = (photos * 3 * n) as f64;
        let unit = 1000.0 * 2.0 * self.photo * self.photo / residuals;
        let PriorSigmas { diffuse, group, specular, evidence } = self.sigmas;
        let group_unit = evidence * unit * n as f64 / layout.groups as f64;
        let node_unit = evidence * unit * n as f64 / (anisotropy::NODES * anisotropy::NODES) as f64;
        let (own, groups) = (layout.specular_own(), layout.specular_group());
        // (range, where it is pulled to, by which factor steps are longer, weight)
        let mut terms = vec![
            (0..layout.slope(), Mean::Each(&self.diffuse), 1.0, unit / diffuse.powi(2)),
            (layout.slope()..own, Mean::None, 1.0, unit / SLOPE_DEVIATION.powi(2)),
            (own..groups, Mean::None, 1.0, unit / OWN_DEVIATION.powi(2)),
            (groups..layout.roughness_group(), Mean::Each(&self.specular), GROUP_STEP, group_unit / specular.powi(2)),
            (layout.roughness_group()..layout.tilt(), Mean::None, GROUP_STEP, group_unit / group.powi(2)),
            (layout.tilt()..layout.tilt() + 2, Mean::None, TILT_STEP, unit / TILT_DEVIATION.powi(2)),
            (
                layout.anisotropy_group()..layout.anisotropy_field(),
                Mean::None,
                1.0,
                group_unit / anisotropy::GROUP_DEVIATION.powi(2),
            ),
            (layout.anisotropy_field()..layout.len(), Mean::None, 1.0, node_unit / anisotropy::FIELD_DEVIATION.powi(2)),
        ];
        if !self.bare.is_empty() {
            let mean = Mean::Shared(BARE_DIFFUSE, &self.bare);
            terms.extend((0..3).map(|c| (c * n..(c + 1) * n, mean, 1.0, unit / BARE_DEVIATION.powi(2))));
        }
        let mut total = 0.0;
        if layout.anisotropic {
            let weight = node_unit / anisotropy::NEIGHBOUR_DEVIATION.powi(2);
            let at = |node: usize, i: usize| layout.anisotropy_field() + 2 * node + i;
            for (a, b) in anisotropy::neighbours() {
                for (a, b) in [0, 1].map(|i| (at(a, i), at(b, i))) {
                    let difference = params[a] - params[b];
                    total += 0.5 * weight * f64::from(difference * difference);
                    if let Some(gradient) = gradient.as_deref_mut() {
                        gradient[a] += weight as f32 * difference;
                        gradient[b] -= weight as f32 * difference;
                    }
                }
            }
        }
        for (range, mean, step, weight) in terms {
            let weight = weight * f64::from(step * step);
            let values = params[range.clone()].par_chunks(PART).enumerate();
            let pull = |part: usize, values: &[f32], slopes| {
                let mean = mean.part(part * PART, part * PART + values.len());
                f32::run(Pull { values, mean, weight, slopes })
            };
            let squares: Vec<f64> = match gradient.as_deref_mut() {
                None => values.map(|(part, values)| pull(part, values, None)).collect(),
                Some(gradient) => values
                    .zip(gradient[range].par_chunks_mut(PART))
                    .map(|((part, values), slopes)| pull(part, values, Some(slopes)))
                    .collect(),
            };
            total += 0.5 * weight * squares.iter().sum::<f64>();
        }
        total
    }
}

/// The sum of the squares of `values` off their mean; adds `weight` times how far they are off to `slopes`.
struct Pull<'a> {
    values: &'a [f32],
    mean: Mean<'a>,
    weight: f64,
    slopes: Option<&'a mut [f32]>,
}

impl Kernel<f32> for Pull<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<L: Lanes<Scalar = f32>>(mut self) -> f64 {
        let weight = L::splat(self.weight);
        let mut squares = L::splat(0.0).widen();
        for begin in (0..self.values.len()).step_by(L::LANES) {
            let end = self.values.len().min(begin + L::LANES);
            let value = L::load(&self.values[begin..end]);
            let (off, share) = match self.mean {
                Mean::None => (value, L::splat(1.0)),
                Mean::Each(means) => (value - L::load(&means[begin..end]), L::splat(1.0)),
                Mean::Shared(mean, shares) => (value - L::splat(mean), L::load(&shares[begin..end])),
            };
            squares = (share * off).widen().mul_add(off.widen(), squares);
            if let Some(slopes) = &mut self.slopes {
                let slopes = &mut slopes[begin..end];
                (weight * share).mul_add(off, L::load(slopes)).store(slopes);
            }
        }
        squares.sum()
    }
}

#[cfg(test)]
mod tests {
    use super::specular_surprise;

    #[test]
    fn specular_albedos_are_those_of_dielectrics_or_of_metals() {
        let of = |value: f64| specular_surprise((value / (1.0 - value)).ln());
        assert!(of(0.04) < of(0.02) && of(0.02) < of(0.005));
        assert!(of(0.04) < of(0.6) && of(0.6) < of(0.2) && of(0.6) < of(0.97));
    }
}
