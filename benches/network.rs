//! The network at the released sizes with random weights, 256 x 256, four photos: encoder, decoder, and decoder with the way back.
//! `python3 python/tools/bench_torch.py` measures the same in PyTorch.

use std::hint::black_box;
use std::ops::ControlFlow;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use svbrdf_gcn::Lobe;
use svbrdf_gcn::nn::{Gcn, Model, NetworkConfig};
use svbrdf_gcn::progress::{CancelToken, Control, Progress};

const SIZE: usize = 256;

fn paper(criterion: &mut Criterion) {
    let model =
        Model::random(&[NetworkConfig::paper(4, Gcn::Diagonal, Lobe::Isotropic)], 1).expect("a valid configuration");
    let network = model.network(4).expect("a network for four photos");
    let photo: Vec<f32> = (0..3 * SIZE * SIZE).map(|i| (i as f32 * 0.37).sin().abs()).collect();
    let photos = [&photo[..]; 4];
    let mut callback = |_: &Progress| ControlFlow::Continue(());
    let mut control = Control::new(&mut callback, CancelToken::new());
    let code = network.encode(&photos, SIZE, SIZE, &mut control).expect("encodes");
    let feature = network.decode(&code.latent, &code, &mut control).expect("decodes");
    assert!(feature.iter().all(|value| value.is_finite()));

    let mut group = criterion.benchmark_group("paper-64");
    group.sample_size(10).warm_up_time(Duration::from_secs(1)).measurement_time(Duration::from_secs(8));
    group.bench_function("encoder", |bencher| {
        bencher.iter(|| black_box(network.encode(&photos, SIZE, SIZE, &mut control).expect("encodes")));
    });
    group.bench_function("decoder", |bencher| {
        bencher.iter(|| black_box(network.decode(&code.latent, &code, &mut control).expect("decodes")));
    });
    group.bench_function("decoder and gradient of z", |bencher| {
        bencher.iter(|| {
            let (feature, trace) = network.decode_traced(&code.latent, &code, &mut control).expect("decodes");
            black_box(trace.pull_back(&feature, &mut control).expect("has a gradient"))
        });
    });
    group.finish();
    if let Ok(status) = std::fs::read_to_string("/proc/self/status") {
        for line in status.lines().filter(|line| line.starts_with("VmHWM")) {
            eprintln!("peak memory: {line}");
        }
    }
}

criterion_group!(benches, paper);
criterion_main!(benches);
