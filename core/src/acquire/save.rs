//! A capture of raw photos as a folder.

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::{Value, json};

use super::Acquisition;
use crate::cancel::CancelToken;
use crate::error::{Error, Result};
use crate::image::Image;
use crate::io::ours::{self, Description};
use crate::io::save::Saving;
use crate::io::{exr_half, png8};
use crate::memory;

/// The file of a photo of the capture, counted from 0.
pub(super) fn photo_name(index: usize) -> String {
    format!("{index:02}.exr")
}

/// The picture of what was found.
pub const CONTACT_SHEET_PNG: &str = "contact-sheet.png";

fn mask_name(index: usize) -> String {
    format!("{index:02}-saturated.png")
}

impl Acquisition {
    /// Writes the capture to `folder`: `capture.json`, the rectified photos as OpenEXR in half precision, for each with saturated pixels a PNG that says which, and
    /// `contact-sheet.png`.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] if that would replace files that are not ours; [`Error::Io`].
    pub fn save(&self, folder: impl AsRef<Path>) -> Result<()> {
        self.save_unless(folder.as_ref(), &CancelToken::new())
    }

    /// [`Acquisition::save`] until `cancel` is cancelled.
    pub(crate) fn save_unless(&self, folder: &Path, cancel: &CancelToken) -> Result<()> {
        let mut files: Vec<(String, Vec<u8>)> = Vec::new();
        let mut photos = Vec::new();
        for (index, photo) in self.capture.photos().iter().enumerate() {
            cancel.check()?;
            let (name, mask) = (photo_name(index), mask_name(index));
            files.push((name.clone(), exr_half(&folder.join(&name), &photo.image)?));
            let shot = &photo.shot;
            let mut entry = json!({ "file": name, "camera": shot.camera, "light": shot.light, "light_intensity": shot.light_intensity });
            if photo.saturated.iter().any(|&bits| bits != 0) {
                let values = photo.saturated.iter().flat_map(|bits| [0, 1, 2].map(|c| f32::from(bits >> c & 1)));
                let data = memory::collected(3 * photo.saturated.len(), values)?;
                let image = Image::new(photo.image.width(), photo.image.height(), 3, data)?;
                files.push((mask.clone(), png8(&folder.join(&mask), &image, crate::Transfer::Linear)?));
                entry["saturated"] = mask.into();
            }
            photos.push(entry);
        }
        let sheet = png8(&folder.join(CONTACT_SHEET_PNG), &self.contact_sheet, crate::Transfer::Linear)?;
        files.push((CONTACT_SHEET_PNG.to_owned(), sheet));
        let value = json!({
            "format": Description::Capture.format(),
            "version": 2,
            "unit": self.capture.unit().map(crate::Unit::name),
            "patch_size": self.capture.patch_size(),
            "transfer": "linear",
            "photos": photos,
            "acquisition": self.report,
        });
        let path = folder.join(Description::Capture.file());
        let mut text = serde_json::to_vec_pretty(&value).map_err(|e| Error::io(&path, e))?;
        text.push(b'\n');
        files.push((Description::Capture.file().to_owned(), text));
        check_folder(folder)?;
        let saving = Saving::begin(folder, cancel)?;
        // Photos of an earlier capture that has more of them go.
        let old = Description::Capture.read(folder).map(|value| Description::Capture.names(&value)).unwrap_or_default();
        let new: BTreeSet<String> = files.iter().map(|(name, _)| name.clone()).collect();
        let gone = old.difference(&new).filter(|name| is_acquired(name)).cloned().collect();
        saving.replace(&files, gone)
    }
}

/// Whether a file has a name that [`Acquisition::save`] gives.
fn is_acquired(name: &str) -> bool {
    let number = name.strip_suffix(".exr").or_else(|| name.strip_suffix("-saturated.png"));
    number.is_some_and(|number| number.len() >= 2 && number.bytes().all(|byte| byte.is_ascii_digit()))
}

/// Refuses a folder whose capture was not acquired: its photos cannot be had again.
///
/// # Errors
/// [`Error::InvalidArgument`] naming it.
pub(crate) fn check_folder(folder: &Path) -> Result<()> {
    let described = Description::Capture.read(folder);
    if described.as_ref().is_some_and(|value| value.get("acquisition").is_none_or(Value::is_null)) {
        let reason = "the capture in this folder was not made by acquire, so it is not replaced; choose another folder";
        return Err(Error::invalid(folder.display().to_string(), reason));
    }
    let own: BTreeSet<String> = described.map(|value| Description::Capture.names(&value)).unwrap_or_default();
    let likely: Vec<String> = (0..own.len().max(1)).flat_map(|i| [photo_name(i), mask_name(i)]).collect();
    let names = likely.iter().map(String::as_str).chain([Description::Capture.file(), CONTACT_SHEET_PNG]);
    ours::check(folder, Description::Capture, names)
}
