//! Files that a command must not write over.

use std::path::{Path, PathBuf};

use crate::capture::photo_files;
use crate::error::{Error, Result};
use crate::io::ours::Description;

/// Refuses an output that is one of `files`, which are `what`.
///
/// # Errors
/// [`Error::InvalidArgument`] naming the output.
pub fn keep(output: &Path, what: &str, files: impl IntoIterator<Item = PathBuf>) -> Result<()> {
    let Ok(place) = output.canonicalize() else { return Ok(()) };
    if files.into_iter().any(|file| file.canonicalize().is_ok_and(|file| file == place)) {
        let reason = format!("this is {what}, so it is not replaced; name another output");
        return Err(Error::invalid(output.display().to_string(), reason));
    }
    Ok(())
}

/// Refuses a picture of a material that would replace one of its maps, or a file that a material or a capture beside it names.
///
/// # Errors
/// As [`keep`].
pub fn keep_maps_and_photos(output: &Path, material: &Path) -> Result<()> {
    let maps = |folder: &Path| {
        let value = Description::Material.read(folder);
        let names = value.map(|value| Description::Material.names(&value)).unwrap_or_default();
        names.into_iter().map(|name| folder.join(name)).collect::<Vec<_>>()
    };
    let beside = output.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    keep(output, "a map that this command reads", maps(material))?;
    keep(output, "a file of the material beside it", maps(beside))?;
    keep(output, "a photo of the capture beside it", photo_files(beside).unwrap_or_default())
}
