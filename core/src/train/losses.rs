//! The training loss: maps, re-renderings, certainty; and its gradient with respect to what the network gives.

use std::f64::consts::FRAC_PI_2;
use std::ops::Range;

use rayon::prelude::*;

use super::batch::Example;
use super::config::LossSettings;
use crate::brdf::real::Real;
use crate::error::{Error, Result};
use crate::maps::{Lobe, Maps};
use crate::nn::{Decoding, Scalar};
use crate::render::rendering_loss;

const GAMMA: f64 = 2.2;
/// Raw planes and planes of the maps.
const RAW: usize = 9;
const MAPS: usize = 10;
/// Width of the patch in the unit of the views.
const PATCH_SIZE: f64 = 2.0;
/// Raw planes of diffuse albedo, normal, roughness, specular albedo.
const GROUPS: [Range<usize>; 4] = [0..3, 3..5, 5..6, 6..9];
const NORMAL: usize = 1;
const ROUGHNESS: usize = 2;

/// The total and its parts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Losses {
    /// The weighted sum of `maps`, `rendering` and `certainty`.
    pub loss: f64,
    /// Mean of the errors of the four maps.
    pub maps: f64,
    /// Mean absolute difference of compressed renderings.
    pub rendering: f64,
    /// Negative logarithm of the likelihood of the errors, up to a constant.
    pub certainty: f64,
    /// Mean absolute errors of raw planes in units of the encoded maps: diffuse albedo, normal, roughness, specular albedo.
    pub groups: [f64; 4],
}

impl Losses {
    /// Adds `share` times `other`.
    pub fn add(&mut self, other: &Self, share: f64) {
        let pairs = [
            (&mut self.loss, other.loss),
            (&mut self.maps, other.maps),
            (&mut self.rendering, other.rendering),
            (&mut self.certainty, other.certainty),
        ];
        for (sum, value) in pairs.into_iter().chain(self.groups.iter_mut().zip(other.groups)) {
            *sum += share * value;
        }
    }
}

/// The gradient with respect to what the network gave: raw planes and logarithms of standard deviations, (9, H, W) each.
pub(crate) struct Slopes<E> {
    pub raw: Vec<E>,
    pub log_sigma: Vec<E>,
}

/// How far the network's outputs are from the truth.
pub(crate) struct Criterion<'a> {
    pub settings: &'a LossSettings,
    /// Raw roughness below this decodes as this.
    pub roughness_floor: f64,
}

impl Criterion<'_> {
    /// The losses of `raw` planes and logarithms of standard deviations for one `example` of `height` x `width` pixels, and the gradient of their weighted sum.
    ///
    /// Maps: the mean absolute difference of raw planes, albedos and roughness over 2, first within each map. Renderings: as [`rendering_loss`].
    /// Certainty: Laplace's likelihood of errors e whose mean is sqrt(2 / pi) sigma, as for a Gaussian, so that sigma covers about two thirds: the mean of
    /// `e sqrt(pi / 2) / sigma + ln sigma`; e are the errors of raw planes within their ranges, and have no gradient here.
    pub fn losses<E: Real + Scalar>(
        &self,
        raw: &[E],
        log_sigma: &[E],
        example: &Example,
        height: usize,
        width: usize,
    ) -> Result<(Losses, Slopes<E>)> {
        let pixels = height * width;
        if example.maps.len() != MAPS * pixels {
            let expected = format!("{MAPS} planes of {height} x {width}");
            return Err(Error::shape("maps", expected, format!("{} values", example.maps.len())));
        }
        let mut d_raw = vec![E::default(); RAW * pixels];
        let mut d_log_sigma = vec![E::default(); RAW * pixels];
        let planes = d_raw.par_chunks_mut(pixels).zip(d_log_sigma.par_chunks_mut(pixels));
        let planes = planes.zip(raw.par_chunks(pixels).zip(log_sigma.par_chunks(pixels)));
        let sums: Vec<[f64; 2]> = planes
            .enumerate()
            .map(|(plane, ((d_raw, d_log_sigma), (raw, log_sigma)))| {
                let plane = Plane::new(plane, pixels, self);
                plane.losses(&example.maps[plane.map * pixels..][..pixels], raw, log_sigma, d_raw, d_log_sigma)
            })
            .collect();

        let mut losses = Losses::default();
        for (of_group, group) in losses.groups.iter_mut().zip(GROUPS) {
            *of_group = sums[group.clone()].iter().map(|sum| sum[0]).sum::<f64>() / (group.len() * pixels) as f64;
        }
        losses.maps = losses.groups.iter().sum::<f64>() / GROUPS.len() as f64;
        losses.certainty = sums.iter().map(|sum| sum[1]).sum::<f64>() / (RAW * pixels) as f64;
        losses.rendering = self.rendering(raw, example, height, width, &mut d_raw)?;
        let LossSettings { maps, rendering, certainty, .. } = *self.settings;
        losses.loss = maps * losses.maps + rendering * losses.rendering + certainty * losses.certainty;
        Ok((losses, Slopes { raw: d_raw, log_sigma: d_log_sigma }))
    }

    /// The loss of the renderings; its weighted gradient is added to `d_raw`.
    fn rendering<E: Real + Scalar>(
        &self,
        raw: &[E],
        example: &Example,
        height: usize,
        width: usize,
        d_raw: &mut [E],
    ) -> Result<f64> {
        let decoding = Decoding::new(Lobe::Isotropic).with_roughness_floor(self.roughness_floor)?;
        let truth = example.maps.iter().map(|&value| <E as Scalar>::of(f64::from(value))).collect();
        let truth = Maps::new(Lobe::Isotropic, width, height, truth)?;
        let mut predicted = truth.clone();
        decoding.decode(raw, &mut predicted)?;
        let mut d_maps = truth.clone();
        let loss = rendering_loss(&predicted, &truth, PATCH_SIZE, &example.views, &mut d_maps)?;
        let mut by_raw = vec![E::default(); raw.len()];
        decoding.backward(raw, &d_maps, &mut by_raw)?;
        let weight = <E as Scalar>::of(self.settings.rendering);
        d_raw.par_iter_mut().zip(&by_raw).for_each(|(sum, &slope)| *sum += slope * weight);
        Ok(loss)
    }
}

/// What the losses of maps and certainty need to know of a raw plane.
struct Plane {
    /// The plane of the maps that it encodes.
    map: usize,
    is_normal: bool,
    /// Bounds within which raw values count, for the certainty.
    bounds: [f64; 2],
    /// Of raw values in those of the encoded map.
    unit: f64,
    /// Weights of an absolute error, and of a pixel's certainty, in the total.
    weights: [f64; 2],
}

impl Plane {
    fn new(plane: usize, pixels: usize, criterion: &Criterion<'_>) -> Self {
        let group = GROUPS.iter().position(|group| group.contains(&plane)).unwrap_or(0);
        let of_group = (GROUPS.len() * GROUPS[group].len() * pixels) as f64;
        let settings = criterion.settings;
        Self {
            // The normal's z is not encoded.
            map: if group > NORMAL { plane + 1 } else { plane },
            is_normal: group == NORMAL,
            bounds: match group {
                NORMAL => [f64::NEG_INFINITY, f64::INFINITY],
                ROUGHNESS => [criterion.roughness_floor, 1.0],
                _ => [-1.0, 1.0],
            },
            unit: if group == NORMAL { 1.0 } else { 0.5 },
            weights: [settings.maps / of_group, settings.certainty / (RAW * pixels) as f64],
        }
    }

    /// The sums of absolute errors and of certainty's terms over pixels; the weighted gradients are written to `d_raw` and `d_log_sigma`.
    fn losses<E: Scalar>(
        &self,
        map: &[f32],
        raw: &[E],
        log_sigma: &[E],
        d_raw: &mut [E],
        d_log_sigma: &mut [E],
    ) -> [f64; 2] {
        let mut sums = [0.0; 2];
        let inputs = map.iter().zip(raw.iter().zip(log_sigma));
        for ((&map, (raw, log_sigma)), (d_raw, d_log_sigma)) in inputs.zip(d_raw.iter_mut().zip(d_log_sigma)) {
            let (raw, log_sigma) = (raw.wide(), log_sigma.wide());
            let target = self.encoded(map.into());
            let error = (raw - target) * self.unit;
            sums[0] += error.abs();
            let sign = if error > 0.0 {
                1.0
            } else if error < 0.0 {
                -1.0
            } else {
                0.0
            };
            *d_raw = E::of(sign * self.unit * self.weights[0]);

            let error = (raw.clamp(self.bounds[0], self.bounds[1]) - target).abs() * self.unit;
            let deviations = error * FRAC_PI_2.sqrt() * (-log_sigma).exp();
            sums[1] += deviations + log_sigma;
            *d_log_sigma = E::of((1.0 - deviations) * self.weights[1]);
        }
        sums
    }

    /// The raw value that decodes to `value`.
    fn encoded(&self, value: f64) -> f64 {
        if self.is_normal { value } else { 2.0 * value.clamp(0.0, 1.0).powf(1.0 / GAMMA) - 1.0 }
    }
}
