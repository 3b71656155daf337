//! Options as Python gives them.

use std::convert::Infallible;
use std::path::PathBuf;

use pyo3::exceptions::{PyOverflowError, PyTypeError, PyValueError};
use pyo3::inspect::PyStaticExpr;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyString, PyType};
use pyo3::{type_hint_identifier, type_hint_subscript, type_hint_union};
use svbrdf_gcn::memory::parse_bytes;

use crate::capture::PyCapture;
use crate::errors::{argument, exception, format};
use crate::fit::PyCancelToken;
use crate::material::PyMaterial;
use crate::types::{Callback, Weights};

/// The most photos, views or positions that are taken from a generator.
const MAX_ITEMS: usize = 1 << 16;
/// Characters of a wrong argument that a message shows.
const MAX_SHOWN: usize = 60;

/// An integer as a type that has no negative values.
///
/// # Errors
/// `ArgumentError` if it is negative or too large.
pub fn count<T: TryFrom<i128>>(name: &str, value: i128) -> PyResult<T> {
    T::try_from(value).map_err(|_| {
        let expected = if value < 0 { "an integer of 0 or more" } else { "a smaller integer" };
        argument(name, format_args!("expected {expected}, got {value}"))
    })
}

/// [`count`] of what is given.
///
/// # Errors
/// As [`count`].
pub fn maybe_count<T: TryFrom<i128>>(name: &str, value: Option<Given<'_, i128>>) -> PyResult<Option<T>> {
    maybe(name, value)?.map(|value| count(name, value)).transpose()
}

/// The number of bytes that is given.
///
/// # Errors
/// As [`maybe`].
pub fn bytes(max_memory: Option<Given<'_, Bytes>>) -> PyResult<Option<u64>> {
    Ok(maybe("max_memory", max_memory)?.map(|Bytes(bytes)| bytes))
}

/// [`count`] of every one.
///
/// # Errors
/// As [`count`].
pub fn counts(name: &str, values: Given<'_, Integers>) -> PyResult<Vec<usize>> {
    values.take(name)?.0.into_iter().map(|value| count(name, value)).collect()
}

/// The one of `all` that is called `value`.
///
/// # Errors
/// `ArgumentError` that lists the names.
pub fn choice<T: Copy>(name: &str, value: &str, all: &[T], of: impl Fn(T) -> &'static str) -> PyResult<T> {
    all.iter().copied().find(|&choice| of(choice) == value).ok_or_else(|| {
        let names: Vec<&str> = all.iter().map(|&choice| of(choice)).collect();
        let (last, rest) = names.split_last().unwrap_or((&"", &[]));
        argument(name, format_args!("expected {} or {last}, got '{value}'", rest.join(", ")))
    })
}

/// What a parameter takes.
pub trait Expected<'py>: Sized {
    /// Its type in the stubs.
    const HINT: PyStaticExpr;
    /// Its name in messages.
    const NAME: &'static str;

    /// The value that `object` stands for.
    fn take(object: &Bound<'py, PyAny>) -> PyResult<Self>;
}

macro_rules! expected {
    ($($type:ty: $name:literal),* $(,)?) => {$(
        impl<'py> Expected<'py> for $type {
            const HINT: PyStaticExpr = <$type as FromPyObject<'_, 'py>>::INPUT_TYPE;
            const NAME: &'static str = $name;

            #[allow(clippy::needless_question_mark, reason = "not every type fails with a PyErr")]
            fn take(object: &Bound<'py, PyAny>) -> PyResult<Self> {
                Ok(object.extract()?)
            }
        }
    )*};
}

expected! {
    i128: "an integer",
    f32: "a number",
    f64: "a number",
    bool: "True or False",
    String: "a string",
    PathBuf: "a path (str or os.PathLike)",
    Weights<'py>: "a Model or a path (str or os.PathLike)",
    Bound<'py, PyCancelToken>: "a CancelToken",
    Bound<'py, PyMaterial>: "a Material",
    Bound<'py, PyCapture>: "a Capture",
    Callback: "something to call",
}

/// A number of bytes: an integer, or a text as the command line takes it.
pub struct Bytes(pub u64);

impl<'py> Expected<'py> for Bytes {
    const HINT: PyStaticExpr =
        type_hint_union!(<i128 as FromPyObject<'_, 'py>>::INPUT_TYPE, <String as FromPyObject<'_, 'py>>::INPUT_TYPE);
    const NAME: &'static str = "an integer or a text such as '2G'";

    fn take(object: &Bound<'py, PyAny>) -> PyResult<Self> {
        if object.is_instance_of::<PyString>() {
            let text: String = object.extract()?;
            return parse_bytes(&text).map(Self).map_err(|error| exception(object.py(), &error));
        }
        count("max_memory", object.extract()?).map(Self)
    }
}

/// Where a flash is beside the lens; none where it is to be found.
pub struct LightOffset(pub Option<[f64; 2]>);

impl<'py> Expected<'py> for LightOffset {
    const HINT: PyStaticExpr =
        type_hint_union!(<Numbers as Expected<'py>>::HINT, <String as FromPyObject<'_, 'py>>::INPUT_TYPE);
    const NAME: &'static str = "two numbers or 'auto'";

    fn take(object: &Bound<'py, PyAny>) -> PyResult<Self> {
        if object.is_instance_of::<PyString>() {
            let text: String = object.extract()?;
            return if text == "auto" { Ok(Self(None)) } else { Err(PyTypeError::new_err("text")) };
        }
        let Numbers(offset) = Numbers::take(object)?;
        let offset = <[f64; 2]>::try_from(offset)
            .map_err(|offset| PyValueError::new_err(format!("{} of them", offset.len())))?;
        Ok(Self(Some(offset)))
    }
}

macro_rules! listed {
    ($($list:ident($type:ident): $name:literal;)*) => {$(
        #[doc = concat!("A list, generator or the like of ", $name, ", but no text.")]
        pub struct $list(pub Vec<$type>);

        impl<'py> Expected<'py> for $list {
            const HINT: PyStaticExpr = type_hint_subscript!(
                type_hint_identifier!("collections.abc", "Iterable"),
                <$type as FromPyObject<'_, 'py>>::INPUT_TYPE
            );
            const NAME: &'static str = $name;

            fn take(object: &Bound<'py, PyAny>) -> PyResult<Self> {
                if object.is_instance_of::<PyString>() || object.is_instance_of::<PyBytes>() {
                    return Err(PyTypeError::new_err("text"));
                }
                items(object)?.iter().map(|item| item.extract()).collect::<PyResult<_>>().map(Self)
            }
        }
    )*};
}

listed! {
    Integers(i128): "integers";
    Numbers(f64): "numbers";
    Paths(PathBuf): "paths";
}

/// What can be gone through, as a list.
///
/// # Errors
/// `TypeError` for what cannot; `ValueError` for more than any of ours may have: a generator need not end.
pub fn items<'py>(object: &Bound<'py, PyAny>) -> PyResult<Vec<Bound<'py, PyAny>>> {
    let items = object.try_iter()?.take(MAX_ITEMS + 1).collect::<PyResult<Vec<_>>>()?;
    if items.len() > MAX_ITEMS {
        return Err(PyValueError::new_err(format!("more than {MAX_ITEMS}")));
    }
    Ok(items)
}

/// An argument as it comes, to be taken under its name: what PyO3 takes itself is refused without one.
pub enum Given<'py, T> {
    Object(Bound<'py, PyAny>),
    Default(T),
}

impl<'py, T: Expected<'py>> Given<'py, T> {
    /// # Errors
    /// `FormatError` (a `TypeError`) for another type, `ArgumentError` (a `ValueError`) for what is none of its values; what the object itself raises.
    pub fn take(self, name: &str) -> PyResult<T> {
        let object = match self {
            Self::Object(object) => object,
            Self::Default(value) => return Ok(value),
        };
        T::take(&object).map_err(|error| named(name, T::NAME, &object, error))
    }
}

impl<'py, T: Expected<'py>> FromPyObject<'_, 'py> for Given<'py, T> {
    type Error = Infallible;
    const INPUT_TYPE: PyStaticExpr = T::HINT;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> Result<Self, Infallible> {
        Ok(Self::Object(object.to_owned()))
    }
}

/// [`Given::take`] of what is given.
///
/// # Errors
/// As [`Given::take`].
pub fn maybe<'py, T: Expected<'py>>(name: &str, given: Option<Given<'py, T>>) -> PyResult<Option<T>> {
    given.map(|given| given.take(name)).transpose()
}

/// `error`, if it is about the type or the value of `object`, as one of ours that says which argument it was.
pub fn named(name: &str, expected: &str, object: &Bound<'_, PyAny>, error: PyErr) -> PyErr {
    let py = object.py();
    let is_exactly = |class: &Bound<'_, PyType>| error.get_type(py).is(class);
    let is_type_error = is_exactly(&py.get_type::<PyTypeError>());
    if !is_type_error && !is_exactly(&py.get_type::<PyValueError>()) && !is_exactly(&py.get_type::<PyOverflowError>()) {
        return error;
    }
    if is_type_error {
        return format(name, expected, shown(object));
    }
    argument(name, format_args!("expected {expected}, got {}: {}", shown(object), error.value(py)))
}

/// An object as it may stand in a message: short, with its type.
pub fn shown(object: &Bound<'_, PyAny>) -> String {
    let kind = object.get_type().name().map_or_else(|_| String::new(), |name| format!(" ({name})"));
    let text = object.repr().map_or_else(|_| "something".to_owned(), |text| text.to_string_lossy().into_owned());
    let end = text.char_indices().nth(MAX_SHOWN).map(|(end, _)| end);
    match end {
        Some(end) => format!("{}...{kind}", &text[..end]),
        None => format!("{text}{kind}"),
    }
}
