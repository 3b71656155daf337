use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use safetensors::{Dtype, SafeTensors};

use super::batch::{Batch, Example};
use super::config::{LossSettings, OptimiserSettings};
use super::optimiser;
use super::trainer::{Measured, Trainer};
use crate::nn::{PhotoGraphConfig, Scalar};
use crate::shot::Shot;

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/training")
}

/// A file of tensors, `f32` or `f64`.
struct Tensors(Vec<u8>);

impl Tensors {
    fn open(name: &str) -> Self {
        Self(std::fs::read(folder().join(name)).unwrap())
    }

    fn get(&self, name: &str) -> Vec<f64> {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        let tensor = file.tensor(name).unwrap();
        match tensor.dtype() {
            Dtype::F32 => tensor.data().as_chunks().0.iter().map(|&value| f32::from_le_bytes(value).into()).collect(),
            Dtype::F64 => tensor.data().as_chunks().0.iter().map(|&value| f64::from_le_bytes(value)).collect(),
            other => panic!("{name}: {other}"),
        }
    }

    fn single(&self, name: &str) -> Vec<f32> {
        self.get(name).into_iter().map(|value| value as f32).collect()
    }
}

const PHOTOS: usize = 3;
const HEIGHT: usize = 18;
const WIDTH: usize = 22;
const VIEWS: usize = 3;

fn batch(steps: &Tensors) -> Batch {
    let (inputs, maps) = (steps.single("inputs"), steps.single("maps"));
    let places = ["camera", "light", "intensity"].map(|name| steps.get(name));
    let view = |index: usize| {
        let [camera, light, light_intensity] =
            places.each_ref().map(|values| std::array::from_fn(|axis| values[3 * index + axis]));
        Shot { camera, light, light_intensity }
    };
    let examples = inputs.chunks_exact(PHOTOS * 13 * HEIGHT * WIDTH).zip(maps.chunks_exact(10 * HEIGHT * WIDTH));
    let example = |(index, (inputs, maps)): (usize, (&[f32], &[f32]))| Example {
        inputs: inputs.to_vec(),
        maps: maps.to_vec(),
        views: (index * VIEWS..(index + 1) * VIEWS).map(view).collect(),
    };
    let examples = examples.enumerate().map(example).collect();
    Batch { photos: PHOTOS, height: HEIGHT, width: WIDTH, examples }
}

fn state() -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(folder().join("checkpoint/state.json")).unwrap()).unwrap()
}

fn settings() -> (PhotoGraphConfig, OptimiserSettings, LossSettings) {
    let config = &state()["config"];
    let of = |name: &str| config[name].clone();
    (
        serde_json::from_value(of("model")).unwrap(),
        serde_json::from_value(of("optimiser")).unwrap(),
        serde_json::from_value(of("loss")).unwrap(),
    )
}

fn trainer<E: Scalar + crate::brdf::real::Real>(steps: &Tensors) -> Trainer<E> {
    let (model, optimiser, loss) = settings();
    let start = |(name, _): (String, Vec<usize>)| {
        let values: Vec<E> = steps.get(&format!("start.{name}")).into_iter().map(<E as Scalar>::of).collect();
        (name, Arc::new(values))
    };
    let values: BTreeMap<_, _> = model.tensors().into_iter().map(start).collect();
    Trainer::from_values(model, optimiser, loss, values)
}

/// Fails where values differ by more than `tolerance` of the largest, or 1e-12.
fn compare<E: Scalar>(got: &[E], expected: &[f64], tolerance: f64, what: &str) {
    assert_eq!(got.len(), expected.len(), "{what}");
    let scale = expected.iter().fold(0.0, |a: f64, value| a.max(value.abs()));
    for (i, (got, expected)) in got.iter().zip(expected).enumerate() {
        let off = (got.wide() - expected).abs();
        assert!(off <= (tolerance * scale).max(1e-12), "{what}, {i}: {got:?} {expected}, largest {scale}");
    }
}

fn compare_gradients<E: Scalar + crate::brdf::real::Real>(tolerance: f64) {
    let steps = Tensors::open("steps.safetensors");
    let trainer = trainer::<E>(&steps);
    let (_, mut gradients) = trainer.gradients(&batch(&steps)).unwrap();
    let norm = optimiser::norm(&gradients);
    compare(&[norm], &steps.get("measured.norm")[..1], tolerance, "norm");
    let clip = settings().1.clip;
    assert!(norm > clip);
    let factor = <E as Scalar>::of(optimiser::clip(norm, clip));
    let mut largest = 0.0f64;
    for (name, gradient) in &mut gradients {
        gradient.iter_mut().for_each(|slope| *slope *= factor);
        let expected = steps.get(&format!("gradient.{name}"));
        largest = expected.iter().fold(largest, |a, value| a.max(value.abs()));
        // Adding a constant to the logits of all senders changes nothing.
        if name.ends_with("key.bias") {
            assert!(gradient.iter().all(|slope| slope.wide().abs() < tolerance * largest), "{name}: {gradient:?}");
        } else {
            compare(gradient, &expected, tolerance, name);
        }
    }
}

#[test]
fn gradients_of_the_pytorch_trainer() {
    compare_gradients::<f64>(1e-8);
}

#[test]
fn gradients_in_single_precision() {
    // Absolute values and maxima have kinks: at some pixels rounding decides on which side.
    compare_gradients::<f32>(2e-3);
}

fn compare_measured(got: Measured, steps: &Tensors, step: usize, tolerance: f64, of_norm: f64) {
    for (name, value) in got.entries() {
        let tolerance = if name == "norm" { of_norm } else { tolerance };
        compare(&[value], &steps.get(&format!("measured.{name}"))[step..=step], tolerance, name);
    }
}

#[test]
fn steps_of_the_pytorch_trainer() {
    let steps = Tensors::open("steps.safetensors");
    let batch = batch(&steps);
    let (mut wide, mut single) = (trainer::<f64>(&steps), trainer::<f32>(&steps));
    let rates = steps.get("rate");
    for (step, &rate) in rates.iter().enumerate() {
        compare_measured(wide.step(&batch, rate).unwrap(), &steps, step, 1e-9, 1e-9);
        compare_measured(single.step(&batch, rate).unwrap(), &steps, step, 1e-5, 1e-3);
    }
    assert_eq!(wide.steps(), rates.len());
    for (which, file) in ["model", "average", "moment1", "moment2"].into_iter().enumerate() {
        let expected = Tensors::open(&format!("checkpoint/{file}.safetensors"));
        for (name, _) in settings().0.tensors() {
            // What the fixture holds is rounded to single precision.
            compare(wide.part(which, &name), &expected.get(&name), 1e-7, &format!("{file}, {name}"));
        }
    }
}

#[test]
fn checkpoints_of_the_pytorch_trainer_there_and_back() {
    let (model, optimiser, loss) = settings();
    let mut trainer = Trainer::new(model.clone(), optimiser, loss, 1).unwrap();
    let state_ = trainer.load(&folder()).unwrap();
    assert_eq!(state_, state());
    assert_eq!(trainer.steps(), 3);
    let place = tempfile::tempdir().unwrap();
    // Twice, so that one replaces the other.
    trainer.save(place.path(), &serde_json::json!({"seconds": 1.5})).unwrap();
    trainer.save(place.path(), &state_).unwrap();
    assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 1);
    for file in ["model", "average", "moment1", "moment2"] {
        let name = format!("checkpoint/{file}.safetensors");
        let (ours, theirs) = (std::fs::read(place.path().join(&name)).unwrap(), Tensors::open(&name).0);
        let (ours, theirs) = (SafeTensors::deserialize(&ours).unwrap(), SafeTensors::deserialize(&theirs).unwrap());
        assert_eq!(ours.len(), theirs.len());
        for (name, tensor) in theirs.tensors() {
            let ours = ours.tensor(&name).unwrap();
            assert_eq!((ours.dtype(), ours.shape()), (tensor.dtype(), tensor.shape()), "{file}, {name}");
            assert!(ours.data() == tensor.data(), "{file}, {name}");
        }
    }
    let text = std::fs::read(place.path().join("checkpoint/state.json")).unwrap();
    assert_eq!(serde_json::from_slice::<serde_json::Value>(&text).unwrap(), state_);
}

#[test]
fn training_goes_on_exactly_where_it_stopped() {
    let steps = Tensors::open("steps.safetensors");
    let batch = batch(&steps);
    let (model, optimiser, loss) = settings();
    let fresh = |seed| Trainer::new(model.clone(), optimiser.clone(), loss.clone(), seed).unwrap();
    let mut whole = fresh(2);
    let expected: Vec<Measured> = (0..4).map(|_| whole.step(&batch, 1e-3).unwrap()).collect();
    let place = tempfile::tempdir().unwrap();
    let mut first = fresh(2);
    (0..2).for_each(|step| assert_eq!(first.step(&batch, 1e-3).unwrap(), expected[step]));
    first.save(place.path(), &state()).unwrap();
    let mut second = fresh(3);
    second.load(place.path()).unwrap();
    (2..4).for_each(|step| assert_eq!(second.step(&batch, 1e-3).unwrap(), expected[step]));
    for (name, _) in model.tensors() {
        (0..4).for_each(|which| assert_eq!(whole.part(which, &name), second.part(which, &name), "{name}"));
    }

    // Without moments the parameters are the same, and the optimiser starts afresh.
    std::fs::remove_file(place.path().join("checkpoint/moment2.safetensors")).unwrap();
    let mut third = fresh(3);
    third.load(place.path()).unwrap();
    assert_eq!(third.steps(), 2);
    assert_eq!(third.step(&batch, 1e-3).unwrap(), expected[2]);
    assert!(third.step(&batch, 1e-3).unwrap().loss.is_finite());
}

#[test]
fn steps_lower_the_loss() {
    let steps = Tensors::open("steps.safetensors");
    let batch = batch(&steps);
    let (model, optimiser, loss) = settings();
    let mut trainer = Trainer::new(model, optimiser, loss, 2).unwrap();
    let losses: Vec<f64> = (0..40).map(|_| trainer.step(&batch, 3e-3).unwrap().loss).collect();
    assert!(losses[39] < 0.8 * losses[0], "{losses:?}");
    // What validation runs is the network of the moving average.
    let averaged = trainer.averaged().unwrap();
    assert_eq!(averaged.config(), &settings().0);
}

#[test]
fn broken_batches_and_gradients_change_nothing() {
    let steps = Tensors::open("steps.safetensors");
    let (model, optimiser, loss) = settings();
    let mut trainer = Trainer::new(model, optimiser, loss, 2).unwrap();
    let before = trainer.part(0, "intro.weight").to_vec();
    let broken = |edit: &dyn Fn(&mut Batch)| {
        let mut batch = batch(&steps);
        edit(&mut batch);
        batch
    };
    for (edit, named) in [
        (&(|batch: &mut Batch| batch.examples.clear()) as &dyn Fn(&mut Batch), "batch"),
        (&|batch: &mut Batch| batch.photos = 2, "inputs"),
        (&|batch: &mut Batch| batch.height = 0, "inputs"),
        (&|batch: &mut Batch| batch.examples[1].inputs.truncate(9), "inputs"),
        (&|batch: &mut Batch| batch.examples[1].maps.truncate(9), "maps"),
        (&|batch: &mut Batch| batch.examples[1].views.clear(), "views"),
    ] {
        let message = trainer.step(&broken(edit), 1e-3).unwrap_err().to_string();
        assert!(message.contains(named), "{message}");
    }
    assert_eq!(trainer.steps(), 0);
    let measured = trainer.step(&broken(&|batch| batch.examples[0].inputs[7] = f32::NAN), 1e-3).unwrap();
    assert_eq!((measured.norm, measured.skipped), (0.0, 1.0));
    assert_eq!(trainer.steps(), 1);
    assert_eq!(trainer.part(0, "intro.weight"), before);
    assert_eq!(trainer.step(&batch(&steps), 1e-3).unwrap().skipped, 0.0);
    assert_ne!(trainer.part(0, "intro.weight"), before);
}

#[test]
fn broken_checkpoints_are_refused() {
    let (model, optimiser, loss) = settings();
    let mut trainer = Trainer::new(model.clone(), optimiser.clone(), loss.clone(), 1).unwrap();
    let place = tempfile::tempdir().unwrap();
    assert!(matches!(trainer.load(place.path()), Err(crate::Error::Io { .. })));
    assert!(trainer.save(place.path(), &serde_json::json!([1])).unwrap_err().to_string().contains("state"));
    trainer.save(place.path(), &state()).unwrap();
    let before = trainer.part(0, "intro.weight").to_vec();
    let mut refused = |file: &str, content: &[u8], named: &str| {
        let path = place.path().join("checkpoint").join(file);
        let good = std::fs::read(&path).unwrap();
        std::fs::write(&path, content).unwrap();
        let message = trainer.load(place.path()).unwrap_err().to_string();
        assert!(message.contains(file) && message.contains(named), "{message}");
        std::fs::write(&path, good).unwrap();
    };
    refused("state.json", b"{", "EOF");
    refused("state.json", b"{}", "config.model");
    let mut other = state();
    other["step"] = "three".into();
    refused("state.json", other.to_string().as_bytes(), "step");
    other["config"]["model"]["width"] = 5.into();
    refused("state.json", other.to_string().as_bytes(), "width: 5");
    refused("average.safetensors", b"nothing", "average");
    refused("moment1.safetensors", &std::fs::read(folder().join("steps.safetensors")).unwrap(), "missing");
    assert_eq!(trainer.part(0, "intro.weight"), before);
    trainer.load(place.path()).unwrap();
}

/// Seconds of a step of the default network on four crops of 96 x 96 with four photos.
#[test]
#[ignore = "a measurement"]
fn time_of_a_step() {
    let (photos, side) = (4, 96);
    let mut rng = fastrand::Rng::with_seed(1);
    let mut numbers = |len: usize| (0..len).map(|_| rng.f32()).collect::<Vec<_>>();
    let shot = Shot { camera: [0.1, 0.0, 3.0], light: [0.5, -0.5, 2.5], light_intensity: [20.0; 3] };
    let mut example = || Example {
        inputs: numbers(photos * 13 * side * side),
        maps: numbers(10 * side * side),
        views: vec![shot; 9],
    };
    let examples = (0..4).map(|_| example()).collect();
    let batch = Batch { photos, height: side, width: side, examples };
    let config = PhotoGraphConfig::default();
    let mut trainer = Trainer::new(config, OptimiserSettings::default(), LossSettings::default(), 1).unwrap();
    let times: Vec<f64> = (0..6)
        .map(|_| {
            let begin = std::time::Instant::now();
            trainer.step(&batch, 1e-4).unwrap();
            begin.elapsed().as_secs_f64()
        })
        .collect();
    eprintln!("seconds of a step: {times:.3?}");
}
