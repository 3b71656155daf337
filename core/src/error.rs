//! The one error type of the crate; every binding maps these variants one to one.

use std::path::{Path, PathBuf};

/// What went wrong. Messages name the argument and both values.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value out of its range, or options that contradict each other.
    #[error("{name}: {reason}")]
    InvalidArgument {
        /// The argument, option or file the value came from.
        name: String,
        /// What was expected and what was found.
        reason: String,
    },
    /// Sizes, channel counts or strides that do not fit.
    #[error("{name}: expected {expected}, got {got}")]
    ShapeMismatch {
        /// The argument or file.
        name: String,
        /// The shape that would have been right.
        expected: String,
        /// The shape found.
        got: String,
    },
    /// A data type, file format or colour space this library does not read.
    #[error("{name}: unsupported format: {got}")]
    UnsupportedFormat {
        /// The argument or file.
        name: String,
        /// What it holds.
        got: String,
    },
    /// A weights file that is corrupt, of another version, or of another model.
    #[error("weights: {reason}")]
    Weights {
        /// What was expected and what was found.
        reason: String,
    },
    /// A file that is missing, unreadable or cannot be written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The operating system's or the decoder's word on it.
        source: std::io::Error,
    },
    /// NaN or infinity in the loss or the maps.
    #[error("{stage}: value is not finite at iteration {iteration}")]
    NonFinite {
        /// The stage of the fit, or the function.
        stage: String,
        /// The iteration, counted from 0.
        iteration: usize,
    },
    /// The run would need more memory than it may use.
    #[error("max_memory: the run needs about {needed} bytes, allowed are {allowed}")]
    OutOfMemory {
        /// Estimated need in bytes.
        needed: u64,
        /// The limit in bytes.
        allowed: u64,
    },
    /// The caller asked to stop; nothing is wrong.
    #[error("cancelled")]
    Cancelled,
}

/// [`std::result::Result`] with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// An [`Error::InvalidArgument`].
    pub(crate) fn invalid(name: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::InvalidArgument { name: name.into(), reason: reason.into() }
    }

    /// An [`Error::ShapeMismatch`].
    pub(crate) fn shape(name: impl Into<String>, expected: impl Into<String>, got: impl Into<String>) -> Self {
        Self::ShapeMismatch { name: name.into(), expected: expected.into(), got: got.into() }
    }

    /// An [`Error::Io`] for `path`.
    pub(crate) fn io(path: &Path, source: impl Into<std::io::Error>) -> Self {
        Self::Io { path: path.to_path_buf(), source: source.into() }
    }
}
