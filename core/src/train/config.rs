//! Training configurations: TOML files, with the same keys, defaults and checks as `python/training/configuration.py`.

use std::f64::consts::PI;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::error::{Error, Result};
use crate::io::read_file;
use crate::nn::PhotoGraphConfig;

/// Largest configuration file that is read, in bytes.
const FILE_MAX: u64 = 1 << 20;
/// Smallest and largest side of a crop or a procedural material, in pixels.
const SIDES: [f64; 2] = [8.0, 4096.0];
/// Most photos of a capture.
const PHOTOS_MAX: usize = 64;

/// Everything that a training depends on, but for its data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Configuration {
    /// Seed of everything random.
    pub seed: u64,
    /// Length of the whole training in steps; 0: it is given in seconds.
    pub steps: u64,
    /// Length of the whole training in seconds of training, over any number of runs.
    pub seconds: f64,
    /// Materials.
    pub data: DataSettings,
    /// How often a batch has 1, 2, 3 ... photos, relatively.
    pub photos: Vec<f64>,
    /// What part of the training runs with which crops; the last size is the model's window.
    pub phase: Vec<Phase>,
    /// Sizes of the network.
    pub model: PhotoGraphConfig,
    /// Optimiser.
    pub optimiser: OptimiserSettings,
    /// Weights of the losses.
    pub loss: LossSettings,
    /// How held-out materials are judged.
    pub validation: ValidationSettings,
    /// Steps per entry of the log.
    pub log_steps: usize,
    /// Minutes between checkpoints.
    pub checkpoint_minutes: f64,
    /// Concerns PyTorch alone: memory layout of the network.
    pub channels_last: bool,
    /// Concerns PyTorch alone: the network in half the precision. Here all is computed in single precision.
    pub bfloat16: bool,
    /// Concerns PyTorch alone: time the GPU's algorithms of every convolution.
    pub benchmark: bool,
    /// Concerns PyTorch alone: compile the network.
    pub compile: bool,
}

/// The materials that crops are taken from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DataSettings {
    /// A pack made by `python/training/pack.py`, or a folder of material folders.
    pub pack: String,
    /// Share of procedural materials in a batch, [0, 1].
    pub procedural: f64,
    /// The pool of procedural materials holds `groups` times `per_group`.
    pub groups: usize,
    /// Every `refresh` steps as many of the oldest are replaced.
    pub per_group: usize,
    /// See `per_group`.
    pub refresh: usize,
    /// Side of a procedural material in pixels.
    pub size: usize,
    /// What captures are: `any`; those of the synthetic literature are drawn by PyTorch's trainer alone.
    pub captures: String,
    /// Whether the network is shown where camera and light stood: always, here.
    pub directions: bool,
}

/// A part of the training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Phase {
    /// Its share of the whole; all add up to 1.
    pub share: f64,
    /// Side of a crop in pixels.
    pub size: usize,
    /// Captures per step.
    pub batch: usize,
}

/// AdamW with warm-up and cosine decay of the rate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimiserSettings {
    /// Largest rate.
    pub rate: f64,
    /// Rate at the end.
    pub final_rate: f64,
    /// Share of the training in which the rate grows linearly.
    pub warmup: f64,
    /// Decay of the kernels of convolutions.
    pub decay: f64,
    /// Decay of the moments' averages.
    pub betas: [f64; 2],
    /// Largest norm of the gradient.
    pub clip: f64,
    /// Decay of the moving average of the weights.
    pub average: f64,
}

/// Weights of the losses: maps and renderings as in the paper, and certainty.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossSettings {
    /// Of the maps' errors.
    pub maps: f64,
    /// Of the re-renderings' errors.
    pub rendering: f64,
    /// Re-renderings per capture.
    pub views: usize,
    /// Of the certainty's likelihood.
    pub certainty: f64,
}

/// How held-out materials are judged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValidationSettings {
    /// Minutes between validations.
    pub minutes: f64,
    /// Side of the maps in pixels.
    pub size: usize,
    /// Numbers of photos of the captures.
    pub photos: Vec<usize>,
    /// Re-renderings per material.
    pub views: usize,
}

impl Default for Configuration {
    fn default() -> Self {
        let phase = vec![Phase { share: 1.0, size: 128, batch: 32 }];
        Self {
            seed: 1,
            steps: 0,
            seconds: 1440.0,
            data: DataSettings::default(),
            photos: vec![3.0, 2.0, 2.0, 4.0, 2.0, 0.0, 2.0, 0.0, 1.5],
            model: PhotoGraphConfig { window: phase.last().map(|phase| phase.size), ..PhotoGraphConfig::default() },
            phase,
            optimiser: OptimiserSettings::default(),
            loss: LossSettings::default(),
            validation: ValidationSettings::default(),
            log_steps: 50,
            checkpoint_minutes: 4.0,
            channels_last: true,
            bfloat16: true,
            benchmark: true,
            compile: false,
        }
    }
}

impl Default for DataSettings {
    fn default() -> Self {
        Self {
            pack: "data/materials.zip".into(),
            procedural: 0.45,
            groups: 56,
            per_group: 6,
            refresh: 2,
            size: 320,
            captures: "any".into(),
            directions: true,
        }
    }
}

impl Default for OptimiserSettings {
    fn default() -> Self {
        Self { rate: 1e-3, final_rate: 1e-6, warmup: 0.02, decay: 1e-4, betas: [0.9, 0.95], clip: 1.0, average: 0.999 }
    }
}

impl Default for LossSettings {
    fn default() -> Self {
        Self { maps: 10.0, rendering: 1.0, views: 9, certainty: 0.1 }
    }
}

impl Default for ValidationSettings {
    fn default() -> Self {
        Self { minutes: 6.0, size: 256, photos: vec![1, 4, 8], views: 20 }
    }
}

impl Configuration {
    /// The configuration in the file `path`, with `changes` such as `optimiser.rate=2e-4`.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be read; [`Error::InvalidArgument`] naming file or change, setting and value for all else.
    pub fn load(path: impl AsRef<Path>, changes: &[String]) -> Result<Self> {
        let path = path.as_ref();
        let text = read_file(path, FILE_MAX)?;
        let text =
            String::from_utf8(text).map_err(|error| Error::invalid(path.display().to_string(), error.to_string()))?;
        Self::parse(&path.display().to_string(), &text, changes)
    }

    /// As [`Configuration::load`], from a file's content; `name` is what messages call it.
    ///
    /// # Errors
    /// As [`Configuration::load`].
    pub fn parse(name: &str, text: &str, changes: &[String]) -> Result<Self> {
        let mut given = table(name, text)?;
        for change in changes {
            let unfit = |reason: String| Error::invalid(format!("--set {change}"), reason);
            let (key, value) =
                change.split_once('=').ok_or_else(|| unfit("expected a setting and its value, KEY=VALUE".into()))?;
            let mut value = table("value", &format!("value = {value}")).map_err(|error| unfit(error.to_string()))?;
            let Some(value) = value.remove("value").filter(|_| value.is_empty()) else {
                return Err(unfit("expected one value".into()));
            };
            let mut tables = key.trim().split('.').collect::<Vec<_>>();
            let last = tables.pop().unwrap_or_default();
            let mut place = &mut given;
            for table in tables {
                let inner = place.entry(table).or_insert_with(|| Map::new().into());
                place = inner.as_object_mut().ok_or_else(|| unfit(format!("{table} is no table")))?;
            }
            place.insert(last.into(), value);
        }
        let unfit = |reason: String| Error::invalid(name, reason);
        if let Some(network) = given.remove("network").filter(|network| *network != "photo graph") {
            return Err(unfit(format!(
                "network: expected \"photo graph\", got {network}: python/training/train.py trains networks of the paper's form"
            )));
        }
        let mut defaults = serde_json::to_value(Self::default()).map_err(|error| unfit(error.to_string()))?;
        // It follows from the phases.
        defaults["model"].as_object_mut().and_then(|model| model.remove("window"));
        merge(&mut defaults, given, "").map_err(unfit)?;
        let mut config: Self = serde_json::from_value(defaults).map_err(|error| unfit(error.to_string()))?;
        config.model.window = config.phase.last().map(|phase| phase.size);
        config.check().map_err(unfit)?;
        config.model.validate()?;
        Ok(config)
    }

    fn check(&self) -> std::result::Result<(), String> {
        let Self { data, optimiser, loss, validation, .. } = self;
        within("phase", self.phase.len() as f64, [1.0, 64.0])?;
        for phase in &self.phase {
            within("phase.share", phase.share, [0.0, 1.0])?;
            within("phase.size", phase.size as f64, SIDES)?;
            within("phase.batch", phase.batch as f64, [1.0, 4096.0])?;
        }
        let total: f64 = self.phase.iter().map(|phase| phase.share).sum();
        if (total - 1.0).abs() > 1e-6 {
            return Err(format!("phase.share: expected a sum of 1, got {total}"));
        }
        within("numbers of photos", self.photos.len() as f64, [1.0, PHOTOS_MAX as f64])?;
        for &weight in &self.photos {
            within("photos", weight, [0.0, 1e9])?;
        }
        if self.photos.iter().sum::<f64>() <= 0.0 {
            return Err(format!("photos: expected a number above 0, got {:?}", self.photos));
        }
        if self.steps == 0 && self.seconds <= 0.0 {
            return Err(format!("seconds: expected a number above 0 where steps is 0, got {}", self.seconds));
        }
        if data.captures != "any" || !data.directions {
            return Err(format!(
                "data.captures, data.directions: expected \"any\" and true, got {:?} and {}: python/training/train.py knows the others",
                data.captures, data.directions
            ));
        }
        within("data.procedural", data.procedural, [0.0, 1.0])?;
        within("data.size", data.size as f64, SIDES)?;
        within("data.groups", data.groups as f64, [1.0, 65536.0])?;
        within("data.per_group", data.per_group as f64, [1.0, 65536.0])?;
        within("data.refresh", data.refresh as f64, [1.0, 1e12])?;
        for (name, value, range) in [
            ("rate", optimiser.rate, [0.0, 1e3]),
            ("final_rate", optimiser.final_rate, [0.0, 1e3]),
            ("warmup", optimiser.warmup, [0.0, 0.999]),
            ("decay", optimiser.decay, [0.0, 1e3]),
            ("betas", optimiser.betas[0], [0.0, 0.999_999]),
            ("betas", optimiser.betas[1], [0.0, 0.999_999]),
            ("clip", optimiser.clip, [1e-9, 1e9]),
            ("average", optimiser.average, [0.0, 0.999_999_9]),
        ] {
            within(&format!("optimiser.{name}"), value, range)?;
        }
        for (name, value) in [("maps", loss.maps), ("rendering", loss.rendering), ("certainty", loss.certainty)] {
            within(&format!("loss.{name}"), value, [0.0, 1e9])?;
        }
        within("loss.views", loss.views as f64, [1.0, 4096.0])?;
        within("validation.minutes", validation.minutes, [0.0, 1e9])?;
        within("validation.size", validation.size as f64, SIDES)?;
        within("validation.views", validation.views as f64, [1.0, 4096.0])?;
        for &photos in &validation.photos {
            within("validation.photos", photos as f64, [1.0, PHOTOS_MAX as f64])?;
        }
        within("log_steps", self.log_steps as f64, [1.0, 1e12])?;
        within("checkpoint_minutes", self.checkpoint_minutes, [0.0, 1e9])
    }

    /// How far a training is, from 0 to 1 and a little beyond.
    pub(crate) fn progress(&self, step: u64, seconds: f64) -> f64 {
        if self.steps > 0 { step as f64 / self.steps as f64 } else { seconds / self.seconds }
    }

    /// The phase at `progress` from 0 to 1; none if there are no phases.
    pub(crate) fn phase_at(&self, mut progress: f64) -> Option<&Phase> {
        let at = self.phase.iter().find(|phase| {
            progress -= phase.share;
            progress < 0.0
        });
        at.or(self.phase.last())
    }
}

impl OptimiserSettings {
    /// The rate at `progress` from 0 to 1.
    pub(crate) fn rate_at(&self, progress: f64) -> f64 {
        if progress < self.warmup {
            return self.rate * (progress / self.warmup + 1e-3);
        }
        let phase = ((progress - self.warmup) / (1.0 - self.warmup)).min(1.0);
        self.final_rate + (self.rate - self.final_rate) * 0.5 * (1.0 + (PI * phase).cos())
    }
}

fn table(name: &str, text: &str) -> Result<Map<String, Value>> {
    toml::from_str(text).map_err(|error| {
        let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
        let line = 1 + before.matches('\n').count();
        Error::invalid(name, format!("line {line}: {}", error.message().replace('\n', ", ")))
    })
}

fn within(name: &str, value: f64, [low, high]: [f64; 2]) -> std::result::Result<(), String> {
    if (low..=high).contains(&value) { Ok(()) } else { Err(format!("{name}: expected {low} to {high}, got {value}")) }
}

/// Replaces the settings of `defaults` that are `given`; `place` is the name of the table, with a dot.
fn merge(defaults: &mut Value, given: Map<String, Value>, place: &str) -> std::result::Result<(), String> {
    for (key, value) in given {
        let name = format!("{place}{key}");
        let Some(default) = defaults.get_mut(&key) else { return Err(format!("{name}: there is no such setting")) };
        let fits = match &*default {
            Value::Number(number) => value.is_number() && (number.is_f64() || value.is_u64()),
            Value::Bool(_) => value.is_boolean(),
            Value::String(_) => value.is_string(),
            Value::Array(_) => value.is_array(),
            Value::Object(_) | Value::Null => value.is_object(),
        };
        if !fits {
            return Err(format!("{name}: expected a value like {default}, got {value}"));
        }
        match value {
            Value::Object(inner) => merge(default, inner, &format!("{name}."))?,
            value => *default = value,
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::Configuration;

    fn parse(text: &str, changes: &[&str]) -> crate::error::Result<Configuration> {
        let changes: Vec<String> = changes.iter().map(|&change| change.to_owned()).collect();
        Configuration::parse("some.toml", text, &changes)
    }

    fn refused(text: &str, changes: &[&str]) -> String {
        parse(text, changes).unwrap_err().to_string()
    }

    #[test]
    fn the_files_of_the_other_trainer() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../python/training");
        let default = Configuration::load(folder.join("default.toml"), &[]).unwrap();
        assert_eq!((default.seconds, default.model.window, default.phase[0].batch), (15600.0, Some(96), 4));
        assert_eq!((default.optimiser.average, default.optimiser.clip, default.loss.views), (0.998, 1.0, 5));
        let large = Configuration::load(folder.join("large.toml"), &[]).unwrap();
        assert_eq!((large.model.stem, large.model.window), (24, Some(256)));
        assert_eq!(large.phase_at(0.69).unwrap().size, 128);
        assert_eq!(large.phase_at(0.71).unwrap().size, 256);
        assert_eq!(large.phase_at(1.5).unwrap().size, 256);
        let smoke = Configuration::load(folder.join("smoke.toml"), &["steps=7".into()]).unwrap();
        assert_eq!((smoke.steps, smoke.validation.photos.as_slice(), smoke.bfloat16), (7, [1, 4].as_slice(), false));
        assert_eq!(smoke.progress(7, 0.0), 1.0);
        assert_eq!(Configuration::load(folder.join("directions.toml"), &[]).unwrap().steps, 1500);
        for (file, change) in [
            ("paper-16.toml", "seed=1"),
            ("smoke.toml", "data.directions=false"),
            ("smoke.toml", "data.captures=\"paper\""),
        ] {
            let message = Configuration::load(folder.join(file), &[change.into()]).unwrap_err().to_string();
            assert!(message.contains("python/training/train.py"), "{message}");
        }
    }

    #[test]
    fn defaults_and_changes() {
        assert_eq!(parse("", &[]).unwrap(), Configuration::default());
        let changed =
            parse("[model]\nblocks = [1]\n", &["optimiser.rate=2", "data.pack=\"x.zip\"", "model.stem = 8"]).unwrap();
        assert_eq!((changed.optimiser.rate, changed.data.pack.as_str(), changed.model.stem), (2.0, "x.zip", 8));
        assert_eq!((changed.model.blocks.as_slice(), changed.model.node), ([1].as_slice(), 32));
        // What a checkpoint keeps is read back.
        let text = serde_json::to_string(&changed).unwrap();
        assert_eq!(serde_json::from_str::<Configuration>(&text).unwrap(), changed);
    }

    #[test]
    fn what_does_not_fit_is_refused_by_name() {
        for (text, name) in [
            ("rate = 1", "rate: there is no such setting"),
            ("[optimiser]\nrat = 1", "optimiser.rat: there is no such setting"),
            ("[model]\nwindow = 9", "model.window: there is no such setting"),
            ("seed = 1.5", "seed: expected a value like 1, got 1.5"),
            ("seed = -1", "seed: expected a value like 1, got -1"),
            ("optimiser = 3", "optimiser: expected a value like"),
            ("seconds = nan", "seconds"),
            ("seconds = 0", "seconds: expected a number above 0"),
            ("[[phase]]\nshare = 0.5\nsize = 64\nbatch = 1", "phase.share: expected a sum of 1, got 0.5"),
            ("[[phase]]\nshare = 1.0\nsize = 4\nbatch = 1", "phase.size: expected 8 to 4096, got 4"),
            ("[[phase]]\nshare = 1.0\nsize = 64\nbatch = 1\nmore = 1", "more"),
            ("phase = []", "phase"),
            ("photos = []", "photos"),
            ("photos = [0, 0]", "photos: expected a number above 0"),
            ("photos = [\"a\"]", "some.toml"),
            ("log_steps = 0", "log_steps"),
            ("[data]\nprocedural = 1.1", "data.procedural: expected 0 to 1, got 1.1"),
            ("[optimiser]\nbetas = [0.9, 1.0]", "optimiser.betas"),
            ("[model]\nheads = 5", "node"),
            ("steps = ", "some.toml"),
        ] {
            let message = refused(text, &[]);
            assert!(message.contains(name), "{text}: {message}");
        }
        for change in ["seed", "seed=", "seed.x=1", "=1", "no.such=1", "seed=1\nsteps=2"] {
            refused("", &[change]);
        }
    }

    #[test]
    fn the_rate_warms_up_and_falls() {
        // python/training/train.py, Trainer.rate, of the default optimiser.
        let optimiser = Configuration::default().optimiser;
        for (progress, expected) in
            [(0.0, 1e-6), (0.01, 5.01e-4), (0.02, 1e-3), (0.51, 5.005e-4), (1.0, 1e-6), (1.2, 1e-6)]
        {
            assert!((optimiser.rate_at(progress) - expected).abs() < 1e-12, "{progress}");
        }
    }
}
