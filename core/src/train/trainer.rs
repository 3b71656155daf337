//! The network under training: its parameters, the optimiser's memory, and the files in which they outlast a run.

use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File};
use std::io::{BufReader, BufWriter};
use std::path::Path;
use std::sync::Arc;

use serde::Serialize;
use serde_json::Value;

use super::batch::Batch;
use super::config::{LossSettings, OptimiserSettings};
use super::losses::{Criterion, Losses};
use super::optimiser::{self, AdamW, Moments};
use super::start;
use crate::brdf::real::Real;
use crate::error::{Error, Result};
use crate::io::{file, read_file};
use crate::nn::{PhotoGraph, PhotoGraphConfig, Pool, Scalar, Trainable, read_tensors, write_tensors};

/// Tensors by name.
type Tensors<E> = BTreeMap<String, Vec<E>>;

/// The files of a checkpoint beside `state.json`: parameters, their moving average, the moments of AdamW.
const FILES: [&str; 4] = ["model", "average", "moment1", "moment2"];

/// Largest `state.json` that is read, in bytes.
const STATE_MAX: u64 = 1 << 20;

/// What a step measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Measured {
    /// The total that was descended.
    pub loss: f64,
    pub maps: f64,
    pub rendering: f64,
    pub certainty: f64,
    pub diffuse: f64,
    pub normal: f64,
    pub roughness: f64,
    pub specular: f64,
    /// Norm of the gradient before it was clipped; 0 where it was not finite.
    pub norm: f64,
    /// 1 if the parameters were left alone because the gradient was not finite, else 0.
    pub skipped: f64,
}

impl Measured {
    /// All of it by name, in the order of a log.
    pub fn entries(&self) -> [(&'static str, f64); 10] {
        [
            ("loss", self.loss),
            ("maps", self.maps),
            ("rendering", self.rendering),
            ("certainty", self.certainty),
            ("diffuse", self.diffuse),
            ("normal", self.normal),
            ("roughness", self.roughness),
            ("specular", self.specular),
            ("norm", self.norm),
            ("skipped", self.skipped),
        ]
    }
}

/// A network, its optimiser and the moving average of its parameters.
///
/// In single precision; tests compute in double precision.
pub(crate) struct Trainer<E: Scalar = f32> {
    model: PhotoGraphConfig,
    optimiser: OptimiserSettings,
    loss: LossSettings,
    values: BTreeMap<String, Arc<Vec<E>>>,
    average: Tensors<E>,
    moments: BTreeMap<String, Moments<E>>,
    /// Names of the kernels of convolutions, which decay.
    kernels: Vec<String>,
    steps: usize,
    /// The step at which the moments began.
    begun: usize,
    pool: Pool<E>,
}

impl<E: Scalar + Real> Trainer<E> {
    /// Training from `values` on.
    pub fn from_values(
        model: PhotoGraphConfig,
        optimiser: OptimiserSettings,
        loss: LossSettings,
        values: BTreeMap<String, Arc<Vec<E>>>,
    ) -> Self {
        let average = values.iter().map(|(name, values)| (name.clone(), values.to_vec())).collect();
        let moments = values.iter().map(|(name, values)| (name.clone(), Moments::new(values.len()))).collect();
        let kernels = model.tensors().into_iter().filter(|(_, shape)| shape.len() == 4).map(|(name, _)| name).collect();
        let pool = Pool::default();
        Self { model, optimiser, loss, values, average, moments, kernels, steps: 0, begun: 0, pool }
    }

    /// One step of the optimiser at learning rate `rate`, on the mean over the examples of `batch`; on the threads of the current rayon pool.
    ///
    /// A gradient that is not finite leaves the parameters as they are.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] or [`Error::InvalidArgument`] if an example has not the sizes of `batch`, or no views; nothing has changed then.
    pub fn step(&mut self, batch: &Batch, rate: f64) -> Result<Measured> {
        let (losses, gradients) = self.gradients(batch)?;
        let norm = optimiser::norm(&gradients);
        let finite = norm.is_finite();
        if finite {
            self.update(&gradients, optimiser::clip(norm, self.optimiser.clip), rate);
        }
        self.steps += 1;
        let [diffuse, normal, roughness, specular] = losses.groups;
        let Losses { loss, maps, rendering, certainty, .. } = losses;
        let (norm, skipped) = if finite { (norm, 0.0) } else { (0.0, 1.0) };
        Ok(Measured { loss, maps, rendering, certainty, diffuse, normal, roughness, specular, norm, skipped })
    }

    /// The losses of `batch`, means over its examples, and the gradient of the total with respect to every parameter.
    pub(super) fn gradients(&self, batch: &Batch) -> Result<(Losses, Tensors<E>)> {
        let &Batch { photos, height, width, ref examples } = batch;
        if examples.is_empty() {
            return Err(Error::invalid("batch", "expected at least one example, got none"));
        }
        let net = Trainable::new(&self.model, &self.values, self.pool.clone())?;
        let criterion = Criterion { settings: &self.loss, roughness_floor: f64::from(self.model.roughness_floor) };
        let share = 1.0 / examples.len() as f64;
        let (mut losses, mut gradients) = (Losses::default(), Tensors::new());
        for example in examples {
            let inputs: Vec<E> = example.inputs.iter().map(|&value| <E as Scalar>::of(value.into())).collect();
            let run = net.run(&inputs, photos, height, width)?;
            let (of_example, slopes) = criterion.losses(&run.raw, &run.log_sigma, example, height, width)?;
            losses.add(&of_example, share);
            net.pull_back(run, &slopes.raw, &slopes.log_sigma, &mut gradients)?;
        }
        let share = <E as Scalar>::of(share);
        gradients.values_mut().flatten().for_each(|gradient| *gradient *= share);
        Ok((losses, gradients))
    }

    fn update(&mut self, gradients: &Tensors<E>, factor: f64, rate: f64) {
        let step = AdamW { rate, betas: self.optimiser.betas, count: self.steps + 1 - self.begun };
        let weight = optimiser::average_weight(self.optimiser.average, self.steps);
        let state = self.values.iter_mut().zip(self.moments.values_mut()).zip(self.average.values_mut());
        for (((name, values), moments), average) in state {
            let Some(gradient) = gradients.get(name) else { continue };
            let decay = if self.kernels.contains(name) { self.optimiser.decay } else { 0.0 };
            let values = Arc::make_mut(values);
            step.step(values, moments, gradient, factor, decay);
            optimiser::take_into_average(average, values, weight);
        }
    }

    /// Tensor `name` of file `which` of a checkpoint.
    pub(super) fn part(&self, which: usize, name: &str) -> &[E] {
        let moments = self.moments.get(name);
        let values = match which {
            0 => self.values.get(name).map(|values| &***values),
            1 => self.average.get(name).map(Vec::as_slice),
            2 => moments.map(|moments| moments.first.as_slice()),
            _ => moments.map(|moments| moments.second.as_slice()),
        };
        values.unwrap_or_default()
    }

    /// Steps so far, those of earlier runs among them.
    pub fn steps(&self) -> usize {
        self.steps
    }
}

impl Trainer {
    /// Training from the start; the same `seed` starts from the same parameters.
    ///
    /// # Errors
    /// [`Error::Weights`] if a size in `model` is out of range.
    pub fn new(model: PhotoGraphConfig, optimiser: OptimiserSettings, loss: LossSettings, seed: u64) -> Result<Self> {
        model.validate()?;
        let values = start::tensors(&model, seed);
        Ok(Self::from_values(model, optimiser, loss, values))
    }

    /// The network with the moving average of the parameters.
    ///
    /// # Errors
    /// As [`PhotoGraph::new`].
    pub fn averaged(&self) -> Result<PhotoGraph> {
        PhotoGraph::new(self.model.clone(), |name, _| Ok(self.average.get(name).cloned().unwrap_or_default()))
    }

    /// Writes `folder`/checkpoint, which the PyTorch trainer goes on from as well; the one before stays until the new one is whole.
    ///
    /// `state` becomes `state.json`, with the number of steps as `step`.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] if `state` is no JSON object; [`Error::Io`] if a file cannot be written.
    pub fn save(&self, folder: &Path, state: &Value) -> Result<()> {
        let Value::Object(state) = state else {
            return Err(Error::invalid("state", format!("expected a JSON object, got {state}")));
        };
        let mut state = state.clone();
        state.insert("step".into(), self.steps.into());
        let [fresh, place, old] = ["checkpoint.part", "checkpoint", "checkpoint.old"].map(|name| folder.join(name));
        remove(&fresh)?;
        fs::create_dir_all(&fresh).map_err(|error| Error::io(&fresh, error))?;
        let shapes = self.model.tensors();
        for (which, file) in FILES.into_iter().enumerate() {
            let tensors = shapes.iter().map(|(name, shape)| (name.clone(), shape.clone(), self.part(which, name)));
            let path = fresh.join(format!("{file}.safetensors"));
            let file = File::create(&path).map_err(|error| Error::io(&path, error))?;
            let tensors: Vec<_> = tensors.collect();
            write_tensors(BufWriter::new(file), HashMap::new(), &tensors).map_err(|error| Error::io(&path, error))?;
        }
        let path = fresh.join("state.json");
        let text = serde_json::to_string_pretty(&state).map_err(|error| Error::io(&path, error))?;
        fs::write(&path, text).map_err(|error| Error::io(&path, error))?;
        remove(&old)?;
        if place.exists() {
            fs::rename(&place, &old).map_err(|error| Error::io(&place, error))?;
        }
        fs::rename(&fresh, &place).map_err(|error| Error::io(&fresh, error))?;
        remove(&old)
    }

    /// Goes on from `folder`/checkpoint, and returns its `state.json`. Without the files of the moments the optimiser starts afresh.
    ///
    /// # Errors
    /// [`Error::Io`] if a file is missing or cannot be read; [`Error::Weights`] if one is damaged or its network is another. Nothing has changed then.
    pub fn load(&mut self, folder: &Path) -> Result<Value> {
        let place = ["checkpoint", "checkpoint.old"].map(|name| folder.join(name));
        let place = if place[0].exists() { &place[0] } else { &place[1] };
        let path = place.join("state.json");
        let broken = |reason: String| Error::Weights { reason: format!("{}: {reason}", path.display()) };
        let state: Value =
            serde_json::from_slice(&read_file(&path, STATE_MAX)?).map_err(|error| broken(error.to_string()))?;
        let model = state.pointer("/config/model").cloned().unwrap_or_default();
        match serde_json::from_value::<PhotoGraphConfig>(model) {
            Ok(model) if model == self.model => {}
            Ok(model) => return Err(broken(format!("config.model: expected {:?}, got {model:?}", self.model))),
            Err(error) => return Err(broken(format!("config.model: {error}"))),
        }
        let steps = state.get("step").and_then(Value::as_u64).and_then(|step| usize::try_from(step).ok());
        let steps = steps.ok_or_else(|| broken("step: expected a number of steps".into()))?;

        let shapes = self.model.tensors();
        let read = |file: &str| {
            let path = place.join(format!("{file}.safetensors"));
            read_tensors(BufReader::new(file::open(&path)?.0), &shapes).map_err(|error| match error {
                Error::Weights { reason } => Error::Weights { reason: format!("{}: {reason}", path.display()) },
                other => other,
            })
        };
        let (values, average) = (read(FILES[0])?, read(FILES[1])?);
        let has_moments = FILES[2..].iter().all(|file| place.join(format!("{file}.safetensors")).exists());
        let moments = if has_moments {
            let pairs = read(FILES[2])?.into_iter().zip(read(FILES[3])?.into_values());
            pairs.map(|((name, first), second)| (name, Moments { first, second })).collect()
        } else {
            tracing::warn!("{}: no moments: the optimiser starts afresh", place.display());
            values.iter().map(|(name, values)| (name.clone(), Moments::new(values.len()))).collect()
        };
        self.values = values.into_iter().map(|(name, values)| (name, Arc::new(values))).collect();
        (self.average, self.moments, self.steps) = (average, moments, steps);
        self.begun = if has_moments { 0 } else { steps };
        Ok(state)
    }
}

/// Removes a folder, if it is there.
fn remove(folder: &Path) -> Result<()> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(Error::io(folder, error)),
        _ => Ok(()),
    }
}
