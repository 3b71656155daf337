//! Material folders: one image per map and `material.json`, which says how each is encoded. `docs/materials.md` describes them.

use std::collections::{BTreeMap, BTreeSet};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::decode::{Demand, MAX_DECODED_BYTES, Stored, decode, demand_of_bytes};
use super::encode::{named_channels, png8, png16, tiff_float};
use super::exr::{self, Precision};
use super::file::read_file_unless;
use super::ours::{self, Description};
use super::resize::{fit_size, shrink};
use super::save::{Files, Saving, read_whole};
use crate::cancel::CancelToken;
use crate::color::{ColorSpace, Transfer};
use crate::deviations::Deviations;
use crate::error::{Error, Result};
use crate::image::Image;
use crate::maps::Lobe;
use crate::material::Material;
use crate::memory;
use crate::unit::Unit;

/// The file that describes a material folder.
pub const MATERIAL_JSON: &str = Description::Material.file();

/// The picture beside the maps.
pub const PREVIEW_PNG: &str = ours::PREVIEW_PNG;

const FORMAT: &str = Description::Material.format();
const VERSION: u64 = 1;
const MAX_JSON_BYTES: u64 = 64 << 20;
/// Pixels and what a file has beside them.
const MAX_MAP_BYTES: u64 = MAX_DECODED_BYTES + (1 << 16);

/// How far a stored value may lie outside of [0, 1] (rounding of half floats, filters) before it is an error.
const RANGE_SLACK: f32 = 1e-3;

/// The image format of written maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum MaterialFormat {
    /// OpenEXR with half floats, everything linear: a relative error of 2^-11 (absolute 2^-25 below 6e-5).
    #[default]
    Exr,
    /// PNG with 16 bits: albedos sRGB-encoded (in ACEScg linear), roughness, normal and tangent as data.
    Png16,
    /// TIFF with 32-bit floats, everything linear; loses nothing.
    Tiff,
}

impl MaterialFormat {
    const ALL: [Self; 3] = [Self::Exr, Self::Png16, Self::Tiff];

    fn extension(self) -> &'static str {
        match self {
            Self::Exr => "exr",
            Self::Png16 => "png",
            Self::Tiff => "tif",
        }
    }

    fn file_name(self, map: Map) -> String {
        format!("{}.{}", map.name(), self.extension())
    }

    /// The file of a map's standard deviation.
    fn deviation_name(self, map: Map) -> String {
        format!("{}_deviation.{}", map.name(), self.extension())
    }

    /// The transfer function of the file of a map.
    fn transfer(self, map: Map, color_space: ColorSpace) -> Transfer {
        if self == Self::Png16 && map.is_color() && color_space == ColorSpace::Rec709 {
            Transfer::Srgb
        } else {
            Transfer::Linear
        }
    }
}

/// How a material is written.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct SaveOptions {
    /// The image format of the maps.
    pub format: MaterialFormat,
    /// What made the material (settings, losses, timings, warnings), written to `material.json` as it is.
    pub report: Option<serde_json::Value>,
    /// The colour space of the albedos written.
    pub color_space: ColorSpace,
    /// How sure the maps are, written beside them.
    pub deviations: Option<Deviations>,
    /// A picture in screen values, (H, W, 3), [0, 1], written as `preview.png`; see [`preview`](crate::preview::preview).
    pub preview: Option<Image>,
}

impl SaveOptions {
    /// Maps in this format, no report.
    pub fn new(format: MaterialFormat) -> Self {
        Self { format, ..Self::default() }
    }

    /// Adds a report to `material.json`.
    pub fn report(mut self, report: serde_json::Value) -> Self {
        self.report = Some(report);
        self
    }

    /// Writes how sure the maps are beside them.
    pub fn deviations(mut self, deviations: Option<Deviations>) -> Self {
        self.deviations = deviations;
        self
    }

    /// Writes a picture beside the maps.
    pub fn preview(mut self, preview: Image) -> Self {
        self.preview = Some(preview);
        self
    }

    /// Writes the albedos in this colour space.
    pub fn color_space(mut self, color_space: ColorSpace) -> Self {
        self.color_space = color_space;
        self
    }
}

/// The encodings of maps in the field, for files without a `material.json`.
///
/// In all of them normals are stored as (n + 1) / 2 with +y up, roughness is perceptual. A folder holds one image per map, a strip
/// is one image of square tiles from left to right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum MaterialEncoding {
    /// Data set of Deschaintre et al. 2018: everything linear; strips of normal, diffuse, roughness, specular, which may begin with a photo.
    Deschaintre2018,
    /// Deep Inverse Rendering: diffuse gamma 2.2, the rest linear; strips of normal, diffuse, roughness, specular.
    DeepInverseRendering,
    /// MaterialGAN and the code of the paper: all but the normal gamma 2.2; strips of diffuse, normal, roughness, specular.
    MaterialGan,
    /// svbrdf-diff-renderer: all but the normal gamma 2.2; files `nom`, `dif`, `spe`, `rgh`, no strips.
    DiffRenderer,
}

impl MaterialEncoding {
    /// All encodings.
    pub const ALL: [Self; 4] =
        [Self::Deschaintre2018, Self::DeepInverseRendering, Self::MaterialGan, Self::DiffRenderer];

    /// The name on the command line and in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Deschaintre2018 => "deschaintre2018",
            Self::DeepInverseRendering => "deep-inverse-rendering",
            Self::MaterialGan => "materialgan",
            Self::DiffRenderer => "svbrdf-diff-renderer",
        }
    }

    /// The inverse of [`MaterialEncoding::name`].
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|encoding| encoding.name() == name)
    }

    fn transfer(self, map: Map) -> Transfer {
        match (self, map) {
            (Self::Deschaintre2018, _) | (_, Map::Normal) => Transfer::Linear,
            (Self::DeepInverseRendering, Map::Diffuse) | (Self::MaterialGan | Self::DiffRenderer, _) => {
                Transfer::Gamma22
            }
            (Self::DeepInverseRendering, _) => Transfer::Linear,
        }
    }

    /// The maps of a strip from left to right.
    fn strip(self) -> Option<[Map; 4]> {
        match self {
            Self::Deschaintre2018 | Self::DeepInverseRendering => {
                Some([Map::Normal, Map::Diffuse, Map::Roughness, Map::Specular])
            }
            Self::MaterialGan => Some([Map::Diffuse, Map::Normal, Map::Roughness, Map::Specular]),
            Self::DiffRenderer => None,
        }
    }
}

/// How a material is read.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct LoadOptions {
    /// The encoding of files without a `material.json`; a `material.json` says it itself.
    pub encoding: Option<MaterialEncoding>,
    /// The width of the patch, where no `material.json` says it; 1 if not given.
    pub patch_size: Option<f64>,
    /// The unit of that width; not known if not given.
    pub unit: Option<Unit>,
}

impl LoadOptions {
    /// Only folders with a `material.json`.
    pub fn new() -> Self {
        Self::default()
    }

    /// Also files without a `material.json`, in this encoding.
    pub fn encoding(mut self, encoding: MaterialEncoding) -> Self {
        self.encoding = Some(encoding);
        self
    }

    /// The width of the patch of files without a `material.json`.
    pub fn patch_size(mut self, patch_size: f64) -> Self {
        self.patch_size = Some(patch_size);
        self
    }

    /// The unit of the patch's width of files without a `material.json`.
    pub fn unit(mut self, unit: Unit) -> Self {
        self.unit = Some(unit);
        self
    }
}

/// The maps by their names on disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Map {
    Diffuse,
    Specular,
    Roughness,
    Normal,
    Tangent,
}

impl Map {
    const ALL: [Self; 5] = [Self::Diffuse, Self::Specular, Self::Roughness, Self::Normal, Self::Tangent];

    /// Whether the map holds colours, which have a colour space.
    fn is_color(self) -> bool {
        matches!(self, Self::Diffuse | Self::Specular)
    }

    fn name(self) -> &'static str {
        match self {
            Self::Diffuse => "diffuse",
            Self::Specular => "specular",
            Self::Roughness => "roughness",
            Self::Normal => "normal",
            Self::Tangent => "tangent",
        }
    }

    /// The name in the files of svbrdf-diff-renderer.
    fn short_name(self) -> &'static str {
        match self {
            Self::Diffuse => "dif",
            Self::Specular => "spe",
            Self::Roughness => "rgh",
            Self::Normal => "nom",
            Self::Tangent => "tan",
        }
    }
}

/// `material.json`. Fields that are only for people are not read.
#[derive(Serialize, Deserialize)]
struct MaterialFile {
    format: String,
    version: u64,
    #[serde(skip_deserializing)]
    written_by: String,
    #[serde(skip_deserializing)]
    width: usize,
    #[serde(skip_deserializing)]
    height: usize,
    patch_size: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    unit: Option<Unit>,
    lobe: Lobe,
    maps: MapFiles,
    #[serde(skip_serializing_if = "Option::is_none")]
    deviations: Option<DeviationFiles>,
    /// Maps and deviations as they were written.
    #[serde(skip_serializing_if = "Option::is_none")]
    files: Option<BTreeMap<String, Content>>,
    #[serde(skip_deserializing)]
    conventions: Conventions,
    #[serde(skip_serializing_if = "Option::is_none")]
    report: Option<serde_json::Value>,
}

/// By what a file is known again.
#[derive(PartialEq, Eq, Serialize, Deserialize)]
struct Content {
    bytes: u64,
    /// Eight hexadecimal digits.
    crc32: String,
}

impl Content {
    fn of(bytes: &[u8]) -> Self {
        Self { bytes: bytes.len() as u64, crc32: format!("{:08x}", crc32fast::hash(bytes)) }
    }
}

impl std::fmt::Display for Content {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} bytes with CRC-32 {}", self.bytes, self.crc32)
    }
}

#[derive(Serialize, Deserialize)]
struct MapFiles {
    diffuse: MapFile,
    specular: MapFile,
    roughness: MapFile,
    normal: MapFile,
    #[serde(skip_serializing_if = "Option::is_none")]
    tangent: Option<MapFile>,
}

/// The files of standard deviations.
#[derive(Serialize, Deserialize)]
struct DeviationFiles {
    diffuse: String,
    specular: String,
    roughness: String,
    normal: String,
}

/// One map's file, relative to the folder, and how its values are stored.
#[derive(Clone, Serialize, Deserialize)]
struct MapFile {
    file: String,
    transfer: Transfer,
    /// Of a colour map; Rec. 709 where it is not stated.
    #[serde(skip_serializing_if = "Option::is_none")]
    color_space: Option<ColorSpace>,
}

/// What the maps mean, in words.
#[derive(Default, Serialize)]
struct Conventions {
    frame: &'static str,
    diffuse: &'static str,
    specular: &'static str,
    roughness: &'static str,
    normal: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    tangent: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    deviations: Option<&'static str>,
    shading: &'static str,
}

impl Conventions {
    fn new(lobe: Lobe, deviations: bool) -> Self {
        let anisotropic = lobe == Lobe::Anisotropic;
        Self {
            frame: "x right, y up (row 0 is at +y), z out of the surface; patch_size is the width of the maps, the height follows from their aspect",
            diffuse: "diffuse albedo, linear RGB of color_space, 0 to 1, encoded with transfer",
            specular: "specular albedo (reflectance at normal incidence, F0), linear, 0 to 1, encoded with transfer",
            roughness: if anisotropic {
                "perceptual roughness along tangent and bitangent in channels R and G, 0 to 1; alpha is its square"
            } else {
                "perceptual roughness, 0 to 1; alpha is its square"
            },
            normal: "unit vector, +x right, +y up, stored as (n + 1) / 2",
            tangent: anisotropic.then_some("unit vector orthogonal to the normal, stored as (t + 1) / 2"),
            deviations: deviations.then_some(
                "standard deviations of the linear values; of albedos the root mean square over colours, of the normal about an angle in radians",
            ),
            shading: "d (1 - s) / pi + D F G / (4 (n.v)(n.l)): GGX, separable Smith-Schlick masking with k = alpha / 2, spherical Gaussian Fresnel",
        }
    }
}

impl Material {
    /// Writes the maps and `material.json` to a folder, which is made if it is not there.
    ///
    /// Files are `diffuse`, `specular`, `roughness`, `normal` and, for an anisotropic material, `tangent`, with the extension of the
    /// format. Albedos and roughness are limited to [0, 1], normals and tangents written at unit length. A material that is there is
    /// replaced as a whole: whenever the process ends or a call fails, the folder holds all of the old one or all of the new one, and the next save or
    /// load finishes what was begun. Files that only the old one had, of another format say, are removed.
    ///
    /// # Errors
    /// As [`Material::to_maps`]; [`Error::InvalidArgument`] if a file of one of these names is neither named by the folder's `material.json` nor an image that
    /// says it was written by this library; [`Error::Io`] if a file cannot be written, or another process saves there for more than a minute.
    ///
    /// # Example
    /// ```no_run
    /// use svbrdf_gcn::{Material, Unit};
    /// use svbrdf_gcn::io::material::{LoadOptions, MaterialEncoding, MaterialFormat, SaveOptions};
    ///
    /// // A strip of the MaterialGAN data set as a folder of 16-bit PNGs.
    /// let options = LoadOptions::new().encoding(MaterialEncoding::MaterialGan).patch_size(6.8).unit(Unit::new("cm"));
    /// let material = Material::load_with("strip.png", &options)?;
    /// material.save("out", &SaveOptions::new(MaterialFormat::Png16))?;
    /// assert_eq!(Material::load("out")?.unit, Some(Unit::new("cm")));
    /// # Ok::<(), svbrdf_gcn::Error>(())
    /// ```
    pub fn save(&self, folder: impl AsRef<Path>, options: &SaveOptions) -> Result<()> {
        self.save_unless(folder.as_ref(), options, &CancelToken::new())
    }

    /// [`Material::save`], given up if `cancel` is cancelled before files are about to take their places.
    ///
    /// # Errors
    /// As [`Material::save`]; [`Error::Cancelled`], and nothing has changed.
    pub(crate) fn save_unless(&self, folder: &Path, options: &SaveOptions, cancel: &CancelToken) -> Result<()> {
        let material = self.limited()?;
        let mut files: Vec<(String, Vec<u8>)> = Vec::new();
        let encode = |path: &Path, image: &Image, transfer, color_space: Option<ColorSpace>| {
            cancel.check()?;
            match options.format {
                MaterialFormat::Exr => {
                    let channels = named_channels(image)?;
                    let color_space = color_space.unwrap_or_default();
                    exr::encode(path, image.width(), image.height(), &channels, Precision::Half, color_space)
                }
                MaterialFormat::Png16 => png16(path, image, transfer),
                MaterialFormat::Tiff => tiff_float(path, image),
            }
        };
        let mut write = |map: Map, image: &Image| {
            let mut converted = image.clone();
            if map.is_color() {
                ColorSpace::Rec709.convert_image(options.color_space, &mut converted);
            }
            let image = &converted;
            let entry = MapFile {
                file: options.format.file_name(map),
                transfer: options.format.transfer(map, options.color_space),
                color_space: map.is_color().then_some(options.color_space),
            };
            let bytes = encode(&folder.join(&entry.file), image, entry.transfer, entry.color_space)?;
            files.push((entry.file.clone(), bytes));
            Ok(entry)
        };
        let maps_written = MapFiles {
            diffuse: write(Map::Diffuse, &material.diffuse_albedo)?,
            specular: write(Map::Specular, &material.specular_albedo)?,
            roughness: write(Map::Roughness, &material.roughness)?,
            normal: write(Map::Normal, &half_range(&material.normal)?)?,
            tangent: match &material.tangent {
                Some(tangent) => Some(write(Map::Tangent, &half_range(tangent)?)?),
                None => None,
            },
        };
        let mut write_deviation = |map: Map, image: &Image| {
            let name = options.format.deviation_name(map);
            let (size, expected) =
                ([image.height(), image.width(), image.channels()], [material.height(), material.width(), 1]);
            if size != expected {
                return Err(Error::shape(name, format!("shape {expected:?}"), format!("{size:?}")));
            }
            files.push((name.clone(), encode(&folder.join(&name), image, Transfer::Linear, None)?));
            Ok(name)
        };
        let deviations = match &options.deviations {
            Some(deviations) => Some(DeviationFiles {
                diffuse: write_deviation(Map::Diffuse, &deviations.diffuse_albedo)?,
                specular: write_deviation(Map::Specular, &deviations.specular_albedo)?,
                roughness: write_deviation(Map::Roughness, &deviations.roughness)?,
                normal: write_deviation(Map::Normal, &deviations.normal)?,
            }),
            None => None,
        };
        let description = MaterialFile {
            format: FORMAT.to_owned(),
            version: VERSION,
            written_by: concat!("svbrdf-gcn ", env!("CARGO_PKG_VERSION")).to_owned(),
            width: material.width(),
            height: material.height(),
            patch_size: self.patch_size,
            unit: self.unit.clone(),
            lobe: material.lobe(),
            maps: maps_written,
            conventions: Conventions::new(material.lobe(), deviations.is_some()),
            deviations,
            files: Some(files.iter().map(|(name, bytes)| (name.clone(), Content::of(bytes))).collect()),
            report: options.report.clone(),
        };
        let mut text =
            serde_json::to_vec_pretty(&description).map_err(|e| Error::io(&folder.join(MATERIAL_JSON), e))?;
        text.push(b'\n');
        files.push((MATERIAL_JSON.to_owned(), text));
        if let Some(preview) = &options.preview {
            // The picture holds screen values already.
            files.push((PREVIEW_PNG.to_owned(), png8(&folder.join(PREVIEW_PNG), preview, Transfer::Linear)?));
        }

        let saving = Saving::begin(folder, cancel)?;
        ours::check(folder, Description::Material, files.iter().map(|(name, _)| name.as_str()))?;
        let replaced = replaced(folder, &files);
        saving.replace(&files, replaced)
    }

    /// Reads a folder with a `material.json`. Albedos in another colour space are converted to Rec. 709 and limited to [0, 1] again.
    ///
    /// A map that has changed since its `material.json` was written is read as it is, with a warning that names it in [`Material::warnings`]. What a save
    /// that was ended by force left in the folder is finished or cleared away, where this process may write there.
    ///
    /// # Errors
    /// [`Error::Io`] for files that are missing or broken; [`Error::UnsupportedFormat`] for another version of the format, or a
    /// folder without `material.json` (see [`Material::load_with`]); [`Error::ShapeMismatch`] if the maps differ in size;
    /// [`Error::InvalidArgument`] for values outside of [0, 1] or not finite.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        Self::load_with(path, &LoadOptions::default())
    }

    /// Reads a folder with a `material.json`, or, where `options` state their encoding, a folder with one image per map (`diffuse` or
    /// `dif`, `specular` or `spe`, `roughness` or `rgh`, `normal` or `nom`) or a strip.
    ///
    /// # Errors
    /// As [`Material::load`].
    pub fn load_with(path: impl AsRef<Path>, options: &LoadOptions) -> Result<Self> {
        Self::load_within(path.as_ref(), options, None, &CancelToken::new())
    }

    /// [`Material::load_with`] with at most `max_memory` bytes, three quarters of the free memory if not given, until `cancel` is cancelled.
    ///
    /// # Errors
    /// As [`Material::load`]; [`Error::OutOfMemory`] before a map is decoded; [`Error::Cancelled`].
    pub(crate) fn load_within(
        path: &Path,
        options: &LoadOptions,
        max_memory: Option<u64>,
        cancel: &CancelToken,
    ) -> Result<Self> {
        let bounds = &Bounds { allowed: memory::allowed(max_memory, 0), cancel };
        let metadata = std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
        if metadata.is_dir()
            && let Some(material) =
                described(path, cancel, |files, description| load_described(path, files, description, bounds))?
        {
            return Ok(material);
        }
        let Some(encoding) = options.encoding else {
            let names = MaterialEncoding::ALL.map(MaterialEncoding::name).join(", ");
            return Err(Error::UnsupportedFormat {
                name: path.display().to_string(),
                got: format!("maps without {MATERIAL_JSON}; their encoding must be stated: {names}"),
            });
        };
        let patch_size = options.patch_size.unwrap_or(1.0);
        let material = if metadata.is_dir() {
            load_plain(path, encoding, patch_size, bounds)?
        } else {
            load_strip(path, encoding, patch_size, bounds)?
        };
        Ok(Self { unit: options.unit.clone(), ..material })
    }

    /// The material at a longer side of at most `longer` pixels, resampled by area; never enlarged. Normals and tangents are averaged
    /// and brought to unit length.
    ///
    /// # Errors
    /// As [`Material::to_maps`]; [`Error::InvalidArgument`] if `longer` is 0.
    pub fn resized(&self, longer: usize) -> Result<Self> {
        if longer == 0 {
            return Err(Error::invalid("size", "expected at least 1 pixel, got 0"));
        }
        let maps = self.to_maps()?;
        let full = (maps.width(), maps.height());
        let size = fit_size(full.0, full.1, Some(longer));
        let resize = |image: &Image| {
            let row = full.0 * image.channels();
            let (values, _) = shrink(full, size, image.channels(), |y, out, _| {
                out.copy_from_slice(&image.data()[y * row..(y + 1) * row]);
                Ok(())
            })?;
            Image::new(size.0, size.1, image.channels(), values)
        };
        let resized = Self {
            diffuse_albedo: resize(&self.diffuse_albedo)?,
            specular_albedo: resize(&self.specular_albedo)?,
            roughness: resize(&self.roughness)?,
            normal: resize(&self.normal)?,
            tangent: self.tangent.as_ref().map(resize).transpose()?,
            unit: self.unit.clone(),
            warnings: self.warnings.clone(),
            ..*self
        };
        resized.normalised()
    }
}

/// The `report` of a material folder's `material.json`, where there is one.
///
/// # Errors
/// As [`Material::load`].
pub fn read_report(folder: impl AsRef<Path>) -> Result<Option<serde_json::Value>> {
    required(folder.as_ref(), |_, description| Ok(description.report.clone()))
}

/// How sure the maps of a material folder are, where it says so.
///
/// # Errors
/// As [`Material::load`].
pub fn read_deviations(folder: impl AsRef<Path>) -> Result<Option<Deviations>> {
    let folder = folder.as_ref();
    required(folder, |files, description| {
        description.deviations.as_ref().map(|names| load_deviations(folder, files, names)).transpose()
    })
}

fn load_deviations(folder: &Path, files: &Files<'_>, names: &DeviationFiles) -> Result<Deviations> {
    let mut first = None;
    let mut read = |name: &str| {
        let path = folder.join(name);
        let image =
            decode(&path, &files.read(name, MAX_MAP_BYTES)?, &CancelToken::new())?.to_image(Transfer::Linear)?;
        let size = [image.height(), image.width(), image.channels()];
        let expected = *first.get_or_insert([size[0], size[1], 1]);
        if size != expected {
            return Err(Error::shape(path.display().to_string(), format!("shape {expected:?}"), format!("{size:?}")));
        }
        match image.data().iter().find(|value| !(value.is_finite() && **value >= 0.0)) {
            Some(value) => {
                Err(Error::invalid(path.display().to_string(), format!("expected values from 0, got {value}")))
            }
            None => Ok(image),
        }
    };
    Ok(Deviations {
        diffuse_albedo: read(&names.diffuse)?,
        specular_albedo: read(&names.specular)?,
        roughness: read(&names.roughness)?,
        normal: read(&names.normal)?,
    })
}

/// Checks whether [`Material::save`] may write to a folder what a fit can come to: better known before the fit than after it.
///
/// # Errors
/// [`Error::InvalidArgument`] naming the file that a save would refuse to replace.
pub fn check_folder(folder: impl AsRef<Path>, format: MaterialFormat) -> Result<()> {
    let names: Vec<String> = file_names(format).collect();
    ours::check(folder.as_ref(), Description::Material, names.iter().map(String::as_str))
}

/// All files that a material may have in a format.
pub(crate) fn file_names(format: MaterialFormat) -> impl Iterator<Item = String> {
    let maps = Map::ALL.into_iter().flat_map(move |map| [format.file_name(map), format.deviation_name(map)]);
    maps.chain([PREVIEW_PNG, MATERIAL_JSON].map(str::to_owned))
}

/// The files of the material in a folder that `files` do not replace, as far as they bear names that [`Material::save`] gives.
fn replaced(folder: &Path, files: &[(String, Vec<u8>)]) -> BTreeSet<String> {
    let Some(old) = Description::Material.read(folder) else { return BTreeSet::new() };
    let mut names = Description::Material.names(&old);
    let given: BTreeSet<String> = MaterialFormat::ALL.into_iter().flat_map(file_names).collect();
    names.retain(|name| given.contains(name) && !files.iter().any(|(file, _)| file == name));
    // A picture that is not written may be somebody else's.
    names.retain(|name| name != PREVIEW_PNG || ours::says_ours(&folder.join(name)));
    names
}

/// What `read` makes of a folder with a `material.json`; `None` for one without.
fn described<T>(
    folder: &Path,
    cancel: &CancelToken,
    read: impl Fn(&Files<'_>, &MaterialFile) -> Result<T>,
) -> Result<Option<T>> {
    read_whole(folder, MATERIAL_JSON, MAX_JSON_BYTES, cancel, |files| {
        let Some(text) = &files.description else { return Ok(None) };
        read(files, &parse_description(&folder.join(MATERIAL_JSON), text)?).map(Some)
    })
}

fn required<T>(folder: &Path, read: impl Fn(&Files<'_>, &MaterialFile) -> Result<T>) -> Result<T> {
    described(folder, &CancelToken::new(), read)?
        .ok_or_else(|| Error::io(&folder.join(MATERIAL_JSON), ErrorKind::NotFound))
}

fn parse_description(path: &Path, bytes: &[u8]) -> Result<MaterialFile> {
    #[derive(Deserialize)]
    struct Head {
        format: Option<String>,
        version: Option<u64>,
    }
    let invalid = |e: serde_json::Error| Error::invalid(path.display().to_string(), e.to_string());
    let head: Head = serde_json::from_slice(bytes).map_err(invalid)?;
    if head.format.as_deref() != Some(FORMAT) || head.version != Some(VERSION) {
        let format = head.format.as_deref().unwrap_or("missing");
        let version = head.version.map_or("missing".to_owned(), |version| version.to_string());
        return Err(Error::UnsupportedFormat {
            name: path.display().to_string(),
            got: format!("format {format:?}, version {version}; read is {FORMAT:?}, version {VERSION}"),
        });
    }
    serde_json::from_slice(bytes).map_err(invalid)
}

fn load_described(
    folder: &Path,
    files: &Files<'_>,
    description: &MaterialFile,
    bounds: &Bounds<'_>,
) -> Result<Material> {
    let MapFiles { diffuse, specular, roughness, normal, tangent } = &description.maps;
    let mut warnings = Vec::new();
    let mut read = |map: Map, entry: &MapFile| {
        let path = folder.join(&entry.file);
        let bytes = files.read(&entry.file, MAX_MAP_BYTES)?;
        let (found, written) = (Content::of(&bytes), description.files.as_ref().and_then(|all| all.get(&entry.file)));
        if let Some(written) = written.filter(|written| **written != found) {
            let path = path.display();
            warnings
                .push(format!("{path}: changed since {MATERIAL_JSON} was written: expected {written}, got {found}"));
        }
        let mut image = decode_map(
            map,
            description.lobe,
            &path,
            &bounds.decode(&path, &bytes, 1, description.lobe)?,
            entry.transfer,
        )?;
        if let Some(color_space) = entry.color_space.filter(|_| map.is_color()) {
            color_space.convert_image(ColorSpace::Rec709, &mut image);
        }
        Ok(image)
    };
    let tangent = match (description.lobe, tangent) {
        (Lobe::Isotropic, _) => None,
        (Lobe::Anisotropic, Some(entry)) => Some(read(Map::Tangent, entry)?),
        (Lobe::Anisotropic, None) => {
            let name = folder.join(MATERIAL_JSON).display().to_string();
            return Err(Error::invalid(name, "lobe anisotropic, but maps has no tangent"));
        }
    };
    let [diffuse_albedo, specular_albedo, roughness, normal] = [
        read(Map::Diffuse, diffuse)?,
        read(Map::Specular, specular)?,
        read(Map::Roughness, roughness)?,
        read(Map::Normal, normal)?,
    ];
    let (patch_size, unit) = (description.patch_size, description.unit.clone());
    assemble(
        folder,
        Material { diffuse_albedo, specular_albedo, roughness, normal, tangent, patch_size, unit, warnings },
    )
}

/// What the loading of a material is held to.
struct Bounds<'a> {
    allowed: u64,
    cancel: &'a CancelToken,
}

impl Bounds<'_> {
    /// [`decode`] of a file with `maps` maps of a material, if there is the memory for it.
    fn decode(&self, path: &Path, bytes: &[u8], maps: usize, lobe: Lobe) -> Result<Stored> {
        let Demand { size: (width, height), .. } = demand_of_bytes(path, bytes, self.cancel)?;
        // The maps as they are read, in planes, and limited to their ranges.
        let pixel = (3 * lobe.planes() * size_of::<f32>()) as u64;
        let needed =
            pixel.saturating_mul((width / maps) as u64).saturating_mul(height as u64).saturating_add(memory::SMALL);
        memory::check(&format!("reading maps of {width} x {height} pixels"), needed, self.allowed)?;
        decode(path, bytes, self.cancel)
    }

    fn read(&self, path: &Path, maps: usize) -> Result<Stored> {
        self.decode(path, &read_file_unless(path, MAX_MAP_BYTES, self.cancel)?, maps, Lobe::Isotropic)
    }
}

/// A folder with one image per map, in a stated encoding.
fn load_plain(folder: &Path, encoding: MaterialEncoding, patch_size: f64, bounds: &Bounds<'_>) -> Result<Material> {
    let read = |map: Map| {
        let path = find_map(folder, map)?;
        decode_map(map, Lobe::Isotropic, &path, &bounds.read(&path, 1)?, encoding.transfer(map))
    };
    assemble(folder, isotropic(read, patch_size)?)
}

fn isotropic(read: impl Fn(Map) -> Result<Image>, patch_size: f64) -> Result<Material> {
    Ok(Material {
        diffuse_albedo: read(Map::Diffuse)?,
        specular_albedo: read(Map::Specular)?,
        roughness: read(Map::Roughness)?,
        normal: read(Map::Normal)?,
        tangent: None,
        patch_size,
        unit: None,
        warnings: Vec::new(),
    })
}

/// The one image of a folder that is named like the map.
fn find_map(folder: &Path, map: Map) -> Result<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))? {
        let path = entry.map_err(|e| Error::io(folder, e))?.path();
        let stem = path.file_stem().map(|stem| stem.to_string_lossy().to_lowercase()).unwrap_or_default();
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        let is_image = ["png", "jpg", "jpeg", "tif", "tiff", "exr"].contains(&extension.as_str());
        if is_image && (stem == map.name() || stem == map.short_name()) {
            found.push(path);
        }
    }
    found.sort();
    match found.as_slice() {
        [path] => Ok(path.clone()),
        [] => {
            let reason = format!("no image named {} or {}", map.name(), map.short_name());
            Err(Error::io(folder, std::io::Error::new(std::io::ErrorKind::NotFound, reason)))
        }
        [first, second, ..] => Err(Error::invalid(
            folder.display().to_string(),
            format!("{} and {} are both the {} map", first.display(), second.display(), map.name()),
        )),
    }
}

/// One image of square tiles, in a stated encoding.
fn load_strip(path: &Path, encoding: MaterialEncoding, patch_size: f64, bounds: &Bounds<'_>) -> Result<Material> {
    let name = || path.display().to_string();
    let Some(order) = encoding.strip() else {
        let got = format!("an image file; {} has a folder of files", encoding.name());
        return Err(Error::UnsupportedFormat { name: name(), got });
    };
    let stored = bounds.read(path, order.len())?;
    let side = stored.height;
    let photo = usize::from(encoding == MaterialEncoding::Deschaintre2018 && stored.width == 5 * side);
    if stored.width != (4 + photo) * side {
        let expected = format!("a strip of 4 square tiles, {} x {side} pixels", 4 * side);
        return Err(Error::shape(name(), expected, format!("{} x {side}", stored.width)));
    }
    let tile = |map: Map| {
        let index = photo + order.iter().position(|&other| other == map).unwrap_or_default();
        let pixels = stored.to_image(encoding.transfer(map))?;
        let channels = pixels.channels();
        let rows = pixels.data().chunks_exact(stored.width * channels);
        let part = rows.flat_map(|row| &row[index * side * channels..(index + 1) * side * channels]).copied();
        let data = memory::collected(side * side * channels, part)?;
        to_map(map, Lobe::Isotropic, path, Image::new(side, side, channels, data)?)
    };
    assemble(path, isotropic(tile, patch_size)?)
}

fn decode_map(map: Map, lobe: Lobe, path: &Path, stored: &Stored, transfer: Transfer) -> Result<Image> {
    to_map(map, lobe, path, stored.to_image(transfer)?)
}

/// The values of one map from the decoded pixels of its file.
fn to_map(map: Map, lobe: Lobe, path: &Path, pixels: Image) -> Result<Image> {
    let allowed = -RANGE_SLACK..=1.0 + RANGE_SLACK;
    if let Some(value) = pixels.data().iter().find(|value| !allowed.contains(value)) {
        return Err(Error::invalid(path.display().to_string(), format!("expected values from 0 to 1, got {value}")));
    }
    let (width, height) = (pixels.width(), pixels.height());
    let count = width * height;
    let data: Vec<f32> = match (map, pixels.channels()) {
        (Map::Roughness, 3) if lobe == Lobe::Anisotropic => {
            memory::collected(2 * count, pixels.data().chunks_exact(3).flat_map(|rgb| [rgb[0], rgb[1]]))?
        }
        (Map::Roughness, 3) => {
            memory::collected(count, pixels.data().chunks_exact(3).map(|rgb| (rgb[0] + rgb[1] + rgb[2]) / 3.0))?
        }
        (Map::Roughness, _) if lobe == Lobe::Isotropic => return Ok(pixels),
        (Map::Diffuse | Map::Specular, 1) => {
            memory::collected(3 * count, pixels.data().iter().flat_map(|&grey| [grey; 3]))?
        }
        (Map::Diffuse | Map::Specular, 3) => return Ok(pixels),
        (Map::Normal | Map::Tangent, 3) => memory::collected(3 * count, pixels.data().iter().map(|v| 2.0 * v - 1.0))?,
        (_, channels) => {
            return Err(Error::shape(path.display().to_string(), "three channels", channels.to_string()));
        }
    };
    let channels = data.len() / count;
    Image::new(width, height, channels, data)
}

/// The material with values limited to their ranges and vectors at unit length.
fn assemble(path: &Path, material: Material) -> Result<Material> {
    material.normalised().map_err(|error| match error {
        Error::ShapeMismatch { name, expected, got } => {
            Error::ShapeMismatch { name: format!("{}: {name}", path.display()), expected, got }
        }
        error => error,
    })
}

/// Vectors as they are stored: (n + 1) / 2.
fn half_range(image: &Image) -> Result<Image> {
    let data = memory::collected(image.data().len(), image.data().iter().map(|v| (v + 1.0) / 2.0))?;
    Image::new(image.width(), image.height(), image.channels(), data)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use tempfile::TempDir;

    use super::*;
    use crate::io::save::failing;

    fn material(value: f32) -> Material {
        let image = |channels: usize, value: f32| Image::new(2, 2, channels, vec![value; 4 * channels]).unwrap();
        Material {
            diffuse_albedo: image(3, value),
            specular_albedo: image(3, value),
            roughness: image(1, value),
            normal: Image::new(2, 2, 3, [0.0, 0.0, 1.0].repeat(4)).unwrap(),
            tangent: None,
            patch_size: f64::from(value),
            unit: None,
            warnings: Vec::new(),
        }
    }

    fn options(format: MaterialFormat) -> SaveOptions {
        SaveOptions::new(format).preview(Image::new(1, 1, 3, vec![0.5; 3]).unwrap())
    }

    #[test]
    fn a_failing_disk_leaves_the_whole_old_or_the_whole_new_material() {
        let (old, new) = (material(0.25), material(0.75));
        let mut seen = BTreeSet::new();
        for (format, stays) in [MaterialFormat::Exr, MaterialFormat::Tiff].into_iter().zip([false, true]) {
            for at in 0.. {
                let dir = TempDir::new().unwrap();
                old.save(dir.path(), &options(MaterialFormat::Exr)).unwrap();
                let (result, reached) = failing::at(at, stays, || new.save(dir.path(), &options(format)));
                // What a load finds that may write nothing, and one that may.
                let (frozen, _) = failing::at(0, true, || Material::load(dir.path()).unwrap());
                let back = Material::load(dir.path()).unwrap();
                assert_eq!(back, frozen);
                assert!(back.warnings.is_empty(), "step {at}: {:?}", back.warnings);
                assert_eq!(back.diffuse_albedo, if back.patch_size == 0.25 { &old } else { &new }.diffuse_albedo);
                let names = fs::read_dir(dir.path()).unwrap().count();
                assert_eq!(names, 6, "four maps, the picture, the description");
                if !reached {
                    result.unwrap();
                    assert_eq!(back.patch_size, 0.75);
                    break;
                }
                seen.insert((result.is_ok(), back.patch_size == 0.25));
            }
        }
        assert!(seen.contains(&(false, true)) && seen.contains(&(false, false)) && !seen.contains(&(true, true)));
    }
}
