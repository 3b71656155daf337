//! Options as Python gives them.

use pyo3::prelude::*;

use crate::errors::argument;

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
pub fn maybe_count<T: TryFrom<i128>>(name: &str, value: Option<i128>) -> PyResult<Option<T>> {
    value.map(|value| count(name, value)).transpose()
}

/// [`count`] of every one.
///
/// # Errors
/// As [`count`].
pub fn counts(name: &str, values: &[i128]) -> PyResult<Vec<usize>> {
    values.iter().map(|&value| count(name, value)).collect()
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
