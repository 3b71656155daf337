//! Whose a file is: saves and exports replace what they wrote, and nothing else.

use std::collections::BTreeSet;
use std::io::Cursor;
use std::path::Path;

use serde_json::Value;

use super::read_file;
use super::tiff;
use crate::error::{Error, Result};

/// What written images say made them, in the field that their format has for it.
pub(super) const SOFTWARE: &str = concat!("svbrdf-gcn ", env!("CARGO_PKG_VERSION"));

/// How that begins, of whatever version.
const OURS: &[u8] = b"svbrdf-gcn";

const MAX_BYTES: u64 = 64 << 20;
const MAX_IMAGE_BYTES: u64 = 1 << 31;

/// The picture beside the maps of a material.
pub(super) const PREVIEW_PNG: &str = "preview.png";

/// A file that describes others in its folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Description {
    Capture,
    Material,
    Export,
}

impl Description {
    const ALL: [Self; 3] = [Self::Capture, Self::Material, Self::Export];

    pub const fn file(self) -> &'static str {
        match self {
            Self::Capture => "capture.json",
            Self::Material => "material.json",
            Self::Export => "export.json",
        }
    }

    pub const fn format(self) -> &'static str {
        match self {
            Self::Capture => "svbrdf-gcn capture",
            Self::Material => "svbrdf-gcn material",
            Self::Export => "svbrdf-gcn export",
        }
    }

    /// The description of this folder, as far as it can be read and is of our format, in whatever version.
    pub fn read(self, folder: &Path) -> Option<Value> {
        let value: Value = serde_json::from_slice(&read_file(&folder.join(self.file()), MAX_BYTES).ok()?).ok()?;
        (value.get("format")?.as_str()? == self.format()).then_some(value)
    }

    /// The files that such a description names, and the picture that a material may have beside its maps.
    pub fn names(self, value: &Value) -> BTreeSet<String> {
        let keys: &[&str] = match self {
            Self::Capture => &["photos"],
            Self::Material => &["maps", "deviations", "files"],
            Self::Export => &["files", "earlier"],
        };
        let unnamed = (self == Self::Material).then(|| PREVIEW_PNG.to_owned());
        let photos = value.get("photos").and_then(Value::as_array).filter(|_| self == Self::Capture);
        let masks =
            photos.into_iter().flatten().filter_map(|photo| photo.get("saturated")?.as_str().map(str::to_owned));
        let unnamed = unnamed.into_iter().chain(masks);
        keys.iter().flat_map(|key| names_in(value, key)).chain(unnamed).collect()
    }
}

/// The files in one field of a description: in a list, or in a table, whose keys are names of files where its entries hold none.
pub(crate) fn names_in(value: &Value, field: &str) -> BTreeSet<String> {
    let file = |entry: &Value| entry.as_str().or_else(|| entry.get("file")?.as_str()).map(str::to_owned);
    match value.get(field) {
        Some(Value::Array(list)) => list.iter().filter_map(file).collect(),
        Some(Value::Object(table)) => table.iter().map(|(key, entry)| file(entry).unwrap_or(key.clone())).collect(),
        _ => BTreeSet::new(),
    }
}

/// Refuses to replace what is not ours: `files` are to be written to `folder`, with `own` among them.
///
/// Ours are the files that the folder's own description names, and images that say they are, unless a description of another kind names them.
///
/// # Errors
/// [`Error::InvalidArgument`] naming the file.
pub(crate) fn check<'a>(folder: &Path, own: Description, files: impl IntoIterator<Item = &'a str>) -> Result<()> {
    let described: Vec<_> = Description::ALL.iter().map(|kind| (*kind, kind.read(folder))).collect();
    let names = |(kind, value): &(Description, Option<Value>), file: &str| {
        value.as_ref().is_some_and(|value| kind.names(value).contains(file))
    };
    for file in files {
        let path = folder.join(file);
        let Ok(metadata) = path.symlink_metadata() else { continue };
        let other = described.iter().find(|entry| entry.0 != own && names(entry, file));
        let mine = described.iter().find(|(kind, _)| *kind == own);
        let is_ours = match mine {
            Some((_, value)) if file == own.file() => value.is_some(),
            _ => mine.is_some_and(|mine| names(mine, file)) || says_ours(&path),
        };
        let reason = match other {
            Some((kind, _)) => format!("{} beside it names this file", kind.file()),
            None if metadata.is_dir() => "this is a folder".to_owned(),
            None if is_ours => continue,
            None => "svbrdf-gcn did not write this file".to_owned(),
        };
        let reason = format!("{reason}, so it is not replaced; move it away or choose another folder");
        return Err(Error::invalid(path.display().to_string(), reason));
    }
    Ok(())
}

/// Whether a file is an image that says we wrote it.
pub(crate) fn says_ours(path: &Path) -> bool {
    read_file(path, MAX_IMAGE_BYTES).is_ok_and(|bytes| software(&bytes).is_some_and(|text| text.starts_with(OURS)))
}

/// What an image file says made it: the text chunk `Software` of PNG, tag 305 of TIFF, the attribute `software` of OpenEXR.
fn software(bytes: &[u8]) -> Option<Vec<u8>> {
    match bytes {
        [0x89, b'P', b'N', b'G', ..] => {
            let mut rest = bytes.get(8..)?;
            while let [a, b, c, d, name @ ..] = rest {
                let length = u32::from_be_bytes([*a, *b, *c, *d]) as usize;
                let (data, after) = name.get(4..)?.split_at_checked(length)?;
                match name.get(..4)? {
                    b"tEXt" => {
                        if let Some(text) = data.strip_prefix(b"Software\0") {
                            return Some(text.to_vec());
                        }
                    }
                    b"IDAT" => return None,
                    _ => {}
                }
                rest = after.get(4..)?;
            }
            None
        }
        [b'I', b'I', ..] | [b'M', b'M', ..] => {
            let (file, first) = tiff::File::open(bytes)?;
            Some(file.directory(first)?.bytes(305)?.to_vec())
        }
        [0x76, 0x2f, 0x31, 0x01, ..] => {
            let meta = exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), false).ok()?;
            Some(meta.headers.first()?.own_attributes.software_name.as_ref()?.to_string().into_bytes())
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use tempfile::TempDir;

    use super::*;
    use crate::color::Transfer;
    use crate::image::Image;
    use crate::io::write_image;

    #[test]
    fn written_images_say_so() {
        let dir = TempDir::new().unwrap();
        for channels in [1, 3] {
            let image = Image::new(2, 3, channels, vec![0.5; 6 * channels]).unwrap();
            for name in ["a.png", "a.tif", "a.exr"] {
                let path = dir.path().join(name);
                write_image(&path, &image, Transfer::Srgb).unwrap();
                assert_eq!(software(&fs::read(&path).unwrap()).unwrap(), with_end(name), "{name}");
                assert!(says_ours(&path));
                // Cut anywhere, the file is of unknown origin, or says what it says.
                let bytes = fs::read(&path).unwrap();
                for length in 0..bytes.len() {
                    drop(software(&bytes[..length]));
                }
            }
        }
        fs::write(dir.path().join("plain.png"), b"\x89PNG\r\n\x1a\n").unwrap();
        assert!(!says_ours(&dir.path().join("plain.png")) && !says_ours(&dir.path().join("none.png")));
    }

    /// Text in TIFF ends with a NUL.
    fn with_end(name: &str) -> Vec<u8> {
        let end: &[u8] = if name.ends_with("tif") { b"\0" } else { b"" };
        [SOFTWARE.as_bytes(), end].concat()
    }

    #[test]
    fn files_of_others_are_refused() {
        let dir = TempDir::new().unwrap();
        let write = |name: &str, bytes: &[u8]| fs::write(dir.path().join(name), bytes).unwrap();
        let refused = |own: Description, file: &str| match check(dir.path(), own, [file]) {
            Ok(()) => String::new(),
            Err(error) => error.to_string(),
        };
        assert_eq!(refused(Description::Material, "diffuse.png"), "");
        write("diffuse.png", b"a photo");
        let message = refused(Description::Material, "diffuse.png");
        assert!(message.contains("diffuse.png") && message.contains("did not write"), "{message}");

        let maps = br#"{"format": "svbrdf-gcn material", "maps": {"diffuse": {"file": "diffuse.png"}}, "deviations": {"normal": "n.png"}}"#;
        write("material.json", maps);
        for name in ["diffuse.png", "n.png", "preview.png", "material.json"] {
            write("n.png", b"");
            write("preview.png", b"");
            assert_eq!(refused(Description::Material, name), "", "{name}");
        }
        let image = Image::new(1, 1, 1, vec![0.5]).unwrap();
        write_image(dir.path().join("diffuse.png"), &image, Transfer::Linear).unwrap();
        let message = refused(Description::Export, "diffuse.png");
        assert!(message.contains("material.json beside it"), "{message}");
        let capture = br#"{"format": "svbrdf-gcn capture", "photos": [{"file": "diffuse.png"}]}"#;
        write("capture.json", capture);
        assert!(refused(Description::Material, "diffuse.png").contains("capture.json beside it"));
        fs::remove_file(dir.path().join("capture.json")).unwrap();

        // Descriptions of somebody else, and folders of such names.
        write("material.json", b"{\"format\": \"another\"}");
        assert!(refused(Description::Material, "material.json").contains("did not write"));
        assert_eq!(refused(Description::Material, "diffuse.png"), "", "the image says that it is ours");
        fs::create_dir(dir.path().join("normal.png")).unwrap();
        assert!(refused(Description::Material, "normal.png").contains("folder"));
    }
}
