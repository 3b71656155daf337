//! The adapter step at 256 x 256, in its parts.

use criterion::{Criterion, criterion_group, criterion_main};
use svbrdf_gcn::nn::{AdapterParams, Adapters};

const SIZE: usize = 256;

/// Values in [-0.5, 0.5) without pattern.
fn noise(len: usize) -> Vec<f32> {
    let mut state = 1u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32 - 0.5
    };
    (0..len).map(|_| next()).collect()
}

fn adapters(criterion: &mut Criterion) {
    for (name, channels, outputs) in [("isotropic", 9, &[3, 2, 1, 3][..]), ("anisotropic", 14, &[3, 3, 2, 3, 3])] {
        let feature = noise(channels * SIZE * SIZE);
        let params = noise(outputs.iter().map(|&k| AdapterParams::len_for(channels, k)).sum());
        let mut adapters = Adapters::new(&feature, channels, outputs, SIZE, SIZE).unwrap();
        let mut raw = vec![0.0; adapters.raw_len()];
        let (mut d_params, mut d_feature) = (vec![0.0; params.len()], vec![0.0; feature.len()]);
        let d_raw = noise(raw.len());
        let mut group = criterion.benchmark_group(format!("adapters/{name}"));
        group.bench_function("forward", |bencher| bencher.iter(|| adapters.forward(&params, &mut raw)));
        group.bench_function("backward", |bencher| {
            bencher.iter(|| adapters.backward(&d_raw, Some(&mut d_params), None));
        });
        group.bench_function("backward_with_feature", |bencher| {
            bencher.iter(|| adapters.backward(&d_raw, Some(&mut d_params), Some(&mut d_feature)));
        });
    }
}

criterion_group!(benches, adapters);
criterion_main!(benches);
