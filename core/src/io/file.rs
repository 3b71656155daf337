//! Files to read. What is no file, a named pipe say, would be waited for without end: it is looked at before it is opened.

use std::fs::{File, FileType, Metadata};
use std::io::{self, Read};
use std::path::Path;

use crate::cancel::{CancelToken, Cancellable};
use crate::error::{Error, Result};
use crate::memory;

/// Opens a regular file to be read, and says how many bytes it has.
///
/// # Errors
/// [`Error::Io`] saying what `path` is, if it is no regular file.
pub(crate) fn open(path: &Path) -> Result<(File, u64)> {
    let regular = |metadata: io::Result<Metadata>| -> Result<u64> {
        let metadata = metadata.map_err(|e| Error::io(path, e))?;
        match kind(metadata.file_type()) {
            None => Ok(metadata.len()),
            Some(kind) => Err(Error::io(path, io::Error::other(format!("expected a file, got {kind}")))),
        }
    };
    regular(std::fs::metadata(path))?;
    let file = File::open(path).map_err(|e| Error::io(path, e))?;
    let len = regular(file.metadata())?;
    Ok((file, len))
}

/// What a path leads to that is no regular file.
fn kind(file_type: FileType) -> Option<&'static str> {
    if file_type.is_file() {
        return None;
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if file_type.is_fifo() {
            return Some("a named pipe");
        }
        if file_type.is_socket() {
            return Some("a socket");
        }
        if file_type.is_char_device() || file_type.is_block_device() {
            return Some("a device");
        }
    }
    Some(if file_type.is_dir() { "a folder" } else { "something else" })
}

/// The bytes of a regular file of at most `max` bytes.
///
/// # Errors
/// As [`open`]; [`Error::InvalidArgument`] if it has more; [`Error::OutOfMemory`] if the system refuses memory for them.
pub(crate) fn read_file(path: &Path, max: u64) -> Result<Vec<u8>> {
    read_file_unless(path, max, &CancelToken::new())
}

/// [`read_file`] until `cancel` is cancelled.
///
/// # Errors
/// As [`read_file`]; [`Error::Cancelled`].
pub(crate) fn read_file_unless(path: &Path, max: u64, cancel: &CancelToken) -> Result<Vec<u8>> {
    let (file, len) = open(path)?;
    if len > max {
        return Err(Error::invalid(path.display().to_string(), format!("file of {len} bytes, at most {max} are read")));
    }
    let mut bytes = memory::reserved(len as usize)?;
    // A file that grows meanwhile is read as far as it was looked at.
    let read = Cancellable::new(file.take(len), cancel).read_to_end(&mut bytes);
    cancel.check()?;
    read.map_err(|e| Error::io(path, e))?;
    Ok(bytes)
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::symlink;
    use std::process::Command;

    use super::*;

    #[test]
    fn what_is_no_file_is_named_and_not_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let (pipe, link, socket) =
            (folder.path().join("pipe"), folder.path().join("link"), folder.path().join("socket"));
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        symlink(&pipe, &link).unwrap();
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        let cases = [
            (pipe.as_path(), "a named pipe"),
            (&link, "a named pipe"),
            (folder.path(), "a folder"),
            (&socket, "a socket"),
            (Path::new("/dev/zero"), "a device"),
        ];
        for (path, what) in cases {
            let message = read_file(path, 10).unwrap_err().to_string();
            assert!(message.contains(&path.display().to_string()) && message.ends_with(what), "{message}");
        }
    }

    #[test]
    fn sizes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, b"twelve bytes").unwrap();
        assert_eq!(read_file(&path, 12).unwrap(), b"twelve bytes");
        let message = read_file(&path, 11).unwrap_err().to_string();
        assert!(message.contains("12 bytes") && message.contains("at most 11"), "{message}");
    }
}
