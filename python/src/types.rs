//! Python types that the stubs name and Rust does not have.

use std::convert::Infallible;
use std::ops::Deref;
use std::path::PathBuf;

use pyo3::exceptions::{PyRuntimeError, PyTypeError};
use pyo3::inspect::PyStaticExpr;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use pyo3::{type_hint_identifier, type_hint_subscript, type_hint_union};

use crate::capture::PyCapture;
use crate::fit::{PyModel, PyProgress};

const ARRAY_LIKE: PyStaticExpr = type_hint_identifier!("numpy.typing", "ArrayLike");
const PATH: PyStaticExpr = <PathBuf as FromPyObject<'_, '_>>::INPUT_TYPE;
const PROGRESS: PyStaticExpr = <PyProgress as pyo3::PyTypeInfo>::TYPE_HINT;

/// Anything that numpy can make an array of.
pub struct ArrayLike<'py>(Bound<'py, PyAny>);

impl<'py> FromPyObject<'_, 'py> for ArrayLike<'py> {
    type Error = Infallible;
    const INPUT_TYPE: PyStaticExpr = ARRAY_LIKE;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> Result<Self, Infallible> {
        Ok(Self(object.to_owned()))
    }
}

impl<'py> Deref for ArrayLike<'py> {
    type Target = Bound<'py, PyAny>;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

/// Photos: an array, or anything that arrays or paths come out of.
pub struct Photos<'py>(pub Bound<'py, PyAny>);

impl<'py> FromPyObject<'_, 'py> for Photos<'py> {
    type Error = Infallible;
    const INPUT_TYPE: PyStaticExpr = type_hint_union!(
        ARRAY_LIKE,
        type_hint_subscript!(type_hint_identifier!("collections.abc", "Iterable"), type_hint_union!(ARRAY_LIKE, PATH))
    );

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> Result<Self, Infallible> {
        Ok(Self(object.to_owned()))
    }
}

/// What a fit is made from.
#[derive(FromPyObject)]
pub enum Source<'py> {
    Capture(Bound<'py, PyCapture>),
    Path(PathBuf),
    Photos(Photos<'py>),
}

/// Weights, or the path of their file.
#[derive(FromPyObject)]
pub enum Weights<'py> {
    #[pyo3(annotation = "Model")]
    Model(Bound<'py, PyModel>),
    #[pyo3(annotation = "str or os.PathLike")]
    Path(PathBuf),
}

/// Something to call with a `Progress`.
pub struct Callback(pub Py<PyAny>);

impl<'py> FromPyObject<'_, 'py> for Callback {
    type Error = PyErr;
    const INPUT_TYPE: PyStaticExpr = type_hint_subscript!(
        type_hint_identifier!("collections.abc", "Callable"),
        PyStaticExpr::List { elts: &[PROGRESS] },
        type_hint_identifier!("builtins", "object")
    );

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        if object.is_callable() {
            return Ok(Self(object.to_owned().unbind()));
        }
        Err(PyTypeError::new_err(format!("expected something to call, got {}", object.repr()?)))
    }
}

/// A dictionary as `json.loads` makes it.
pub struct Json<'py>(pub Bound<'py, PyDict>);

impl<'py> Json<'py> {
    /// What serialises as an object.
    pub fn of(py: Python<'py>, value: &impl serde::Serialize) -> PyResult<Self> {
        Self::new(py, &serde_json::to_value(value).map_err(json_error)?)
    }

    /// A value of the core; an empty dictionary for null.
    pub fn new(py: Python<'py>, value: &serde_json::Value) -> PyResult<Self> {
        if value.is_null() {
            return Ok(Self(PyDict::new(py)));
        }
        Ok(Self(py.import("json")?.call_method1("loads", (value.to_string(),))?.cast_into()?))
    }
}

/// Only a bug keeps a report from being written as JSON.
pub fn json_error(error: serde_json::Error) -> PyErr {
    PyRuntimeError::new_err(format!("a bug in svbrdf_gcn, please report it: {error}"))
}

impl<'py> IntoPyObject<'py> for Json<'py> {
    type Target = PyDict;
    type Output = Bound<'py, PyDict>;
    type Error = Infallible;
    const OUTPUT_TYPE: PyStaticExpr = type_hint_subscript!(
        type_hint_identifier!("builtins", "dict"),
        type_hint_identifier!("builtins", "str"),
        type_hint_identifier!("typing", "Any")
    );

    fn into_pyobject(self, _: Python<'py>) -> Result<Self::Output, Infallible> {
        Ok(self.0)
    }
}
