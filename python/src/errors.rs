//! One table from the errors of the core to the exceptions of `svbrdf_gcn.errors` and Python's own.

use std::io::ErrorKind;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

use pyo3::exceptions::{PyMemoryError, PyOSError, PyRuntimeError};
use pyo3::prelude::*;
use svbrdf_gcn::{CancelToken, Error};

mod classes {
    use pyo3::import_exception;

    import_exception!(svbrdf_gcn.errors, ArgumentError);
    import_exception!(svbrdf_gcn.errors, BrokenFileError);
    import_exception!(svbrdf_gcn.errors, Cancelled);
    import_exception!(svbrdf_gcn.errors, FormatError);
    import_exception!(svbrdf_gcn.errors, NonFiniteError);
    import_exception!(svbrdf_gcn.errors, ShapeError);
    import_exception!(svbrdf_gcn.errors, WeightsError);
}

use classes::{ArgumentError, BrokenFileError, Cancelled, FormatError, NonFiniteError, ShapeError, WeightsError};

/// Python is asked for signals, and callbacks are called, no more often than this.
pub const PAUSE: Duration = Duration::from_millis(50);

/// Runs work of the core while other Python threads run.
///
/// # Errors
/// As [`exception`]; `RuntimeError` if the core panics.
pub fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> svbrdf_gcn::Result<T> + Send) -> PyResult<T> {
    match py.detach(|| catch_unwind(AssertUnwindSafe(work))) {
        Ok(result) => result.map_err(|error| exception(py, &error)),
        Err(panic) => {
            let said = panic.downcast_ref::<&str>().map(ToString::to_string);
            let said = said.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
            Err(PyRuntimeError::new_err(format!("a bug in svbrdf_gcn, please report it: {said}")))
        }
    }
}

/// [`detached`], on a thread of its own while this one listens to signals: Ctrl-C cancels `cancel`, which stops the work.
///
/// # Errors
/// As [`detached`]; what a signal's handler raises, `KeyboardInterrupt`.
pub fn interruptible<T: Send>(
    py: Python<'_>,
    cancel: &CancelToken,
    work: impl FnOnce() -> svbrdf_gcn::Result<T> + Send,
) -> PyResult<T> {
    let mut raised = None;
    let result = detached(py, || {
        let (sender, receiver) = sync_channel(1);
        std::thread::scope(|scope| {
            let worker = scope.spawn(move || drop(sender.send(work())));
            loop {
                match receiver.recv_timeout(PAUSE) {
                    Ok(result) => return result,
                    Err(RecvTimeoutError::Timeout) if raised.is_none() => {
                        raised = Python::attach(|py| py.check_signals()).err();
                        if raised.is_some() {
                            cancel.cancel();
                        }
                    }
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => break,
                }
            }
            // The work has panicked; `detached` says so.
            match worker.join() {
                Err(panic) => std::panic::resume_unwind(panic),
                Ok(()) => Err(Error::Cancelled),
            }
        })
    });
    match raised {
        Some(error) => Err(error),
        None => result,
    }
}

/// The exception that stands for an error of the core.
pub fn exception(py: Python<'_>, error: &Error) -> PyErr {
    let message = error.to_string();
    match error {
        Error::InvalidArgument { .. } => ArgumentError::new_err(message),
        Error::ShapeMismatch { .. } => ShapeError::new_err(message),
        Error::UnsupportedFormat { .. } => FormatError::new_err(message),
        Error::Weights { .. } => WeightsError::new_err(message),
        Error::Io { path, source } => os_error(py, path, source).unwrap_or_else(|error| error),
        Error::NonFinite { .. } => NonFiniteError::new_err(message),
        Error::OutOfMemory { .. } => PyMemoryError::new_err(message),
        Error::Cancelled => Cancelled::new_err(message),
        _ => PyRuntimeError::new_err(message),
    }
}

/// The subclass of `OSError` for an error of the system, with its number; `BrokenFileError` for a file that is broken. Both have a message and a file name.
fn os_error(py: Python<'_>, path: &Path, source: &std::io::Error) -> PyResult<PyErr> {
    let file = path.as_os_str().to_owned();
    if let Some(number) = source.raw_os_error() {
        let text = py.import("os")?.call_method1("strerror", (number,))?;
        return Ok(PyOSError::new_err((number, text.unbind(), file)));
    }
    if source.kind() == ErrorKind::NotFound {
        let number = py.import("errno")?.getattr("ENOENT")?;
        return Ok(PyOSError::new_err((number.unbind(), source.to_string(), file)));
    }
    Ok(BrokenFileError::new_err((py.None(), source.to_string(), file)))
}

/// An `ArgumentError`: `name: reason`.
pub fn argument(name: &str, reason: impl std::fmt::Display) -> PyErr {
    ArgumentError::new_err(format!("{name}: {reason}"))
}

/// A `ShapeError`: `name: expected ..., got ...`.
pub fn shape(name: &str, expected: impl std::fmt::Display, got: impl std::fmt::Display) -> PyErr {
    ShapeError::new_err(format!("{name}: expected {expected}, got {got}"))
}

/// A `FormatError`: `name: expected ..., got ...`.
pub fn format(name: &str, expected: impl std::fmt::Display, got: impl std::fmt::Display) -> PyErr {
    FormatError::new_err(format!("{name}: expected {expected}, got {got}"))
}
