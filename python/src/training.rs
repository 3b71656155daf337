//! `TrainingData`, what a network is trained on.

use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use pyo3::inspect::PyStaticExpr;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use pyo3::{type_hint_identifier, type_hint_subscript};
use serde_json::Value;
use svbrdf_gcn::train::{Batch, Captures, Data, KINDS, Library, Settings, procedural_material};

use crate::arrays::{NUMPY_FLOAT32, array};
use crate::errors::{argument, detached};
use crate::options::{Given, Numbers, choice, count, maybe_count};
use crate::types::Json;

/// Materials to train on, and captures of them as a network sees them; see docs/training.md.
///
/// What a step sees follows from `seed` and the step's number alone. Any thread may ask; one at a time is served, while other Python threads run.
///
/// Parameters
/// ----------
/// library : str or os.PathLike
///     A pack of materials (``python -m svbrdf_gcn.training.pack``) or a folder of material folders.
/// seed : int
///     Of everything random.
/// photos : iterable of float
///     How often a batch has 1, 2, 3 ... photos, relatively.
/// procedural : float
///     Share of procedural materials in a batch, from 0 to 1.
/// groups, per_group, refresh : int
///     There are ``groups * per_group`` procedural materials; every `refresh` steps `per_group` of the oldest are replaced.
/// size : int
///     Side of a procedural material in pixels.
/// captures : str
///     ``"any"``: near and far with every defect; ``"near"``: a perfect camera; ``"real"``: far with every defect; ``"paper"``: as the synthetic literature.
/// directions : bool
///     Whether the network is shown where camera and light stood. Otherwise the planes that follow from positions are 0.
/// views : int
///     Renderings per capture that a loss compares.
/// threads : int, optional
///     All processors if not given.
///
/// Raises
/// ------
/// ArgumentError
///     For values out of range, and for materials that cannot be used.
/// OSError
///     If the library cannot be read.
/// MemoryError
///     If there is no room for it.
///
/// Examples
/// --------
/// >>> from svbrdf_gcn.training import TrainingData  # doctest: +SKIP
/// >>> data = TrainingData("data/materials.zip", seed=1, photos=[1, 1, 0, 2], procedural=0.45, groups=28, per_group=4,
/// ...                     refresh=12, size=256, captures="any", directions=True, views=5)  # doctest: +SKIP
/// >>> data.batch(0, count=4, size=96)["maps"].shape  # doctest: +SKIP
/// (4, 10, 96, 96)
#[pyclass(frozen, name = "TrainingData", module = "svbrdf_gcn.training")]
pub struct PyTrainingData {
    data: Mutex<Data>,
    materials: usize,
    held_out: Vec<String>,
    facts: Value,
}

impl PyTrainingData {
    fn data(&self) -> MutexGuard<'_, Data> {
        self.data.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl PyTrainingData {
    /// How many kinds of procedural materials there are.
    #[classattr]
    #[pyo3(name = "KINDS")]
    const KINDS: usize = KINDS;

    #[new]
    #[pyo3(signature = (library, *, seed, photos, procedural, groups, per_group, refresh, size, captures, directions, views, threads = None))]
    #[allow(clippy::too_many_arguments, reason = "they have names in Python")]
    fn new(
        py: Python<'_>,
        library: Given<'_, PathBuf>,
        seed: Given<'_, i128>,
        photos: Given<'_, Numbers>,
        procedural: Given<'_, f64>,
        groups: Given<'_, i128>,
        per_group: Given<'_, i128>,
        refresh: Given<'_, i128>,
        size: Given<'_, i128>,
        captures: Given<'_, String>,
        directions: Given<'_, bool>,
        views: Given<'_, i128>,
        threads: Option<Given<'_, i128>>,
    ) -> PyResult<Self> {
        let library = library.take("library")?;
        let settings = Settings {
            seed: count("seed", seed.take("seed")?)?,
            photos: photos.take("photos")?.0,
            procedural: procedural.take("procedural")?,
            groups: count("groups", groups.take("groups")?)?,
            per_group: count("per_group", per_group.take("per_group")?)?,
            refresh: count("refresh", refresh.take("refresh")?)?,
            size: count("size", size.take("size")?)?,
            captures: family(captures)?,
            directions: directions.take("directions")?,
            views: count("views", views.take("views")?)?,
        };
        let threads = maybe_count("threads", threads)?;
        let library = detached(py, || Library::open(&library))?;
        let (materials, held_out, facts) = (library.materials(), library.held_out().to_vec(), library.facts());
        let data = detached(py, || Data::new(library, settings, threads))?;
        Ok(Self { data: Mutex::new(data), materials, held_out, facts })
    }

    /// How many photographed materials there are to train on.
    #[getter]
    fn materials(&self) -> usize {
        self.materials
    }

    /// Names of the materials held out, in the order of ``validation``.
    #[getter]
    fn held_out(&self) -> Vec<String> {
        self.held_out.clone()
    }

    /// What the photographed materials are, and under which licences, as a weights file says it.
    #[getter]
    fn facts<'py>(&self, py: Python<'py>) -> PyResult<Json<'py>> {
        Json::new(py, &self.facts)
    }

    /// What step `step` sees.
    ///
    /// Parameters
    /// ----------
    /// step : int
    ///     From 0 on; the same number gives the same arrays.
    /// count : int
    ///     Captures.
    /// size : int
    ///     Side of their crops in pixels.
    ///
    /// Returns
    /// -------
    /// dict of str to ndarray
    ///     Float32 arrays of the caller's own. A crop covers x and y from -1 to 1. ``inputs`` (count, photos, 13, size, size), what the network sees of every
    ///     photo: the photo in gamma 2.2, 3; its ratio to a white surface in gamma 2.2, 3; saturation, 1; direction to the light, 3; half vector, 3.
    ///     ``maps`` (count, 10, size, size): the true diffuse albedo, normal, roughness and specular albedo. ``shots`` (count, photos, 3, 3):
    ///     camera, light and light intensity of every photo as stated; ``views`` (count, views, 3, 3): those of the renderings that a loss compares.
    ///
    /// Raises
    /// ------
    /// ArgumentError
    ///     For a size or count out of range.
    /// MemoryError
    ///     If there is no room.
    ///
    /// Examples
    /// --------
    /// >>> batch = data.batch(0, count=4, size=96)  # doctest: +SKIP
    fn batch<'py>(
        &self,
        py: Python<'py>,
        step: Given<'_, i128>,
        count: Given<'_, i128>,
        size: Given<'_, i128>,
    ) -> PyResult<Arrays<'py>> {
        let step = self::count("step", step.take("step")?)?;
        let number = self::count("count", count.take("count")?)?;
        let size = self::count("size", size.take("size")?)?;
        let batch = detached(py, || self.data().batch(step, number, size))?;
        Arrays::new(py, batch)
    }

    /// Captures of held-out materials, whole and upright, always the same.
    ///
    /// Parameters
    /// ----------
    /// captures : str
    ///     ``"near"``, ``"real"``, ``"paper"`` or ``"any"``, as for ``TrainingData``.
    /// photos : int
    ///     Photos of each capture.
    /// size : int
    ///     Side of a material in pixels.
    /// first, count : int
    ///     Which of the materials held out.
    /// views : int
    ///     Renderings that scores compare, the same for every material.
    ///
    /// Returns
    /// -------
    /// dict of str to ndarray
    ///     As ``batch``.
    ///
    /// Raises
    /// ------
    /// ArgumentError
    ///     For values out of range.
    /// MemoryError
    ///     If there is no room.
    ///
    /// Examples
    /// --------
    /// >>> four = data.validation("real", photos=4, size=128, first=0, count=4, views=20)  # doctest: +SKIP
    #[allow(clippy::too_many_arguments, reason = "they have names in Python")]
    fn validation<'py>(
        &self,
        py: Python<'py>,
        captures: Given<'_, String>,
        photos: Given<'_, i128>,
        size: Given<'_, i128>,
        first: Given<'_, i128>,
        count: Given<'_, i128>,
        views: Given<'_, i128>,
    ) -> PyResult<Arrays<'py>> {
        let captures = family(captures)?;
        let photos = self::count("photos", photos.take("photos")?)?;
        let size = self::count("size", size.take("size")?)?;
        let first: usize = self::count("first", first.take("first")?)?;
        let number: usize = self::count("count", count.take("count")?)?;
        let views = self::count("views", views.take("views")?)?;
        let end = first.checked_add(number).ok_or_else(|| argument("count", "expected a smaller integer"))?;
        let batch = detached(py, || self.data().validation(captures, photos, size, first..end, views))?;
        Arrays::new(py, batch)
    }

    /// Maps of a procedural material, float32 of shape (10, size, size).
    ///
    /// Parameters
    /// ----------
    /// seed, number : int
    ///     The same give the same material; ``TrainingData.KINDS`` kinds take turns.
    /// size : int
    ///     Side in pixels.
    ///
    /// Returns
    /// -------
    /// ndarray
    ///     Diffuse albedo 3, normal 3, roughness 1, specular albedo 3.
    ///
    /// Raises
    /// ------
    /// ArgumentError
    ///     If `size` is out of its range.
    ///
    /// Examples
    /// --------
    /// >>> leather = TrainingData.procedural(1, number=8, size=128)  # doctest: +SKIP
    #[staticmethod]
    fn procedural<'py>(
        py: Python<'py>,
        seed: Given<'_, i128>,
        number: Given<'_, i128>,
        size: Given<'_, i128>,
    ) -> PyResult<Planes<'py>> {
        let seed = count("seed", seed.take("seed")?)?;
        let number = count("number", number.take("number")?)?;
        let size = count("size", size.take("size")?)?;
        let maps = detached(py, || procedural_material(seed, number, size))?;
        let planes = maps.data().len() / (size * size);
        array(py, maps.data().to_vec(), &[planes, size, size]).map(Planes)
    }
}

fn family(captures: Given<'_, String>) -> PyResult<Captures> {
    choice("captures", &captures.take("captures")?, &Captures::ALL, |(name, _)| name).map(|(_, captures)| captures)
}

/// A float32 array.
pub struct Planes<'py>(Bound<'py, PyAny>);

impl<'py> IntoPyObject<'py> for Planes<'py> {
    type Target = PyAny;
    type Output = Bound<'py, PyAny>;
    type Error = std::convert::Infallible;
    const OUTPUT_TYPE: PyStaticExpr = NUMPY_FLOAT32;

    fn into_pyobject(self, _: Python<'py>) -> Result<Self::Output, Self::Error> {
        Ok(self.0)
    }
}

/// A batch as float32 arrays by name, which take its memory over.
pub struct Arrays<'py>(Bound<'py, PyDict>);

impl<'py> Arrays<'py> {
    fn new(py: Python<'py>, batch: Batch) -> PyResult<Self> {
        let Batch { count, photos, size, compared, inputs, maps, shots, views } = batch;
        let planes = |len: usize, images: usize| len / (images * size * size);
        let inputs_shape = [count, photos, planes(inputs.len(), count * photos), size, size];
        let maps_shape = [count, planes(maps.len(), count), size, size];
        let arrays = PyDict::new(py);
        arrays.set_item("inputs", array(py, inputs, &inputs_shape)?)?;
        arrays.set_item("maps", array(py, maps, &maps_shape)?)?;
        arrays.set_item("shots", array(py, shots, &[count, photos, 3, 3])?)?;
        arrays.set_item("views", array(py, views, &[count, compared, 3, 3])?)?;
        Ok(Self(arrays))
    }
}

impl<'py> IntoPyObject<'py> for Arrays<'py> {
    type Target = PyDict;
    type Output = Bound<'py, PyDict>;
    type Error = std::convert::Infallible;
    const OUTPUT_TYPE: PyStaticExpr = type_hint_subscript!(
        type_hint_identifier!("builtins", "dict"),
        type_hint_identifier!("builtins", "str"),
        NUMPY_FLOAT32
    );

    fn into_pyobject(self, _: Python<'py>) -> Result<Self::Output, Self::Error> {
        Ok(self.0)
    }
}
