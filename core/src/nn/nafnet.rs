//! The NAFNet block (Chen et al., "Simple Baselines for Image Restoration", ECCV 2022, fig. 2; paper, section 3.2).

use std::sync::Arc;

use dfdx::tensor::{Cpu, Tape};
use rayon::prelude::*;

use super::kernels::{add_scaled, dot, fill, gate, gate_backward, norm, norm_backward, scale, scale_shift, sum, times};
use super::layout::Layout;
use super::matrix::{Matrix, multiply};
use super::ops::{self, depthwise_band, pooled_gradient, taps, total, turned};
use super::scalar::Scalar;
use super::tape::{Buffer, Param, Planes, Pool, record};
use crate::error::Result;

/// Weight and bias of one of the block's layers.
#[derive(Clone)]
pub(crate) struct Layer<E: Scalar> {
    pub weight: Param<E>,
    pub bias: Param<E>,
}

/// The parameters of a block on `channels` channels; the names are those of the released code.
#[derive(Clone)]
pub(crate) struct Block<E: Scalar> {
    pub channels: usize,
    pub norm1: Layer<E>,
    pub conv1: Layer<E>,
    pub conv2: Layer<E>,
    pub sca: Layer<E>,
    pub conv3: Layer<E>,
    pub beta: Param<E>,
    pub norm2: Layer<E>,
    pub conv4: Layer<E>,
    pub conv5: Layer<E>,
    pub gamma: Param<E>,
}

impl<E: Scalar> Block<E> {
    /// A block on `channels` channels whose parameters `get` gives by name.
    pub fn new(channels: usize, mut get: impl FnMut(&str) -> Result<Param<E>>) -> Result<Self> {
        let mut layer = |name: &str| -> Result<Layer<E>> {
            Ok(Layer { weight: get(&format!("{name}.weight"))?, bias: get(&format!("{name}.bias"))? })
        };
        let (norm1, conv1, conv2, sca) = (layer("norm1")?, layer("conv1")?, layer("conv2")?, layer("sca.1")?);
        let (conv3, norm2, conv4, conv5) = (layer("conv3")?, layer("norm2")?, layer("conv4")?, layer("conv5")?);
        let (beta, gamma) = (get("beta")?, get("gamma")?);
        Ok(Self { channels, norm1, conv1, conv2, sca, conv3, beta, norm2, conv4, conv5, gamma })
    }

    fn is_tracked(&self) -> bool {
        let layers =
            [&self.norm1, &self.conv1, &self.conv2, &self.sca, &self.conv3, &self.norm2, &self.conv4, &self.conv5];
        layers.iter().any(|layer| layer.weight.is_tracked() || layer.bias.is_tracked())
            || self.beta.is_tracked()
            || self.gamma.is_tracked()
    }
}

/// The block as one operation. The gradients of its parameters, where one is asked for, come from [`composed`].
pub(crate) fn block<E: Scalar, T: Tape<E, Cpu>>(x: Planes<E, T>, block: &Arc<Block<E>>) -> Result<Planes<E, T>> {
    if T::OWNS_TAPE && block.is_tracked() {
        return composed(x, block);
    }
    check_channels(block, x.layout)?;
    let (layout, records) = (x.layout, x.records());
    let purpose = if records { Purpose::Gradient } else { Purpose::Value { window: None } };
    let (out, kept) = forward(block, layout, x.values(), x.pool(), purpose);
    let (x, tape) = x.split();
    let block = block.clone();
    record(out, layout, tape, records, move |dy, grads| {
        let Some(kept) = kept else { return Ok(()) };
        x.add_gradient(grads, || kept.backward(&block, layout, x.values(), x.pool(), dy))
    })
}

/// The block without gradient, its channel attention averaging over windows of `window` pixels (see [`ops::window_means`]), or over all pixels
/// where one window covers them or there is none.
pub(crate) fn block_within<E: Scalar>(x: Planes<E>, block: &Block<E>, window: Option<usize>) -> Result<Planes<E>> {
    check_channels(block, x.layout)?;
    Planes::of(forward(block, x.layout, x.values(), x.pool(), Purpose::Value { window }).0, x.layout)
}

fn check_channels<E: Scalar>(block: &Block<E>, layout: Layout) -> Result<()> {
    if layout.channels == block.channels {
        return Ok(());
    }
    let expected = format!("{} channels", block.channels);
    Err(crate::error::Error::shape("block", expected, layout.channels.to_string()))
}

/// What a block is run for.
#[derive(Clone, Copy, PartialEq)]
enum Purpose {
    /// Its gradient too.
    Gradient,
    /// Its value alone, channel attention averaging over windows of so many pixels.
    Value { window: Option<usize> },
}

/// What channel attention multiplies with.
enum Attention<E: Scalar> {
    /// One factor for each channel.
    Factors(Vec<E>),
    /// The means that make the factors of every pixel.
    Means(Buffer<E>),
}

/// The block, operation by operation.
pub(crate) fn composed<E: Scalar, T: Tape<E, Cpu>>(x: Planes<E, T>, block: &Block<E>) -> Result<Planes<E, T>> {
    let branch = ops::layer_norm(x.branch(), &block.norm1.weight, &block.norm1.bias)?;
    let branch = ops::pointwise(branch, &block.conv1.weight, Some(&block.conv1.bias))?;
    let branch = ops::depthwise3x3(branch, &block.conv2.weight, &block.conv2.bias)?;
    let branch = ops::simple_gate(branch)?;
    let branch = ops::channel_attention(branch, &block.sca.weight, &block.sca.bias)?;
    let branch = ops::pointwise(branch, &block.conv3.weight, Some(&block.conv3.bias))?;
    let y = ops::residual(x, branch, &block.beta)?;
    let branch = ops::layer_norm(y.branch(), &block.norm2.weight, &block.norm2.bias)?;
    let branch = ops::pointwise(branch, &block.conv4.weight, Some(&block.conv4.bias))?;
    let branch = ops::simple_gate(branch)?;
    let branch = ops::pointwise(branch, &block.conv5.weight, Some(&block.conv5.bias))?;
    ops::residual(y, branch, &block.gamma)
}

/// Channels up to which the input of the second gate is computed again on the way back instead of being kept: there one more
/// matrix product costs no more than writing and reading the values.
const RECOMPUTED_CHANNELS: usize = 128;

/// What a block keeps for the way back, beside its input.
struct Kept<E: Scalar> {
    /// Output of the depthwise convolution, 2c channels.
    gate1: Buffer<E>,
    /// Factors of the channel attention.
    factor: Vec<E>,
    /// Between the two halves of the block.
    middle: Buffer<E>,
    /// Output of conv4, 2c channels, unless it is recomputed.
    gate2: Option<Buffer<E>>,
}

/// `bands` mutable pieces of `len` values each (the last may be shorter) of a buffer that may not be there.
fn pieces<E: Scalar>(buffer: Option<&mut Buffer<E>>, len: usize, bands: usize) -> Vec<Option<&mut [E]>> {
    match buffer {
        Some(buffer) => buffer.chunks_mut(len).map(Some).collect(),
        None => (0..bands).map(|_| None).collect(),
    }
}

/// `out = weight x + bias` for a band.
pub(crate) fn linear<E: Scalar>(out: &mut [E], layer: &Layer<E>, x: &[E], channels: usize) {
    let (pixels, outputs) = (x.len() / channels, layer.bias.values().len());
    fill(out, outputs, Some(layer.bias.values()));
    multiply(out, true, Matrix::new(layer.weight.values(), outputs, channels), Matrix::new(x, channels, pixels));
}

/// `out = weight^T dy` for a band.
fn linear_backward<E: Scalar>(out: &mut [E], layer: &Layer<E>, dy: &[E], channels: usize) {
    let outputs = layer.bias.values().len();
    let weight = Matrix::new(layer.weight.values(), outputs, channels).transposed();
    multiply(out, false, weight, Matrix::new(dy, outputs, dy.len() / outputs));
}

/// The second half's input to its gate, from a band between the halves.
fn second_gate_input<E: Scalar>(out: &mut [E], block: &Block<E>, middle: &[E], normal: &mut [E]) {
    norm(normal, middle, block.norm2.weight.values(), block.norm2.bias.values());
    linear(out, &block.conv4, normal, block.channels);
}

/// The block's output, and what [`Kept::backward`] needs if it is run for its gradient.
fn forward<E: Scalar>(
    block: &Block<E>,
    layout: Layout,
    x: &[E],
    pool: &Pool<E>,
    purpose: Purpose,
) -> (Buffer<E>, Option<Kept<E>>) {
    let keep = purpose == Purpose::Gradient;
    let (c, bands) = (block.channels, layout.bands());
    let (single, double) = (layout.band_len(), 2 * layout.band_len());
    let wide = layout.with_channels(2 * c);

    let mut expanded = pool.take(wide.len());
    expanded.par_chunks_mut(double).zip(x.par_chunks(single)).for_each(|(expanded, x)| {
        let mut normal = pool.take(x.len());
        norm(&mut normal, x, block.norm1.weight.values(), block.norm1.bias.values());
        linear(expanded, &block.conv1, &normal, c);
    });

    let mut gate1 = keep.then(|| pool.take(wide.len()));
    let mut gated = pool.take(layout.len());
    let sums: Vec<Vec<E>> = pieces(gate1.as_mut(), double, bands)
        .into_par_iter()
        .zip(gated.par_chunks_mut(single))
        .enumerate()
        .map(|(band, (kept, gated))| {
            let mut local = kept.is_none().then(|| pool.take(2 * gated.len()));
            let input = kept.or(local.as_deref_mut()).unwrap_or_default();
            let conv2 = &block.conv2;
            depthwise_band(input, &expanded, wide, band, |k| (taps(conv2.weight.values(), k), conv2.bias.values()[k]));
            gate(gated, input);
            gated.chunks_exact(gated.len() / c).map(sum).collect()
        })
        .collect();
    drop(expanded);
    let attention = match purpose {
        Purpose::Value { window: Some(window) } if window < layout.height.max(layout.width) => {
            Attention::Means(ops::window_means(&gated, layout, window, pool))
        }
        _ => {
            let mut mean = total(&sums);
            mean.iter_mut().for_each(|mean| *mean *= E::splat(1.0 / layout.pixels() as f64));
            Attention::Factors(ops::affine(block.sca.weight.values(), &mean, block.sca.bias.values()))
        }
    };

    let mut out = pool.take(layout.len());
    let mut middle = keep.then(|| pool.take(layout.len()));
    let mut gate2 = (keep && c > RECOMPUTED_CHANNELS).then(|| pool.take(wide.len()));
    pieces(middle.as_mut(), single, bands)
        .into_par_iter()
        .zip(pieces(gate2.as_mut(), double, bands))
        .zip(out.par_chunks_mut(single).zip(x.par_chunks(single)).zip(gated.par_chunks_mut(single)))
        .enumerate()
        .for_each(|(band, ((middle, gate2), ((out, x), gated)))| {
            let mut narrow = pool.take(x.len());
            match &attention {
                Attention::Factors(factors) => scale(&mut narrow, gated, factors),
                Attention::Means(means) => {
                    linear(&mut narrow, &block.sca, &means[band * single..][..x.len()], c);
                    times(&mut narrow, gated);
                }
            }
            linear(gated, &block.conv3, &narrow, c);
            out.copy_from_slice(x);
            add_scaled(out, gated, block.beta.values());
            if let Some(middle) = middle {
                middle.copy_from_slice(out);
            }
            let mut local = gate2.is_none().then(|| pool.take(2 * x.len()));
            let input = gate2.or(local.as_deref_mut()).unwrap_or_default();
            second_gate_input(input, block, out, &mut narrow);
            gate(gated, input);
            linear(&mut narrow, &block.conv5, gated, c);
            add_scaled(out, &narrow, block.gamma.values());
        });
    let kept = match (gate1, middle, attention) {
        (Some(gate1), Some(middle), Attention::Factors(factor)) => Some(Kept { gate1, factor, middle, gate2 }),
        _ => None,
    };
    (out, kept)
}

impl<E: Scalar> Kept<E> {
    /// Turns `dy`, the gradient with respect to the block's output, into that with respect to its input `x`.
    fn backward(self, block: &Block<E>, layout: Layout, x: &[E], pool: &Pool<E>, mut dy: Buffer<E>) -> Buffer<E> {
        let (c, bands) = (block.channels, layout.bands());
        let (single, double) = (layout.band_len(), 2 * layout.band_len());
        let wide = layout.with_channels(2 * c);
        let Self { mut gate1, factor, middle, mut gate2 } = self;

        // The second half turns `dy` into the gradient between the halves; `dgated` is that with respect to the first gate's
        // output, as far as it does not come through the factors.
        let mut dgated = pool.take(layout.len());
        let dfactors: Vec<Vec<E>> = pieces(gate2.as_mut(), double, bands)
            .into_par_iter()
            .zip(dy.par_chunks_mut(single).zip(dgated.par_chunks_mut(single)))
            .zip(middle.par_chunks(single).zip(gate1.par_chunks(double)))
            .map(|((gate2, (dy, dgated)), (middle, gate1))| {
                let mut narrow = pool.take(dy.len());
                let mut local = gate2.is_none().then(|| pool.take(2 * dy.len()));
                if let Some(local) = &mut local {
                    second_gate_input(local, block, middle, &mut narrow);
                }
                let input = gate2.or(local.as_deref_mut()).unwrap_or_default();
                scale(&mut narrow, dy, block.gamma.values());
                linear_backward(dgated, &block.conv5, &narrow, c);
                gate_backward(input, dgated);
                linear_backward(&mut narrow, &block.conv4, input, c);
                norm_backward(dy, &narrow, middle, block.norm2.weight.values());
                scale(&mut narrow, dy, block.beta.values());
                linear_backward(dgated, &block.conv3, &narrow, c);
                gate(&mut narrow, gate1);
                let pixels = dy.len() / c;
                narrow.chunks_exact(pixels).zip(dgated.chunks_exact(pixels)).map(|(g, d)| dot(g, d)).collect()
            })
            .collect();
        drop((middle, gate2));
        let share = pooled_gradient(block.sca.weight.values(), &total(&dfactors), layout.pixels());

        gate1.par_chunks_mut(double).zip(dgated.par_chunks_mut(single)).for_each(|(gate1, dgated)| {
            scale_shift(dgated, &factor, &share);
            gate_backward(gate1, dgated);
        });
        drop(dgated);

        // The residual connection passes `dy` on as it is.
        dy.par_chunks_mut(single).zip(x.par_chunks(single)).enumerate().for_each(|(band, (dy, x))| {
            let mut expanded = pool.take(2 * dy.len());
            let weight = block.conv2.weight.values();
            depthwise_band(&mut expanded, &gate1, wide, band, |k| (turned(weight, k), E::default()));
            let mut normal = pool.take(dy.len());
            linear_backward(&mut normal, &block.conv1, &expanded, c);
            norm_backward(dy, &normal, x, block.norm1.weight.values());
        });
        dy
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::{Block, block, block_within, composed};
    use crate::nn::layout::Layout;
    use crate::nn::ops::testing::{check, compare, numbers};
    use crate::nn::params::block_tensors;
    use crate::nn::tape::{Param, Planes};

    fn random(channels: usize) -> Arc<Block<f64>> {
        let tensors: Vec<_> = block_tensors(channels).collect();
        let get = |name: &str| {
            let (which, (_, shape)) = tensors.iter().enumerate().find(|(_, tensor)| tensor.0 == name).unwrap();
            Ok(Param::constant(numbers(shape.iter().product(), which as u64).into()))
        };
        Arc::new(Block::new(channels, get).unwrap())
    }

    #[test]
    fn one_operation_gives_what_the_single_ones_give() {
        for (channels, height, width) in [(5, 20, 40), (3, 16, 16), (2, 3, 300), (130, 5, 6), (4, 1, 1)] {
            let layout = Layout { channels, height, width };
            let block_ = random(channels);
            let x = Planes::constant(numbers(layout.len(), 3), layout).unwrap();
            let (one, many) = (block(x.traced(), &block_).unwrap(), composed(x.traced(), &block_).unwrap());
            compare(one.values(), many.values(), 1e-12, "values");
            compare(block(x.branch(), &block_).unwrap().values(), many.values(), 1e-12, "values without tape");
            let seed = numbers(layout.len(), 4);
            let one = one.cut().1.pull_back(seed.clone()).unwrap().of(&x.slot()).unwrap();
            let many = many.cut().1.pull_back(seed).unwrap().of(&x.slot()).unwrap();
            compare(&one, &many, 1e-11, "gradient");
        }
    }

    #[test]
    fn gradients() {
        let layout = Layout { channels: 5, height: 20, width: 40 };
        let fixed = random(5);
        check(layout, &[], |x, _| block(x, &fixed));
        let tensors: Vec<_> = block_tensors(5).collect();
        let sizes: Vec<usize> = tensors.iter().map(|(_, shape)| shape.iter().product()).collect();
        check(layout, &sizes, |x, params| {
            let get = |name: &str| Ok(params[tensors.iter().position(|tensor| tensor.0 == name).unwrap()].clone());
            block(x, &Arc::new(Block::new(5, get)?))
        });
    }

    #[test]
    fn windows() {
        let layout = Layout { channels: 3, height: 20, width: 40 };
        let block_ = random(3);
        let x = Planes::constant(numbers(layout.len(), 3), layout).unwrap();
        let global = block(x.branch(), &block_).unwrap();
        for window in [None, Some(40), Some(1000)] {
            let out = block_within(x.branch(), &block_, window).unwrap();
            compare(out.values(), global.values(), 1e-13, "one window");
        }
        let local = block_within(x.branch(), &block_, Some(39)).unwrap();
        let off = local.values().iter().zip(global.values()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off > 1e-4, "{off}");
        // With one pixel to a window the block has no memory of the rest: a change reaches its neighbours only.
        let mut moved = x.values().to_vec();
        moved[layout.row(1, 9).start + 20] += 0.5;
        let moved = Planes::constant(moved, layout).unwrap();
        let [a, b] = [x, moved].map(|x| block_within(x, &block_, Some(1)).unwrap());
        let [a, b] = [a, b].map(|out| layout.unpack(out.values(), 20, 40));
        for (at, (a, b)) in a.iter().zip(&b).enumerate() {
            let near = (at / 40 % 20).abs_diff(9) <= 1 && (at % 40).abs_diff(20) <= 1;
            // The sums that glide over the picture are rounded.
            assert_eq!((a - b).abs() > 1e-12, near, "{at}");
        }
    }

    #[test]
    fn wrong_channels_are_an_error() {
        let x = Planes::constant(vec![0.0; 3], Layout { channels: 3, height: 1, width: 1 }).unwrap();
        assert!(block(x, &random(4)).is_err());
    }
}
