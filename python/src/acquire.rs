//! `acquire`, from raw photos to a capture.

use std::path::PathBuf;

use pyo3::prelude::*;
use svbrdf_gcn::acquire::{AcquireOptions, Acquisition, Corners, Sheet, acquire};

use crate::arrays::{ImageArray, corners_of};
use crate::capture::PyCapture;
use crate::errors::{argument, exception};
use crate::fit::{PyCancelToken, reported, token};
use crate::options::{Bytes, Given, LightOffset, Paths, bytes, maybe, maybe_count};
use crate::types::{ArrayLike, Callback, Json};

/// Width of the sheet's window in millimetres.
const WINDOW: f64 = 100.0;

/// A capture made of raw photos, and how it came about; see ``acquire``.
///
/// Examples
/// --------
/// >>> acquisition = svbrdf_gcn.acquire(photos, light_offset=(12, 0))  # doctest: +SKIP
/// >>> acquisition  # doctest: +SKIP
/// <svbrdf_gcn.Acquisition: 9 photos, 0 left out>
/// >>> material = svbrdf_gcn.fit_material(acquisition.capture)  # doctest: +SKIP
#[pyclass(frozen, name = "Acquisition", module = "svbrdf_gcn")]
pub struct PyAcquisition(Acquisition);

#[pymethods]
impl PyAcquisition {
    /// The rectified photos with their positions, in millimetres.
    #[getter]
    fn capture(&self) -> PyCapture {
        PyCapture(self.0.capture.clone())
    }

    /// What was found: ``photos``, those ``left_out`` with the reason, ``lenses``, ``warnings``.
    #[getter]
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Json<'py>> {
        Json::of(py, &self.0.report)
    }

    /// A picture of it in sRGB from 0 to 1, float32 of shape (H, W, 3): photos with tags and sample drawn in, rectified patches, where cameras stood, what is missing.
    #[getter]
    fn contact_sheet<'py>(&self, py: Python<'py>) -> PyResult<ImageArray<'py>> {
        ImageArray::owned(py, &self.0.contact_sheet)
    }

    /// Write the capture to a folder: ``capture.json``, the rectified photos as OpenEXR, for each with saturated pixels a PNG that says which, and ``contact-sheet.png``.
    ///
    /// Parameters
    /// ----------
    /// folder : str or os.PathLike
    ///     Made if it is not there.
    ///
    /// Raises
    /// ------
    /// ArgumentError
    ///     If that would replace files that are not ours.
    /// OSError
    ///     If it cannot be written.
    ///
    /// Examples
    /// --------
    /// >>> acquisition = svbrdf_gcn.acquire(photos, depth=1)  # doctest: +SKIP
    /// >>> acquisition.save("leather")  # doctest: +SKIP
    fn save(&self, py: Python<'_>, folder: Given<'_, PathBuf>) -> PyResult<()> {
        let folder = folder.take("folder")?;
        crate::errors::detached(py, || self.0.save(folder))
    }

    fn __repr__(&self) -> String {
        let (photos, left_out) = (self.0.capture.len(), self.0.report.left_out.len());
        format!("<svbrdf_gcn.Acquisition: {photos} photos, {left_out} left out>")
    }
}

/// Make a capture of photos that show the sample in the window of a printed sheet (``svbrdf-gcn sheet``, docs/capturing.md), or of which the patch's corners are known.
///
/// Lengths are in millimetres. Photos that cannot be used are left out and named in the report with the reason.
///
/// Parameters
/// ----------
/// photos : iterable of str or os.PathLike
///     The photos' files.
/// window : float, optional
///     Width of the window of our own sheet; 100 if not given.
/// frame_width : float, optional
///     The photos show the frame of svbrdf-diff-renderer instead, this wide from outer edge to outer edge.
/// printed_bar : float, optional
///     Length of the sheet's bar of 100 mm as it was printed.
/// depth : float, default 0
///     How far the sample lies below the sheet's face.
/// size : int, optional
///     Side of the rectified photos in pixels, 16 to 16384; 1024 if not given. They are never finer than the photos.
/// light_offset : iterable of float or "auto", optional
///     Where the flash is, seen from the lens: to the right and up in photos as they were taken, before they were turned upright. At the lens if not given;
///     found from the paper if ``"auto"``.
/// dark : str or os.PathLike, optional
///     A photo of the sheet without flash, exposed as the others: what it shows is subtracted.
/// paper_white : float, default 0.8
///     Diffuse albedo of the paper.
/// corners : array_like of shape (N, 4, 2) or (N, 8), optional
///     There is no sheet: for each photo the upper left, upper right, lower right and lower left corner of the sample's square patch, x and y in pixels of
///     the photo as viewers show it. What is assumed then is in the report (``assumptions``).
/// patch_width : float, optional
///     Width of the patch whose corners are given.
/// max_memory : int or str, optional
///     Most bytes the work may use, such as ``4000000000`` or ``"2G"``; three quarters of the free memory if not given.
/// progress : callable, optional
///     Called on this thread with a ``Progress`` at most every 50 ms, and at the end. What it raises stops the work and comes out unchanged.
/// cancel : CancelToken, optional
///     Stops the work from any thread. So does Ctrl-C, with ``KeyboardInterrupt``.
///
/// Returns
/// -------
/// Acquisition
///     Its `capture` is what ``fit_material`` takes.
///
/// Raises
/// ------
/// ArgumentError
///     For options out of range, and if no photo can be used.
/// OSError, FormatError
///     For photos that cannot be read.
/// MemoryError
///     If the photos need more than `max_memory`.
/// Cancelled
///     If `cancel` was cancelled.
///
/// Examples
/// --------
/// >>> try:
/// ...     svbrdf_gcn.acquire(["samples/tiles/00.png"])
/// ... except svbrdf_gcn.ArgumentError as error:
/// ...     print("none can be used" in str(error))
/// True
#[pyfunction]
#[pyo3(name = "acquire", signature = (photos, *, window = None, frame_width = None, printed_bar = None, depth = Given::Default(0.0), size = None,
    light_offset = None, dark = None, paper_white = Given::Default(0.8), corners = None, patch_width = None, max_memory = None, progress = None, cancel = None))]
#[allow(clippy::too_many_arguments, reason = "they have names in Python")]
pub fn py_acquire(
    py: Python<'_>,
    photos: Given<'_, Paths>,
    window: Option<Given<'_, f64>>,
    frame_width: Option<Given<'_, f64>>,
    printed_bar: Option<Given<'_, f64>>,
    depth: Given<'_, f64>,
    size: Option<Given<'_, i128>>,
    light_offset: Option<Given<'_, LightOffset>>,
    dark: Option<Given<'_, PathBuf>>,
    paper_white: Given<'_, f64>,
    corners: Option<ArrayLike<'_>>,
    patch_width: Option<Given<'_, f64>>,
    max_memory: Option<Given<'_, Bytes>>,
    progress: Option<Given<'_, Callback>>,
    cancel: Option<Given<'_, Bound<'_, PyCancelToken>>>,
) -> PyResult<PyAcquisition> {
    let Paths(photos) = photos.take("photos")?;
    let raised = |error: svbrdf_gcn::Error| exception(py, &error);
    let (window, frame_width) = (maybe("window", window)?, maybe("frame_width", frame_width)?);
    let (printed_bar, patch_width) = (maybe("printed_bar", printed_bar)?, maybe("patch_width", patch_width)?);
    let of_sheets = [("window", window), ("frame_width", frame_width), ("printed_bar", printed_bar)];
    let given = of_sheets.into_iter().find_map(|(name, value)| Some((name, value?)));
    if let (Some(_), Some((name, value))) = (&corners, given) {
        let reason = format_args!("is for photos of a sheet: expected none beside corners, got {value}");
        return Err(argument(name, reason));
    }
    let mut options = match (corners, patch_width) {
        (Some(corners), Some(width)) => {
            AcquireOptions::of_corners(Corners::new(width, corners_of(&corners)?).map_err(raised)?)
        }
        (Some(_), None) => {
            return Err(argument("patch_width", "expected the width of the patch whose corners are given, got None"));
        }
        (None, Some(width)) => {
            return Err(argument(
                "patch_width",
                format_args!("is for photos whose corners are given: expected none without corners, got {width}"),
            ));
        }
        (None, None) => {
            let sheet = match (window, frame_width) {
                (Some(_), Some(_)) => {
                    return Err(argument("frame_width", "is the other sheet's, which has no window, got both"));
                }
                (None, Some(width)) => Sheet::tags16(width),
                (window, None) => Sheet::new(window.unwrap_or(WINDOW)),
            };
            let scaled = |sheet: Sheet| printed_bar.map_or(Ok(sheet.clone()), |length| sheet.with_printed_bar(length));
            AcquireOptions::new(sheet.and_then(scaled).map_err(raised)?)
        }
    };
    options.depth = depth.take("depth")?;
    options.size = maybe_count("size", size)?;
    options.paper_white = paper_white.take("paper_white")?;
    options.max_memory = bytes(max_memory)?;
    if let Some(LightOffset(offset)) = maybe("light_offset", light_offset)? {
        options.light_offset = offset;
    }
    options.dark = maybe("dark", dark)?;
    options.cancel = token(cancel)?;
    let progress = maybe("progress", progress)?;
    reported(py, progress, |progress| acquire(&photos, &options, progress)).map(PyAcquisition)
}
