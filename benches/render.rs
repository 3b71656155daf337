//! Time of the renderer and of the loss with its gradient, 256 x 256.

use criterion::{Criterion, criterion_group, criterion_main};
use svbrdf_gcn::render::{Target, encode_radiance, photo_loss, render_maps};
use svbrdf_gcn::{Lobe, Maps, Shot};

const SIZE: usize = 256;
const PATCH: f64 = 9.7;

/// Maps with some structure: bumps, stripes of gloss, colours.
fn maps(lobe: Lobe, phase: f32) -> Maps<f32> {
    let data = (0..lobe.planes() * SIZE * SIZE)
        .map(|i| {
            let (plane, pixel) = (i / (SIZE * SIZE), i % (SIZE * SIZE));
            let (row, column) = ((pixel / SIZE) as f32, (pixel % SIZE) as f32);
            let wave = (0.11 * row + 0.07 * column + plane as f32 + phase).sin();
            match plane {
                3 | 4 => 0.2 * wave,
                5 => 1.0,
                6 => 0.4 + 0.25 * wave,
                _ => 0.5 + 0.4 * wave,
            }
        })
        .collect();
    Maps::new(lobe, SIZE, SIZE, data).expect("the planes have the right size")
}

fn shots(separate: bool, count: usize) -> Vec<Shot> {
    (0..count)
        .map(|i| {
            let angle = 2.4 * i as f64;
            let camera = [4.0 * angle.cos(), 4.0 * angle.sin(), 12.0];
            let light = if separate { [camera[0] + 1.0, camera[1], 11.5] } else { camera };
            Shot { camera, light, light_intensity: [420.0, 400.0, 380.0] }
        })
        .collect()
}

fn targets(lobe: Lobe, shots: &[Shot]) -> Vec<Target> {
    let target = |shot: &Shot| {
        let radiance = render_maps(&maps(lobe, 0.5), PATCH, shot)?;
        let encoded: Vec<f32> = radiance.iter().map(|&r| encode_radiance(r).min(1.0)).collect();
        let saturated: Vec<u8> = (0..SIZE * SIZE).map(|p| if radiance[p] > 1.0 { 7 } else { 0 }).collect();
        Target::new(SIZE, SIZE, *shot, &encoded, &saturated)
    };
    shots.iter().map(|shot| target(shot).expect("the maps render")).collect()
}

fn bench(criterion: &mut Criterion) {
    for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
        let maps = maps(lobe, 0.0);
        let mut gradient = maps.clone();
        let mut group = criterion.benchmark_group(format!("{lobe:?}").to_lowercase());
        for (name, separate) in [("collocated", false), ("separate", true)] {
            let shot = shots(separate, 1)[0];
            group.bench_function(format!("render, {name}"), |bencher| {
                bencher.iter(|| render_maps(&maps, PATCH, &shot).expect("the maps render"));
            });
            for count in [1, 4] {
                let targets = targets(lobe, &shots(separate, count));
                group.bench_function(format!("loss and gradient, {count} photos, {name}"), |bencher| {
                    bencher.iter(|| photo_loss(&maps, PATCH, &targets, Some(&mut gradient)).expect("the maps render"));
                });
            }
        }
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);
