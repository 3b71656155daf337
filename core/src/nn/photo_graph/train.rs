//! The photo graph on the tape: its outputs, and the gradient of a loss of them with respect to every parameter.
//!
//! Photos pass by themselves, each on a tape of its own, up to where they meet: in the messages and in the pooling. dfdx runs operations
//! backwards in the order they were recorded in, on whichever of the merged tapes they came.

use std::collections::BTreeMap;
use std::sync::Arc;

use dfdx::tensor::{Cpu, Merge, OwnedTape};
use rayon::prelude::*;

use super::config::{HINTS, INPUTS, LOG_SIGMA, PhotoGraphConfig, RAW_PLANES};
use super::hints::Hints;
use super::net::{Adapter, FIRST_DIRECTION, Net, bounded_log_sigma, half, halved};
use super::padded;
use super::rounds::{DIRECTIONS, Pooling, Round};
use crate::error::{Error, Result};
use crate::nn::kernels::{add, add_products, add_weighted, dot, softmax, sum};
use crate::nn::layout::Layout;
use crate::nn::nafnet::composed;
use crate::nn::network::Blocks;
use crate::nn::ops::{conv3x3, layer_norm, pixel_shuffle, pointwise, residual, total};
use crate::nn::scalar::{Scalar, kernel, multiply_add};
use crate::nn::tape::{End, Param, Planes, Pool, record};
use crate::nn::weights::broken;

type Tape<E> = OwnedTape<E, Cpu>;
type Traced<E> = Planes<E, Tape<E>>;

/// A photo graph whose parameters' gradients are asked for.
pub(crate) struct Trainable<E: Scalar> {
    config: PhotoGraphConfig,
    net: Net<E>,
    params: BTreeMap<String, Param<E>>,
    pool: Pool<E>,
}

/// What a run of [`Trainable`] gives.
pub(crate) struct Run<E: Scalar> {
    /// Raw maps, (9, H, W).
    pub raw: Vec<E>,
    /// The logarithms of their standard deviations, (9, H, W).
    pub log_sigma: Vec<E>,
    size: (usize, usize),
    layout: Layout,
    end: End<E>,
}

impl<E: Scalar> Trainable<E> {
    /// The network of `tensors`, shared; memory comes from `pool`.
    pub fn new(config: &PhotoGraphConfig, tensors: &BTreeMap<String, Arc<Vec<E>>>, pool: Pool<E>) -> Result<Self> {
        let mut params = BTreeMap::new();
        let net = Net::new(config, &mut |name| {
            let values = tensors.get(name).ok_or_else(|| broken(format!("tensor {name} is missing")))?;
            let param = Param::tracked(values.clone());
            params.insert(name.to_owned(), param.clone());
            Ok(param)
        })?;
        Ok(Self { config: config.clone(), net, params, pool })
    }

    /// Runs the network on `inputs`, the planes of all photos, (N, 13, `height`, `width`). Channel attention averages over the whole picture.
    pub fn run(&self, inputs: &[E], photos: usize, height: usize, width: usize) -> Result<Run<E>> {
        let (net, pool) = (&self.net, &self.pool);
        let planes = INPUTS * height * width;
        if inputs.is_empty() || inputs.len() != photos * planes {
            let expected = format!("{INPUTS} planes of {height} x {width} for each of {photos} photos");
            return Err(Error::shape("inputs", expected, format!("{} values", inputs.len())));
        }
        let layout = padded(&self.config, height, width);
        let mut hints = Hints::new(layout, pool);
        let (mut fine, mut nodes, mut directions) = (Vec::new(), Vec::new(), Vec::new());
        for photo in inputs.chunks_exact(planes) {
            let photo = Planes::pooled(layout.pack(photo, height, width), layout, pool)?;
            hints.add(photo.values());
            directions.push(halved(&photo, FIRST_DIRECTION, DIRECTIONS)?);
            let x = conv3x3(photo.traced_constant(), 1, &net.intro.weight, &net.intro.bias)?;
            let x = through(x, &net.stem)?;
            fine.push(x.branch());
            nodes.push(through(half(x, &net.fold)?, &net.node)?);
        }
        for round in &net.rounds {
            nodes = exchanged(nodes, &directions, round)?;
        }
        let hints = hints.finish(pool)?;
        let coarse = pooled(nodes, &halved(&hints, 0, HINTS)?)?;
        let out = self.restored(pooled(fine, &hints)?, coarse)?;

        let (out, end) = out.cut();
        let mut raw = out.layout.unpack(out.values(), height, width);
        let log_sigma = raw.split_off(RAW_PLANES * height * width);
        Ok(Run { raw, log_sigma, size: (height, width), layout: out.layout, end })
    }

    /// Raw maps and logarithms of standard deviations, one after the other, from pooled features.
    fn restored(&self, fine: Traced<E>, coarse: Traced<E>) -> Result<Traced<E>> {
        let net = &self.net;
        let mut x = pointwise(coarse, &net.entry.weight, Some(&net.entry.bias))?;
        let mut skips = Vec::with_capacity(net.levels.len());
        for level in &net.levels {
            x = through(x, &level.encoder)?;
            skips.push(x.branch());
            x = half(x, &level.down)?;
        }
        x = through(x, &net.middle)?;
        for (level, skip) in net.levels.iter().zip(skips).rev() {
            x = pixel_shuffle(pointwise(x, &level.up, None)?, Some(skip))?;
            x = through(x, &level.decoder)?;
        }
        let fine = pointwise(fine, &net.skip.weight, Some(&net.skip.bias))?;
        x = pixel_shuffle(pointwise(x, &net.unfold, None)?, Some(fine))?;
        x = through(x, &net.tail)?;
        // The certainty learns from the features without changing them.
        let detached = x.branch().split().0.traced_constant();
        let log_sigma = bounded(adapted(detached, &net.certainty)?)?;
        let feature = conv3x3(x, 1, &net.ending.weight, &net.ending.bias)?;
        let raw = net.adapters.iter().map(|adapter| adapted(feature.branch(), adapter));
        let mut outputs = raw.collect::<Result<Vec<_>>>()?;
        outputs.push(log_sigma);
        let (outputs, tape) = gathered(outputs);
        concatenated(outputs, feature.split().1.merge(tape))
    }

    /// Adds the gradient of a loss with respect to every parameter to `sums`, by name, given that with respect to what `run` gave.
    pub fn pull_back(
        &self,
        run: Run<E>,
        d_raw: &[E],
        d_log_sigma: &[E],
        sums: &mut BTreeMap<String, Vec<E>>,
    ) -> Result<()> {
        let (height, width) = run.size;
        for (name, gradient) in [("d_raw", d_raw), ("d_log_sigma", d_log_sigma)] {
            if gradient.len() != RAW_PLANES * height * width {
                let expected = format!("{RAW_PLANES} planes of {height} x {width}");
                return Err(Error::shape(name, expected, format!("{} values", gradient.len())));
            }
        }
        let gradient = run.layout.pack(&[d_raw, d_log_sigma].concat(), height, width);
        let mut pullback = run.end.pull_back(gradient)?;
        for (name, param) in &self.params {
            let Some(gradient) = pullback.of_param(param) else { continue };
            match sums.get_mut(name) {
                Some(sum) => add(sum, &gradient),
                None => drop(sums.insert(name.clone(), gradient)),
            }
        }
        Ok(())
    }
}

fn through<E: Scalar>(x: Traced<E>, blocks: &Blocks<E>) -> Result<Traced<E>> {
    blocks.iter().try_fold(x, |x, block| composed(x, block))
}

fn adapted<E: Scalar>(x: Traced<E>, adapter: &Adapter<E>) -> Result<Traced<E>> {
    conv3x3(composed(x, &adapter.block)?, 1, &adapter.end.weight, &adapter.end.bias)
}

/// The images without their tapes, and these as one.
fn gathered<E: Scalar>(all: Vec<Traced<E>>) -> (Vec<Planes<E>>, Tape<E>) {
    let mut tape = Tape::default();
    let mut split = |x: Traced<E>| {
        let (x, other) = x.split();
        tape = std::mem::take(&mut tape).merge(other);
        x
    };
    let all = all.into_iter().map(&mut split).collect();
    (all, tape)
}

/// The channels of images of one size, one after the other.
fn concatenated<E: Scalar>(parts: Vec<Planes<E>>, tape: Tape<E>) -> Result<Traced<E>> {
    let (first, pool) = (parts[0].layout, parts[0].pool().clone());
    let to = first.with_channels(parts.iter().map(|part| part.layout.channels).sum());
    let mut out = pool.take(to.len());
    out.par_chunks_mut(to.band_len()).enumerate().for_each(|(band, out)| {
        let mut start = 0;
        for part in &parts {
            let from = &part.values()[part.layout.band(band)];
            out[start..start + from.len()].copy_from_slice(from);
            start += from.len();
        }
    });
    let parts: Vec<_> = parts.into_iter().map(|part| (part.slot(), part.layout)).collect();
    let wanted = parts.iter().any(|(slot, _)| slot.is_wanted());
    record(out, to, tape, wanted, move |dy, grads| {
        let mut first = 0;
        for (slot, layout) in parts {
            let channels = first..first + layout.channels;
            first = channels.end;
            slot.add(grads, || {
                let mut dx = pool.take(layout.len());
                let bands = dx.par_chunks_mut(layout.band_len()).enumerate();
                bands.for_each(|(band, dx)| dx.copy_from_slice(&dy[to.part(band, channels.clone())]));
                dx
            })?;
        }
        Ok(())
    })
}

/// Logarithms of standard deviations within their bounds; what was outside of them has no gradient.
fn bounded<E: Scalar>(x: Traced<E>) -> Result<Traced<E>> {
    let layout = x.layout;
    let mut out = x.pool().copy(x.values());
    out.par_iter_mut().for_each(|value| *value = bounded_log_sigma(*value));
    let (x, tape) = x.split();
    let wanted = x.is_wanted();
    record(out, layout, tape, wanted, move |mut dy, grads| {
        let (low, high) = (E::of(LOG_SIGMA[0]), E::of(LOG_SIGMA[1]));
        dy.par_iter_mut().zip(x.values()).for_each(|(dy, &x)| {
            if x < low || x > high {
                *dy = E::default();
            }
        });
        x.add_gradient(grads, || dy)
    })
}

/// Mean, maximum and standard deviation over photos, the `hints`, which have no gradient, and a plane of 1 / photos.
fn pooled<E: Scalar>(photos: Vec<Traced<E>>, hints: &Planes<E>) -> Result<Traced<E>> {
    let (layout, pool) = (photos[0].layout, photos[0].pool().clone());
    let mut pooling = Pooling::new(layout, &pool);
    photos.iter().for_each(|photo| pooling.add(photo.values()));
    let out = pooling.finish(hints)?;
    let to = out.layout;
    let out = out.into_buffer();
    let (photos, tape) = gathered(photos);
    let (kept, wanted) = (pool.copy(&out), photos.iter().any(Planes::is_wanted));
    record(out, to, tape, wanted, move |mut dy, grads| {
        let share = E::of(1.0 / photos.len() as f64);
        dy.par_chunks_mut(to.band_len()).enumerate().for_each(|(band, dy)| {
            let part = layout.band(band);
            let (dmean, rest) = dy.split_at_mut(part.len());
            let (dlargest, rest) = rest.split_at_mut(part.len());
            let kept = &kept[to.part(band, layout.channels..3 * layout.channels)];
            let (largest, spread) = kept.split_at(part.len());
            for (at, (dmean, dlargest)) in dmean.iter_mut().zip(dlargest).enumerate() {
                *dmean *= share;
                let at_largest = |photo: &&Planes<E>| photo.values()[part.start + at] == largest[at];
                *dlargest /= E::of(photos.iter().filter(at_largest).count().max(1) as f64);
                rest[at] *= share / spread[at];
            }
        });
        for photo in &photos {
            photo.add_gradient(grads, || {
                let mut dx = pool.take(layout.len());
                dx.par_chunks_mut(layout.band_len()).enumerate().for_each(|(band, dx)| {
                    let x = &photo.values()[layout.band(band)];
                    let three = to.part(band, 0..3 * layout.channels);
                    pooled_backward(dx, x, &kept[three.clone()], &dy[three]);
                });
                dx
            })?;
        }
        Ok(())
    })
}

kernel! {
    /// The gradient with respect to one photo's `x`: `values` are mean, maximum and deviation, `slopes` the gradients with respect to the mean over the
    /// photos, to the maximum over those that have it, and to the deviation over the photos times the deviation.
    fn pooled_backward<E>(dx: &mut [E], x: &[E], values: &[E], slopes: &[E]) {
        let len = x.len();
        let (mean, rest) = values.split_at(len);
        let (dmean, drest) = slopes.split_at(len);
        let (dlargest, dspread) = drest.split_at(len);
        for i in 0..len {
            let at_largest = if x[i] == rest[i] { dlargest[i] } else { E::default() };
            dx[i] = multiply_add::<E, FUSED>(dspread[i], x[i] - mean[i], dmean[i] + at_largest);
        }
    }
}

/// What a photo gives to the others in a round of messages.
struct Sender<E: Scalar> {
    key: Planes<E>,
    value: Planes<E>,
    directions: Planes<E>,
}

/// The nodes after a round of messages.
fn exchanged<E: Scalar>(nodes: Vec<Traced<E>>, directions: &[Planes<E>], round: &Round<E>) -> Result<Vec<Traced<E>>> {
    let (mut queries, mut keys, mut values) = (Vec::new(), Vec::new(), Vec::new());
    for node in &nodes {
        let x = layer_norm(node.branch(), &round.norm.weight, &round.norm.bias)?;
        queries.push(pointwise(x.branch(), &round.query.weight, Some(&round.query.bias))?);
        keys.push(pointwise(x.branch(), &round.key.weight, Some(&round.key.bias))?);
        values.push(pointwise(x, &round.value.weight, Some(&round.value.bias))?);
    }
    let ((keys, tape), (values, other)) = (gathered(keys), gathered(values));
    // All that leads to keys and values travels with the first node.
    let mut tape = Some(tape.merge(other));
    let senders = keys.into_iter().zip(values).zip(directions);
    let senders: Arc<Vec<_>> = Arc::new(
        senders.map(|((key, value), directions)| Sender { key, value, directions: directions.branch() }).collect(),
    );
    let hear = |(receiver, (node, query)): (usize, (Traced<E>, Traced<E>))| {
        let brought = heard(query, receiver, &senders, round)?;
        let brought = pointwise(brought, &round.out.weight, Some(&round.out.bias))?;
        let (node, own) = residual(node, brought, &round.gain)?.split();
        composed(node.put(own.merge(tape.take().unwrap_or_default())), &round.block)
    };
    nodes.into_iter().zip(queries).enumerate().map(hear).collect()
}

/// The values of all `senders`, weighed as photo `receiver` with its `query` asks for, see [`Round::exchange`].
fn heard<E: Scalar>(
    query: Traced<E>,
    receiver: usize,
    senders: &Arc<Vec<Sender<E>>>,
    round: &Round<E>,
) -> Result<Traced<E>> {
    let (query, tape) = query.split();
    let (pool, layout, heads, count) = (query.pool().clone(), query.layout, round.heads, senders.len());
    let to = senders[receiver].value.layout;
    let edges = layout.with_channels(heads * count);
    let (dim, share) = (layout.channels / heads, to.channels / heads);
    let scale = E::of(1.0 / (dim as f64).sqrt());
    let of_head = move |channels: usize, head: usize| head * channels..(head + 1) * channels;

    let (mut weights, mut out) = (pool.take(edges.len()), pool.zeros(to.len()));
    let bands = weights.par_chunks_mut(edges.band_len()).zip(out.par_chunks_mut(to.band_len()));
    bands.enumerate().for_each(|(band, (weights, out))| {
        let pixels = out.len() / to.channels;
        let (mut largest, mut sums) = (pool.take(pixels), pool.take(pixels));
        let parts = weights.chunks_exact_mut(count * pixels).zip(out.chunks_exact_mut(share * pixels));
        for (head, (weights, out)) in parts.enumerate() {
            let query = &query.values()[layout.part(band, of_head(dim, head))];
            let (pair, own) = (&round.pair.values()[2 * head..], round.own.values()[head]);
            for (sender, logits) in weights.chunks_exact_mut(pixels).enumerate() {
                logits.fill(if sender == receiver { own } else { E::default() });
                let key = &senders[sender].key.values()[layout.part(band, of_head(dim, head))];
                add_products(logits, query, key, scale);
                for (likeness, &weight) in LIKENESSES.into_iter().zip(pair) {
                    let [one, other] = [receiver, sender].map(|photo| likeness.of(&senders[photo], band));
                    add_products(logits, one, other, weight);
                }
            }
            softmax(weights, &mut largest, &mut sums);
            for (sender, weight) in senders.iter().zip(weights.chunks_exact(pixels)) {
                add_weighted(out, &sender.value.values()[to.part(band, of_head(share, head))], weight);
            }
        }
    });

    let (senders, pair, own) = (senders.clone(), round.pair.clone(), round.own.clone());
    record(out, to, tape, true, move |dy, grads| {
        let mut dlogits = pool.zeros(edges.len());
        let bands = dlogits.par_chunks_mut(edges.band_len()).zip(weights.par_chunks(edges.band_len()));
        // Of every band the gradients with respect to `pair`, then to `own`.
        let biases = bands.enumerate().map(|(band, (dlogits, weights))| {
            let pixels = weights.len() / edges.channels;
            let mut along = pool.take(pixels);
            let mut biases = vec![E::default(); 3 * heads];
            let parts = dlogits.chunks_exact_mut(count * pixels).zip(weights.chunks_exact(count * pixels));
            for (head, (dlogits, weights)) in parts.enumerate() {
                let dy = &dy[to.part(band, of_head(share, head))];
                for (sender, dweight) in senders.iter().zip(dlogits.chunks_exact_mut(pixels)) {
                    add_products(dweight, dy, &sender.value.values()[to.part(band, of_head(share, head))], E::ONE);
                }
                softmax_backward(dlogits, weights, &mut along);
                for (sender, dlogits) in dlogits.chunks_exact_mut(pixels).enumerate() {
                    for (which, likeness) in LIKENESSES.into_iter().enumerate() {
                        let [one, other] = [receiver, sender].map(|photo| likeness.of(&senders[photo], band));
                        along.fill(E::default());
                        add_products(&mut along, one, other, E::ONE);
                        biases[2 * head + which] += dot(&along, dlogits);
                    }
                    if sender == receiver {
                        biases[2 * heads + head] += sum(dlogits);
                    }
                    dlogits.iter_mut().for_each(|slope| *slope *= scale);
                }
            }
            biases
        });
        let biases = total(&biases.collect::<Vec<_>>());
        pair.add_gradient(grads, |gradient| add(gradient, &biases[..2 * heads]))?;
        own.add_gradient(grads, |gradient| add(gradient, &biases[2 * heads..]))?;

        query.add_gradient(grads, || {
            let mut dquery = pool.zeros(layout.len());
            dquery.par_chunks_mut(layout.band_len()).enumerate().for_each(|(band, dquery)| {
                let pixels = dquery.len() / layout.channels;
                for (head, dquery) in dquery.chunks_exact_mut(dim * pixels).enumerate() {
                    for (index, sender) in senders.iter().enumerate() {
                        let edge = head * count + index;
                        let key = &sender.key.values()[layout.part(band, of_head(dim, head))];
                        add_weighted(dquery, key, &dlogits[edges.part(band, edge..edge + 1)]);
                    }
                }
            });
            dquery
        })?;
        // `x` of every head times what is on its edge from `sender`.
        let along_edge = |x: &[E], layout: Layout, edge_values: &[E], sender: usize| {
            let mut out = pool.zeros(layout.len());
            out.par_chunks_mut(layout.band_len()).enumerate().for_each(|(band, out)| {
                let channels = layout.channels / heads;
                for (head, out) in out.chunks_exact_mut(out.len() / heads).enumerate() {
                    let edge = head * count + sender;
                    let weight = &edge_values[edges.part(band, edge..edge + 1)];
                    add_weighted(out, &x[layout.part(band, of_head(channels, head))], weight);
                }
            });
            out
        };
        for (index, sender) in senders.iter().enumerate() {
            sender.key.add_gradient(grads, || along_edge(query.values(), layout, &dlogits, index))?;
            sender.value.add_gradient(grads, || along_edge(&dy, to, &weights, index))?;
        }
        Ok(())
    })
}

/// What makes two photos alike, in the order of [`Round::pair`].
#[derive(Clone, Copy)]
enum Likeness {
    HalfVector,
    Light,
}

const LIKENESSES: [Likeness; 2] = [Likeness::HalfVector, Likeness::Light];

impl Likeness {
    /// A photo's directions in band `band`.
    fn of<E: Scalar>(self, photo: &Sender<E>, band: usize) -> &[E] {
        let channels = match self {
            Self::Light => 0..3,
            Self::HalfVector => 3..6,
        };
        &photo.directions.values()[photo.directions.layout.part(band, channels)]
    }
}

kernel! {
    /// Turns `slopes`, the gradient with respect to the `weights` that a softmax over rows gave, into that with respect to its input; `along` has room
    /// for one row.
    fn softmax_backward<E>(slopes: &mut [E], weights: &[E], along: &mut [E]) {
        let pixels = along.len();
        along.fill(E::default());
        for (slopes, weights) in slopes.chunks_exact(pixels).zip(weights.chunks_exact(pixels)) {
            for ((along, &slope), &weight) in along.iter_mut().zip(slopes).zip(weights) {
                *along = multiply_add::<E, FUSED>(slope, weight, *along);
            }
        }
        for (slopes, weights) in slopes.chunks_exact_mut(pixels).zip(weights.chunks_exact(pixels)) {
            for ((slope, &weight), &along) in slopes.iter_mut().zip(weights).zip(&*along) {
                *slope = weight * (*slope - along);
            }
        }
    }
}
