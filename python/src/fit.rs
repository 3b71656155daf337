//! `fit_material`, its progress, and how it is stopped.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use pyo3::prelude::*;
use svbrdf_gcn::nn::Model;
use svbrdf_gcn::{CancelToken, Capture, FitOptions, Method, Preset, Refine, Reflectance, fit_material};

use crate::capture::{Reading, Setup, capture};
use crate::errors::{PAUSE, detached};
use crate::material::PyMaterial;
use crate::options::{Bytes, Given, Integers, bytes, choice, count, maybe, maybe_count};
use crate::types::{ArrayLike, Callback, Source, Weights};

/// Stops a fit, or the reading of photos, from any thread.
///
/// A token that was cancelled stays so; take a new one for the next run.
///
/// Examples
/// --------
/// >>> token = svbrdf_gcn.CancelToken()
/// >>> token.cancel()
/// >>> try:
/// ...     svbrdf_gcn.fit_material("samples/tiles", size=32, cancel=token)
/// ... except svbrdf_gcn.Cancelled:
/// ...     print("stopped")
/// stopped
#[pyclass(frozen, name = "CancelToken", module = "svbrdf_gcn")]
pub struct PyCancelToken(svbrdf_gcn::CancelToken);

#[pymethods]
impl PyCancelToken {
    #[new]
    fn new() -> Self {
        Self(svbrdf_gcn::CancelToken::new())
    }

    /// Ask every fit and every reading that was given this token to stop; they raise ``Cancelled``.
    ///
    /// Examples
    /// --------
    /// >>> token = svbrdf_gcn.CancelToken()
    /// >>> token.cancel()
    /// >>> token.cancelled
    /// True
    fn cancel(&self) {
        self.0.cancel();
    }

    /// Whether ``cancel`` was called.
    #[getter]
    fn cancelled(&self) -> bool {
        self.0.is_cancelled()
    }

    fn __repr__(&self) -> String {
        let state = if self.0.is_cancelled() { "cancelled" } else { "not cancelled" };
        format!("<svbrdf_gcn.CancelToken: {state}>")
    }
}

/// Where a fit, or ``acquire``, stands; what the ``progress`` callback is given.
///
/// Examples
/// --------
/// >>> seen = []
/// >>> material = svbrdf_gcn.fit_material("samples/tiles", size=32, method="direct", direct_steps=5, progress=seen.append)
/// >>> seen[-1].stage, seen[-1].step, seen[-1].steps
/// ('direct', 5, 5)
#[pyclass(frozen, get_all, name = "Progress", module = "svbrdf_gcn")]
pub struct PyProgress {
    /// The part that runs: ``acquire``; of a fit ``encode``, ``latent``, ``adapters``, ``direct`` or ``finish``.
    stage: &'static str,
    /// Steps of the stage that are done.
    step: usize,
    /// Steps that the stage takes at most.
    steps: usize,
    /// The loss before the last step, where the stage has one.
    loss: Option<f64>,
}

#[pymethods]
impl PyProgress {
    fn __repr__(&self) -> String {
        let loss = self.loss.map_or(String::new(), |loss| format!(", loss {loss:.4}"));
        format!("<svbrdf_gcn.Progress: {} {}/{}{loss}>", self.stage, self.step, self.steps)
    }
}

/// Trained weights.
///
/// Immutable: load them once and give them to as many fits as you like, from any thread.
///
/// Examples
/// --------
/// >>> svbrdf_gcn.Model.load("no-such-file.safetensors")
/// Traceback (most recent call last):
/// FileNotFoundError: [Errno 2] No such file or directory: 'no-such-file.safetensors'
#[pyclass(frozen, name = "Model", module = "svbrdf_gcn")]
pub struct PyModel(Arc<Model>);

#[pymethods]
impl PyModel {
    /// Read a weights file.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    ///     A safetensors file; ``docs/weights.md`` tells where weights come from.
    ///
    /// Returns
    /// -------
    /// Model
    ///
    /// Raises
    /// ------
    /// OSError
    ///     If the file cannot be read.
    /// WeightsError
    ///     If it is damaged, of another version or of another model.
    ///
    /// Examples
    /// --------
    /// >>> try:
    /// ...     svbrdf_gcn.Model.load("README.md")
    /// ... except svbrdf_gcn.WeightsError as error:
    /// ...     print("not a weights file")
    /// not a weights file
    #[staticmethod]
    fn load(py: Python<'_>, path: Given<'_, PathBuf>) -> PyResult<Self> {
        let path = path.take("path")?;
        detached(py, || Model::load(path)).map(|model| Self(Arc::new(model)))
    }

    /// The default network, which is part of the package and which a fit without ``weights`` takes.
    ///
    /// Returns
    /// -------
    /// Model
    ///
    /// Examples
    /// --------
    /// >>> svbrdf_gcn.Model.embedded().license
    /// 'CC0-1.0'
    #[staticmethod]
    fn embedded(py: Python<'_>) -> PyResult<Self> {
        detached(py, Model::embedded).map(Self)
    }

    /// The numbers of photos that there is a network for; a fit takes the one for the most photos it has. ``[1]`` for a photo graph,
    /// which takes any number of photos from one up.
    #[getter]
    fn photos(&self) -> Vec<usize> {
        if self.0.photo_graph().is_some() {
            return vec![1];
        }
        self.0.networks().iter().map(|network| network.config().photos).collect()
    }

    /// The licence of the weights.
    #[getter]
    fn license(&self) -> &str {
        self.0.license()
    }

    fn __repr__(&self) -> String {
        if self.0.photo_graph().is_some() {
            return format!("<svbrdf_gcn.Model: photo graph for 1 photo or more, {}>", self.0.license());
        }
        format!("<svbrdf_gcn.Model: networks for {:?} photos, {}>", self.photos(), self.0.license())
    }
}

/// Recover the material that photos show.
///
/// Other Python threads run meanwhile. Ctrl-C stops the fit with ``KeyboardInterrupt``.
///
/// Parameters
/// ----------
/// capture_or_photos : Capture, path of a capture, array of shape (N, H, W, 3), or iterable of arrays or image paths
///     A ``Capture``, or a path that ``Capture.open`` takes, brings its own positions; photos as arrays or image paths need
///     `camera_positions`, `patch_size`, `light_intensity` and `transfer`, described at ``Capture``. The path of one photo, taken
///     from straight above with the flash, is enough too: what is assumed then is among ``report["warnings"]``.
/// camera_positions, light_positions, patch_size, white_level : optional
///     See ``Capture``.
/// light_intensity : optional
///     See ``Capture``. With a path it replaces what the capture states, or what is chosen for one photo.
/// transfer, color_space, ignore_profiles, size, views : optional
///     See ``Capture`` and ``Capture.open``.
/// preset : {"draft", "balanced", "high"}, default "balanced"
///     How much time to spend.
/// method : {"auto", "network", "direct"}, default "auto"
///     How to get from photos to maps; auto: network.
/// reflectance : {"auto", "diffuse", "dielectric", "isotropic", "anisotropic"}, default "auto"
///     What the surface is taken to be made of; auto: the simplest that predicts photos left out as well as the others do. All maps come
///     out in any case. A network of the paper's form takes ``"auto"`` alone.
/// refine : {"auto", "none", "light", "all"}, default "auto"
///     What of the capture's statements may be corrected: the light of each photo, or that and its position; auto: what predicts photos left out better.
/// weights : Model, str or os.PathLike, optional
///     Other weights than those built in.
/// latent_steps, adapter_steps, direct_steps, finish_steps : int, optional
///     Steps on the latent code, the adapters, the maps themselves, the per-pixel finish, instead of the preset's.
/// max_memory : int or str, optional
///     Most bytes the run may use, from the reading of photos on, such as ``4000000000`` or ``"2G"``; three quarters of the free memory if not given.
/// seed : int, default 0
///     Seed of everything random. The same seed and thread count give the same bits on the same processor.
/// threads : int, optional
///     Threads; all if not given.
/// early_stop : bool, optional
///     Stop a stage when its loss has flattened; on if not given.
/// progress : callable, optional
///     Called on this thread with a ``Progress`` at most every 50 ms, and at the end of a stage. What it raises stops the
///     fit and comes out unchanged; what it returns is not looked at.
/// cancel : CancelToken, optional
///     Stops the fit, and the reading of photos before it, from any thread.
///
/// Returns
/// -------
/// Material
///     The maps; its `report` tells how they came about.
///
/// Raises
/// ------
/// ArgumentError
///     For options out of range, and arguments that are missing or given twice.
/// ShapeError, FormatError, OSError
///     For photos that cannot be read; see ``Capture``.
/// WeightsError
///     For weights that are broken, or need more photos.
/// MemoryError
///     If the run would need more than `max_memory`, before anything is computed.
/// NonFiniteError
///     If the loss is not finite from the start.
/// Cancelled
///     If `cancel` was cancelled.
///
/// Examples
/// --------
/// >>> material = svbrdf_gcn.fit_material("samples/tiles", size=32, preset="draft", seed=7)
/// >>> material.roughness.shape, material.report["method"]
/// ((32, 32, 1), 'network')
#[pyfunction]
#[pyo3(name = "fit_material", signature = (capture_or_photos, *, camera_positions = None, light_positions = None,
    patch_size = None, light_intensity = None, transfer = None, color_space = None, ignore_profiles = Given::Default(false), size = None, views = None, white_level = None,
    preset = Given::Default("balanced".into()), method = Given::Default("auto".into()), reflectance = Given::Default("auto".into()), refine = Given::Default("auto".into()), weights = None, latent_steps = None, adapter_steps = None, direct_steps = None, finish_steps = None,
    max_memory = None, seed = Given::Default(0), threads = None, early_stop = None, progress = None, cancel = None))]
#[expect(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn py_fit_material<'py>(
    py: Python<'py>,
    capture_or_photos: Source<'py>,
    camera_positions: Option<ArrayLike<'py>>,
    light_positions: Option<ArrayLike<'py>>,
    patch_size: Option<Given<'py, f64>>,
    light_intensity: Option<ArrayLike<'py>>,
    transfer: Option<Given<'py, String>>,
    color_space: Option<Given<'py, String>>,
    ignore_profiles: Given<'py, bool>,
    size: Option<Given<'py, i128>>,
    views: Option<Given<'py, Integers>>,
    white_level: Option<Given<'py, f32>>,
    preset: Given<'py, String>,
    method: Given<'py, String>,
    reflectance: Given<'py, String>,
    refine: Given<'py, String>,
    weights: Option<Given<'py, Weights<'py>>>,
    latent_steps: Option<Given<'py, i128>>,
    adapter_steps: Option<Given<'py, i128>>,
    direct_steps: Option<Given<'py, i128>>,
    finish_steps: Option<Given<'py, i128>>,
    max_memory: Option<Given<'py, Bytes>>,
    seed: Given<'py, i128>,
    threads: Option<Given<'py, i128>>,
    early_stop: Option<Given<'py, bool>>,
    progress: Option<Given<'py, Callback>>,
    cancel: Option<Given<'py, Bound<'py, PyCancelToken>>>,
) -> PyResult<PyMaterial> {
    let mut options = FitOptions::preset(choice("preset", &preset.take("preset")?, &PRESETS, preset_name)?);
    options.method = choice("method", &method.take("method")?, &METHODS, method_name)?;
    options.reflectance = choice("reflectance", &reflectance.take("reflectance")?, &REFLECTANCES, Reflectance::name)?;
    options.refine = choice("refine", &refine.take("refine")?, &REFINES, Refine::name)?;
    options.latent_steps = maybe_count("latent_steps", latent_steps)?;
    options.adapter_steps = maybe_count("adapter_steps", adapter_steps)?;
    options.direct_steps = maybe_count("direct_steps", direct_steps)?;
    options.finish_steps = maybe_count("finish_steps", finish_steps)?;
    options.max_memory = bytes(max_memory)?;
    options.seed = count("seed", seed.take("seed")?)?;
    options.threads = maybe_count("threads", threads)?;
    options.early_stop = maybe("early_stop", early_stop)?;
    options.cancel = token(cancel)?;
    let setup = Setup { camera_positions, light_positions, patch_size, light_intensity, white_level };
    let ignore_profiles = ignore_profiles.take("ignore_profiles")?;
    let (cancel, max_memory) = (options.cancel.clone(), options.max_memory);
    let reading = Reading { size, views, transfer, color_space, ignore_profiles, cancel, max_memory };
    let (weights, progress) = (maybe("weights", weights)?, maybe("progress", progress)?);
    let capture = capture(py, &capture_or_photos, setup, reading)?;
    let model = weights.map(|weights| model(py, &weights, &capture)).transpose()?;

    PyMaterial::fitted(reported(py, progress, |progress| fit_material(&capture, model.as_deref(), &options, progress))?)
}

/// Runs work of the core that reports its progress: to `callback`, if there is one, and stopped by signals.
///
/// # Errors
/// As [`detached`]; what the callback or a signal's handler raises.
pub fn reported<T: Send>(
    py: Python<'_>,
    callback: Option<Callback>,
    work: impl FnOnce(&mut svbrdf_gcn::progress::ProgressFn<'_>) -> svbrdf_gcn::Result<T> + Send,
) -> PyResult<T> {
    let mut reports = Reports { callback, next: Instant::now(), raised: None };
    let result = detached(py, || work(&mut |progress| reports.pass(progress)));
    match reports.raised {
        Some(error) => Err(error),
        None => result,
    }
}

/// The token that was given, else one that nobody cancels.
///
/// # Errors
/// As [`maybe`].
pub fn token<'py>(given: Option<Given<'py, Bound<'py, PyCancelToken>>>) -> PyResult<CancelToken> {
    Ok(maybe("cancel", given)?.map_or_else(CancelToken::new, |token| token.get().0.clone()))
}

const PRESETS: [Preset; 3] = [Preset::Draft, Preset::Balanced, Preset::High];

fn preset_name(preset: Preset) -> &'static str {
    match preset {
        Preset::Draft => "draft",
        Preset::High => "high",
        _ => "balanced",
    }
}

const METHODS: [Method; 3] = [Method::Auto, Method::Network, Method::Direct];

const REFLECTANCES: [Reflectance; 5] = [
    Reflectance::Auto,
    Reflectance::Diffuse,
    Reflectance::Dielectric,
    Reflectance::Isotropic,
    Reflectance::Anisotropic,
];

const REFINES: [Refine; 4] = [Refine::Auto, Refine::None, Refine::Light, Refine::All];

fn method_name(method: Method) -> &'static str {
    match method {
        Method::Network => "network",
        Method::Direct => "direct",
        _ => "auto",
    }
}

fn model(py: Python<'_>, weights: &Weights<'_>, capture: &Capture) -> PyResult<Arc<Model>> {
    match weights {
        Weights::Model(model) => Ok(model.get().0.clone()),
        Weights::Path(path) => detached(py, || Model::load_for(path, capture.len())).map(Arc::new),
    }
}

/// Brings reports of progress to Python.
struct Reports {
    callback: Option<Callback>,
    next: Instant,
    raised: Option<PyErr>,
}

impl Reports {
    fn pass(&mut self, progress: &svbrdf_gcn::Progress) -> ControlFlow<()> {
        let end = progress.step == progress.steps;
        if Instant::now() < self.next && !end {
            return ControlFlow::Continue(());
        }
        let result = Python::attach(|py| {
            py.check_signals()?;
            let Some(Callback(callback)) = &self.callback else { return Ok(()) };
            let (step, steps) = (progress.step, progress.steps);
            let report = PyProgress { stage: progress.stage.name(), step, steps, loss: progress.loss };
            callback.call1(py, (report,)).map(drop)
        });
        // From now on, so that a slow callback does not take all the time.
        self.next = Instant::now() + PAUSE;
        match result {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                self.raised = Some(error);
                ControlFlow::Break(())
            }
        }
    }
}
