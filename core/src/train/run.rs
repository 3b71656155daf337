//! The loop: steps, a log, checkpoints, validation, and the weights at the end.

use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde_json::{Map, Value, json};

use super::config::Configuration;
use super::data::Data;
use super::data::library::Library;
use super::trainer::Trainer;
use super::validate::{Validation, held_out, validate, work};
use crate::error::{Error, Result};
use crate::maps::Maps;
use crate::nn::Model;
use crate::progress::{CancelToken, Control};

/// How a run of a training ends, and what its weights say of themselves.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct RunOptions {
    /// End the run after so many seconds, with a checkpoint; none: when the training is complete.
    pub seconds: Option<f64>,
    /// The licence that the weights state.
    pub license: String,
    /// Ends the run after the step that is running, with a checkpoint.
    pub cancel: CancelToken,
}

impl Default for RunOptions {
    fn default() -> Self {
        Self { seconds: None, license: "not stated".into(), cancel: CancelToken::new() }
    }
}

/// What a run tells.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub enum Event<'a> {
    /// The materials are read.
    Started {
        /// Materials to train on.
        materials: usize,
        /// Materials held out.
        held_out: usize,
        /// Parameters of the network.
        parameters: usize,
        /// Steps of earlier runs.
        step: u64,
    },
    /// The names of settings that differ from the checkpoint's.
    Changed(&'a [String]),
    /// A step is done.
    Stepped {
        /// Steps so far.
        step: u64,
        /// From 0 to 1 over the whole training.
        progress: f64,
        /// Means of losses over the last steps, as the log has them, at every entry of it.
        entry: Option<&'a Map<String, Value>>,
    },
    /// Held-out materials are judged from here on.
    Validating,
    /// They were.
    Validated(&'a Validation),
}

/// What a run came to.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Summary {
    /// Steps so far, those of earlier runs among them.
    pub steps: u64,
    /// Seconds of training, likewise.
    pub seconds: f64,
    /// From 0 to 1 over the whole training.
    pub progress: f64,
    /// Whether the run was cancelled.
    pub cancelled: bool,
    /// The averaged weights.
    pub model: PathBuf,
}

/// Trains, or goes on from `folder`/checkpoint, and writes `folder`/log.jsonl, checkpoints, and the averaged weights as `folder`/model.safetensors.
///
/// On the threads of the current rayon pool.
///
/// # Errors
/// As [`Configuration::load`] for the materials it names; [`Error::Io`] if a file cannot be read or written; [`Error::Weights`] if the checkpoint
/// is of another network.
pub fn run(
    config: &Configuration,
    folder: &Path,
    options: &RunOptions,
    on_event: &mut dyn FnMut(&Event<'_>),
) -> Result<Summary> {
    let began = Instant::now();
    let settings = (config.optimiser.clone(), config.loss.clone());
    let trainer = Trainer::new(config.model.clone(), settings.0, settings.1, config.seed)?;
    let mut run = Run { config, folder, trainer, seconds: 0.0, cancel: options.cancel.clone(), last: None };
    if ["checkpoint", "checkpoint.old"].iter().any(|name| folder.join(name).exists()) {
        let state = run.trainer.load(folder)?;
        run.seconds = state.get("seconds").and_then(Value::as_f64).unwrap_or(0.0);
        let changed = changed(config, &state)?;
        if !changed.is_empty() {
            on_event(&Event::Changed(&changed));
        }
    }
    let library = Library::open(Path::new(&config.data.pack))?;
    let maps = held_out(&library.validation, config.validation.size)?;
    let facts = library.facts();
    fs::create_dir_all(folder).map_err(|error| Error::io(folder, error))?;
    let mut data = Data::new(config, library.training);
    on_event(&Event::Started {
        materials: data.materials(),
        held_out: maps.len(),
        parameters: run.trainer.averaged()?.parameters(),
        step: run.step(),
    });

    let (mut saved, mut checked) = (Instant::now(), Instant::now());
    let mut means = Means::default();
    let mut reserve = Reserve::default();
    while run.progress() < 1.0 && !run.cancel.is_cancelled() {
        let left = options.seconds.map(|seconds| seconds - began.elapsed().as_secs_f64());
        if left.is_some_and(|left| left < reserve.seconds(work(maps.len(), &config.validation))) {
            break;
        }
        let mark = Instant::now();
        let Some(phase) = config.phase_at(run.progress()) else { break };
        let batch = data.batch(run.step(), phase.batch, phase.size)?;
        let pixels = (phase.batch * batch.photos * phase.size * phase.size) as f64;
        let measured = run.trainer.step(&batch, config.optimiser.rate_at(run.progress()))?;
        run.seconds += mark.elapsed().as_secs_f64();
        reserve.stepped(mark.elapsed().as_secs_f64(), pixels);
        means.add(&measured.entries());

        let entry = if means.count == config.log_steps || run.step() == 1 || run.progress() >= 1.0 {
            let mut entry = means.take();
            entry.insert("step".into(), run.step().into());
            entry.insert("seconds".into(), rounded(run.seconds, 100.0).into());
            entry.insert("rate".into(), config.optimiser.rate_at(run.progress()).into());
            run.log(&entry)?;
            Some(entry)
        } else {
            None
        };
        on_event(&Event::Stepped { step: run.step(), progress: run.progress(), entry: entry.as_ref() });
        if saved.elapsed().as_secs_f64() > 60.0 * config.checkpoint_minutes {
            run.save()?;
            saved = Instant::now();
        }
        if checked.elapsed().as_secs_f64() > 60.0 * config.validation.minutes {
            let mark = Instant::now();
            run.check(&maps, on_event)?;
            reserve.validation = Some(mark.elapsed().as_secs_f64());
            checked = Instant::now();
        }
    }
    run.save()?;
    if !run.cancel.is_cancelled() {
        run.check(&maps, on_event)?;
    }
    let model = folder.join("model.safetensors");
    run.export(&model, facts, &options.license)?;
    Ok(Summary {
        steps: run.step(),
        seconds: run.seconds,
        progress: run.progress(),
        cancelled: run.cancel.is_cancelled(),
        model,
    })
}

/// A training and where it stands.
struct Run<'a> {
    config: &'a Configuration,
    folder: &'a Path,
    trainer: Trainer,
    /// Of training, without checkpoints and validations.
    seconds: f64,
    cancel: CancelToken,
    /// The last validation's entry of the log.
    last: Option<Value>,
}

impl Run<'_> {
    fn step(&self) -> u64 {
        self.trainer.steps() as u64
    }

    fn progress(&self) -> f64 {
        self.config.progress(self.step(), self.seconds)
    }

    fn log(&self, entry: &impl serde::Serialize) -> Result<()> {
        let path = self.folder.join("log.jsonl");
        let mut line = serde_json::to_string(entry).map_err(|error| Error::io(&path, error))?;
        line.push('\n');
        let file = OpenOptions::new().append(true).create(true).open(&path);
        file.and_then(|mut file| file.write_all(line.as_bytes())).map_err(|error| Error::io(&path, error))
    }

    fn save(&self) -> Result<()> {
        self.trainer.save(self.folder, &json!({ "seconds": self.seconds, "config": stated(self.config)? }))
    }

    /// Judges the averaged network; nothing is logged if the run is cancelled meanwhile.
    fn check(&mut self, maps: &[Maps<f32>], on_event: &mut dyn FnMut(&Event<'_>)) -> Result<()> {
        on_event(&Event::Validating);
        let mut go_on = |_: &_| ControlFlow::Continue(());
        let mut control = Control::new(&mut go_on, self.cancel.clone());
        let results = match validate(&self.trainer.averaged()?, maps, &self.config.validation, &mut control) {
            Err(Error::Cancelled) => return Ok(()),
            results => results?,
        };
        let entry = json!({ "step": self.step(), "seconds": rounded(self.seconds, 10.0), "validation": results });
        self.log(&entry)?;
        self.last = Some(entry);
        on_event(&Event::Validated(&results));
        Ok(())
    }

    /// Writes the averaged weights with what a reader must know of them.
    fn export(&self, path: &Path, data: Value, license: &str) -> Result<()> {
        let mut training =
            json!({ "steps": self.step(), "seconds": self.seconds.round(), "settings": stated(self.config)? });
        if let (Some(last), Some(training)) = (&self.last, training.as_object_mut()) {
            training.insert("validation".into(), last.clone());
        }
        let facts = BTreeMap::from([("data".into(), data.to_string()), ("training".into(), training.to_string())]);
        Model::from_photo_graph(self.trainer.averaged()?, license).with_facts(facts).save(path)
    }
}

/// A configuration as a checkpoint keeps it.
fn stated(config: &Configuration) -> Result<Value> {
    // By way of text, where a number in single precision has no more digits than it needs, as in the file it was read from.
    let text = serde_json::to_string(config).and_then(|text| serde_json::from_str(&text));
    text.map_err(|error| Error::invalid("configuration", error.to_string()))
}

/// Names of the settings in which the checkpoint with this `state` differs from `config`.
fn changed(config: &Configuration, state: &Value) -> Result<Vec<String>> {
    let Value::Object(now) = stated(config)? else { return Ok(Vec::new()) };
    let before = |key: &str| state.pointer(&format!("/config/{key}"));
    Ok(now
        .into_iter()
        .filter(|(key, value)| !before(key).is_some_and(|b| same(b, value)))
        .map(|(key, _)| key)
        .collect())
}

/// Whether two values are the same, however their numbers are written.
fn same(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Number(a), Value::Number(b)) => a.as_f64() == b.as_f64(),
        (Value::Array(a), Value::Array(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same(a, b)),
        (Value::Object(a), Value::Object(b)) => {
            a.len() == b.len() && a.iter().all(|(key, a)| b.get(key).is_some_and(|b| same(a, b)))
        }
        (a, b) => a == b,
    }
}

fn rounded(value: f64, parts: f64) -> f64 {
    (value * parts).round() / parts
}

/// Means of what steps measured.
#[derive(Default)]
struct Means {
    sums: BTreeMap<&'static str, f64>,
    count: usize,
}

impl Means {
    fn add(&mut self, values: &[(&'static str, f64)]) {
        for &(name, value) in values {
            *self.sums.entry(name).or_default() += value;
        }
        self.count += 1;
    }

    fn take(&mut self) -> Map<String, Value> {
        let Self { sums, count } = std::mem::take(self);
        sums.into_iter().map(|(name, sum)| (name.to_owned(), rounded(sum / count as f64, 1e5).into())).collect()
    }
}

/// The time that the end of a run takes: the step that is running, a checkpoint, a validation, the export.
#[derive(Default)]
struct Reserve {
    /// Of the longest step.
    step: f64,
    /// Of a step, per pixel of its photos, in the mean.
    pixel: f64,
    /// Of the last validation, if there was one.
    validation: Option<f64>,
}

impl Reserve {
    /// For files.
    const FILES: f64 = 2.0;
    /// A step goes forward and backward, which takes three times as long as forward alone; with a margin.
    const FORWARD: f64 = 0.5;

    fn stepped(&mut self, seconds: f64, pixels: f64) {
        let own = seconds / pixels;
        self.pixel = if self.pixel > 0.0 { 0.9 * self.pixel + 0.1 * own } else { own };
        self.step = self.step.max(seconds);
    }

    /// With a validation of so many pixels.
    fn seconds(&self, pixels: f64) -> f64 {
        Self::FILES + self.step + self.validation.unwrap_or(Self::FORWARD * self.pixel * pixels)
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use serde_json::Value;

    use super::{Event, Library, RunOptions, Summary, run};
    use crate::error::Result;
    use crate::nn::Model;
    use crate::train::Configuration;

    /// A folder of three materials, a training of four steps, and where it goes to.
    struct Training {
        folder: tempfile::TempDir,
        config: Configuration,
    }

    impl Training {
        fn new() -> Self {
            let folder = tempfile::tempdir().unwrap();
            let mut rng = fastrand::Rng::with_seed(1);
            for name in ["a", "b", "c"] {
                let material = folder.path().join("library").join(name);
                std::fs::create_dir_all(&material).unwrap();
                for kind in ["basecolor", "normal", "roughness"] {
                    let pixels: Vec<u8> = (0..24 * 24 * 3).map(|_| rng.u8(100..200)).collect();
                    let file = material.join(format!("{kind}.png"));
                    image::save_buffer(file, &pixels, 24, 24, image::ColorType::Rgb8).unwrap();
                }
            }
            let text = format!(
                "steps = 4\nphotos = [1, 1]\nlog_steps = 2\n[data]\npack = {:?}\nsize = 16\ngroups = 2\nper_group = 2\n\
                 [[phase]]\nshare = 1.0\nsize = 16\nbatch = 2\n\
                 [model]\nstem = 4\nnode = 4\nwidth = 4\nblocks = [1]\nmiddle = 1\ntail = 4\n\
                 [validation]\nsize = 16\nphotos = [2]\nviews = 2",
                folder.path().join("library").display().to_string()
            );
            Self { config: Configuration::parse("test", &text, &[]).unwrap(), folder }
        }

        fn run(&self, name: &str, options: &RunOptions, on_event: &mut dyn FnMut(&Event<'_>)) -> Result<Summary> {
            run(&self.config, &self.folder.path().join(name), options, on_event)
        }
    }

    fn log(folder: &Path) -> Vec<Value> {
        let text = std::fs::read_to_string(folder.join("log.jsonl")).unwrap();
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    #[test]
    fn a_training_and_the_same_in_two_runs() {
        let training = Training::new();
        let mut told = Vec::new();
        let summary = training
            .run("whole", &RunOptions::default(), &mut |event| match event {
                Event::Started { materials, held_out, step, .. } => told.push((*materials, *held_out, *step)),
                Event::Stepped { step, .. } => told.push((0, 0, *step)),
                _ => {}
            })
            .unwrap();
        assert_eq!(told, [(2, 1, 0), (0, 0, 1), (0, 0, 2), (0, 0, 3), (0, 0, 4)]);
        assert_eq!((summary.steps, summary.progress, summary.cancelled), (4, 1.0, false));
        let whole = training.folder.path().join("whole");
        let entries = log(&whole);
        let steps: Vec<u64> = entries.iter().map(|entry| entry["step"].as_u64().unwrap()).collect();
        // The first step, two more, the last, and the validation.
        assert_eq!(steps, [1, 3, 4, 4]);
        for name in ["seconds", "rate", "loss", "maps", "rendering", "certainty", "diffuse", "norm", "skipped"] {
            assert!(entries[0][name].is_number(), "{name}");
        }
        for family in ["near 2", "real 2"] {
            let scores = entries[3]["validation"][family].as_object().unwrap();
            assert_eq!(scores.len(), 13);
            assert!(scores.values().all(|value| value.as_f64().is_some_and(f64::is_finite)), "{scores:?}");
        }
        let model = Model::load(&summary.model).unwrap();
        assert_eq!((model.license(), model.photo_graph().unwrap().config()), ("not stated", &training.config.model));
        assert!(model.facts()["data"].contains("\"held_out\":[\"a\"]") && model.facts()["training"].contains("near 2"));

        let options = RunOptions::default();
        let cancel = options.cancel.clone();
        let first = training.run("parts", &options, &mut |event| {
            if matches!(event, Event::Stepped { step: 2, .. }) {
                cancel.cancel();
            }
        });
        let first = first.unwrap();
        assert_eq!((first.steps, first.cancelled), (2, true));
        let second = training.run("parts", &RunOptions::default(), &mut |event| {
            assert!(!matches!(event, Event::Changed(_)), "{event:?}");
        });
        assert_eq!(second.unwrap().steps, 4);
        let average = |name: &str| {
            let path = training.folder.path().join(name).join("checkpoint/average.safetensors");
            std::fs::read(path).unwrap()
        };
        assert!(average("whole") == average("parts"), "two runs came to other weights than one");
    }

    #[test]
    fn what_cannot_go_on_is_refused() {
        let mut training = Training::new();
        let mut options = RunOptions { seconds: Some(0.0), ..RunOptions::default() };
        // No time for a step: a checkpoint all the same.
        assert_eq!(training.run("out", &options, &mut |_| {}).unwrap().steps, 0);
        training.config.optimiser.rate = 0.5;
        let mut changed = Vec::new();
        options.cancel.cancel();
        training
            .run("out", &options, &mut |event| {
                if let Event::Changed(names) = event {
                    changed = names.to_vec();
                }
            })
            .unwrap();
        assert_eq!(changed, ["optimiser"]);
        options.seconds = None;
        training.config.model.stem = 5;
        assert!(training.run("out", &options, &mut |_| {}).unwrap_err().to_string().contains("stem: 5"));
        training.config.data.pack = "nowhere.zip".into();
        let other = training.run("other", &options, &mut |_| {}).unwrap_err().to_string();
        assert!(other.contains("nowhere.zip"), "{other}");
        assert!(Library::open(training.folder.path()).is_err());
    }
}
