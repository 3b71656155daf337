//! One prediction of the photo graph in its default sizes with random weights: `cargo bench --bench photo_graph -- [photos [size]]`, 4 photos of 256 x
//! 256 pixels where nothing is said. Prints seconds of the fastest of some runs, seconds of the processor, and peak memory beside its estimate.

use std::ops::ControlFlow;
use std::time::Instant;

use svbrdf_gcn::nn::{Mirror, PhotoGraph, PhotoGraphConfig};
use svbrdf_gcn::progress::{CancelToken, Control, Progress};
use svbrdf_gcn::{Capture, Image, Photo, Shot, Transfer};

/// Seconds this process has computed, over all threads; none where the system does not tell.
fn processor_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The fields after the name in parentheses; 100 ticks a second.
    let ticks = stat.rsplit(')').next()?.split_whitespace().skip(11).take(2);
    Some(ticks.filter_map(|field| field.parse::<f64>().ok()).sum::<f64>() / 100.0)
}

/// A line of `/proc/self/status` in MB.
fn status(key: &str) -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find(|line| line.starts_with(key))?;
    Some(line.split_whitespace().nth(1)?.parse::<f64>().ok()? * 1024.0 / 1e6)
}

fn main() {
    let mut numbers = std::env::args().filter_map(|argument| argument.parse::<usize>().ok());
    let (photos, size) = (numbers.next().unwrap_or(4), numbers.next().unwrap_or(256));
    let photo = |index: usize| {
        let values = (0..3 * size * size).map(|i| (0.37 * (i + index) as f32).sin().abs()).collect();
        let place = [index as f64, 1.0, 20.0];
        Photo {
            name: index.to_string(),
            shot: Shot { camera: place, light: place, light_intensity: [1200.0; 3] },
            image: Image::new(size, size, 3, values).expect("a photo"),
            saturated: vec![0; size * size],
        }
    };
    let capture = Capture::new((0..photos).map(photo).collect(), 10.0, Transfer::Gamma22).expect("a capture");
    let graph = PhotoGraph::random(PhotoGraphConfig::default(), 1).expect("a network");
    let mut callback = |_: &Progress| ControlFlow::Continue(());
    let mut control = Control::new(&mut callback, CancelToken::new());
    let before = status("VmRSS");
    let runs = if size > 1000 { 1 } else { 5 };
    let mut fastest = f64::INFINITY;
    let computed = processor_seconds();
    for _ in 0..runs {
        let begun = Instant::now();
        graph.predict(&capture, Mirror::default(), &mut control).expect("a prediction");
        fastest = fastest.min(begun.elapsed().as_secs_f64());
    }
    let computed = processor_seconds().zip(computed).map(|(after, before)| (after - before) / f64::from(runs));
    let peak = status("VmHWM").zip(before).map(|(peak, before)| peak - before);
    let estimate = graph.memory(photos, size, size) as f64 / 1e6;
    eprintln!(
        "{photos} photos of {size} x {size}: {fastest:.3} s; processor {computed:.3?} s; peak {peak:.0?} MB, estimated {estimate:.0} MB"
    );
}
