//! What a file or folder is, for messages to those who gave it in place of another.

use std::fs::{self, File};
use std::io::Read;
use std::path::Path;

use super::decode::{Kind, read_stored};
use super::material::MATERIAL_JSON;
use crate::cancel::CancelToken;

/// The description of a capture of our own.
pub(crate) const CAPTURE_JSON: &str = "capture.json";
/// The file that a capture in MaterialGAN's layout is known by.
pub(crate) const CAMERA_POSITIONS: &str = "camera_pos.txt";

/// The extensions of photos.
const PHOTO_EXTENSIONS: [&str; 6] = ["png", "jpg", "jpeg", "tif", "tiff", "exr"];

/// What lies at `path`: "a PNG image of 4 x 2 pixels", "a folder with 9 images and no capture.json".
pub(crate) fn describe(path: &Path) -> String {
    match fs::metadata(path) {
        Ok(found) if found.is_dir() => folder(path),
        Ok(found) if found.is_file() => file(path, found.len()),
        Ok(_) => "neither a file nor a folder".to_owned(),
        Err(error) => error.to_string(),
    }
}

/// Whether a file of this name is a photo by its extension.
pub(crate) fn is_photo(name: &Path) -> bool {
    let extension = name.extension().and_then(|extension| extension.to_str()).unwrap_or_default().to_lowercase();
    PHOTO_EXTENSIONS.contains(&extension.as_str())
}

/// Whether a file begins as the images do that are read.
pub(crate) fn is_image(path: &Path) -> bool {
    path.is_file() && start_of(path).is_ok_and(|start| Kind::of(&start).is_some())
}

fn start_of(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut start = Vec::new();
    File::open(path)?.take(64).read_to_end(&mut start)?;
    Ok(start)
}

fn folder(path: &Path) -> String {
    if path.join(MATERIAL_JSON).exists() {
        return "the folder of a material".to_owned();
    }
    if [CAPTURE_JSON, CAMERA_POSITIONS].iter().any(|file| path.join(file).exists()) {
        return "the folder of a capture".to_owned();
    }
    let photos = fs::read_dir(path).map_or(0, |all| all.flatten().filter(|file| is_photo(&file.path())).count());
    match photos {
        0 => format!("a folder without images and without {CAPTURE_JSON}"),
        1 => format!("a folder with 1 image and no {CAPTURE_JSON}"),
        _ => format!("a folder with {photos} images and no {CAPTURE_JSON}"),
    }
}

fn file(path: &Path, len: u64) -> String {
    let Ok(start) = start_of(path) else { return format!("a file of {len} bytes that cannot be read") };
    if let Some(kind) = Kind::of(&start).map(Kind::name) {
        return match read_stored(path, &CancelToken::new()) {
            Ok(image) => format!("{kind} image of {} x {} pixels", image.width, image.height),
            Err(_) => format!("{kind} image that cannot be read"),
        };
    }
    match &start[..] {
        [_, _, _, _, _, _, 0, 0, b'{', ..] => "a weights file".to_owned(),
        [b'{' | b'[' | b' ' | b'\n', ..] => format!("a text of {len} bytes"),
        _ => format!("a file of {len} bytes that is no image"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_and_folders() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        assert_eq!(describe(dir.path()), "a folder without images and without capture.json");
        assert!(describe(&at("nowhere")).contains("No such file"));
        let image = crate::Image::new(3, 2, 1, vec![0.5; 6]).unwrap();
        super::super::write_image(at("a.PNG"), &image, crate::Transfer::Srgb).unwrap();
        assert_eq!(describe(dir.path()), "a folder with 1 image and no capture.json");
        super::super::write_image(at("b.jpg"), &image, crate::Transfer::Srgb).unwrap();
        assert_eq!(describe(dir.path()), "a folder with 2 images and no capture.json");
        assert_eq!(describe(&at("a.PNG")), "a PNG image of 3 x 2 pixels");
        assert_eq!(describe(&at("b.jpg")), "a JPEG image of 3 x 2 pixels");
        fs::write(at("b.jpg"), b"\xff\xd8\xff\xe0").unwrap();
        assert_eq!(describe(&at("b.jpg")), "a JPEG image that cannot be read");
        fs::write(at("text"), "{}").unwrap();
        assert_eq!(describe(&at("text")), "a text of 2 bytes");
        fs::write(at("bytes"), [7; 5]).unwrap();
        assert_eq!(describe(&at("bytes")), "a file of 5 bytes that is no image");
        let weights = Path::new(env!("CARGO_MANIFEST_DIR")).join("weights/default.safetensors");
        assert_eq!(describe(&weights), "a weights file");
        fs::write(at("capture.json"), "").unwrap();
        assert_eq!(describe(dir.path()), "the folder of a capture");
        fs::write(at("material.json"), "").unwrap();
        assert_eq!(describe(dir.path()), "the folder of a material");
    }
}
