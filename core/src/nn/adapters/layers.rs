//! What the kernels compute with, made from an adapter's parameters, and the way back for the gradients.
//!
//! Constant factors are folded into the convolutions they meet: the weights of a layer norm into the 1x1 convolution behind it, the channel
//! attention and beta into the one after the gate, gamma into the last. The gradients of all these follow from those of the folded
//! convolutions, so that no factor costs anything per pixel.

use super::kernels::Dense;
use crate::nn::AdapterParams;

/// Tensors of an adapter, in the order of [`AdapterParams::tensors`].
#[derive(Clone, Copy)]
enum Tensor {
    Norm1Weight,
    Norm1Bias,
    Conv1Weight,
    Conv1Bias,
    Conv2Weight,
    Conv2Bias,
    ScaWeight,
    ScaBias,
    Conv3Weight,
    Conv3Bias,
    Beta,
    Norm2Weight,
    Norm2Bias,
    Conv4Weight,
    Conv4Bias,
    Conv5Weight,
    Conv5Bias,
    Gamma,
    EndWeight,
    EndBias,
}

/// Gradients the kernels sum over pixels, each the index of an array of [`Sums`]: of the entries of a folded layer, then of its bias.
#[derive(Clone, Copy)]
pub(super) enum Sum {
    /// The last convolution: (output, tap, channel), then (output, tap), of which the middle tap counts.
    End,
    /// gamma times conv5: (channel, channel), then (channel).
    Out,
    /// conv4 times the weight of norm2: (2 channels, channel), then (2 channels).
    Conv4,
    /// beta times conv3 times the attention: (channel, channel), then (channel).
    Mix,
    /// conv2: (2 channels, tap), the tenth tap being the bias.
    Conv2,
    /// conv1 times the weight of norm1: (2 channels, channel), then (2 channels).
    Conv1,
}

/// Lengths of the arrays of [`Sums`].
pub(super) fn sum_lengths(m: usize, k: usize) -> [usize; 6] {
    let dense = |outputs: usize| outputs * (m + 1);
    [dense(9 * k), dense(m), dense(2 * m), dense(m), 20 * m, dense(2 * m)]
}

/// Sums over pixels, one array per [`Sum`].
pub(super) type Sums = [Vec<f64>; 6];

/// The layers of one adapter.
pub(super) struct Layers {
    channels: usize,
    outputs: usize,
    params: Vec<f32>,
    /// The mean of the gate's result over pixels, and the attention made from it.
    mean: Vec<f32>,
    attention: Vec<f32>,
    pub(super) conv1: Dense,
    pub(super) conv1_transposed: Dense,
    /// Nine taps and the bias of each channel of conv2, and the taps of its transpose.
    pub(super) conv2: Vec<[f32; 10]>,
    pub(super) conv2_transposed: Vec<[f32; 10]>,
    pub(super) mix: Dense,
    pub(super) mix_transposed: Dense,
    pub(super) conv4: Dense,
    pub(super) conv4_transposed: Dense,
    pub(super) out: Dense,
    pub(super) out_transposed: Dense,
    /// Inputs are (channel, tap).
    pub(super) end: Dense,
    /// Inputs are (output, tap), taps as in `end`.
    pub(super) end_transposed: Dense,
}

impl Layers {
    /// Layers of an adapter; [`Layers::attend`] completes them.
    pub(super) fn new(m: usize, k: usize, params: &[f32]) -> Self {
        let none = Dense::default;
        let mut layers = Self {
            channels: m,
            outputs: k,
            params: params.to_vec(),
            mean: vec![0.0; m],
            attention: vec![0.0; m],
            conv1: none(),
            conv1_transposed: none(),
            conv2: Vec::new(),
            conv2_transposed: Vec::new(),
            mix: none(),
            mix_transposed: none(),
            conv4: none(),
            conv4_transposed: none(),
            out: none(),
            out_transposed: none(),
            end: none(),
            end_transposed: none(),
        };
        layers.fold();
        layers
    }

    fn tensor(&self, tensor: Tensor) -> &[f32] {
        let range = AdapterParams::tensors(self.channels, self.outputs).nth(tensor as usize).map(|tensor| tensor.2);
        range.map_or(&[], |range| &self.params[range])
    }

    fn fold(&mut self) {
        use Tensor::*;
        let (m, k) = (self.channels, self.outputs);
        let zero = |_: usize| 0.0;

        let folded = |norm: Tensor, shift: Tensor, conv: Tensor, bias: Tensor| {
            let (scale, shift, weight, bias) =
                (self.tensor(norm), self.tensor(shift), self.tensor(conv), self.tensor(bias));
            let forward = Dense::new(
                2 * m,
                m,
                |o, i| weight[o * m + i] * scale[i],
                |o| bias[o] + (0..m).map(|i| weight[o * m + i] * shift[i]).sum::<f32>(),
            );
            (forward, Dense::new(m, 2 * m, |i, o| weight[o * m + i] * scale[i], zero))
        };
        let (conv1, conv1_transposed) = folded(Norm1Weight, Norm1Bias, Conv1Weight, Conv1Bias);
        let (conv4, conv4_transposed) = folded(Norm2Weight, Norm2Bias, Conv4Weight, Conv4Bias);

        let (weight, bias) = (self.tensor(Conv2Weight), self.tensor(Conv2Bias));
        let taps = |c: usize| std::array::from_fn(|tap| if tap < 9 { weight[c * 9 + tap] } else { bias[c] });
        let flipped = |c: usize| std::array::from_fn(|tap| if tap < 9 { weight[c * 9 + 8 - tap] } else { 0.0 });
        let (conv2, conv2_transposed) = ((0..2 * m).map(taps).collect(), (0..2 * m).map(flipped).collect());

        let (weight, bias, gamma) = (self.tensor(Conv5Weight), self.tensor(Conv5Bias), self.tensor(Gamma));
        let out = Dense::new(m, m, |o, i| gamma[o] * weight[o * m + i], |o| gamma[o] * bias[o]);
        let out_transposed = Dense::new(m, m, |i, o| gamma[o] * weight[o * m + i], zero);

        let (weight, bias) = (self.tensor(EndWeight), self.tensor(EndBias));
        let end = Dense::new(k, 9 * m, |o, i| weight[o * 9 * m + i], |o| bias[o]);
        let end_transposed = Dense::new(m, 9 * k, |c, i| weight[(i / 9 * m + c) * 9 + i % 9], zero);

        (self.conv1, self.conv1_transposed, self.conv2, self.conv2_transposed) =
            (conv1, conv1_transposed, conv2, conv2_transposed);
        (self.conv4, self.conv4_transposed, self.out, self.out_transposed) =
            (conv4, conv4_transposed, out, out_transposed);
        (self.end, self.end_transposed) = (end, end_transposed);
    }

    /// The channel attention, from the mean over pixels of the gate's result.
    pub(super) fn attend(&mut self, mean: impl Iterator<Item = f64>) {
        let m = self.channels;
        self.mean = mean.map(|mean| mean as f32).collect();
        let dot = |row: usize| -> f32 {
            self.tensor(Tensor::ScaWeight)[row * m..][..m].iter().zip(&self.mean).map(|(w, x)| w * x).sum()
        };
        self.attention = (0..m).map(|row| dot(row) + self.tensor(Tensor::ScaBias)[row]).collect();
        let (weight, bias) = (self.tensor(Tensor::Conv3Weight), self.tensor(Tensor::Conv3Bias));
        let (beta, attention) = (self.tensor(Tensor::Beta), &self.attention);
        let entry = |o: usize, i: usize| beta[o] * weight[o * m + i] * attention[i];
        let mix = Dense::new(m, m, entry, |o| beta[o] * bias[o]);
        let mix_transposed = Dense::new(m, m, |i, o| entry(o, i), |_| 0.0);
        (self.mix, self.mix_transposed) = (mix, mix_transposed);
    }

    /// The gradient of the attention, given that of the mix.
    fn attention_gradient(&self, mix: &[f64]) -> Vec<f64> {
        let m = self.channels;
        let (weight, beta) = (self.tensor(Tensor::Conv3Weight), self.tensor(Tensor::Beta));
        let entry = |o: usize, i: usize| mix[o * m + i] * f64::from(beta[o]) * f64::from(weight[o * m + i]);
        (0..m).map(|i| (0..m).map(|o| entry(o, i)).sum()).collect()
    }

    /// The gradient of the mean of the gate's result, given that of the mix.
    pub(super) fn mean_gradient(&self, mix: &[f64]) -> Vec<f64> {
        let m = self.channels;
        let (attention, weight) = (self.attention_gradient(mix), self.tensor(Tensor::ScaWeight));
        (0..m).map(|i| (0..m).map(|o| attention[o] * f64::from(weight[o * m + i])).sum()).collect()
    }

    /// Writes the gradients of all parameters, given the sums over pixels.
    pub(super) fn unfold(&self, sums: &Sums, gradient: &mut [f32]) {
        use Tensor::*;
        let (m, k) = (self.channels, self.outputs);
        let ranges: Vec<_> = AdapterParams::tensors(m, k).map(|tensor| tensor.2).collect();
        let mut write = |tensor: Tensor, value: &dyn Fn(usize) -> f64| {
            let target = &mut gradient[ranges[tensor as usize].clone()];
            target.iter_mut().enumerate().for_each(|(i, target)| *target = value(i) as f32);
        };
        let value = |tensor: Tensor| -> Vec<f64> { self.tensor(tensor).iter().map(|&x| f64::from(x)).collect() };
        let sum = |sum: Sum| &sums[sum as usize][..];

        for (norm, shift, conv, bias, of) in [
            (Norm1Weight, Norm1Bias, Conv1Weight, Conv1Bias, Sum::Conv1),
            (Norm2Weight, Norm2Bias, Conv4Weight, Conv4Bias, Sum::Conv4),
        ] {
            let (d, d_bias) = sum(of).split_at(2 * m * m);
            let (scale, offset, weight) = (value(norm), value(shift), value(conv));
            write(norm, &|i| (0..2 * m).map(|o| d[o * m + i] * weight[o * m + i]).sum());
            write(shift, &|i| (0..2 * m).map(|o| d_bias[o] * weight[o * m + i]).sum());
            write(conv, &|e| d[e] * scale[e % m] + d_bias[e / m] * offset[e % m]);
            write(bias, &|o| d_bias[o]);
        }
        write(Conv2Weight, &|e| sum(Sum::Conv2)[e / 9 * 10 + e % 9]);
        write(Conv2Bias, &|c| sum(Sum::Conv2)[c * 10 + 9]);

        let (d, d_bias) = sum(Sum::Mix).split_at(m * m);
        let (weight, bias, beta) = (value(Conv3Weight), value(Conv3Bias), value(Beta));
        let attention = |i: usize| f64::from(self.attention[i]);
        write(Conv3Weight, &|e| d[e] * beta[e / m] * attention(e % m));
        write(Conv3Bias, &|o| d_bias[o] * beta[o]);
        write(Beta, &|o| {
            d_bias[o] * bias[o] + (0..m).map(|i| d[o * m + i] * weight[o * m + i] * attention(i)).sum::<f64>()
        });
        let d_attention = self.attention_gradient(d);
        write(ScaWeight, &|e| d_attention[e / m] * f64::from(self.mean[e % m]));
        write(ScaBias, &|o| d_attention[o]);

        let (d, d_bias) = sum(Sum::Out).split_at(m * m);
        let (weight, bias, gamma) = (value(Conv5Weight), value(Conv5Bias), value(Gamma));
        write(Conv5Weight, &|e| d[e] * gamma[e / m]);
        write(Conv5Bias, &|o| d_bias[o] * gamma[o]);
        write(Gamma, &|o| d_bias[o] * bias[o] + (0..m).map(|i| d[o * m + i] * weight[o * m + i]).sum::<f64>());

        // (output, channel, tap) from (output, tap, channel).
        write(EndWeight, &|e| sum(Sum::End)[(e / (9 * m) * 9 + e % 9) * m + e / 9 % m]);
        write(EndBias, &|o| sum(Sum::End)[9 * k * m + 9 * o + 4]);
    }
}
