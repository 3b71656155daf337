//! The one error type of the crate; every binding maps these variants one to one.

use std::fmt::Display;
use std::path::{Path, PathBuf};

/// What went wrong. Messages name the argument and both values. They are one line: control characters in names and texts of files are escaped, so that
/// none can steer a terminal.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value out of its range, or options that contradict each other.
    #[error("{}: {}", printable(name), printable(reason))]
    InvalidArgument {
        /// The argument, option or file the value came from.
        name: String,
        /// What was expected and what was found.
        reason: String,
    },
    /// Sizes, channel counts or strides that do not fit.
    #[error("{}: expected {}, got {}", printable(name), printable(expected), printable(got))]
    ShapeMismatch {
        /// The argument or file.
        name: String,
        /// The shape that would have been right.
        expected: String,
        /// The shape found.
        got: String,
    },
    /// A data type, file format or colour space this library does not read.
    #[error("{}: unsupported format: {}", printable(name), printable(got))]
    UnsupportedFormat {
        /// The argument or file.
        name: String,
        /// What it holds.
        got: String,
    },
    /// A weights file that is corrupt, of another version, or of another model.
    #[error("weights: {}", printable(reason))]
    Weights {
        /// What was expected and what was found.
        reason: String,
    },
    /// A file that is missing, unreadable or cannot be written.
    #[error("{}: {}", printable(path.display()), printable(source))]
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
    /// More memory than may be used, or than the system gives.
    #[error("{}", out_of_memory(what, *needed, *allowed))]
    OutOfMemory {
        /// What needs it.
        what: String,
        /// The need in bytes, estimated where there is a limit.
        needed: u64,
        /// The limit in bytes; `None` where the system refused.
        allowed: Option<u64>,
    },
    /// The caller asked to stop; nothing is wrong.
    #[error("cancelled")]
    Cancelled,
}

/// [`std::result::Result`] with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

fn out_of_memory(what: &str, needed: u64, allowed: Option<u64>) -> String {
    match allowed {
        Some(allowed) => format!(
            "max_memory: {what} needs about {needed} bytes, allowed are {allowed}: take a smaller size or fewer photos, or allow more"
        ),
        None => format!("memory: {what} need {needed} bytes, which the system refuses"),
    }
}

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

/// `text` on one line that leaves a terminal alone: control characters, and those that turn the direction of text, are escaped as in Rust's strings.
///
/// Names of files, and whatever else comes out of files, are shown to people only through this.
pub(crate) fn printable(text: impl Display) -> String {
    let text = text.to_string();
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        let turns =
            matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
        if c.is_control() || turns {
            shown.extend(c.escape_default());
        } else {
            shown.push(c);
        }
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_one_line_that_a_terminal_can_take() {
        assert_eq!(
            printable("a\u{1b}[31m\nb\u{9b}\u{202e}c \u{e9}\u{4e2d}"),
            "a\\u{1b}[31m\\nb\\u{9b}\\u{202e}c \u{e9}\u{4e2d}"
        );
        let name = "evil\u{1b}]0;title\u{7}.png";
        let errors = [
            Error::invalid(name, "a\nb"),
            Error::shape(name, "a\rb", "c\u{8}"),
            Error::UnsupportedFormat { name: name.into(), got: "\u{1b}c".into() },
            Error::Weights { reason: name.into() },
            Error::io(Path::new(name), std::io::Error::other("\u{1b}c")),
        ];
        for error in errors {
            let message = error.to_string();
            assert!(!message.chars().any(char::is_control), "{message:?}");
            assert!(message.contains("\\u{"), "{message}");
        }
    }
}
