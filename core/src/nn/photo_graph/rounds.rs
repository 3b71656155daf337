//! What happens between photos: rounds of messages, and pooling.

use rayon::prelude::*;

use super::config::{HINTS, PhotoGraphConfig, SPREAD_EPSILON};
use crate::error::Result;
use crate::nn::kernels::{add_products, add_scaled, add_weighted, deviation, norm, softmax, take_in};
use crate::nn::layout::Layout;
use crate::nn::nafnet::{Block, Layer, linear};
use crate::nn::network::{Source, layer};
use crate::nn::scalar::Scalar;
use crate::nn::tape::{Buffer, Param, Planes, Pool};

/// Planes of a photo's directions: to the light, half vector.
pub(super) const DIRECTIONS: usize = 6;

/// One round of messages between the photos, and the block that each passes through after it.
pub(super) struct Round<E: Scalar> {
    pub heads: usize,
    pub norm: Layer<E>,
    pub query: Layer<E>,
    pub key: Layer<E>,
    pub value: Layer<E>,
    pub out: Layer<E>,
    /// Weights of the likeness of half vectors and of light directions, (heads, 2).
    pub pair: Param<E>,
    /// Added to a head's edges from a photo to itself.
    pub own: Param<E>,
    pub gain: Param<E>,
    pub block: Block<E>,
}

/// A photo at half resolution.
pub(super) struct Node<E: Scalar> {
    /// Features, in the layout of all nodes.
    pub features: Buffer<E>,
    /// Directions, in the same layout with [`DIRECTIONS`] channels.
    pub directions: Buffer<E>,
}

impl<E: Scalar> Round<E> {
    /// The round `name` of a network.
    pub fn new(config: &PhotoGraphConfig, get: &mut Source<'_, E>, name: &str) -> Result<Self> {
        let mut of = |part: &str| layer(get, &format!("{name}.{part}"));
        let (norm, query, key, value, out) = (of("norm")?, of("query")?, of("key")?, of("value")?, of("out")?);
        let mut single = |part: &str| get(&format!("{name}.{part}"));
        let (pair, own, gain) = (single("pair")?, single("loop")?, single("gain")?);
        let block = Block::new(config.node, |tensor| get(&format!("{name}.block.{tensor}")))?;
        Ok(Self { heads: config.heads, norm, query, key, value, out, pair, own, gain, block })
    }

    /// Adds to the features of every node what it hears from all; `layout` is that of the features.
    ///
    /// Per pixel and head: a softmax over the senders j of `q_i . k_j / sqrt(dim) + pair . (h_i . h_j, l_i . l_j) + [i = j] own` weighs their values.
    pub fn exchange(&self, nodes: &mut [Node<E>], layout: Layout, pool: &Pool<E>) {
        let len = layout.band_len();
        // For each band the parts of all nodes.
        let mut bands: Vec<Vec<Part<'_, E>>> = (0..layout.bands()).map(|_| Vec::with_capacity(nodes.len())).collect();
        for Node { features, directions } in nodes {
            let directions = directions.chunks(DIRECTIONS * (len / layout.channels));
            for ((band, features), directions) in bands.iter_mut().zip(features.chunks_mut(len)).zip(directions) {
                band.push(Part { features, directions });
            }
        }
        bands.into_par_iter().for_each(|mut parts| self.exchange_band(&mut parts, layout.channels, pool));
    }

    fn exchange_band(&self, parts: &mut [Part<'_, E>], channels: usize, pool: &Pool<E>) {
        let (count, pixels) = (parts.len(), parts[0].features.len() / channels);
        let (heads, inner) = (self.heads, self.query.bias.values().len());
        let mut normal = pool.take(channels * pixels);
        let mut queries = pool.take(count * inner * pixels);
        let mut keys = pool.take(count * inner * pixels);
        let mut values = pool.take(count * channels * pixels);
        for (photo, part) in parts.iter().enumerate() {
            norm(&mut normal, part.features, self.norm.weight.values(), self.norm.bias.values());
            let of = |width: usize| photo * width * pixels..(photo + 1) * width * pixels;
            linear(&mut queries[of(inner)], &self.query, &normal, channels);
            linear(&mut keys[of(inner)], &self.key, &normal, channels);
            linear(&mut values[of(channels)], &self.value, &normal, channels);
        }

        let (dim, share) = (inner / heads, channels / heads);
        let scale = E::splat(1.0 / (dim as f64).sqrt());
        let mut logits = pool.take(count * pixels);
        let (mut largest, mut sums) = (pool.take(pixels), pool.take(pixels));
        let mut brought = pool.take(channels * pixels);
        for receiver in 0..count {
            brought.fill(E::default());
            for head in 0..heads {
                let of =
                    |photo: usize| (photo * inner + head * dim) * pixels..(photo * inner + (head + 1) * dim) * pixels;
                let (pair, own) = (&self.pair.values()[2 * head..], self.own.values()[head]);
                let (light, half) = parts[receiver].directions.split_at(3 * pixels);
                for (sender, logits) in logits.chunks_exact_mut(pixels).enumerate() {
                    logits.fill(if sender == receiver { own } else { E::default() });
                    add_products(logits, &queries[of(receiver)], &keys[of(sender)], scale);
                    let (other_light, other_half) = parts[sender].directions.split_at(3 * pixels);
                    add_products(logits, half, other_half, pair[0]);
                    add_products(logits, light, other_light, pair[1]);
                }
                softmax(&mut logits, &mut largest, &mut sums);
                let to = &mut brought[head * share * pixels..(head + 1) * share * pixels];
                for (sender, weight) in logits.chunks_exact(pixels).enumerate() {
                    let start = (sender * channels + head * share) * pixels;
                    add_weighted(to, &values[start..start + share * pixels], weight);
                }
            }
            linear(&mut normal, &self.out, &brought, channels);
            add_scaled(parts[receiver].features, &normal, self.gain.values());
        }
    }
}

/// A band of a node.
struct Part<'a, E> {
    features: &'a mut [E],
    directions: &'a [E],
}

/// Mean, maximum and standard deviation of features over photos, taken in one after the other; then the hints, and a plane of 1 / photos.
pub(super) struct Pooling<E: Scalar> {
    /// The layout of the features.
    layout: Layout,
    values: Buffer<E>,
    photos: usize,
}

impl<E: Scalar> Pooling<E> {
    /// Of no photos yet, with features in `layout`.
    pub fn new(layout: Layout, pool: &Pool<E>) -> Self {
        Self { layout, values: pool.take(Self::layout(layout).len()), photos: 0 }
    }

    fn layout(features: Layout) -> Layout {
        features.with_channels(3 * features.channels + HINTS + 1)
    }

    /// Takes in the features of one more photo.
    pub fn add(&mut self, features: &[E]) {
        self.photos += 1;
        let (first, share) = (self.photos == 1, E::splat(1.0 / self.photos as f64));
        let bands = self.values.par_chunks_mut(Self::layout(self.layout).band_len());
        bands.zip(features.par_chunks(self.layout.band_len())).for_each(|(band, x)| {
            let (mean, rest) = band.split_at_mut(x.len());
            let (largest, rest) = rest.split_at_mut(x.len());
            let squares = &mut rest[..x.len()];
            if first {
                mean.copy_from_slice(x);
                largest.copy_from_slice(x);
                squares.fill(E::default());
            } else {
                take_in(mean, largest, squares, x, share);
            }
        });
    }

    /// What the photos amount to, with their `hints` ([`HINTS`], H, W): (3 C + [`HINTS`] + 1, H, W).
    pub fn finish(mut self, hints: &Planes<E>) -> Result<Planes<E>> {
        let (to, channels) = (Self::layout(self.layout), self.layout.channels);
        let share = E::splat(1.0 / self.photos as f64);
        let hints = hints.values().par_chunks(to.with_channels(HINTS).band_len());
        self.values.par_chunks_mut(to.band_len()).zip(hints).for_each(|(band, hints)| {
            let pixels = band.len() / to.channels;
            deviation(&mut band[2 * channels * pixels..3 * channels * pixels], share, E::splat(SPREAD_EPSILON));
            let (before, last) = band[3 * channels * pixels..].split_at_mut(hints.len());
            before.copy_from_slice(hints);
            last.fill(share);
        });
        Planes::of(self.values, to)
    }
}

#[cfg(test)]
mod tests {
    use super::Pooling;
    use crate::nn::layout::Layout;
    use crate::nn::ops::testing::{compare, numbers};
    use crate::nn::photo_graph::config::HINTS;
    use crate::nn::tape::{Planes, Pool};

    #[test]
    fn pooling_is_what_the_definition_says() {
        let layout = Layout { channels: 3, height: 20, width: 40 };
        for photos in [1, 2, 7] {
            let all: Vec<Vec<f64>> = (0..photos).map(|photo| numbers(layout.len(), photo as u64)).collect();
            let mut pooling = Pooling::new(layout, &Pool::default());
            all.iter().for_each(|x| pooling.add(&layout.pack(x, 20, 40)));
            let to = layout.with_channels(HINTS);
            let hints = numbers(to.len(), 99);
            let packed = Planes::constant(to.pack(&hints, 20, 40), to).unwrap();
            let got = pooling.finish(&packed).unwrap();
            let of = |f: &dyn Fn(&[f64]) -> f64| -> Vec<f64> {
                (0..layout.len()).map(|at| f(&all.iter().map(|x| x[at]).collect::<Vec<_>>())).collect()
            };
            let n = photos as f64;
            let mean = |x: &[f64]| x.iter().sum::<f64>() / n;
            let spread = |x: &[f64]| (x.iter().map(|v| (v - mean(x)).powi(2)).sum::<f64>() / n + 1e-4).sqrt();
            let largest = |x: &[f64]| x.iter().fold(f64::NEG_INFINITY, |a, &b| a.max(b));
            let expected = [of(&mean), of(&largest), of(&spread), hints, vec![1.0 / n; 800]].concat();
            compare(&got.layout.unpack(got.values(), 20, 40), &expected, 1e-12, "pooled");
        }
    }
}
