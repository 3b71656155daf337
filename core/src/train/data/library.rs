//! Photographed materials: a pack, or a folder of material folders.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufReader, Cursor, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use image::ImageReader;
use rayon::prelude::*;
use serde::Deserialize;
use zip::ZipArchive;

use super::texture::Texture;
use crate::color::Transfer;
use crate::error::{Error, Result};
use crate::fit::memory;
use crate::image::Image;
use crate::io::resize::shrink;
use crate::io::{decode_image, read_file};
use crate::maps::{Lobe, Maps};

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
pub(crate) struct Library {
    pub training: Vec<Texture>,
    pub validation: Vec<Texture>,
    /// Names of the materials held out.
    pub held_out: Vec<String>,
    /// How many of the materials to train on come under which licence.
    pub licences: BTreeMap<String, usize>,
}

/// The files of a material, in the order of [`KINDS`].
type Files = [Option<Vec<u8>>; 4];

impl Library {
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
        let file = File::open(path).map_err(|error| Error::io(path, error))?;
        let mut archive = ZipArchive::new(BufReader::new(file)).map_err(broken)?;
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
        let (taken, allowed) = (AtomicU64::new(0), memory::allowed(None));
        for chunk in entries.chunks(CHUNK) {
            let files = chunk.iter().map(&mut read).collect::<Result<Vec<Files>>>()?;
            let textures: Vec<Texture> = chunk
                .par_iter()
                .zip(&files)
                .map(|(entry, files)| {
                    let maps = maps(&path.join(&entry.name), files, side)?;
                    let bytes = Texture::bytes(maps.width());
                    let needed = taken.fetch_add(bytes, Ordering::Relaxed).saturating_add(bytes);
                    if needed > allowed { Err(Error::OutOfMemory { needed, allowed }) } else { Ok(Texture::new(&maps)) }
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
        library.held_out.sort();
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
    });
    Image::new(out, out, channels, values)
}
