//! Photographed materials: a pack, or a folder of material folders.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufReader, Cursor, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use image::ImageReader;
use rayon::prelude::*;
use serde::Deserialize;
use serde_json::{Value, json};
use zip::ZipArchive;

use super::texture::Texture;
use crate::color::Transfer;
use crate::error::{Error, Result};
use crate::image::Image;
use crate::io::resize::shrink;
use crate::io::{decode_image, file, read_file};
use crate::maps::{Lobe, Maps};
use crate::memory;

/// Largest index of a pack, and largest image of a material that is read, in bytes of their files.
const INDEX_MAX: u64 = 16 << 20;
const FILE_MAX: u64 = 256 << 20;
/// Most materials of a library.
const MATERIALS_MAX: usize = 100_000;
/// Sides of a texture in pixels, and the largest side of an image that one is made of.
const SIDES: std::ops::RangeInclusive<usize> = 8..=4096;
const SOURCE_MAX: u32 = 8192;
/// Materials of folders are made this small, as `pack.py` does.
const FOLDER_SIDE: usize = 320;
/// What is held out of a folder: the materials this file names, one a line; without it every tenth in the order of their names.
const HELD_OUT: &str = "validation.txt";
const HELD_OUT_EVERY: usize = 10;
/// Materials whose files are in memory at a time.
const CHUNK: usize = 32;
/// The maps of a material, and whether it must have them.
const KINDS: [(&str, bool); 4] = [("basecolor", true), ("normal", true), ("roughness", true), ("metallic", false)];
const SUFFIXES: [&str; 3] = ["png", "jpg", "jpeg"];

/// The index of a pack, `materials.json`.
#[derive(Deserialize)]
struct Index {
    materials: Vec<Entry>,
}

/// A material of a library.
#[derive(Clone, Debug, Deserialize)]
struct Entry {
    name: String,
    #[serde(default)]
    metallic: bool,
    #[serde(default)]
    validation: bool,
    #[serde(default = "unstated")]
    licence: String,
}

fn unstated() -> String {
    "not stated".into()
}

/// Materials to train on, those held out, and where they come from.
pub struct Library {
    training: Vec<Texture>,
    validation: Vec<Texture>,
    /// Names of the materials held out.
    held_out: Vec<String>,
    /// How many of the materials to train on come under which licence.
    licences: BTreeMap<String, usize>,
}

/// The files of a material, in the order of [`KINDS`].
type Files = [Option<Vec<u8>>; 4];

impl Library {
    /// What the materials are, and under which licences, as a weights file says it.
    pub fn facts(&self) -> Value {
        json!({
            "materials": self.training.len(),
            "licences": self.licences,
            "held_out": self.held_out,
            "procedural": "core/src/train/procedural.rs",
        })
    }

    /// Materials to train on.
    pub(super) fn training(&self) -> &[Texture] {
        &self.training
    }

    /// Those held out.
    pub(super) fn validation(&self) -> &[Texture] {
        &self.validation
    }

    /// How many materials there are to train on.
    pub fn materials(&self) -> usize {
        self.training.len()
    }

    /// Names of the materials held out, in their order.
    pub fn held_out(&self) -> &[String] {
        &self.held_out
    }

    /// Reads the pack or folder `path`.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::UnsupportedFormat`] or [`Error::InvalidArgument`] naming the file; [`Error::OutOfMemory`] if the materials
    /// need more than three quarters of the free memory.
    pub fn open(path: &Path) -> Result<Self> {
        if path.is_dir() { Self::open_folder(path) } else { Self::open_pack(path) }
    }

    fn open_pack(path: &Path) -> Result<Self> {
        let broken = |error: zip::result::ZipError| Error::invalid(path.display().to_string(), error.to_string());
        let mut archive = ZipArchive::new(BufReader::new(file::open(path)?.0)).map_err(broken)?;
        let mut read = |name: &str, most: u64| -> Result<Vec<u8>> {
            let entry = archive
                .by_name(name)
                .map_err(|error| Error::invalid(path.display().to_string(), format!("{name}: {error}")))?;
            // What the archive states of its size need not be true.
            let mut bytes = Vec::new();
            let got =
                entry.take(most + 1).read_to_end(&mut bytes).map_err(|error| Error::io(&path.join(name), error))?;
            if got as u64 > most {
                let reason = format!("{name}: more than {most} bytes");
                return Err(Error::invalid(path.display().to_string(), reason));
            }
            Ok(bytes)
        };
        let index = read("materials.json", INDEX_MAX)?;
        let index: Index = serde_json::from_slice(&index)
            .map_err(|error| Error::invalid(path.display().to_string(), format!("materials.json: {error}")))?;
        Self::collect(path, index.materials, None, |entry| {
            let mut files: Files = Default::default();
            for (file, (kind, needed)) in files.iter_mut().zip(KINDS) {
                if needed || entry.metallic {
                    *file = Some(read(&format!("{}/{kind}.jpg", entry.name), FILE_MAX)?);
                }
            }
            Ok(files)
        })
    }

    fn open_folder(path: &Path) -> Result<Self> {
        let folders = std::fs::read_dir(path).map_err(|error| Error::io(path, error))?;
        let mut names = BTreeSet::new();
        for folder in folders {
            let folder = folder.map_err(|error| Error::io(path, error))?.path();
            // What lacks a map is no material.
            let whole = KINDS.iter().all(|&(kind, needed)| !needed || find(&folder, kind).is_some());
            if let Some(name) = folder.file_name().and_then(|name| name.to_str()).filter(|_| whole) {
                names.insert(name.to_owned());
            }
        }
        let list = path.join(HELD_OUT);
        let held: BTreeSet<String> = if list.is_file() {
            let text = read_file(&list, INDEX_MAX)?;
            let held: BTreeSet<String> = String::from_utf8_lossy(&text).split_whitespace().map(str::to_owned).collect();
            if let Some(unknown) = held.iter().find(|&name| !names.contains(name)) {
                return Err(Error::invalid(list.display().to_string(), format!("{unknown}: no such material")));
            }
            held
        } else {
            names.iter().step_by(HELD_OUT_EVERY).cloned().collect()
        };
        let entry = |name: String| Entry {
            metallic: find(&path.join(&name), "metallic").is_some(),
            validation: held.contains(&name),
            licence: unstated(),
            name,
        };
        Self::collect(path, names.into_iter().map(entry).collect(), Some(FOLDER_SIDE), |entry| {
            let folder = path.join(&entry.name);
            let mut files: Files = Default::default();
            for (file, (kind, _)) in files.iter_mut().zip(KINDS) {
                *file = find(&folder, kind).map(|path| read_file(&path, FILE_MAX)).transpose()?;
            }
            Ok(files)
        })
    }

    /// The materials whose files `read` gives, made as small as `side`.
    fn collect(
        path: &Path,
        entries: Vec<Entry>,
        side: Option<usize>,
        mut read: impl FnMut(&Entry) -> Result<Files>,
    ) -> Result<Self> {
        if entries.len() > MATERIALS_MAX {
            let reason = format!("{} materials, at most {MATERIALS_MAX} are read", entries.len());
            return Err(Error::invalid(path.display().to_string(), reason));
        }
        let mut library =
            Self { training: Vec::new(), validation: Vec::new(), held_out: Vec::new(), licences: BTreeMap::new() };
        let (taken, allowed) = (AtomicU64::new(0), memory::allowed(None, 0));
        for chunk in entries.chunks(CHUNK) {
            let files = chunk.iter().map(&mut read).collect::<Result<Vec<Files>>>()?;
            let textures: Vec<Texture> = chunk
                .par_iter()
                .zip(&files)
                .map(|(entry, files)| {
                    let maps = maps(&path.join(&entry.name), files, side)?;
                    let bytes = Texture::bytes(maps.width());
                    let needed = taken.fetch_add(bytes, Ordering::Relaxed).saturating_add(bytes);
                    memory::check("the materials to train on", needed, allowed)?;
                    Ok(Texture::new(&maps))
                })
                .collect::<Result<_>>()?;
            for (entry, texture) in chunk.iter().zip(textures) {
                if entry.validation {
                    library.validation.push(texture);
                    library.held_out.push(entry.name.clone());
                } else {
                    library.training.push(texture);
                    *library.licences.entry(entry.licence.clone()).or_default() += 1;
                }
            }
        }
        for (textures, purpose) in [(&library.training, "to train on"), (&library.validation, "to validate on")] {
            if textures.is_empty() {
                return Err(Error::invalid(path.display().to_string(), format!("no materials {purpose}")));
            }
        }
        Ok(library)
    }
}

/// The file of a map in a material's folder.
fn find(folder: &Path, kind: &str) -> Option<PathBuf> {
    SUFFIXES.iter().map(|suffix| folder.join(format!("{kind}.{suffix}"))).find(|path| path.is_file())
}

/// Maps of a material's files; `name` is what messages call it. The middle square is taken, at most `side` wide.
fn maps(name: &Path, files: &Files, side: Option<usize>) -> Result<Maps<f32>> {
    let read = |kind: usize, transfer: Transfer| {
        let file = name.join(KINDS[kind].0);
        let Some(bytes) = &files[kind] else { return Ok(None) };
        check_size(&file, bytes, if side.is_some() { SOURCE_MAX } else { *SIDES.end() as u32 })?;
        let image = decode_image(&file.display().to_string(), bytes, transfer)?;
        let square = squared(&image, side)?;
        if !SIDES.contains(&square.width()) {
            let reason = format!("{} pixels wide, expected {} to {}", square.width(), SIDES.start(), SIDES.end());
            return Err(Error::invalid(file.display().to_string(), reason));
        }
        Ok(Some(square))
    };
    let missing = || Error::invalid(name.display().to_string(), "a map is missing");
    let base = read(0, Transfer::Srgb)?.ok_or_else(missing)?;
    let normal = read(1, Transfer::Linear)?.ok_or_else(missing)?;
    let roughness = read(2, Transfer::Linear)?.ok_or_else(missing)?;
    let metallic = read(3, Transfer::Linear)?;
    let side = base.width();
    for other in [Some(&normal), Some(&roughness), metallic.as_ref()].into_iter().flatten() {
        if other.width() != side {
            return Err(Error::shape(
                name.display().to_string(),
                format!("maps {side} wide"),
                other.width().to_string(),
            ));
        }
    }
    let pixels = side * side;
    let mut data = vec![0.0; 10 * pixels];
    for at in 0..pixels {
        let base = rgb(&base, at);
        let metallic = metallic.as_ref().map_or(0.0, |metallic| grey(metallic, at));
        let normal = rgb(&normal, at).map(|code| 2.0 * code - 1.0);
        let length = normal.iter().map(|value| value * value).sum::<f32>().sqrt().max(1e-6);
        for channel in 0..3 {
            data[channel * pixels + at] = base[channel] * (1.0 - metallic);
            data[(3 + channel) * pixels + at] = normal[channel] / length;
            data[(7 + channel) * pixels + at] = 0.04 * (1.0 - metallic) + base[channel] * metallic;
        }
        data[6 * pixels + at] = grey(&roughness, at);
    }
    Maps::new(Lobe::Isotropic, side, side, data)
}

fn rgb(image: &Image, at: usize) -> [f32; 3] {
    match image.channels() {
        3 => std::array::from_fn(|channel| image.data()[3 * at + channel]),
        channels => [image.data()[channels * at]; 3],
    }
}

/// Luma of BT.601 of a pixel, as image libraries make grey of RGB.
fn grey(image: &Image, at: usize) -> f32 {
    let [r, g, b] = rgb(image, at);
    if image.channels() == 3 { 0.299 * r + 0.587 * g + 0.114 * b } else { r }
}

/// Refuses an image with a side above `most`, of which every thread would hold one, before it is decoded.
fn check_size(path: &Path, bytes: &[u8], most: u32) -> Result<()> {
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|error| Error::io(path, error))?;
    let size = reader.into_dimensions();
    let (width, height) = size.map_err(|error| Error::io(path, std::io::Error::other(error)))?;
    if width.max(height) <= most {
        return Ok(());
    }
    let reason = format!("image of {width} x {height} pixels, at most {most} x {most} are read");
    Err(Error::invalid(path.display().to_string(), reason))
}

/// The middle square of an image, at most `side` pixels wide.
fn squared(image: &Image, side: Option<usize>) -> Result<Image> {
    let (width, height, channels) = (image.width(), image.height(), image.channels());
    let square = width.min(height);
    let (left, top) = ((width - square) / 2, (height - square) / 2);
    let out = side.map_or(square, |side| side.min(square));
    let (values, _) = shrink((square, square), (out, out), channels, |row, values, mask| {
        let start = ((top + row) * width + left) * channels;
        values.copy_from_slice(&image.data()[start..start + square * channels]);
        mask.fill(0);
        Ok(())
    })?;
    Image::new(out, out, channels, values)
}

#[cfg(test)]
mod tests {
    use std::io::{Cursor, Write};
    use std::path::Path;

    use image::{ExtendedColorType, ImageEncoder};
    use zip::ZipWriter;
    use zip::write::SimpleFileOptions;

    use super::super::texture::Crop;
    use super::{HELD_OUT, Library};

    /// A JPEG of one colour.
    fn jpeg(side: u32, color: &[u8]) -> Vec<u8> {
        let (mut out, kind) =
            (Vec::new(), if color.len() == 3 { ExtendedColorType::Rgb8 } else { ExtendedColorType::L8 });
        let pixels = color.repeat((side * side) as usize);
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut out, 100)
            .write_image(&pixels, side, side, kind)
            .unwrap();
        out
    }

    fn zip(files: &[(&str, Vec<u8>)]) -> Vec<u8> {
        let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
        for (index, (name, bytes)) in files.iter().enumerate() {
            // One stored, one deflated, and so on.
            let methods = [zip::CompressionMethod::Stored, zip::CompressionMethod::Deflated];
            archive.start_file(*name, SimpleFileOptions::default().compression_method(methods[index % 2])).unwrap();
            archive.write_all(bytes).unwrap();
        }
        archive.finish().unwrap().into_inner()
    }

    const INDEX: &str = r#"{"size": 16, "materials": [
        {"name": "a", "family": "wood", "metallic": false, "licence": "CC0-1.0"},
        {"name": "b", "metallic": true, "validation": true}]}"#;

    fn files() -> Vec<(&'static str, Vec<u8>)> {
        vec![
            ("a/basecolor.jpg", jpeg(16, &[128, 128, 128])),
            ("a/normal.jpg", jpeg(16, &[128, 128, 255])),
            ("a/roughness.jpg", jpeg(16, &[77])),
            ("b/basecolor.jpg", jpeg(16, &[128, 128, 128])),
            ("b/normal.jpg", jpeg(16, &[128, 191, 238])),
            ("b/roughness.jpg", jpeg(16, &[77])),
            ("b/metallic.jpg", jpeg(16, &[255])),
            ("materials.json", INDEX.into()),
        ]
    }

    fn open(bytes: &[u8]) -> crate::error::Result<Library> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        Library::open(file.path())
    }

    /// The planes of the middle pixel.
    fn middle(texture: &super::Texture) -> Vec<f32> {
        let crop = Crop { step: 1.0, angle: 0.0, centre: [0.5; 2], mirrored: false };
        texture.sample(1, &crop).unwrap().data().to_vec()
    }

    /// Of `a` and `b`: code 128 of sRGB is 0.2159 (IEC 61966-2-1), 77 / 255 is 0.302; (0, 0.498, 0.866) leans to +y.
    const A: [f32; 10] = [0.2159, 0.2159, 0.2159, 0.004, 0.004, 1.0, 0.302, 0.04, 0.04, 0.04];
    const B: [f32; 10] = [0.0, 0.0, 0.0, 0.004, 0.498, 0.867, 0.302, 0.2159, 0.2159, 0.2159];

    fn close(got: &[f32], expected: &[f32]) {
        // JPEG and half precision.
        assert!(got.iter().zip(expected).all(|(got, expected)| (got - expected).abs() < 0.012), "{got:?} {expected:?}");
    }

    #[test]
    fn a_pack() {
        let library = open(&zip(&files())).unwrap();
        assert_eq!((library.training.len(), library.validation.len()), (1, 1));
        assert_eq!(library.facts()["held_out"], serde_json::json!(["b"]));
        assert_eq!(library.facts()["licences"], serde_json::json!({"CC0-1.0": 1}));
        close(&middle(&library.training[0]), &A);
        close(&middle(&library.validation[0]), &B);
    }

    #[test]
    fn a_folder() {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in files() {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        }
        std::fs::create_dir(folder.path().join("c")).unwrap();
        let library = Library::open(folder.path()).unwrap();
        // Without a list the first of every ten.
        assert_eq!(library.held_out, ["a"]);
        close(&middle(&library.training[0]), &B);
        let list = folder.path().join(HELD_OUT);
        std::fs::write(&list, "b\n").unwrap();
        assert_eq!(Library::open(folder.path()).unwrap().held_out, ["b"]);
        std::fs::write(&list, "b nobody\n").unwrap();
        assert!(Library::open(folder.path()).err().unwrap().to_string().contains("nobody"));
        std::fs::write(&list, "a b").unwrap();
        assert!(Library::open(folder.path()).err().unwrap().to_string().contains("no materials to train on"));
    }

    #[test]
    fn broken_packs_are_refused() {
        let refused = |files: &[(&str, Vec<u8>)]| open(&zip(files)).err().unwrap().to_string();
        let with = |name: &str, bytes: Vec<u8>| {
            let mut files = files();
            files.iter_mut().find(|file| file.0 == name).unwrap().1 = bytes;
            refused(&files)
        };
        let whole = zip(&files());
        for len in (0..whole.len()).step_by(151) {
            assert!(open(&whole[..len]).is_err(), "{len}");
        }
        // A byte off may go unnoticed in a name nobody reads, but never panics.
        for at in (0..whole.len()).step_by(37) {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x55;
            drop(open(&bytes));
        }
        for missing in 0..files().len() {
            let mut files = files();
            let name = files.remove(missing).0;
            assert!(refused(&files).contains(name), "{name}");
        }
        for index in ["", "[]", "{\"materials\": [{}]}", "{\"materials\": 3}"] {
            assert!(with("materials.json", index.into()).contains("materials.json"), "{index}");
        }
        assert!(with("materials.json", "{\"materials\": []}".into()).contains("no materials"));
        assert!(with("a/normal.jpg", jpeg(24, &[128, 128, 255])).contains("expected maps 16 wide, got 24"));
        assert!(with("a/basecolor.jpg", jpeg(4, &[9, 9, 9])).contains("4 pixels wide, expected 8 to 4096"));
        assert!(with("a/basecolor.jpg", b"no image".to_vec()).contains("basecolor"));
        // A header that promises 65500 x 65500 pixels.
        let mut large = jpeg(16, &[9, 9, 9]);
        let frame = large.windows(2).position(|marker| marker == [0xff, 0xc0]).unwrap();
        large[frame + 5..frame + 9].copy_from_slice(&[0xff, 0xdc, 0xff, 0xdc]);
        assert!(with("a/basecolor.jpg", large).contains("65500 x 65500"));
        assert!(Library::open(Path::new("/nowhere/materials.zip")).err().unwrap().to_string().contains("nowhere"));
    }
}
