//! Captures, and the ways to say which photos are meant.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use pyo3::prelude::*;
use pyo3::types::{PyList, PyString, PyTuple};
use svbrdf_gcn::{CancelToken, Capture, CaptureOptions, ColorSpace, PhotoPixels, Shot, Transfer, Unit};

use crate::arrays::{ImageArray, Pixels, Triples, asarray, intensities, is_bare_iterable, shape_of, triples, tuple};
use crate::errors::{argument, detached, format, interruptible, shape};
use crate::fit::{PyCancelToken, token};
use crate::options::{Bytes, Given, Integers, bytes, choice, counts, items, maybe, maybe_count, named, shown};
use crate::types::{ArrayLike, Photos, Source};

/// What says how a capture is read.
pub struct Reading<'py> {
    pub size: Option<Given<'py, i128>>,
    pub views: Option<Given<'py, Integers>>,
    pub transfer: Option<Given<'py, String>>,
    pub color_space: Option<Given<'py, String>>,
    pub ignore_profiles: bool,
    /// Of the call, which a capture that is there does not contradict.
    pub cancel: CancelToken,
    pub max_memory: Option<u64>,
}

impl Reading<'_> {
    fn options(self) -> PyResult<CaptureOptions> {
        let mut options = CaptureOptions::new();
        options.size = maybe_count("size", self.size)?;
        options.views = self.views.map(|views| counts("views", views)).transpose()?;
        options.transfer = maybe("transfer", self.transfer)?.as_deref().map(transfer).transpose()?;
        options.color_space = maybe("color_space", self.color_space)?.as_deref().map(color_space).transpose()?;
        options.ignore_profiles = self.ignore_profiles;
        options.cancel = self.cancel;
        options.max_memory = self.max_memory;
        Ok(options)
    }

    fn given(&self) -> Option<&'static str> {
        [
            ("size", self.size.is_some()),
            ("views", self.views.is_some()),
            ("transfer", self.transfer.is_some()),
            ("color_space", self.color_space.is_some()),
            ("ignore_profiles", self.ignore_profiles),
        ]
        .into_iter()
        .find_map(|(name, given)| given.then_some(name))
    }
}

/// What is known of photos that are not part of a capture.
#[derive(Default)]
pub struct Setup<'py> {
    pub camera_positions: Option<ArrayLike<'py>>,
    pub light_positions: Option<ArrayLike<'py>>,
    pub patch_size: Option<Given<'py, f64>>,
    pub light_intensity: Option<ArrayLike<'py>>,
    pub white_level: Option<Given<'py, f32>>,
}

impl Setup<'_> {
    fn given(&self) -> Option<&'static str> {
        [
            ("camera_positions", self.camera_positions.is_some()),
            ("light_positions", self.light_positions.is_some()),
            ("patch_size", self.patch_size.is_some()),
            ("light_intensity", self.light_intensity.is_some()),
            ("white_level", self.white_level.is_some()),
        ]
        .into_iter()
        .find_map(|(name, given)| given.then_some(name))
    }

    fn shots(&self, photos: usize) -> PyResult<Vec<Shot>> {
        let missing = |name: &str, what: &str| {
            argument(name, format_args!("expected {what} for photos that are no capture, got None"))
        };
        let cameras =
            self.camera_positions.as_ref().ok_or_else(|| missing("camera_positions", "an array of shape (N, 3)"))?;
        let cameras = triples("camera_positions", cameras, photos)?;
        let lights = match &self.light_positions {
            Some(lights) => triples("light_positions", lights, photos)?,
            None => cameras.clone(),
        };
        let what = "one number or three (a white matt patch at distance r is as bright as light_intensity / (pi r^2))";
        let light_intensity = self.light_intensity.as_ref().ok_or_else(|| missing("light_intensity", what))?;
        let light_intensity = intensities("light_intensity", light_intensity, photos)?;
        let shots = cameras.into_iter().zip(lights).zip(light_intensity);
        Ok(shots.map(|((camera, light), light_intensity)| Shot { camera, light, light_intensity }).collect())
    }
}

/// The capture that the first argument of `fit_material` stands for.
///
/// # Errors
/// `ArgumentError` for arguments that a capture brings itself or that photos lack; as `Capture` and `Capture.open` otherwise.
pub fn capture(py: Python<'_>, source: &Source<'_>, setup: Setup<'_>, reading: Reading<'_>) -> PyResult<Arc<Capture>> {
    let (mut setup, mut light_intensity) = (setup, None);
    if let Source::Path(_) = source {
        light_intensity = setup.light_intensity.take();
    }
    let given = match source {
        Source::Capture(_) => setup.given().or_else(|| reading.given()),
        Source::Path(_) => setup.given(),
        Source::Photos(_) => None,
    };
    if let Some(name) = given {
        return Err(argument(name, "the capture brings its own, got it twice"));
    }
    match source {
        Source::Capture(capture) => Ok(capture.get().0.clone()),
        Source::Path(path) => {
            let mut options = reading.options()?;
            if let Some(light_intensity) = light_intensity {
                options.light_intensity = intensities("light_intensity", &light_intensity, 1)?.first().copied();
            }
            open(py, path, options)
        }
        Source::Photos(photos) => from_photos(&photos.0, setup, reading),
    }
}

fn open(py: Python<'_>, path: &Path, options: CaptureOptions) -> PyResult<Arc<Capture>> {
    read(py, options, |options| Capture::open_with(path, options))
}

fn from_photos(photos: &Bound<'_, PyAny>, setup: Setup<'_>, reading: Reading<'_>) -> PyResult<Arc<Capture>> {
    let py = photos.py();
    let options = reading.options()?;
    let photos = list(photos)?;
    let shots = setup.shots(photos.len())?;
    let patch_size = maybe("patch_size", setup.patch_size)?.ok_or_else(|| {
        argument("patch_size", "expected the width of the patch for photos that are no capture, got None")
    })?;
    let transfer = options.transfer.ok_or_else(|| {
        argument("transfer", "expected 'srgb', 'gamma2.2' or 'linear' for photos that are no capture, got None")
    })?;
    let white_level = maybe("white_level", setup.white_level)?;
    let paths = photos.iter().map(path).collect::<PyResult<Vec<_>>>()?;
    if paths.iter().any(Option::is_some) {
        let files = paths.into_iter().collect::<Option<Vec<_>>>();
        let files = files.ok_or_else(|| format("photos", "only paths or only arrays", "both"))?;
        let files: Vec<_> = files.into_iter().zip(shots).collect();
        return read(py, options, |options| Capture::from_files(&files, patch_size, transfer, white_level, options));
    }
    let named: Vec<(String, Pixels)> = photos
        .iter()
        .enumerate()
        .map(|(index, photo)| {
            let name = format!("photos[{index}]");
            let pixels = Pixels::read(&name, photo)?;
            Ok((name, pixels))
        })
        .collect::<PyResult<_>>()?;
    let pixels: Vec<PhotoPixels<'_>> = named
        .iter()
        .zip(shots)
        .map(|((name, pixels), shot)| PhotoPixels {
            name,
            shot,
            width: pixels.width,
            height: pixels.height,
            channels: pixels.channels,
            samples: pixels.values.samples(),
        })
        .collect();
    read(py, options, |options| Capture::from_photos(&pixels, patch_size, transfer, white_level, options))
}

/// Reads photos until the token of `options` is cancelled, or Ctrl-C is pressed.
fn read(
    py: Python<'_>,
    mut options: CaptureOptions,
    work: impl FnOnce(&CaptureOptions) -> svbrdf_gcn::Result<Capture> + Send,
) -> PyResult<Arc<Capture>> {
    options.cancel = options.cancel.child();
    interruptible(py, &options.cancel, || work(&options)).map(Arc::new)
}

/// The photos of a list, a generator or the like, or of an array of rank 4.
fn list<'py>(photos: &Bound<'py, PyAny>) -> PyResult<Vec<Bound<'py, PyAny>>> {
    let is_list = photos.is_instance_of::<PyList>() || photos.is_instance_of::<PyTuple>();
    if is_list || is_bare_iterable(photos)? {
        return items(photos).map_err(|error| named("photos", "photos", photos, error));
    }
    let array = asarray("photos", photos)?;
    let dims = shape_of(&array)?;
    if dims.is_empty() {
        let expected = "an array of shape (N, H, W, 3), or an iterable of arrays or of paths";
        return Err(format("photos", expected, shown(photos)));
    }
    if dims.len() != 4 {
        return Err(shape("photos", "shape (N, H, W, 3)", tuple(&dims)));
    }
    (0..dims[0]).map(|index| array.get_item(index)).collect()
}

/// The path that a string or path-like object stands for.
fn path(object: &Bound<'_, PyAny>) -> PyResult<Option<PathBuf>> {
    if object.is_instance_of::<PyString>() || object.hasattr("__fspath__")? {
        return object.extract().map(Some);
    }
    Ok(None)
}

fn transfer(name: &str) -> PyResult<Transfer> {
    choice("transfer", name, &[Transfer::Srgb, Transfer::Gamma22, Transfer::Linear], Transfer::name)
}

pub fn color_space(name: &str) -> PyResult<ColorSpace> {
    choice("color_space", name, &[ColorSpace::Rec709, ColorSpace::AcesCg], ColorSpace::name)
}

/// Photos of one nearly flat sample, and where camera and light stood for each.
///
/// The sample lies centred in the plane z = 0, x to the right, y up, z towards the camera. Positions and `patch_size` share
/// one length unit.
///
/// Parameters
/// ----------
/// photos : array of shape (N, H, W, 3), or an iterable of N arrays of shape (H, W, 3) or of N paths of image files
///     uint8 and uint16 stand for values from 0 to 1, floats for themselves. Grey photos and photos with alpha (which is
///     ignored) are taken as well. Arrays may have any layout; they are copied.
/// camera_positions : array_like of shape (N, 3)
///     Position of the camera for each photo.
/// patch_size : float
///     Width of the patch that the photos show.
/// light_intensity : float, or array_like of shape (3,) or (N, 3)
///     A white matt patch at distance r from the light has the radiance ``light_intensity / (pi * r**2)``, where 1 is the
///     photos' full value.
/// transfer : {"srgb", "gamma2.2", "linear"}
///     How stored values relate to linear radiance.
/// light_positions : array_like of shape (N, 3), optional
///     Position of the light for each photo; the camera's if not given.
/// white_level : float, optional
///     Stored value from which on floats are saturated. Integers are at their largest value.
/// size : int, optional
///     Longer side in pixels; larger photos are resampled by area, smaller ones are never enlarged.
/// views : iterable of int, optional
///     The photos to take, counted from 0.
/// color_space : {"rec709", "acescg"}, optional
///     Colour space of linear photos and of `light_intensity`, Rec. 709 if not given. Everything is computed in Rec. 709.
/// ignore_profiles : bool, default False
///     Read image files as if they held no colour profiles. Without it their colours are converted where `color_space` is not given.
/// cancel : CancelToken, optional
///     Stops the reading from any thread. So does Ctrl-C, with ``KeyboardInterrupt``.
/// max_memory : int or str, optional
///     Most bytes the run may use, such as ``4000000000`` or ``"2G"``; three quarters of the free memory if not given. Arrays that are given are not counted.
///
/// Raises
/// ------
/// ArgumentError
///     For positions that are not in front of the sample, NaN, and other values out of range.
/// ShapeError
///     For arrays of another shape, and photos that differ in size.
/// FormatError
///     For arrays of other types, and files of other formats.
/// OSError
///     For files that cannot be read.
/// MemoryError
///     If the photos need more than `max_memory`, before any is decoded.
/// Cancelled
///     If `cancel` was cancelled.
///
/// Examples
/// --------
/// >>> import numpy as np
/// >>> photos = np.full((2, 4, 6, 3), 128, np.uint8)
/// >>> cameras = [[-3, 0, 20], [3, 0, 20]]
/// >>> svbrdf_gcn.Capture(photos, camera_positions=cameras, patch_size=10, light_intensity=1200, transfer="srgb")
/// <svbrdf_gcn.Capture: 2 photos of 6 x 4 pixels, patch 10 wide, transfer srgb>
#[pyclass(frozen, name = "Capture", module = "svbrdf_gcn")]
pub struct PyCapture(pub Arc<Capture>);

#[pymethods]
impl PyCapture {
    #[new]
    #[pyo3(signature = (photos, *, camera_positions, patch_size, light_intensity, transfer, light_positions = None,
        white_level = None, size = None, views = None, color_space = None, ignore_profiles = Given::Default(false), cancel = None, max_memory = None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn new<'py>(
        photos: Photos<'py>,
        camera_positions: ArrayLike<'py>,
        patch_size: Given<'py, f64>,
        light_intensity: ArrayLike<'py>,
        transfer: Given<'py, String>,
        light_positions: Option<ArrayLike<'py>>,
        white_level: Option<Given<'py, f32>>,
        size: Option<Given<'py, i128>>,
        views: Option<Given<'py, Integers>>,
        color_space: Option<Given<'py, String>>,
        ignore_profiles: Given<'py, bool>,
        cancel: Option<Given<'py, Bound<'py, PyCancelToken>>>,
        max_memory: Option<Given<'py, Bytes>>,
    ) -> PyResult<Self> {
        let ignore_profiles = ignore_profiles.take("ignore_profiles")?;
        let setup = Setup {
            camera_positions: Some(camera_positions),
            light_positions,
            patch_size: Some(patch_size),
            light_intensity: Some(light_intensity),
            white_level,
        };
        let (cancel, max_memory) = (token(cancel)?, bytes(max_memory)?);
        let reading =
            Reading { size, views, transfer: Some(transfer), color_space, ignore_profiles, cancel, max_memory };
        from_photos(&photos.0, setup, reading).map(Self)
    }

    /// Read a capture: its folder or its JSON file, or one photo taken from straight above with the flash.
    ///
    /// ``docs/captures.md`` describes the layouts, and what is assumed of one photo alone.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    ///     Folder, ``capture.json``, JSON file of svbrdf-diff-renderer, or image file.
    /// size : int, optional
    ///     Longer side in pixels; larger photos are resampled by area, smaller ones are never enlarged.
    /// views : iterable of int, optional
    ///     The photos to take, counted from 0; no others are opened.
    /// transfer : {"srgb", "gamma2.2", "linear"}, optional
    ///     Replaces what the capture states.
    /// color_space : {"rec709", "acescg"}, optional
    ///     Replaces what the capture states for linear photos.
    /// ignore_profiles : bool, default False
    ///     Read photos as if their files held no colour profiles.
    /// cancel : CancelToken, optional
    ///     Stops the reading from any thread. So does Ctrl-C, with ``KeyboardInterrupt``.
    /// max_memory : int or str, optional
    ///     Most bytes the run may use, such as ``4000000000`` or ``"2G"``; three quarters of the free memory if not given.
    ///
    /// Returns
    /// -------
    /// Capture
    ///
    /// Raises
    /// ------
    /// OSError, ArgumentError, ShapeError, FormatError, MemoryError, Cancelled
    ///     As the constructor.
    ///
    /// Examples
    /// --------
    /// >>> svbrdf_gcn.Capture.open("samples/tiles", size=64, views=[0, 4])
    /// <svbrdf_gcn.Capture: 2 photos of 64 x 64 pixels, patch 10 wide, transfer srgb>
    #[staticmethod]
    #[pyo3(signature = (path, *, size = None,
        views = None, transfer = None, color_space = None, ignore_profiles = Given::Default(false), cancel = None, max_memory = None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn open<'py>(
        py: Python<'py>,
        path: Given<'py, PathBuf>,
        size: Option<Given<'py, i128>>,
        views: Option<Given<'py, Integers>>,
        transfer: Option<Given<'py, String>>,
        color_space: Option<Given<'py, String>>,
        ignore_profiles: Given<'py, bool>,
        cancel: Option<Given<'py, Bound<'py, PyCancelToken>>>,
        max_memory: Option<Given<'py, Bytes>>,
    ) -> PyResult<Self> {
        let ignore_profiles = ignore_profiles.take("ignore_profiles")?;
        let (cancel, max_memory) = (token(cancel)?, bytes(max_memory)?);
        let reading = Reading { size, views, transfer, color_space, ignore_profiles, cancel, max_memory };
        open(py, &path.take("path")?, reading.options()?).map(Self)
    }

    /// The capture with only some of its photos.
    ///
    /// Parameters
    /// ----------
    /// views : iterable of int
    ///     The photos to keep, counted from 0, in this order.
    ///
    /// Returns
    /// -------
    /// Capture
    ///
    /// Raises
    /// ------
    /// ArgumentError
    ///     If there is none, one is named twice, or one does not exist.
    ///
    /// Examples
    /// --------
    /// >>> capture = svbrdf_gcn.Capture.open("samples/tiles", size=32)
    /// >>> len(capture), len(capture.select([0, 8]))
    /// (9, 2)
    fn select(&self, py: Python<'_>, views: Given<'_, Integers>) -> PyResult<Self> {
        let views = counts("views", views)?;
        detached(py, || self.0.select(&views)).map(|capture| Self(Arc::new(capture)))
    }

    /// The photos: linear RGB, read-only arrays of shape (H, W, 3).
    #[getter]
    fn photos<'py>(&self, py: Python<'py>) -> PyResult<Vec<ImageArray<'py>>> {
        (0..self.0.len()).map(|index| ImageArray::view(py, &self.0, |capture| &capture.photos()[index].image)).collect()
    }

    /// Names of the photos: their files', or ``photos[0]`` and so on.
    #[getter]
    fn names(&self) -> Vec<&str> {
        self.0.photos().iter().map(|photo| photo.name.as_str()).collect()
    }

    /// Positions of the camera, shape (N, 3).
    #[getter]
    fn camera_positions(&self) -> Triples {
        Triples(self.0.photos().iter().map(|photo| photo.shot.camera).collect())
    }

    /// Positions of the light, shape (N, 3).
    #[getter]
    fn light_positions(&self) -> Triples {
        Triples(self.0.photos().iter().map(|photo| photo.shot.light).collect())
    }

    /// Intensities of the light, shape (N, 3), in photo units times length squared.
    #[getter]
    fn light_intensity(&self) -> Triples {
        Triples(self.0.photos().iter().map(|photo| photo.shot.light_intensity).collect())
    }

    /// Width of the patch.
    #[getter]
    fn patch_size(&self) -> f64 {
        self.0.patch_size()
    }

    /// Name of the length unit, where the capture states it.
    #[getter]
    fn unit(&self) -> Option<&str> {
        self.0.unit().map(Unit::name)
    }

    /// Columns of every photo.
    #[getter]
    fn width(&self) -> usize {
        self.0.width()
    }

    /// Rows of every photo.
    #[getter]
    fn height(&self) -> usize {
        self.0.height()
    }

    /// The transfer function that the photos were decoded with.
    #[getter]
    fn transfer(&self) -> &'static str {
        self.0.transfer().name()
    }

    /// What a user should know about how the capture was read.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.0.warnings().to_vec()
    }

    fn __len__(&self) -> usize {
        self.0.len()
    }

    fn __repr__(&self) -> String {
        let Self(capture) = self;
        format!(
            "<svbrdf_gcn.Capture: {} photos of {} x {} pixels, patch {} wide, transfer {}>",
            capture.len(),
            capture.width(),
            capture.height(),
            capture.patch_size(),
            capture.transfer().name()
        )
    }
}
