//! Files that appear whole or not at all.

use std::io::Write;
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use crate::error::{Error, Result};

/// Writes `files` (final path and contents, all in existing folders) so that none is ever half-written: first all under temporary names, then
/// each is renamed, in order. A failure before the renaming leaves nothing behind.
pub(crate) fn write_files(files: &[(PathBuf, Vec<u8>)]) -> Result<()> {
    let written = files.iter().map(|(path, bytes)| write_temporary(path, bytes)).collect::<Result<Vec<_>>>()?;
    for (file, (path, _)) in written.into_iter().zip(files) {
        file.persist(path).map_err(|e| Error::io(path, e.error))?;
    }
    Ok(())
}

fn write_temporary(path: &Path, bytes: &[u8]) -> Result<NamedTempFile> {
    let mut file = temporary_beside(path)?;
    file.write_all(bytes).map_err(|e| Error::io(path, e))?;
    Ok(file)
}

/// A temporary file in the folder of `path`, to be written and then renamed to it.
pub(crate) fn temporary_beside(path: &Path) -> Result<NamedTempFile> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    builder.prefix(".svbrdf-gcn-").suffix(".tmp");
    // What any new file would get: the process's umask takes its part off.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder).map_err(|e| Error::io(path, e))
}
