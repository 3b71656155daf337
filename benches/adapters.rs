//! The adapter step at 256 x 256: the adapters alone, and all of a step with four photos.

use std::ops::ControlFlow;

use criterion::{Criterion, criterion_group, criterion_main};
use svbrdf_gcn::Shot;
use svbrdf_gcn::fit::optim::adam::Adam;
use svbrdf_gcn::fit::paper::adapters::Readout;
use svbrdf_gcn::nn::{AdapterParams, Adapters, Decoding};
use svbrdf_gcn::progress::{CancelToken, Control, Progress};
use svbrdf_gcn::render::Target;
use svbrdf_gcn::{Error, Lobe};

const SIZE: usize = 256;

const LOBES: [(&str, Lobe, usize, &[usize]); 2] =
    [("isotropic", Lobe::Isotropic, 9, &[3, 2, 1, 3]), ("anisotropic", Lobe::Anisotropic, 14, &[3, 3, 2, 3, 3])];

/// Values in [-0.5, 0.5) without pattern.
fn noise(len: usize) -> Vec<f32> {
    let mut state = 1u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32 - 0.5
    };
    (0..len).map(|_| next()).collect()
}

fn params(channels: usize, outputs: &[usize]) -> Vec<f32> {
    noise(outputs.iter().map(|&k| AdapterParams::len_for(channels, k)).sum())
}

fn adapters(criterion: &mut Criterion) {
    for (name, _, channels, outputs) in LOBES {
        let feature = noise(channels * SIZE * SIZE);
        let params = params(channels, outputs);
        let mut adapters = Adapters::new(&feature, channels, outputs, SIZE, SIZE).expect("sizes fit");
        let mut raw = vec![0.0; adapters.raw_len()];
        let (mut d_params, mut d_feature) = (vec![0.0; params.len()], vec![0.0; feature.len()]);
        let d_raw = noise(raw.len());
        adapters.forward(&params, &mut raw).expect("lengths fit");
        let mut group = criterion.benchmark_group(format!("adapters/{name}"));
        group.bench_function("forward", |bencher| {
            bencher.iter(|| adapters.forward(&params, &mut raw).expect("lengths fit"));
        });
        group.bench_function("backward", |bencher| {
            bencher.iter(|| adapters.backward(&d_raw, Some(&mut d_params), None).expect("lengths fit"));
        });
        group.bench_function("backward_with_feature", |bencher| {
            let mut both = || adapters.backward(&d_raw, Some(&mut d_params), Some(&mut d_feature));
            bencher.iter(|| both().expect("lengths fit"));
        });
    }
}

/// Four photos from near above the patch.
fn targets() -> Result<Vec<Target>, Error> {
    let positions = [[0.0, 0.0], [0.6, 0.5], [-0.7, 0.4], [0.2, -0.8]];
    let target = |[x, y]: [f64; 2]| {
        let at = [x, y, 2.1];
        let shot = Shot { camera: at, light: at, light_intensity: [10.0; 3] };
        let encoded: Vec<f32> = noise(3 * SIZE * SIZE).into_iter().map(|value| value + 0.5).collect();
        Target::new(SIZE, SIZE, shot, &encoded, &vec![0; SIZE * SIZE])
    };
    positions.into_iter().map(target).collect()
}

fn step(criterion: &mut Criterion) {
    let targets = targets().expect("sizes fit");
    let mut callback = |_: &Progress| ControlFlow::Continue(());
    let mut control = Control::new(&mut callback, CancelToken::new());
    for (name, lobe, channels, outputs) in LOBES {
        let feature = noise(channels * SIZE * SIZE);
        let mut params = params(channels, outputs);
        let mut gradient = vec![0.0; params.len()];
        let mut adam = Adam::new(params.len());
        let decoding = Decoding::new(lobe);
        let readout = Readout::new(&feature, channels, outputs, decoding, 2.0, &targets);
        let mut readout = readout.expect("sizes fit");
        criterion.bench_function(&format!("adapter_step/{name}"), |bencher| {
            bencher.iter(|| {
                let loss = readout.loss(&params, Some(&mut gradient), None, &mut control).expect("lengths fit");
                adam.step(&mut params, &gradient, 1e-3);
                loss
            });
        });
    }
}

criterion_group!(benches, adapters, step);
criterion_main!(benches);
