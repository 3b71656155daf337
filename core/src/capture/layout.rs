//! The layouts of captures on disk: which photos there are and what is known of each. No photo is opened here.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde::de::{DeserializeOwned, IgnoredAny};
use serde_json::Value;

use super::{Acquired, Shot, check_patch_size, check_white_level};
use crate::color::{ColorSpace, Transfer};
use crate::error::{Error, Result};
use crate::io::describe::{CAMERA_POSITIONS, CAPTURE_JSON, describe, is_photo};
use crate::io::read_file;
use crate::unit::Unit;

/// The largest text or JSON file of a capture, in bytes.
const MAX_TEXT_BYTES: u64 = 16 << 20;

/// What a capture is, for those who gave something else.
const HINT: &str = "a capture is a folder with a capture.json, or with camera_pos.txt and the like, or a JSON file: it also says where camera and light \
    stood for each photo, see docs/captures.md; one photo alone can be given by its file";

/// What a folder in MaterialGAN's layout holds beside [`CAMERA_POSITIONS`] and photos.
const FOLDER_FILES: [&str; 3] = ["light_pos.txt", "image_size.txt", "light_power.txt"];

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
    /// What `acquire` says of a capture that it made.
    pub acquired: Option<Acquired>,
}

/// One photo's file and shot.
pub(super) struct Entry {
    pub name: String,
    pub path: PathBuf,
    pub shot: Shot,
    /// A picture of the photo's size that is white where its channels are saturated.
    pub saturated: Option<PathBuf>,
}

impl Layout {
    pub fn read(path: &Path) -> Result<Self> {
        let metadata = std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
        if !metadata.is_dir() {
            return Self::from_json(path);
        }
        let json = path.join(CAPTURE_JSON);
        if json.exists() {
            Self::from_json(&json)
        } else if path.join(CAMERA_POSITIONS).exists() {
            Self::from_folder(path)
        } else {
            Err(unsupported(path, format!("{}: {HINT}", describe(path))))
        }
    }

    fn from_json(path: &Path) -> Result<Self> {
        /// What tells the formats apart.
        #[derive(Deserialize)]
        struct Head {
            format: Option<String>,
            version: Option<u64>,
            target_dir: Option<IgnoredAny>,
        }
        let bytes = read_file(path, MAX_TEXT_BYTES)?;
        // JSON of other programs begins as ours does; what does not is something else altogether.
        let begins =
            String::from_utf8_lossy(&bytes).trim_start_matches('\u{feff}').trim_start().starts_with(['{', '[']);
        if !bytes.is_empty() && !begins {
            return Err(unsupported(path, format!("{}: {HINT}", describe(path))));
        }
        let text = as_text(path, bytes)?;
        let head: Head = parse_json(path, &text)?;
        match (head.format.as_deref(), head.version) {
            (Some(FORMAT), Some(version @ (1 | 2))) => read_capture_json(path, &text, version),
            (Some(FORMAT), version) => Err(unsupported(
                path,
                format!(
                    "version {}; this release reads versions 1 and 2",
                    version.map_or("missing".to_owned(), |v| v.to_string())
                ),
            )),
            (None, _) if head.target_dir.is_some() => read_diff_renderer(path, &text),
            (format, _) => Err(unsupported(
                path,
                format!(
                    "format {:?}; read are {FORMAT:?} and svbrdf-diff-renderer's files, which have a target_dir; see docs/captures.md",
                    format.unwrap_or("missing"),
                ),
            )),
        }
    }

    /// A capture of the literature: gamma 2.2, where the files are of integers.
    fn gamma22(entries: Vec<Entry>, patch_size: f64) -> Self {
        let (transfer, implied, color_space) = (Transfer::Gamma22, true, None);
        Self { entries, patch_size, transfer, implied, color_space, unit: None, white_level: None, acquired: None }
    }

    /// The folder of MaterialGAN and the paper: numbered photos and four text files.
    fn from_folder(folder: &Path) -> Result<Self> {
        let missing: Vec<&str> = FOLDER_FILES.into_iter().filter(|file| !folder.join(file).exists()).collect();
        if !missing.is_empty() {
            let reason =
                format!("No such file beside {CAMERA_POSITIONS}: {}; see docs/captures.md", missing.join(", "));
            return Err(Error::io(folder, std::io::Error::new(std::io::ErrorKind::NotFound, reason)));
        }
        let cameras = read_rows(&folder.join(CAMERA_POSITIONS))?;
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
                    saturated: None,
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
const FORMAT: &str = "svbrdf-gcn capture";

/// Reads a `capture.json`. All that is missing or wrong in it is told in one error.
fn read_capture_json(path: &Path, text: &str, version: u64) -> Result<Layout> {
    let mut problems = Problems::default();
    let mut capture = Fields::new("", parse_json(path, text)?);
    for read_before in ["format", "version", "notes"] {
        capture.take::<IgnoredAny>(read_before, &mut problems);
    }
    let acquired = if version >= 2 { capture.take("acquisition", &mut problems) } else { None };
    let patch_size = capture.need("patch_size", &mut problems);
    let transfer = capture.need("transfer", &mut problems);
    let color_space = capture.take("color_space", &mut problems);
    let unit = capture.take("unit", &mut problems);
    let white_level = capture.take("white_level", &mut problems);
    let light_intensity = capture.take::<Intensity>("light_intensity", &mut problems);
    let is_there = capture.need::<IgnoredAny>("photos", &mut problems).is_some();
    // From the text again, where fields that are given twice are still there.
    let photos = is_there.then(|| parse_json::<Photos>(path, text)).transpose();
    let photos = problems.note(photos).flatten().map_or_else(Vec::new, |found| found.photos);
    capture.expect_no_more(&mut problems);
    if let Some(patch_size) = patch_size {
        problems.note(check_patch_size(patch_size));
    }
    problems.note(check_white_level(white_level));

    let folder = folder_of(path);
    let mut entries = Vec::new();
    for (index, object) in photos.into_iter().enumerate() {
        let mut photo = Fields::new(format!("photos[{index}]."), object);
        let name: Option<String> = photo.need("file", &mut problems);
        let camera = photo.need("camera", &mut problems);
        let light = photo.take("light", &mut problems);
        let own = photo.take::<Intensity>("light_intensity", &mut problems).or(light_intensity);
        let saturated = if version >= 2 { photo.take::<String>("saturated", &mut problems) } else { None };
        photo.expect_no_more(&mut problems);
        let (Some(name), Some(camera)) = (name, camera) else { continue };
        let Some(Intensity(light_intensity)) = own else {
            problems.add(format!("light_intensity missing, for the capture and for photo {name}"));
            continue;
        };
        let shot = Shot { camera, light: light.unwrap_or(camera), light_intensity };
        problems.note(shot.check(&name));
        let saturated = saturated.map(|file| folder.join(file));
        entries.push(Entry { path: folder.join(&name), name, shot, saturated });
    }
    match (patch_size, transfer, problems.into_reason()) {
        (Some(patch_size), Some(transfer), None) => {
            Ok(Layout { entries, patch_size, transfer, implied: false, color_space, unit, white_level, acquired })
        }
        (_, _, reason) => Err(Error::invalid(name_of(path), reason.unwrap_or_default())),
    }
}

/// Reads a JSON file of svbrdf-diff-renderer. Photo k of `idx` is `target_dir/kk.png` (two digits), relative to the file; `idx` also picks from the
/// lists of positions. Other fields name folders of that program.
fn read_diff_renderer(path: &Path, text: &str) -> Result<Layout> {
    let mut problems = Problems::default();
    let mut file = Fields::new("", parse_json(path, text)?);
    let patch_size = file.need("im_size", &mut problems);
    let indices: Option<Vec<usize>> = file.need("idx", &mut problems);
    let cameras: Option<Vec<[f64; 3]>> = file.need("camera_pos", &mut problems);
    let lights: Option<Vec<[f64; 3]>> = file.need("light_pos", &mut problems);
    let light_intensity = file.need("light_pow", &mut problems);
    let target: Option<String> = file.need("target_dir", &mut problems);
    let all = (patch_size, indices, cameras, lights, light_intensity, target, problems.into_reason());
    let (Some(patch_size), Some(indices), Some(cameras), Some(lights), Some(light_intensity), Some(target), None) = all
    else {
        return Err(Error::invalid(name_of(path), all.6.unwrap_or_default()));
    };
    same_count(path, lights.len(), "entries of light_pos", "camera_pos", cameras.len())?;
    let folder = folder_of(path).join(target);
    let entries = indices
        .into_iter()
        .map(|index| match (cameras.get(index), lights.get(index)) {
            (Some(&camera), Some(&light)) => {
                let name = format!("{index:02}.png");
                let shot = Shot { camera, light, light_intensity };
                Ok(Entry { path: folder.join(&name), name, shot, saturated: None })
            }
            _ => Err(Error::invalid(
                name_of(path),
                format!("idx {index}, but camera_pos has {} positions", cameras.len()),
            )),
        })
        .collect::<Result<_>>()?;
    Ok(Layout::gamma22(entries, patch_size))
}

#[derive(Deserialize)]
struct Photos {
    photos: Vec<Object>,
}

/// Intensity of a light: one number for all channels, or three.
#[derive(Clone, Copy)]
struct Intensity([f64; 3]);

impl<'de> Deserialize<'de> for Intensity {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        let value = Value::deserialize(deserializer)?;
        if let Some(number) = value.as_f64() {
            return Ok(Self([number; 3]));
        }
        let got = value.to_string();
        serde_json::from_value(value)
            .map(Self)
            .map_err(|_| serde::de::Error::custom(format!("expected one number or three in brackets, got {got}")))
    }
}

/// All that is wrong with a file, so that it is told at once.
#[derive(Default)]
struct Problems(Vec<String>);

impl Problems {
    /// As many are told.
    const MAX: usize = 20;

    fn add(&mut self, problem: String) {
        self.0.push(problem);
    }

    /// The value, or none where there is an error instead.
    fn note<T>(&mut self, result: Result<T>) -> Option<T> {
        result.map_err(|error| self.add(error.to_string())).ok()
    }

    fn into_reason(mut self) -> Option<String> {
        let more = self.0.len().saturating_sub(Self::MAX);
        self.0.truncate(Self::MAX);
        if more > 0 {
            self.0.push(format!("and {more} more"));
        }
        (!self.0.is_empty()).then(|| self.0.join("; "))
    }
}

/// The fields of a JSON object, taken one by one.
struct Fields {
    /// What stands before their names in messages.
    place: String,
    left: Vec<(String, Value)>,
    known: Vec<&'static str>,
}

impl Fields {
    fn new(place: impl Into<String>, object: Object) -> Self {
        Self { place: place.into(), left: object.0, known: Vec::new() }
    }

    /// The value of a field; none if it is not there or null.
    fn take<T: DeserializeOwned>(&mut self, name: &'static str, problems: &mut Problems) -> Option<T> {
        self.known.push(name);
        let at = self.left.iter().position(|(key, _)| key == name)?;
        let (_, value) = self.left.remove(at);
        if value.is_null() {
            return None;
        }
        let parsed = serde_json::from_value(value);
        parsed.map_err(|error| problems.add(format!("{}{name}: {error}", self.place))).ok()
    }

    /// [`Fields::take`] of a field that has to be there.
    fn need<T: DeserializeOwned>(&mut self, name: &'static str, problems: &mut Problems) -> Option<T> {
        if !self.left.iter().any(|(key, value)| key == name && !value.is_null()) {
            problems.add(format!("{}{name} missing", self.place));
        }
        self.take(name, problems)
    }

    /// What is left is unknown, or there twice.
    fn expect_no_more(self, problems: &mut Problems) {
        for (name, _) in self.left {
            problems.add(if self.known.contains(&name.as_str()) {
                format!("{}{name} given twice", self.place)
            } else {
                format!("{}{name} unknown, expected {}", self.place, self.known.join(", "))
            });
        }
    }
}

/// The fields of a JSON object in their order, with those that are given twice.
struct Object(Vec<(String, Value)>);

impl<'de> Deserialize<'de> for Object {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        struct Visitor;

        impl<'de> serde::de::Visitor<'de> for Visitor {
            type Value = Object;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("an object")
            }

            fn visit_map<A: serde::de::MapAccess<'de>>(self, mut map: A) -> std::result::Result<Object, A::Error> {
                let mut fields = Vec::new();
                while let Some(field) = map.next_entry()? {
                    fields.push(field);
                }
                Ok(Object(fields))
            }
        }

        deserializer.deserialize_map(Visitor)
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
    as_text(path, read_file(path, MAX_TEXT_BYTES)?)
}

fn as_text(path: &Path, bytes: Vec<u8>) -> Result<String> {
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
        let Some((stem, _)) = name.rsplit_once('.') else { continue };
        if !is_photo(name.as_ref()) || stem.is_empty() || !stem.bytes().all(|byte| byte.is_ascii_digit()) {
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
