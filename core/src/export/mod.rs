//! Materials for other programs: MaterialX (OpenPBR), glTF, Blender's Principled BSDF and Unreal. `docs/exports.md` describes the files.
//!
//! None of them has a diffuse and a specular albedo: [`principled`] finds base colour, metallic and a dielectric part that reflect the same at normal incidence,
//! as far as the target can, and measures what is lost.

mod gltf;
mod materialx;
pub mod principled;
mod unreal;
mod writer;

use std::path::Path;

use serde::Serialize;

use crate::cancel::CancelToken;
use crate::error::{Error, Result};
use crate::material::Material;
#[cfg(feature = "cli")]
use crate::memory;
use principled::{Loss, Principled};
use writer::Writer;

/// The program a material is exported for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum ExportTarget {
    /// A `.mtlx` document with an OpenPBR surface, and 16-bit PNGs.
    MaterialX,
    /// A `.gltf` with a plane to look at, KHR_materials_specular, and 8-bit PNGs.
    Gltf,
    /// The maps of Blender's Principled BSDF as 16-bit PNGs.
    Principled,
    /// Base colour, occlusion-roughness-metallic, specular and normal as PNGs for Unreal.
    Unreal,
}

impl ExportTarget {
    /// All targets.
    pub const ALL: [Self; 4] = [Self::MaterialX, Self::Gltf, Self::Principled, Self::Unreal];

    /// The name on the command line and in files: `materialx`, `gltf`, `principled` or `unreal`.
    pub fn name(self) -> &'static str {
        match self {
            Self::MaterialX => "materialx",
            Self::Gltf => "gltf",
            Self::Principled => "principled",
            Self::Unreal => "unreal",
        }
    }

    /// The inverse of [`ExportTarget::name`].
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|target| target.name() == name)
    }

    /// The convention that the target has by itself.
    pub fn normals(self) -> NormalConvention {
        match self {
            Self::Unreal => NormalConvention::DirectX,
            Self::MaterialX | Self::Gltf | Self::Principled => NormalConvention::OpenGl,
        }
    }
}

/// Which way green points in normal (and tangent) maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum NormalConvention {
    /// Up: +y.
    OpenGl,
    /// Down: -y.
    DirectX,
}

impl NormalConvention {
    /// The name on the command line and in files: `opengl` or `directx`.
    pub fn name(self) -> &'static str {
        match self {
            Self::OpenGl => "opengl",
            Self::DirectX => "directx",
        }
    }

    /// The inverse of [`NormalConvention::name`].
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::OpenGl, Self::DirectX].into_iter().find(|convention| convention.name() == name)
    }
}

/// How a material is exported.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ExportOptions {
    /// The program it is for.
    pub target: ExportTarget,
    /// What the material is called in the files and in their names: letters, digits and underscores, a letter first.
    pub name: String,
    /// Which way green points in normal maps; the target's own convention if `None`.
    pub normals: Option<NormalConvention>,
    /// Whether the tilt of the whole surface is taken out ([`Material::leveled`]), so that tiles of it make a plane.
    pub level: bool,
}

impl ExportOptions {
    /// A level material called `material`, in the target's own conventions.
    pub fn new(target: ExportTarget) -> Self {
        Self { target, name: "material".to_owned(), normals: None, level: true }
    }

    /// Sets [`ExportOptions::name`].
    #[must_use]
    pub fn name(mut self, name: impl Into<String>) -> Self {
        self.name = name.into();
        self
    }

    /// Sets [`ExportOptions::normals`].
    #[must_use]
    pub fn normals(mut self, normals: NormalConvention) -> Self {
        self.normals = Some(normals);
        self
    }

    /// Sets [`ExportOptions::level`].
    #[must_use]
    pub fn level(mut self, level: bool) -> Self {
        self.level = level;
        self
    }

    /// Estimated bytes that an export of `material` takes at its peak, those of its maps included.
    #[cfg(feature = "cli")]
    pub(crate) fn memory(&self, material: &Material) -> u64 {
        // Beside the maps and the maps limited to their ranges, as measured (core/tests/memory.rs): what the target has in their place, one of its images
        // in the making, and the files so far.
        let pixel = match self.target {
            ExportTarget::Gltf => 192,
            ExportTarget::Principled => 188,
            ExportTarget::MaterialX | ExportTarget::Unreal => 148,
        };
        let pixel = if material.tangent.is_some() { pixel * 5 / 4 } else { pixel };
        2 * material.memory() + pixel * (material.width() * material.height()) as u64 + memory::SMALL
    }

    fn check(&self) -> Result<NormalConvention> {
        let mut characters = self.name.chars();
        let starts = characters.next().is_some_and(|first| first.is_ascii_alphabetic());
        if !starts || !characters.all(|c| c.is_ascii_alphanumeric() || c == '_') || self.name.len() > 64 {
            let reason =
                format!("expected up to 64 letters, digits and underscores, a letter first, got {:?}", self.name);
            return Err(Error::invalid("name", reason));
        }
        let normals = self.normals.unwrap_or(self.target.normals());
        if normals == NormalConvention::DirectX && matches!(self.target, ExportTarget::MaterialX | ExportTarget::Gltf) {
            let reason = format!("{} defines normal maps as opengl, got directx", self.target.name());
            return Err(Error::invalid("normals", reason));
        }
        Ok(normals)
    }
}

/// One written file.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ExportedFile {
    /// Its name in the folder.
    pub file: String,
    /// What it holds, channel by channel.
    pub holds: String,
    /// Of an image: `srgb` (Rec. 709 primaries, sRGB curve) or `data` (numbers as they are: "Non-Color", "Raw", sRGB off).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub color_space: Option<&'static str>,
    /// Of an image: bits per channel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bits: Option<u8>,
}

/// What an export wrote, and what it could not keep.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ExportReport {
    /// The program it is for.
    pub target: ExportTarget,
    /// Which way green points in normal maps.
    pub normals: NormalConvention,
    /// The tilt that was taken out: mean slopes towards +x and +y.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tilt_removed: Option<[f64; 2]>,
    /// The files, `export.json` (this report) not among them.
    pub files: Vec<ExportedFile>,
    /// Index of refraction to set, where the target has one number for it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ior: Option<f64>,
    /// How far reflectances at normal incidence are from the material's, before the rounding of the files.
    pub loss: Loss,
    /// Likewise in a glTF viewer that does not know KHR_materials_specular.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub loss_without_extensions: Option<Loss>,
    /// What the target cannot hold of this material, in words.
    pub lost: Vec<String>,
}

impl Material {
    /// Writes the material for another program to a folder, which is made if it is not there, with a report in `export.json`.
    ///
    /// An export of the same name for the same program is replaced as a whole, as [`Material::save`] does it. Other exports in the folder stay.
    ///
    /// # Errors
    /// As [`Material::to_maps`]; [`Error::InvalidArgument`] for a name that is no identifier, or DirectX normals for MaterialX and
    /// glTF, which define theirs, and for a file in the folder that no export wrote or that another export uses; [`Error::Io`] if a file cannot be written.
    ///
    /// # Example
    /// ```no_run
    /// use svbrdf_gcn::{ExportOptions, ExportTarget, Material};
    ///
    /// let material = Material::load("my-material")?;
    /// let report = material.export("my-material-unreal", &ExportOptions::new(ExportTarget::Unreal).name("Wood"))?;
    /// println!("F0 off by {} on average; {:?}", report.loss.specular.mean, report.lost);
    /// # Ok::<(), svbrdf_gcn::Error>(())
    /// ```
    pub fn export(&self, folder: impl AsRef<Path>, options: &ExportOptions) -> Result<ExportReport> {
        self.export_unless(folder.as_ref(), options, &CancelToken::new())
    }

    /// [`Material::export`], given up if `cancel` is cancelled before files are about to take their places.
    ///
    /// # Errors
    /// As [`Material::export`]; [`Error::Cancelled`], and nothing has changed.
    pub(crate) fn export_unless(
        &self,
        folder: &Path,
        options: &ExportOptions,
        cancel: &CancelToken,
    ) -> Result<ExportReport> {
        let normals = options.check()?;
        let material = if options.level { self.leveled()? } else { self.limited()? };
        let mut writer = Writer::new(folder, &options.name, normals, cancel);
        let content = match options.target {
            ExportTarget::MaterialX => materialx::write(&material, &mut writer)?,
            ExportTarget::Gltf => gltf::write(&material, &mut writer)?,
            ExportTarget::Principled => write_principled(&material, &mut writer)?,
            ExportTarget::Unreal => unreal::write(&material, &mut writer)?,
        };
        writer.finish(&material, options.target, options.level.then(|| self.tilt()), content)
    }
}

/// What a target's module says about the files it has written.
struct Content {
    ior: Option<f64>,
    loss: Loss,
    loss_without_extensions: Option<Loss>,
    lost: Vec<String>,
}

impl Content {
    fn new(loss: Loss) -> Self {
        Self { ior: None, loss, loss_without_extensions: None, lost: Vec::new() }
    }
}

fn write_principled(material: &Material, writer: &mut Writer<'_>) -> Result<Content> {
    let maps = Principled::from_material(material)?;
    writer.color("base_color", 16, &maps.base_color, "Base Color")?;
    writer.data("metallic", 16, &maps.metallic, "Metallic")?;
    writer.data("roughness", 16, &maps.roughness, "Roughness")?;
    writer.data("specular_level", 16, &maps.specular_level, "Specular IOR Level")?;
    writer.color("specular_tint", 16, &maps.specular_tint, "Specular Tint")?;
    writer.vectors("normal", 16, &maps.normal, "(n + 1) / 2")?;
    let mut content = Content { ior: Some(maps.ior), ..Content::new(maps.loss) };
    if let Some(anisotropy) = &maps.anisotropy {
        writer.data("anisotropic", 16, &anisotropy.amount, "Anisotropic")?;
        writer.data("anisotropic_rotation", 16, &anisotropy.rotation, "Anisotropic Rotation: turns")?;
        content.lost.push(
            "anisotropic_rotation is an angle: read it with Closest, interpolation is wrong where it jumps from 0.5 to 0"
                .to_owned(),
        );
        if anisotropy.largest_ratio > 10.0 {
            let ratio = anisotropy.largest_ratio;
            content.lost.push(format!("anisotropy: ratios of alpha up to {ratio:.1} are limited to 10"));
        }
    }
    Ok(content)
}
