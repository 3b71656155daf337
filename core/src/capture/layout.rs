//! The layouts of captures on disk: which photos there are and what is known of each. No photo is opened here.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::Shot;
use crate::color::{ColorSpace, Transfer};
use crate::error::{Error, Result};
use crate::io::read_file;
use crate::unit::Unit;

/// The largest text or JSON file of a capture, in bytes.
const MAX_TEXT_BYTES: u64 = 16 << 20;

/// The extensions of photos in a folder of numbered photos.
const PHOTO_EXTENSIONS: [&str; 6] = ["png", "jpg", "jpeg", "tif", "tiff", "exr"];

/// A capture before its photos are read.
pub(super) struct Layout {
    pub entries: Vec<Entry>,
    pub patch_size: f64,
    pub transfer: Transfer,
    /// The transfer function is what photos of the layout usually have; nobody states it.
    pub implied: bool,
    /// None where nothing states it.
    pub color_space: Option<ColorSpace>,
    pub unit: Option<Unit>,
    pub white_level: Option<f32>,
}

/// One photo's file and shot.
pub(super) struct Entry {
    pub name: String,
    pub path: PathBuf,
    pub shot: Shot,
}

impl Layout {
    pub fn read(path: &Path) -> Result<Self> {
        let metadata = std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
        if !metadata.is_dir() {
            return Self::from_json(path);
        }
        let json = path.join("capture.json");
        if json.exists() {
            Self::from_json(&json)
        } else if path.join("camera_pos.txt").exists() {
            Self::from_folder(path)
        } else {
            Err(Error::UnsupportedFormat {
                name: path.display().to_string(),
                got: "a folder without capture.json and without camera_pos.txt".to_owned(),
            })
        }
    }

    fn from_json(path: &Path) -> Result<Self> {
        /// What tells the formats apart.
        #[derive(Deserialize)]
        struct Head {
            format: Option<String>,
            version: Option<u64>,
            target_dir: Option<serde::de::IgnoredAny>,
        }
        let text = read_text(path)?;
        let head: Head = parse_json(path, &text)?;
        match (head.format.as_deref(), head.version) {
            (Some(CaptureFile::FORMAT), Some(CaptureFile::VERSION)) => {
                parse_json::<CaptureFile>(path, &text)?.into_layout(path)
            }
            (Some(CaptureFile::FORMAT), version) => Err(unsupported(
                path,
                format!(
                    "version {}; this release reads version 1",
                    version.map_or("missing".to_owned(), |v| v.to_string())
                ),
            )),
            (None, _) if head.target_dir.is_some() => parse_json::<DiffRendererFile>(path, &text)?.into_layout(path),
            (format, _) => Err(unsupported(
                path,
                format!(
                    "format {:?}; read are {:?} and svbrdf-diff-renderer's files, which have a target_dir",
                    format.unwrap_or("missing"),
                    CaptureFile::FORMAT
                ),
            )),
        }
    }

    /// A capture of the literature: gamma 2.2, where the files are of integers.
    fn gamma22(entries: Vec<Entry>, patch_size: f64) -> Self {
        let (transfer, implied, color_space) = (Transfer::Gamma22, true, None);
        Self { entries, patch_size, transfer, implied, color_space, unit: None, white_level: None }
    }

    /// The folder of MaterialGAN and the paper: numbered photos and four text files.
    fn from_folder(folder: &Path) -> Result<Self> {
        let cameras = read_rows(&folder.join("camera_pos.txt"))?;
        let light_path = folder.join("light_pos.txt");
        let lights = read_rows(&light_path)?;
        same_count(&light_path, lights.len(), "positions", "camera_pos.txt", cameras.len())?;
        let size_path = folder.join("image_size.txt");
        let patch_size = match read_numbers(&size_path)?.as_slice() {
            [row] if row.len() == 1 => row[0],
            rows => return Err(Error::shape(name_of(&size_path), "one number, the patch size", format!("{rows:?}"))),
        };
        let intensity_path = folder.join("light_power.txt");
        let intensity = match read_rows(&intensity_path)?.as_slice() {
            &[rgb] => rgb,
            rows => {
                return Err(Error::shape(name_of(&intensity_path), "one line r,g,b", format!("{} lines", rows.len())));
            }
        };
        let photos = numbered_photos(folder)?;
        if let Some((_, file)) = photos.iter().find(|&(&number, _)| number >= cameras.len()) {
            return Err(Error::shape(
                name_of(&folder.join("camera_pos.txt")),
                format!("a position for each photo up to {file}"),
                format!("{} positions", cameras.len()),
            ));
        }
        let entries = cameras
            .into_iter()
            .zip(lights)
            .enumerate()
            .map(|(number, (camera, light))| match photos.get(&number) {
                Some(file) => Ok(Entry {
                    name: file.clone(),
                    path: folder.join(file),
                    shot: Shot { camera, light, light_intensity: intensity },
                }),
                None => Err(Error::io(
                    &folder.join(format!("{number:02}.png")),
                    std::io::Error::new(
                        std::io::ErrorKind::NotFound,
                        format!("no photo {number} for the position in camera_pos.txt"),
                    ),
                )),
            })
            .collect::<Result<_>>()?;
        Ok(Self::gamma22(entries, patch_size))
    }
}

/// `capture.json`, described in `docs/captures.md`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CaptureFile {
    #[serde(rename = "format")]
    _format: String,
    #[serde(rename = "version")]
    _version: u64,
    patch_size: f64,
    transfer: Transfer,
    color_space: Option<ColorSpace>,
    light_intensity: Option<[f64; 3]>,
    unit: Option<Unit>,
    white_level: Option<f32>,
    photos: Vec<PhotoEntry>,
    #[serde(rename = "notes")]
    _notes: Option<serde::de::IgnoredAny>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PhotoEntry {
    file: String,
    camera: [f64; 3],
    light: Option<[f64; 3]>,
    light_intensity: Option<[f64; 3]>,
}

impl CaptureFile {
    const FORMAT: &str = "svbrdf-gcn capture";
    const VERSION: u64 = 1;

    fn into_layout(self, path: &Path) -> Result<Layout> {
        let folder = folder_of(path);
        let entries = self
            .photos
            .into_iter()
            .map(|photo| {
                let Some(light_intensity) = photo.light_intensity.or(self.light_intensity) else {
                    let reason = format!("light_intensity missing, for the capture and for photo {}", photo.file);
                    return Err(Error::invalid(name_of(path), reason));
                };
                let shot = Shot { camera: photo.camera, light: photo.light.unwrap_or(photo.camera), light_intensity };
                Ok(Entry { path: folder.join(&photo.file), name: photo.file, shot })
            })
            .collect::<Result<_>>()?;
        Ok(Layout {
            entries,
            patch_size: self.patch_size,
            transfer: self.transfer,
            implied: false,
            color_space: self.color_space,
            unit: self.unit,
            white_level: self.white_level,
        })
    }
}

/// A JSON file of svbrdf-diff-renderer. Photo k of `idx` is `target_dir/kk.png` (two digits), relative to the file; `idx` also picks from the
/// lists of positions. Other fields name folders of that program.
#[derive(Deserialize)]
struct DiffRendererFile {
    im_size: f64,
    idx: Vec<usize>,
    camera_pos: Vec<[f64; 3]>,
    light_pos: Vec<[f64; 3]>,
    light_pow: [f64; 3],
    target_dir: String,
}

impl DiffRendererFile {
    fn into_layout(self, path: &Path) -> Result<Layout> {
        same_count(path, self.light_pos.len(), "entries of light_pos", "camera_pos", self.camera_pos.len())?;
        let folder = folder_of(path).join(&self.target_dir);
        let entries = self
            .idx
            .iter()
            .map(|&index| match (self.camera_pos.get(index), self.light_pos.get(index)) {
                (Some(&camera), Some(&light)) => {
                    let name = format!("{index:02}.png");
                    let shot = Shot { camera, light, light_intensity: self.light_pow };
                    Ok(Entry { path: folder.join(&name), name, shot })
                }
                _ => Err(Error::invalid(
                    name_of(path),
                    format!("idx {index}, but camera_pos has {} positions", self.camera_pos.len()),
                )),
            })
            .collect::<Result<_>>()?;
        Ok(Layout::gamma22(entries, self.im_size))
    }
}

fn folder_of(path: &Path) -> &Path {
    path.parent().unwrap_or(Path::new(""))
}

fn name_of(path: &Path) -> String {
    path.display().to_string()
}

fn unsupported(path: &Path, got: String) -> Error {
    Error::UnsupportedFormat { name: name_of(path), got }
}

fn read_text(path: &Path) -> Result<String> {
    let bytes = read_file(path, MAX_TEXT_BYTES)?;
    let text = String::from_utf8(bytes).map_err(|_| unsupported(path, "text that is not UTF-8".to_owned()))?;
    Ok(text.trim_start_matches('\u{feff}').to_owned())
}

fn parse_json<'a, T: Deserialize<'a>>(path: &Path, text: &'a str) -> Result<T> {
    serde_json::from_str(text).map_err(|e| Error::invalid(name_of(path), e.to_string()))
}

fn same_count(path: &Path, got: usize, what: &str, other: &str, expected: usize) -> Result<()> {
    if got == expected {
        return Ok(());
    }
    Err(Error::shape(name_of(path), format!("{expected} {what}, as many as in {other}"), got.to_string()))
}

/// The lines of a text file as numbers, separated by commas or spaces; empty lines and what follows a # are left out.
fn read_numbers(path: &Path) -> Result<Vec<Vec<f64>>> {
    let text = read_text(path)?;
    let mut rows = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let content = line.split('#').next().unwrap_or_default();
        let words = content.split(|c: char| c == ',' || c.is_whitespace()).filter(|word| !word.is_empty());
        let row = words
            .map(|word| {
                word.parse().map_err(|_| {
                    Error::invalid(name_of(path), format!("line {}: expected numbers, got {word:?}", number + 1))
                })
            })
            .collect::<Result<Vec<f64>>>()?;
        if !row.is_empty() {
            rows.push(row);
        }
    }
    Ok(rows)
}

/// The lines of a text file, three numbers each.
fn read_rows(path: &Path) -> Result<Vec<[f64; 3]>> {
    let three = |row: Vec<f64>| {
        <[f64; 3]>::try_from(row).map_err(|row| Error::shape(name_of(path), "three numbers a line", format!("{row:?}")))
    };
    read_numbers(path)?.into_iter().map(three).collect()
}

/// The photos of a folder by number: files named by digits only, with the extension of an image.
fn numbered_photos(folder: &Path) -> Result<BTreeMap<usize, String>> {
    let mut photos = BTreeMap::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))? {
        let name = entry.map_err(|e| Error::io(folder, e))?.file_name();
        let Some(name) = name.to_str() else { continue };
        let Some((stem, extension)) = name.rsplit_once('.') else { continue };
        let is_photo = PHOTO_EXTENSIONS.contains(&extension.to_lowercase().as_str());
        if !is_photo || stem.is_empty() || !stem.bytes().all(|byte| byte.is_ascii_digit()) {
            continue;
        }
        let Ok(number) = stem.parse() else { continue };
        if let Some(other) = photos.insert(number, name.to_owned()) {
            let mut both = [other, name.to_owned()];
            both.sort();
            return Err(Error::invalid(
                name_of(folder),
                format!("{} and {} are both photo {number}", both[0], both[1]),
            ));
        }
    }
    Ok(photos)
}
