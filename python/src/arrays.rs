//! Arrays in and out.
//!
//! Arrays come in untyped and are checked here, one copy each: what the caller does with them later has no effect. They go out as views
//! of the core's memory, which numpy finds by the array interface protocol; that works with every version of numpy.

use std::sync::Arc;

use pyo3::buffer::{Element, PyBuffer};
use pyo3::exceptions::PyMemoryError;
use pyo3::inspect::PyStaticExpr;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyTuple};
use pyo3::{type_hint_identifier, type_hint_subscript};
use svbrdf_gcn::Image;
use svbrdf_gcn::io::{MAX_DECODED_BYTES, Samples};

use crate::errors::{format, shape};
use crate::options::{items, named};

/// Values of an array, copied.
pub enum Values {
    U8(Vec<u8>),
    U16(Vec<u16>),
    F32(Vec<f32>),
}

impl Values {
    pub fn samples(&self) -> Samples<'_> {
        match self {
            Self::U8(values) => Samples::U8(values),
            Self::U16(values) => Samples::U16(values),
            Self::F32(values) => Samples::F32(values),
        }
    }
}

/// An image of 1 to 4 channels.
pub struct Pixels {
    pub width: usize,
    pub height: usize,
    pub channels: usize,
    pub values: Values,
}

impl Pixels {
    /// Copies an array of shape (H, W, C) or, for one channel, (H, W).
    ///
    /// # Errors
    /// `ShapeError` for another shape, one without pixels, or more than 1 GiB; `FormatError` for other types than `uint8`, `uint16` and floats;
    /// `MemoryError` if there is no room for a copy.
    pub fn read(name: &str, array: &Bound<'_, PyAny>) -> PyResult<Self> {
        let array = asarray(name, array)?;
        let dims = shape_of(&array)?;
        let (height, width, channels) = match dims[..] {
            [height, width] => (height, width, 1),
            [height, width, channels] => (height, width, channels),
            _ => (0, 0, 0),
        };
        if height == 0 || width == 0 || !(1..=4).contains(&channels) {
            return Err(shape(name, "shape (H, W, 3), none of them 0", tuple(&dims)));
        }
        let dtype = array.getattr("dtype")?;
        let bytes = [width, height, channels, dtype.getattr("itemsize")?.extract()?]
            .into_iter()
            .try_fold(1u64, |product, n| product.checked_mul(n as u64));
        if bytes.is_none_or(|bytes| bytes > MAX_DECODED_BYTES) {
            return Err(shape(name, format_args!("at most {MAX_DECODED_BYTES} bytes of pixels"), tuple(&dims)));
        }
        let kind: String = dtype.getattr("name")?.extract()?;
        let values = match kind.as_str() {
            "uint8" => Values::U8(copy(&array, "u1")?),
            "uint16" => Values::U16(copy(&array, "u2")?),
            "float16" | "float32" => Values::F32(copy(&array, "f4")?),
            // Single precision is what everything computes in; a value beyond its range becomes infinite and is refused as such.
            "float64" => Values::F32(copy::<f64>(&array, "f8")?.into_iter().map(|value| value as f32).collect()),
            other => return Err(format(name, "uint8, uint16, float16, float32 or float64", other)),
        };
        Ok(Self { width, height, channels, values })
    }

    /// The pixels as an image of linear values, which only arrays of floats hold.
    ///
    /// # Errors
    /// `FormatError` for integers.
    pub fn into_image(self, py: Python<'_>, name: &str) -> PyResult<Image> {
        match self.values {
            Values::F32(values) => Image::new(self.width, self.height, self.channels, values)
                .map_err(|error| crate::errors::exception(py, &error)),
            Values::U8(_) => Err(format(name, "linear values as floats", "uint8")),
            Values::U16(_) => Err(format(name, "linear values as floats", "uint16")),
        }
    }
}

/// The linear image that an array of floats holds.
///
/// # Errors
/// As [`Pixels::read`] and [`Pixels::into_image`].
pub fn image(name: &str, array: &Bound<'_, PyAny>) -> PyResult<Image> {
    Pixels::read(name, array)?.into_image(array.py(), name)
}

/// The array that argument `name` stands for: what numpy makes one of, and generators and the like.
///
/// # Errors
/// `FormatError` or `ArgumentError` for what is none.
pub fn asarray<'py>(name: &str, object: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    array_of(name, "an array", object, None)
}

/// Likewise, of `float64`.
fn float64<'py>(name: &str, object: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    array_of(name, "numbers", object, Some("f8"))
}

fn array_of<'py>(
    name: &str,
    expected: &str,
    object: &Bound<'py, PyAny>,
    dtype: Option<&str>,
) -> PyResult<Bound<'py, PyAny>> {
    let array = || {
        let numpy = object.py().import("numpy")?;
        if is_bare_iterable(object)? {
            return numpy.call_method1("asarray", (items(object)?, dtype));
        }
        numpy.call_method1("asarray", (object, dtype))
    };
    array().map_err(|error| named(name, expected, object, error))
}

/// Whether all that can be done with an object is to go through it: of a generator numpy would make an array of one object.
pub fn is_bare_iterable(object: &Bound<'_, PyAny>) -> PyResult<bool> {
    Ok(object.hasattr("__iter__")? && !object.hasattr("__getitem__")? && !object.hasattr("__array__")?)
}

pub fn shape_of(array: &Bound<'_, PyAny>) -> PyResult<Vec<usize>> {
    array.getattr("shape")?.extract()
}

/// A shape as Python writes it.
pub fn tuple(dims: &[usize]) -> String {
    match dims {
        [one] => format!("({one},)"),
        _ => format!("({})", dims.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
    }
}

/// The values of an array, row by row, whatever its layout and byte order.
fn copy<T: Element + Default>(array: &Bound<'_, PyAny>, dtype: &str) -> PyResult<Vec<T>> {
    let py = array.py();
    let rows = py.import("numpy")?.call_method1("require", (array, dtype, ["C", "ALIGNED"]))?;
    let buffer = PyBuffer::<T>::get(&rows)?;
    let mut values = Vec::new();
    values
        .try_reserve_exact(buffer.item_count())
        .map_err(|_| PyMemoryError::new_err(format!("no memory for a copy of {} bytes", buffer.len_bytes())))?;
    values.resize(buffer.item_count(), T::default());
    buffer.copy_to_slice(py, &mut values)?;
    Ok(values)
}

/// Four corners of each photo, from an array of shape (N, 4, 2) or (N, 8).
///
/// # Errors
/// `ShapeError`, or what numpy raises for something that is not numbers.
pub fn corners_of(object: &Bound<'_, PyAny>) -> PyResult<Vec<[[f64; 2]; 4]>> {
    let array = float64("corners", object)?;
    match shape_of(&array)?.as_slice() {
        [_, 4, 2] => array.call_method0("tolist")?.extract(),
        &[count, 8] => array.call_method1("reshape", (count, 4, 2))?.call_method0("tolist")?.extract(),
        dims => Err(shape("corners", "shape (N, 4, 2) or (N, 8)", tuple(dims))),
    }
}

/// `count` rows of three finite or infinite numbers.
///
/// # Errors
/// `ShapeError`, or what numpy raises for something that is not numbers.
pub fn triples(name: &str, object: &Bound<'_, PyAny>, count: usize) -> PyResult<Vec<[f64; 3]>> {
    let array = float64(name, object)?;
    let dims = shape_of(&array)?;
    if dims != [count, 3] {
        return Err(shape(name, format_args!("shape ({count}, 3)"), tuple(&dims)));
    }
    array.call_method0("tolist")?.extract()
}

/// Three numbers.
///
/// # Errors
/// As [`triples`].
pub fn triple(name: &str, object: &Bound<'_, PyAny>) -> PyResult<[f64; 3]> {
    let array = float64(name, object)?;
    let dims = shape_of(&array)?;
    if dims != [3] {
        return Err(shape(name, "shape (3,)", tuple(&dims)));
    }
    array.call_method0("tolist")?.extract()
}

/// A number for all photos and channels, three for all photos, or three for each of `count`.
///
/// # Errors
/// As [`triples`].
pub fn intensities(name: &str, object: &Bound<'_, PyAny>, count: usize) -> PyResult<Vec<[f64; 3]>> {
    let array = float64(name, object)?;
    let dims = shape_of(&array)?;
    let list = array.call_method0("tolist")?;
    match dims[..] {
        [] => Ok(vec![[list.extract()?; 3]; count]),
        [3] => Ok(vec![list.extract()?; count]),
        [n, 3] if n == count => list.extract(),
        _ => Err(shape(name, format_args!("shape (), (3,) or ({count}, 3)"), tuple(&dims))),
    }
}

/// Presents values to numpy and keeps their owner alive for as long as there is an array of them.
#[pyclass(frozen, module = "svbrdf_gcn._svbrdf_gcn")]
struct View {
    _owner: Arc<dyn Send + Sync>,
    shape: Vec<usize>,
    address: usize,
    read_only: bool,
}

#[pymethods]
impl View {
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let order = if cfg!(target_endian = "little") { '<' } else { '>' };
        let interface = PyDict::new(py);
        interface.set_item("version", 3)?;
        interface.set_item("shape", PyTuple::new(py, &self.shape)?)?;
        interface.set_item("typestr", format!("{order}f4"))?;
        interface.set_item("data", (self.address, self.read_only))?;
        Ok(interface)
    }
}

/// A float32 array of shape (H, W, C).
pub struct ImageArray<'py>(Bound<'py, PyAny>);

impl<'py> ImageArray<'py> {
    /// A read-only view of an image of `owner`.
    pub fn view<T: Send + Sync + 'static>(
        py: Python<'py>,
        owner: &Arc<T>,
        image: impl FnOnce(&T) -> &Image,
    ) -> PyResult<Self> {
        Self::part(py, owner.clone(), image(owner))
    }

    /// A read-only view of an image that `owner` may have.
    pub fn view_of_some<T: Send + Sync + 'static>(
        py: Python<'py>,
        owner: &Arc<T>,
        image: impl FnOnce(&T) -> Option<&Image>,
    ) -> PyResult<Option<Self>> {
        image(owner).map(|image| Self::part(py, owner.clone(), image)).transpose()
    }

    /// A view of `image`, which is a part of `owner`: the two functions above see to that.
    fn part(py: Python<'py>, owner: Arc<dyn Send + Sync>, image: &Image) -> PyResult<Self> {
        let shape = vec![image.height(), image.width(), image.channels()];
        let address = image.data().as_ptr().expose_provenance();
        asarray("image", Bound::new(py, View { _owner: owner, shape, address, read_only: true })?.as_any()).map(Self)
    }

    /// An array of the caller's own.
    pub fn owned(py: Python<'py>, image: &Image) -> PyResult<Self> {
        let array =
            py.import("numpy")?.call_method1("empty", ((image.height(), image.width(), image.channels()), "f4"))?;
        PyBuffer::<f32>::get(&array)?.copy_from_slice(py, image.data())?;
        Ok(Self(array))
    }
}

/// A float32 array of this shape that takes over `values`.
///
/// # Errors
/// `ShapeError` if there are not as many values as the shape says.
pub fn array<'py>(py: Python<'py>, mut values: Vec<f32>, shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    if shape.iter().product::<usize>() != values.len() {
        return Err(self::shape("values", tuple(shape), tuple(&[values.len()])));
    }
    let address = values.as_mut_ptr().expose_provenance();
    let view = View { _owner: Arc::new(values), shape: shape.to_vec(), address, read_only: false };
    asarray("values", Bound::new(py, view)?.as_any())
}

pub const NUMPY_FLOAT32: PyStaticExpr =
    type_hint_subscript!(type_hint_identifier!("numpy.typing", "NDArray"), type_hint_identifier!("numpy", "float32"));
const NUMPY_FLOAT64: PyStaticExpr =
    type_hint_subscript!(type_hint_identifier!("numpy.typing", "NDArray"), type_hint_identifier!("numpy", "float64"));

impl<'py> IntoPyObject<'py> for ImageArray<'py> {
    type Target = PyAny;
    type Output = Bound<'py, PyAny>;
    type Error = std::convert::Infallible;
    const OUTPUT_TYPE: PyStaticExpr = NUMPY_FLOAT32;

    fn into_pyobject(self, _: Python<'py>) -> Result<Self::Output, Self::Error> {
        Ok(self.0)
    }
}

/// A float64 array of shape (N, 3).
pub struct Triples(pub Vec<[f64; 3]>);

impl<'py> IntoPyObject<'py> for Triples {
    type Target = PyAny;
    type Output = Bound<'py, PyAny>;
    type Error = PyErr;
    const OUTPUT_TYPE: PyStaticExpr = NUMPY_FLOAT64;

    fn into_pyobject(self, py: Python<'py>) -> PyResult<Self::Output> {
        float64("positions", PyList::new(py, self.0)?.as_any())
    }
}
