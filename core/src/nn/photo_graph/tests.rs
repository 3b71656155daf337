use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;

use safetensors::SafeTensors;

use super::config::{HINTS, INPUTS};
use super::hints::Hints;
use super::input::View;
use super::{Mirror, Net, Output, PhotoGraph, PhotoGraphConfig, build, input, padded};
use crate::capture::{Capture, Photo};
use crate::color::Transfer;
use crate::error::Error;
use crate::image::Image;
use crate::maps::{Lobe, Maps};
use crate::nn::layout::Layout;
use crate::nn::model::Model;
use crate::nn::model::testing::{self, reason};
use crate::nn::ops::testing::{compare, numbers};
use crate::nn::scalar::Scalar;
use crate::nn::tape::{Planes, Pool};
use crate::progress::{CancelToken, Control, Progress};
use crate::shot::Shot;

fn go_on(_: &Progress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn fixture(name: &str) -> Vec<u8> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/default");
    std::fs::read(folder.join(name)).unwrap()
}

fn graph() -> PhotoGraph {
    let model = Model::from_bytes(&fixture("weights.safetensors")).unwrap();
    assert_eq!(model.license(), "CC0-1.0");
    assert_eq!(model.facts()["data"], "random weights");
    assert!(model.networks().is_empty());
    assert!(model.network(4).unwrap_err().to_string().contains("photo graph"));
    let PhotoGraph { config, tensors, .. } = model.photo_graph().unwrap();
    PhotoGraph::new(config.clone(), |name, _| Ok(tensors[name].to_vec())).unwrap()
}

/// The expected values of the fixture: three photos of 14 x 18 pixels.
struct Expected(Vec<u8>);

const SIZE: (usize, usize) = (14, 18);

impl Expected {
    fn open() -> Self {
        Self(fixture("expected.safetensors"))
    }

    fn get(&self, name: &str) -> Vec<f64> {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        let tensor = file.tensor(name).unwrap();
        assert_eq!(tensor.dtype(), safetensors::Dtype::F32);
        tensor.data().as_chunks().0.iter().map(|&value| f64::from(f32::from_le_bytes(value))).collect()
    }

    fn capture(&self, patch_size: f64) -> Capture {
        let (height, width) = SIZE;
        let (photos, saturated) = (self.get("photos"), self.get("saturated"));
        let unit = patch_size / 2.0;
        let vector = |name: &str, photo: usize, scale: f64| -> [f64; 3] {
            let all = self.get(name);
            std::array::from_fn(|axis| all[3 * photo + axis] * scale)
        };
        let photo = |index: usize| {
            let pixels = height * width;
            let linear: Vec<f32> =
                photos[3 * index * pixels..][..3 * pixels].iter().map(|value| value.powf(2.2) as f32).collect();
            Photo {
                name: format!("{index}"),
                shot: Shot {
                    camera: vector("camera", index, unit),
                    light: vector("light", index, unit),
                    light_intensity: vector("intensity", index, unit * unit),
                },
                image: Image::from_planar(width, height, 3, &linear).unwrap(),
                // Any channel counts.
                saturated: saturated[index * pixels..][..pixels].iter().map(|&value| 2 * value as u8).collect(),
            }
        };
        Capture::new((0..3).map(photo).collect(), patch_size, Transfer::Gamma22).unwrap()
    }
}

/// Runs the network on planes that lie one after the other, photo after photo.
fn run<E: Scalar>(net: &Net<E>, config: &PhotoGraphConfig, inputs: &[f64], size: (usize, usize)) -> Output<E> {
    let mut callback = go_on;
    let mut control = Control::new(&mut callback, CancelToken::new());
    let layout = padded(config, size.0, size.1);
    let photos: Vec<Vec<E>> = inputs
        .chunks_exact(INPUTS * size.0 * size.1)
        .map(|planes| planes.iter().map(|&value| E::splat(value)).collect())
        .collect();
    let photo =
        |index: usize, pool: &Pool<E>| Planes::pooled(layout.pack(&photos[index], size.0, size.1), layout, pool);
    net.run(config, photos.len(), layout, size, photo, &mut control).unwrap()
}

fn wide(graph: &PhotoGraph) -> Net<f64> {
    let convert = |values: &Arc<Vec<f32>>| Arc::new(values.iter().map(|&value| f64::from(value)).collect());
    build(&graph.config, &graph.tensors, convert).unwrap()
}

fn widened(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&value| value.into()).collect()
}

#[test]
fn answers_of_the_training_code() {
    let (graph, expected) = (graph(), Expected::open());
    let inputs = expected.get("inputs");
    let net = wide(&graph);
    let got = run(&net, &graph.config, &inputs, SIZE);
    // The fixture was computed in f64 from inputs that it holds in f32.
    compare(&got.raw, &expected.get("raw"), 1e-5, "raw");
    compare(&got.log_sigma, &expected.get("log_sigma"), 1e-5, "log_sigma");
    for window in [None, Some(1000), Some(24)] {
        let config = PhotoGraphConfig { window, ..graph.config.clone() };
        compare(&run(&net, &config, &inputs, SIZE).raw, &expected.get("raw_global"), 1e-5, "raw_global");
    }
    let one = &inputs[..INPUTS * SIZE.0 * SIZE.1];
    compare(&run(&net, &graph.config, one, SIZE).raw, &expected.get("raw_single"), 1e-5, "raw_single");
    let mut maps = Maps::new(Lobe::Isotropic, SIZE.1, SIZE.0, vec![0.0; 10 * SIZE.0 * SIZE.1]).unwrap();
    graph.decoding().unwrap().decode(&got.raw, &mut maps).unwrap();
    compare(maps.data(), &expected.get("maps"), 1e-5, "maps");

    let single = run(&graph.net, &graph.config, &inputs, SIZE);
    compare(&widened(&single.raw), &expected.get("raw"), 1e-4, "raw in f32");
    compare(&widened(&single.log_sigma), &expected.get("log_sigma"), 1e-4, "log_sigma in f32");
}

/// The hints of planes that lie one after the other, photo after photo, continued with zeros.
fn hints<E: Scalar>(config: &PhotoGraphConfig, inputs: &[f64]) -> Vec<f64> {
    let (layout, pool) = (padded(config, SIZE.0, SIZE.1), Pool::default());
    let mut hints = Hints::<E>::new(layout, &pool);
    for planes in inputs.chunks_exact(INPUTS * SIZE.0 * SIZE.1) {
        let planes: Vec<E> = planes.iter().map(|&value| E::splat(value)).collect();
        hints.add(&layout.pack(&planes, SIZE.0, SIZE.1));
    }
    let planes = hints.finish(&pool).unwrap();
    planes.layout.unpack(planes.values(), layout.height, layout.width).into_iter().map(Scalar::wide).collect()
}

#[test]
fn hints_of_the_training_code() {
    let (graph, expected) = (graph(), Expected::open());
    let (inputs, expected) = (expected.get("inputs"), expected.get("hints"));
    assert_eq!(expected.len(), HINTS * 16 * 24);
    // Every plane tells something.
    assert!(expected.chunks_exact(16 * 24).all(|plane| plane.iter().any(|value| value.abs() > 0.02)));
    // Stored in f32, computed from inputs that the fixture holds in f32.
    compare(&hints::<f64>(&graph.config, &inputs), &expected, 1e-6, "hints");
    compare(&hints::<f32>(&graph.config, &inputs), &expected, 1e-5, "hints in f32");
}

/// Every pixel as it is.
const WHOLE: View = View { mirror: Mirror { x: false, y: false }, step: 1 };

#[test]
fn from_a_capture_in_any_unit() {
    let (graph, expected) = (graph(), Expected::open());
    let inputs = expected.get("inputs");
    for patch_size in [2.0, 9.7] {
        let capture = expected.capture(patch_size);
        let layout = padded(&graph.config, SIZE.0, SIZE.1);
        for (photo, expected) in capture.photos().iter().zip(inputs.chunks_exact(INPUTS * SIZE.0 * SIZE.1)) {
            let planes = input::planes(photo, patch_size, WHOLE, layout, &Pool::default()).unwrap();
            compare(&widened(&layout.unpack(planes.values(), SIZE.0, SIZE.1)), expected, 2e-6, "inputs");
            assert!(
                planes.values().iter().filter(|value| **value != 0.0).count() <= expected.len(),
                "zeros beyond the photo"
            );
        }
        let mut callback = go_on;
        let mut control = Control::new(&mut callback, CancelToken::new());
        let prediction = graph.predict_at(&capture, WHOLE, &mut control).unwrap();
        assert_eq!((prediction.height, prediction.width), SIZE);
        compare(&widened(&prediction.raw), &expected.get("raw"), 1e-4, "raw");
        compare(&widened(&prediction.log_sigma), &expected.get("log_sigma"), 1e-4, "log_sigma");
        let maps = graph.maps(&prediction).unwrap();
        compare(&widened(maps.data()), &expected.get("maps"), 1e-4, "maps");
    }
}

#[test]
fn the_order_of_photos_does_not_matter() {
    let (graph, expected) = (graph(), Expected::open());
    let net = wide(&graph);
    let inputs = expected.get("inputs");
    let photos: Vec<&[f64]> = inputs.chunks_exact(INPUTS * SIZE.0 * SIZE.1).collect();
    let a = run(&net, &graph.config, &inputs, SIZE);
    for order in [[1, 2, 0], [2, 1, 0]] {
        let b = run(&net, &graph.config, &order.map(|photo| photos[photo]).concat(), SIZE);
        compare(&b.raw, &a.raw, 1e-11, "raw");
        compare(&b.log_sigma, &a.log_sigma, 1e-11, "log_sigma");
    }
    let two = run(&net, &graph.config, &photos[..2].concat(), SIZE);
    let off = two.raw.iter().zip(&a.raw).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off > 1e-3, "a photo more tells nothing: {off}");
}

#[test]
fn any_size_and_number_of_photos() {
    let config = PhotoGraphConfig {
        stem: 3,
        stem_blocks: 1,
        node: 4,
        width: 4,
        blocks: vec![1, 0],
        middle: 1,
        tail: 3,
        window: Some(5),
        ..PhotoGraphConfig::default()
    };
    let graph = PhotoGraph::random(config, 3).unwrap();
    for (photos, height, width) in [(1, 1, 1), (2, 5, 33), (70, 9, 8), (3, 40, 2)] {
        let inputs = numbers(photos * INPUTS * height * width, 1);
        let out = run(&graph.net, &graph.config, &inputs, (height, width));
        assert_eq!((out.raw.len(), out.log_sigma.len()), (9 * height * width, 9 * height * width));
        assert!(out.raw.iter().all(|value| value.is_finite()));
        assert!(out.log_sigma.iter().all(|value| (-7.0..=1.0).contains(value)));
    }
}

#[test]
fn a_mirror_shows_the_capture_mirrored_and_maps_as_they_are() {
    let (graph, capture) = (graph(), Expected::open().capture(2.0));
    let mut callback = go_on;
    let mut control = Control::new(&mut callback, CancelToken::new());
    let (height, width) = SIZE;
    for (mirror, [x, y]) in Mirror::IMAGES.into_iter().zip([[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]]) {
        let other = |p: usize| {
            let (row, column) = (p / width, p % width);
            let (row, column) =
                (if y < 0.0 { height - 1 - row } else { row }, if x < 0.0 { width - 1 - column } else { column });
            row * width + column
        };
        let place = |place: [f64; 3]| [x * place[0], y * place[1], place[2]];
        let photo = |photo: &Photo| {
            let image = (0..height * width).flat_map(|p| &photo.image.data()[3 * other(p)..][..3]).copied();
            Photo {
                shot: Shot { camera: place(photo.shot.camera), light: place(photo.shot.light), ..photo.shot },
                image: Image::new(width, height, 3, image.collect()).unwrap(),
                saturated: (0..height * width).map(|p| photo.saturated[other(p)]).collect(),
                ..photo.clone()
            }
        };
        let photos = capture.photos().iter().map(photo).collect();
        let by_hand = Capture::new(photos, capture.patch_size(), Transfer::Gamma22).unwrap();
        let expected = graph.predict(&by_hand, Mirror::default(), &mut control).unwrap();
        let found = graph.predict(&capture, mirror, &mut control).unwrap();
        for (plane, sign) in [1.0, 1.0, 1.0, x, y, 1.0, 1.0, 1.0, 1.0].into_iter().enumerate() {
            for p in 0..height * width {
                let (at, from) = (plane * height * width + p, plane * height * width + other(p));
                assert_eq!(found.raw[at], sign as f32 * expected.raw[from], "{mirror:?}, plane {plane}, pixel {p}");
                assert_eq!(found.log_sigma[at], expected.log_sigma[from], "{mirror:?}, plane {plane}, pixel {p}");
            }
        }
    }
}

#[test]
fn can_be_cancelled() {
    let (graph, capture) = (graph(), Expected::open().capture(2.0));
    let mut polls = 0;
    let mut count = |_: &Progress| {
        polls += 1;
        ControlFlow::Continue(())
    };
    graph.predict(&capture, Mirror::default(), &mut Control::new(&mut count, CancelToken::new())).unwrap();
    assert!(polls > 20, "{polls}");
    for stop_at in [0, 1, polls / 2, polls - 1] {
        let mut seen = 0;
        let mut stop = |_: &Progress| {
            seen += 1;
            if seen > stop_at { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let result = graph.predict(&capture, Mirror::default(), &mut Control::new(&mut stop, CancelToken::new()));
        assert!(matches!(result, Err(Error::Cancelled)), "{stop_at}");
    }
}

/// The fixture's weights with the metadata or header changed.
fn edited(edit: impl FnOnce(&mut serde_json::Map<String, serde_json::Value>)) -> Vec<u8> {
    testing::edited(&fixture("weights.safetensors"), edit)
}

#[test]
fn broken_files_are_refused() {
    let with = |field: &str, value: serde_json::Value| {
        edited(|header| {
            let text = header["__metadata__"]["architecture"].as_str().unwrap();
            let mut architecture: serde_json::Value = serde_json::from_str(text).unwrap();
            architecture[field] = value;
            header["__metadata__"]["architecture"] = architecture.to_string().into();
        })
    };
    assert!(reason(&with("kind", "tree".into())).contains("photo graph"));
    assert!(reason(&with("width", (1u64 << 40).into())).contains("width"));
    // In range and larger than the file.
    assert!(reason(&with("width", 1024.into())).contains("entry.weight"));
    assert!(reason(&with("rounds", 16.into())).contains("rounds.2"));
    assert!(reason(&with("rounds", 1.into())).contains("rounds.1"));
    assert!(reason(&with("tail_blocks", 0.into())).contains("tail.0"));
    assert!(reason(&edited(|header| header["__metadata__"]["channels"] = "other".into())).contains("channels"));
    assert!(reason(&edited(|header| header["__metadata__"]["architecture"] = "{".into())).contains("architecture"));
    let renamed = edited(|header| {
        let entry = header.remove("fold.bias").unwrap();
        header.insert("surplus".into(), entry);
    });
    assert!(reason(&renamed).contains("fold.bias"));
    assert!(
        reason(&edited(|header| header["fold.weight"]["shape"] = serde_json::json!([2, 8, 2, 2]))).contains("fold")
    );
    let file = fixture("weights.safetensors");
    for len in (0..file.len()).step_by(997) {
        reason(&file[..len]);
    }
}

#[test]
fn saved_and_loaded_again() {
    let model = Model::from_bytes(&fixture("weights.safetensors")).unwrap();
    let file = tempfile::NamedTempFile::new().unwrap();
    model.save(file.path()).unwrap();
    let again = Model::load_for(file.path(), 1).unwrap();
    assert_eq!(again.license(), model.license());
    assert_eq!(again.facts(), model.facts());
    let (a, b) = (model.photo_graph().unwrap(), again.photo_graph().unwrap());
    assert_eq!(a.config, b.config);
    assert_eq!(a.tensors, b.tensors);
    assert_eq!(a.parameters(), model.photo_graph().unwrap().tensors.values().map(|values| values.len()).sum::<usize>());
}

#[test]
fn the_default_sizes() {
    let config = PhotoGraphConfig::default();
    let shapes: BTreeMap<_, _> = config.tensors().into_iter().collect();
    assert_eq!(shapes["fold.weight"], [32, 16, 2, 2]);
    assert_eq!(shapes["middle_blks.2.conv1.weight"][..2], [512, 256]);
    assert_eq!((&shapes["skip.weight"][..2], &shapes["entry.weight"][..2]), (&[16, 59][..], &[64, 107][..]));
    assert_eq!(config.grain(), 8);
    let graph = PhotoGraph::random(config, 1).unwrap();
    assert_eq!(graph.parameters(), shapes.values().map(|shape| shape.iter().product::<usize>()).sum::<usize>());
    let few = graph.memory(1, 256, 256);
    assert!((1 << 20..1 << 29).contains(&few), "{few}");
    assert!(graph.memory(64, 256, 256) > few);
    assert!(graph.memory(usize::MAX, 1 << 40, 1 << 40) > 1 << 60);
    let layout = padded(graph.config(), 255, 257);
    assert_eq!(layout, Layout { channels: INPUTS, height: 256, width: 264 });
}
