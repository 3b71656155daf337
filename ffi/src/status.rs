//! Status codes, and the message that goes with the last failure of a thread.

use std::cell::RefCell;
use std::ffi::{CString, c_char};

use svbrdf_gcn::Error;

use svbrdf_gcn_status::*;

/// What a call came to. Numbers are never used again for something else.
#[repr(i32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum svbrdf_gcn_status {
    /// Done.
    SVBRDF_GCN_OK = 0,
    /// Asked to stop by the progress callback or a cancel token; nothing is wrong.
    SVBRDF_GCN_CANCELLED = 1,
    /// A pointer that must not be NULL is.
    SVBRDF_GCN_ERR_NULL = 2,
    /// A `struct_size` that no release had: the struct was not initialised.
    SVBRDF_GCN_ERR_STRUCT_SIZE = 3,
    /// A value out of its range, an unknown enum value, or options that contradict each other.
    SVBRDF_GCN_ERR_INVALID_ARGUMENT = 4,
    /// Sizes, channel counts or strides that do not fit.
    SVBRDF_GCN_ERR_SHAPE = 5,
    /// A pixel type, file format or colour space that is not read or written.
    SVBRDF_GCN_ERR_FORMAT = 6,
    /// Weights that are not there, corrupt, of another version, or for more photos than there are.
    SVBRDF_GCN_ERR_WEIGHTS = 7,
    /// A file that is missing, unreadable, broken, or cannot be written.
    SVBRDF_GCN_ERR_IO = 8,
    /// NaN or infinity in the loss or the maps.
    SVBRDF_GCN_ERR_NON_FINITE = 9,
    /// The run would need more memory than it may use.
    SVBRDF_GCN_ERR_OUT_OF_MEMORY = 10,
    /// A bug of the library; please report the message. Handles that were part of the call may only be destroyed.
    SVBRDF_GCN_ERR_INTERNAL = 11,
}

/// Why a call failed.
#[derive(Debug)]
pub(crate) struct Failure {
    pub status: svbrdf_gcn_status,
    pub message: String,
}

pub(crate) type Result<T> = std::result::Result<T, Failure>;

impl Failure {
    pub fn null(name: &str) -> Self {
        Self { status: SVBRDF_GCN_ERR_NULL, message: format!("{name}: must not be NULL") }
    }

    pub fn invalid(name: &str, reason: impl std::fmt::Display) -> Self {
        Self { status: SVBRDF_GCN_ERR_INVALID_ARGUMENT, message: format!("{name}: {reason}") }
    }

    pub fn shape(name: &str, reason: impl std::fmt::Display) -> Self {
        Self { status: SVBRDF_GCN_ERR_SHAPE, message: format!("{name}: {reason}") }
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let status = match &error {
            Error::InvalidArgument { .. } => SVBRDF_GCN_ERR_INVALID_ARGUMENT,
            Error::ShapeMismatch { .. } => SVBRDF_GCN_ERR_SHAPE,
            Error::UnsupportedFormat { .. } => SVBRDF_GCN_ERR_FORMAT,
            Error::Weights { .. } => SVBRDF_GCN_ERR_WEIGHTS,
            Error::Io { .. } => SVBRDF_GCN_ERR_IO,
            Error::NonFinite { .. } => SVBRDF_GCN_ERR_NON_FINITE,
            Error::OutOfMemory { .. } => SVBRDF_GCN_ERR_OUT_OF_MEMORY,
            Error::Cancelled => SVBRDF_GCN_CANCELLED,
            _ => SVBRDF_GCN_ERR_INTERNAL,
        };
        Self { status, message: error.to_string() }
    }
}

thread_local! {
    static LAST_ERROR: RefCell<CString> = RefCell::default();
}

/// Keeps `message` for [`svbrdf_gcn_last_error_message`].
pub(crate) fn set_last_error(message: &str) {
    // During the end of a thread there is nobody left to read it.
    let _ = LAST_ERROR.try_with(|last| *last.borrow_mut() = c_string(message));
}

/// `text` for C: what follows a NUL would be lost, so NULs become spaces.
pub(crate) fn c_string(text: &str) -> CString {
    CString::new(text.replace('\0', " ")).unwrap_or_default()
}

/// What the last call of this thread that did not return `SVBRDF_GCN_OK` had to say, in English and UTF-8; empty if there was none.
/// Never NULL. Valid until this thread's next call of any function but this one.
#[unsafe(no_mangle)]
pub extern "C" fn svbrdf_gcn_last_error_message() -> *const c_char {
    LAST_ERROR.try_with(|last| last.borrow().as_ptr()).unwrap_or(c"".as_ptr())
}
