//! Values and gradients of the adapters against a plain f64 version of the same formulas and its central differences.

use svbrdf_gcn::nn::{AdapterParams, Adapters};

/// Uniform values in [-1, 1) from a linear congruential generator.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn values(&mut self, len: usize) -> Vec<f64> {
        (0..len).map(|_| f64::from(self.next() as f32)).collect()
    }
}

struct Case {
    channels: usize,
    outputs: Vec<usize>,
    width: usize,
    height: usize,
    feature: Vec<f64>,
    params: Vec<f64>,
    /// The loss is the sum of the raw planes times these.
    weights: Vec<f64>,
}

impl Case {
    fn new(channels: usize, outputs: &[usize], width: usize, height: usize) -> Self {
        let mut random = Random(width as u64 * 1000 + height as u64);
        let pixels = width * height;
        let len = outputs.iter().map(|&k| AdapterParams::len_for(channels, k)).sum();
        Self {
            channels,
            outputs: outputs.to_vec(),
            width,
            height,
            feature: random.values(channels * pixels),
            params: random.values(len).into_iter().map(|p| 0.6 * p).collect(),
            weights: random.values(outputs.iter().sum::<usize>() * pixels),
        }
    }

    fn adapters(&self) -> Adapters {
        Adapters::new(&single(&self.feature), self.channels, &self.outputs, self.width, self.height).unwrap()
    }

    /// Raw planes as the text of the paper's network has them, pixel by pixel.
    fn raw(&self, feature: &[f64], params: &[f64]) -> Vec<f64> {
        let mut raw = Vec::new();
        let mut rest = params;
        for &k in &self.outputs {
            let (params, others) = rest.split_at(AdapterParams::len_for(self.channels, k));
            rest = others;
            raw.extend(self.adapter(k, feature, params));
        }
        raw
    }

    fn adapter(&self, k: usize, feature: &[f64], params: &[f64]) -> Vec<f64> {
        let (m, pixels) = (self.channels, self.width * self.height);
        let tensor = |name: &str| {
            let (_, _, range) = AdapterParams::tensors(m, k).find(|tensor| tensor.0 == name).unwrap();
            &params[range]
        };
        let norm = |x: &[f64], weight: &[f64], bias: &[f64]| {
            let mut out = vec![0.0; x.len()];
            for p in 0..pixels {
                let mean = (0..m).map(|c| x[c * pixels + p]).sum::<f64>() / m as f64;
                let variance = (0..m).map(|c| (x[c * pixels + p] - mean).powi(2)).sum::<f64>() / m as f64;
                for c in 0..m {
                    out[c * pixels + p] = (x[c * pixels + p] - mean) / (variance + 1e-6).sqrt() * weight[c] + bias[c];
                }
            }
            out
        };
        let dense = |x: &[f64], outputs: usize, weight: &[f64], bias: &[f64]| -> Vec<f64> {
            (0..outputs * pixels)
                .map(|i| {
                    let (o, p) = (i / pixels, i % pixels);
                    bias[o] + (0..m).map(|c| weight[o * m + c] * x[c * pixels + p]).sum::<f64>()
                })
                .collect()
        };
        // The value of plane `c` at (row, column), zero outside.
        let at = |x: &[f64], c: usize, row: isize, column: isize| {
            let inside = (0..self.height as isize).contains(&row) && (0..self.width as isize).contains(&column);
            if inside { x[c * pixels + row as usize * self.width + column as usize] } else { 0.0 }
        };
        let neighbourhood = |x: &[f64], c: usize, p: usize, weight: &[f64]| -> f64 {
            let (row, column) = ((p / self.width) as isize, (p % self.width) as isize);
            (0..9).map(|t| weight[t as usize] * at(x, c, row + t / 3 - 1, column + t % 3 - 1)).sum()
        };
        let gate = |x: &[f64]| -> Vec<f64> { (0..m * pixels).map(|i| x[i] * x[m * pixels + i]).collect() };

        let x = norm(feature, tensor("norm1.weight"), tensor("norm1.bias"));
        let x = dense(&x, 2 * m, tensor("conv1.weight"), tensor("conv1.bias"));
        let (taps, bias) = (tensor("conv2.weight"), tensor("conv2.bias"));
        let x: Vec<f64> = (0..2 * m * pixels)
            .map(|i| bias[i / pixels] + neighbourhood(&x, i / pixels, i % pixels, &taps[i / pixels * 9..][..9]))
            .collect();
        let mut x = gate(&x);
        let means: Vec<f64> = x.chunks(pixels).map(|plane| plane.iter().sum::<f64>() / pixels as f64).collect();
        let (weight, bias) = (tensor("sca.1.weight"), tensor("sca.1.bias"));
        for c in 0..m {
            let attention = bias[c] + (0..m).map(|i| weight[c * m + i] * means[i]).sum::<f64>();
            x[c * pixels..(c + 1) * pixels].iter_mut().for_each(|x| *x *= attention);
        }
        let x = dense(&x, m, tensor("conv3.weight"), tensor("conv3.bias"));
        let beta = tensor("beta");
        let y: Vec<f64> = (0..m * pixels).map(|i| feature[i] + beta[i / pixels] * x[i]).collect();
        let x = norm(&y, tensor("norm2.weight"), tensor("norm2.bias"));
        let x = gate(&dense(&x, 2 * m, tensor("conv4.weight"), tensor("conv4.bias")));
        let x = dense(&x, m, tensor("conv5.weight"), tensor("conv5.bias"));
        let gamma = tensor("gamma");
        let x: Vec<f64> = (0..m * pixels).map(|i| y[i] + gamma[i / pixels] * x[i]).collect();
        let (weight, bias) = (tensor("end.weight"), tensor("end.bias"));
        (0..k * pixels)
            .map(|i| {
                let (o, p) = (i / pixels, i % pixels);
                let channel = |c: usize| neighbourhood(&x, c, p, &weight[(o * m + c) * 9..][..9]);
                bias[o] + (0..m).map(channel).sum::<f64>()
            })
            .collect()
    }

    fn loss(&self, feature: &[f64], params: &[f64]) -> f64 {
        self.raw(feature, params).iter().zip(&self.weights).map(|(raw, weight)| raw * weight).sum()
    }

    /// Central differences of the loss, at every `step`-th place.
    fn slopes(&self, values: &[f64], step: usize, loss: impl Fn(&[f64]) -> f64) -> Vec<(usize, f64)> {
        let mut values = values.to_vec();
        (0..values.len())
            .step_by(step)
            .map(|i| {
                let (at, delta) = (values[i], 1e-5);
                values[i] = at + delta;
                let above = loss(&values);
                values[i] = at - delta;
                let below = loss(&values);
                values[i] = at;
                (i, (above - below) / (2.0 * delta))
            })
            .collect()
    }

    fn check(&self, step: usize) {
        let mut adapters = self.adapters();
        let mut raw = vec![f32::NAN; adapters.raw_len()];
        adapters.forward(&single(&self.params), &mut raw).unwrap();
        compare("raw", &raw, &self.raw(&self.feature, &self.params).into_iter().enumerate().collect::<Vec<_>>(), 1e-5);

        let mut d_params = vec![f32::NAN; adapters.params_len()];
        let mut d_feature = vec![f32::NAN; self.feature.len()];
        adapters.backward(&single(&self.weights), Some(&mut d_params), Some(&mut d_feature)).unwrap();
        let slopes = self.slopes(&self.feature, step, |feature| self.loss(feature, &self.params));
        compare("feature", &d_feature, &slopes, 1e-4);
        let slopes = self.slopes(&self.params, step, |params| self.loss(&self.feature, params));
        let mut start = 0;
        for (adapter, &k) in self.outputs.iter().enumerate() {
            for (name, _, range) in AdapterParams::tensors(self.channels, k) {
                let (begin, end) = (start + range.start, start + range.end);
                let slopes: Vec<_> = slopes.iter().filter(|slope| (begin..end).contains(&slope.0)).copied().collect();
                compare(&format!("adapter {adapter}: {name}"), &d_params, &slopes, 1e-4);
            }
            start += AdapterParams::len_for(self.channels, k);
        }

        // Each gradient alone is the same as both together.
        let mut alone = vec![f32::NAN; d_params.len()];
        adapters.backward(&single(&self.weights), Some(&mut alone), None).unwrap();
        assert_eq!(alone, d_params);
        let mut alone = vec![f32::NAN; d_feature.len()];
        adapters.backward(&single(&self.weights), None, Some(&mut alone)).unwrap();
        assert_eq!(alone, d_feature);
    }
}

fn single(values: &[f64]) -> Vec<f32> {
    values.iter().map(|&value| value as f32).collect()
}

/// All `expected` (place, value) within `tolerance` times the largest of them.
fn compare(name: &str, got: &[f32], expected: &[(usize, f64)], tolerance: f64) {
    let scale = expected.iter().map(|(_, value)| value.abs()).fold(0.0, f64::max);
    for &(at, expected) in expected {
        let error = (f64::from(got[at]) - expected).abs();
        assert!(error <= tolerance * scale, "{name} [{at}]: got {}, expected {expected}, scale {scale}", got[at]);
    }
}

#[test]
fn isotropic_adapters_match() {
    Case::new(9, &[3, 2, 1, 3], 11, 7).check(3);
}

#[test]
fn anisotropic_adapters_match() {
    Case::new(14, &[3, 3, 2, 3, 3], 8, 5).check(3);
}

#[test]
fn odd_sizes_match() {
    for (width, height) in [(1, 1), (1, 6), (5, 1), (2, 2), (16, 3)] {
        Case::new(9, &[1, 2], width, height).check(5);
    }
    for channels in [1, 2, 4, 5] {
        Case::new(channels, &[4, 1], 9, 4).check(3);
    }
}

#[test]
fn sizes_of_several_chunks_and_tiles_match() {
    for (width, height) in [(141, 3), (3, 67), (5, 32), (5, 33), (260, 2)] {
        Case::new(9, &[3, 1], width, height).check(41);
    }
}

#[test]
fn the_thread_count_does_not_change_a_bit() {
    let case = Case::new(9, &[3, 2, 1, 3], 50, 131);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut adapters = case.adapters();
            let mut raw = vec![0.0; adapters.raw_len()];
            let mut d_params = vec![0.0; adapters.params_len()];
            let mut d_feature = vec![0.0; case.feature.len()];
            adapters.forward(&single(&case.params), &mut raw).unwrap();
            adapters.backward(&single(&case.weights), Some(&mut d_params), Some(&mut d_feature)).unwrap();
            (raw, d_params, d_feature)
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(5));
}

#[test]
fn memory_used_before_does_not_change_a_bit() {
    let case = Case::new(9, &[1, 3], 21, 40);
    let mut adapters = case.adapters();
    let run = |adapters: &mut Adapters| {
        let mut raw = vec![0.0; adapters.raw_len()];
        let mut gradient = vec![0.0; adapters.params_len()];
        adapters.forward(&single(&case.params), &mut raw).unwrap();
        adapters.backward(&single(&case.weights), Some(&mut gradient), None).unwrap();
        (raw, gradient)
    };
    let first = run(&mut adapters);
    let other: Vec<f32> = case.feature.iter().map(|&x| 3.0 - x as f32).collect();
    adapters.set_feature(&other).unwrap();
    assert!(run(&mut adapters) != first);
    adapters.set_feature(&single(&case.feature)).unwrap();
    assert!(run(&mut adapters) == first);
}

#[test]
fn wrong_lengths_are_errors() {
    let case = Case::new(9, &[1], 4, 3);
    let mut adapters = case.adapters();
    let (params, len) = (single(&case.params), adapters.raw_len());
    let mut raw = vec![0.0; len];
    assert!(Adapters::new(&[0.0; 3], 9, &[1], 4, 3).is_err());
    assert!(Adapters::new(&[], 9, &[1], 0, 3).is_err());
    assert!(Adapters::new(&[0.0; 12], 1, &[], 4, 3).is_err());
    assert!(adapters.set_feature(&[0.0; 5]).is_err());
    assert!(adapters.backward(&raw, None, None).is_err(), "backward needs a forward pass");
    assert!(adapters.forward(&params[1..], &mut raw).is_err());
    assert!(adapters.forward(&params, &mut raw[1..]).is_err());
    adapters.forward(&params, &mut raw).unwrap();
    assert!(adapters.backward(&raw[1..], None, None).is_err());
    assert!(adapters.backward(&raw, Some(&mut [0.0; 7]), None).is_err());
    assert!(adapters.backward(&raw, None, Some(&mut [0.0; 7])).is_err());
    let feature = single(&case.feature);
    adapters.set_feature(&feature).unwrap();
    assert!(adapters.backward(&raw, None, None).is_err(), "a new feature needs a new forward pass");
}
