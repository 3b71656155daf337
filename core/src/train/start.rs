//! Where training starts from.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::nn::PhotoGraphConfig;

/// What the contributions of blocks and messages are scaled by at the start; zero, as published, learns nothing for too long.
const SCALE_START: f32 = 0.3;

/// The tensors of an untrained network, the same for the same `seed`: kernels and their biases uniform in +-1 / sqrt(values that an output sums), as
/// PyTorch's layers begin; layer norms that change nothing; edges that depend on queries and keys alone.
pub(crate) fn tensors(config: &PhotoGraphConfig, seed: u64) -> BTreeMap<String, Arc<Vec<f32>>> {
    let mut rng = fastrand::Rng::with_seed(seed);
    let mut reach = 0.0;
    let start = |(name, shape): (String, Vec<usize>)| {
        let len = shape.iter().product();
        let constant = |value: f32| vec![value; len];
        let mut uniform = |reach: f32| (0..len).map(|_| reach * (2.0 * rng.f32() - 1.0)).collect();
        let values = match name.rsplit('.').next() {
            Some("weight") if shape.len() == 4 => {
                reach = (shape[1..].iter().product::<usize>() as f32).sqrt().recip();
                uniform(reach)
            }
            Some("weight") => {
                reach = 0.0;
                constant(1.0)
            }
            // It follows its weight.
            Some("bias") if reach > 0.0 => uniform(reach),
            Some("beta" | "gamma" | "gain") => constant(SCALE_START),
            _ => constant(0.0),
        };
        (name, Arc::new(values))
    };
    config.tensors().into_iter().map(start).collect()
}

#[cfg(test)]
mod tests {
    use super::tensors;
    use crate::nn::PhotoGraphConfig;

    #[test]
    fn starts_as_pytorch_does() {
        let config = PhotoGraphConfig::default();
        let all = tensors(&config, 3);
        assert_eq!(all, tensors(&config, 3));
        assert_ne!(all, tensors(&config, 4));
        for (name, reach) in [
            ("intro.weight", (13.0 * 9.0f32).sqrt().recip()),
            ("intro.bias", (13.0 * 9.0f32).sqrt().recip()),
            ("middle_blks.0.conv2.weight", 1.0 / 3.0),
            ("middle_blks.0.conv2.bias", 1.0 / 3.0),
            ("rounds.0.query.bias", 32.0f32.sqrt().recip()),
        ] {
            let largest = all[name].iter().fold(0.0, |a: f32, value| a.max(value.abs()));
            assert!(largest <= reach && largest > 0.7 * reach, "{name}: {largest} {reach}");
        }
        for (name, value) in [
            ("node.0.norm1.weight", 1.0),
            ("node.0.norm1.bias", 0.0),
            ("rounds.0.norm.weight", 1.0),
            ("rounds.0.norm.bias", 0.0),
            ("rounds.0.pair", 0.0),
            ("rounds.0.loop", 0.0),
            ("rounds.0.gain", 0.3),
            ("certainty.conv.beta", 0.3),
            ("tail.0.gamma", 0.3),
        ] {
            assert!(all[name].iter().all(|&got| got == value), "{name}");
        }
    }
}
