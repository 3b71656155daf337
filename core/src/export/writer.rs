//! The files of an export, collected and then written together.

use std::collections::BTreeSet;
use std::path::Path;

use serde::Serialize;
use serde_json::Value;

use super::{Content, ExportReport, ExportTarget, ExportedFile, NormalConvention};
use crate::cancel::CancelToken;
use crate::color::Transfer;
use crate::error::{Error, Result};
use crate::image::Image;
use crate::io::ours::{self, Description, names_in, says_ours};
use crate::io::save::{Saving, is_plain};
use crate::io::{MAX_DECODED_BYTES, png8, png16, read_file};
use crate::material::Material;
use crate::memory;
use crate::unit::Unit;

pub struct Writer<'a> {
    folder: &'a Path,
    name: &'a str,
    normals: NormalConvention,
    cancel: &'a CancelToken,
    files: Vec<(String, Vec<u8>)>,
    entries: Vec<ExportedFile>,
}

impl<'a> Writer<'a> {
    pub fn new(folder: &'a Path, name: &'a str, normals: NormalConvention, cancel: &'a CancelToken) -> Self {
        Self { folder, name, normals, cancel, files: Vec::new(), entries: Vec::new() }
    }

    /// What the material is called.
    pub fn name(&self) -> &'a str {
        self.name
    }

    /// A PNG of linear Rec. 709 colours, sRGB-encoded. Returns the file's name.
    pub fn color(&mut self, stem: &str, bits: u8, image: &Image, holds: &str) -> Result<String> {
        self.png(stem, bits, image, Transfer::Srgb, holds)
    }

    /// A PNG of numbers in [0, 1]. Returns the file's name.
    pub fn data(&mut self, stem: &str, bits: u8, image: &Image, holds: &str) -> Result<String> {
        self.png(stem, bits, image, Transfer::Linear, holds)
    }

    /// A PNG of unit vectors, (v + 1) / 2, green as the convention has it. Returns the file's name.
    pub fn vectors(&mut self, stem: &str, bits: u8, image: &Image, holds: &str) -> Result<String> {
        let up = match self.normals {
            NormalConvention::OpenGl => 1.0,
            NormalConvention::DirectX => -1.0,
        };
        let stored = image.data().as_chunks::<3>().0.iter();
        let values = stored.flat_map(|[x, y, z]| [x, &(up * y), z].map(|v| (v + 1.0) / 2.0));
        let data = memory::collected(image.data().len(), values)?;
        let holds = format!("{holds}, {}", self.normals.name());
        self.data(stem, bits, &Image::new(image.width(), image.height(), 3, data)?, &holds)
    }

    fn png(&mut self, stem: &str, bits: u8, image: &Image, transfer: Transfer, holds: &str) -> Result<String> {
        self.cancel.check()?;
        let file = format!("{stem}.png");
        let path = self.folder.join(&file);
        let bytes = if bits == 16 { png16(&path, image, transfer)? } else { png8(&path, image, transfer)? };
        let color_space = if transfer == Transfer::Srgb { "srgb" } else { "data" };
        self.push(&file, bytes, holds, Some(color_space), Some(bits));
        Ok(file)
    }

    /// Any other file.
    pub fn other(&mut self, file: &str, bytes: Vec<u8>, holds: &str) {
        self.push(file, bytes, holds, None, None);
    }

    fn push(&mut self, file: &str, bytes: Vec<u8>, holds: &str, color_space: Option<&'static str>, bits: Option<u8>) {
        self.files.push((file.to_owned(), bytes));
        self.entries.push(ExportedFile { file: file.to_owned(), holds: holds.to_owned(), color_space, bits });
    }

    /// Writes everything, with `export.json`, in the place of an export of the same name for the same target.
    pub fn finish(
        mut self,
        material: &Material,
        target: ExportTarget,
        tilt_removed: Option<[f64; 2]>,
        content: Content,
    ) -> Result<ExportReport> {
        #[derive(Serialize)]
        struct Sidecar<'a> {
            format: &'static str,
            version: u64,
            written_by: &'static str,
            name: &'a str,
            width: usize,
            height: usize,
            patch_size: f64,
            #[serde(skip_serializing_if = "Option::is_none")]
            unit: Option<&'a Unit>,
            #[serde(flatten)]
            report: &'a ExportReport,
            #[serde(skip_serializing_if = "BTreeSet::is_empty")]
            earlier: BTreeSet<String>,
        }
        let Content { ior, loss, loss_without_extensions, lost } = content;
        let (normals, files) = (self.normals, self.entries);
        let report = ExportReport { target, normals, tilt_removed, files, ior, loss, loss_without_extensions, lost };

        let saving = Saving::begin(self.folder, self.cancel)?;
        let own = Description::Export.file();
        ours::check(self.folder, Description::Export, self.files.iter().map(|(name, _)| name.as_str()).chain([own]))?;
        let former = Former::read(self.folder, target, self.name);
        former.check(self.folder, &self.files)?;
        let sidecar = Sidecar {
            format: Description::Export.format(),
            version: 1,
            written_by: concat!("svbrdf-gcn ", env!("CARGO_PKG_VERSION")),
            name: self.name,
            width: material.width(),
            height: material.height(),
            patch_size: material.patch_size,
            unit: material.unit.as_ref(),
            report: &report,
            earlier: former.others,
        };
        let mut text = serde_json::to_vec_pretty(&sidecar).map_err(|e| Error::io(&self.folder.join(own), e))?;
        text.push(b'\n');
        let is_written = |name: &String| self.files.iter().any(|(file, _)| file == name);
        let replaced = former.same.into_iter().filter(|name| !is_written(name)).collect();
        self.files.push((own.to_owned(), text));
        saving.replace(&self.files, replaced)?;
        Ok(report)
    }
}

/// The files of the exports that a folder holds.
#[derive(Default)]
struct Former {
    /// Images of an export of the same name for the same target, which is replaced.
    same: BTreeSet<String>,
    /// What other exports consist of. Their documents show these images: they stay what they are.
    others: BTreeSet<String>,
}

impl Former {
    fn read(folder: &Path, target: ExportTarget, name: &str) -> Self {
        let Some(value) = Description::Export.read(folder) else { return Self::default() };
        let field = |key: &str| value.get(key).and_then(Value::as_str);
        let mut others = names_in(&value, "earlier");
        let mut same = names_in(&value, "files");
        if (field("target"), field("name")) != (Some(target.name()), Some(name)) {
            others.append(&mut same);
        }
        others.retain(|name| is_plain(name) && folder.join(name).exists());
        same.retain(|name| is_plain(name) && !others.contains(name) && says_ours(&folder.join(name)));
        Self { same, others }
    }

    /// # Errors
    /// [`Error::InvalidArgument`] naming the file of another export that would change.
    fn check(&self, folder: &Path, files: &[(String, Vec<u8>)]) -> Result<()> {
        for (name, bytes) in files.iter().filter(|(name, _)| self.others.contains(name)) {
            let path = folder.join(name);
            if read_file(&path, MAX_DECODED_BYTES)? != *bytes {
                let reason = "another export in this folder uses this file, so it is not replaced; choose another folder, or remove that export";
                return Err(Error::invalid(path.display().to_string(), reason));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::fs;

    use tempfile::TempDir;

    use super::*;
    use crate::export::ExportOptions;
    use crate::io::save::{Files, failing, read_whole};
    use crate::maps::{Lobe, Maps};

    fn material(lobe: Lobe, value: f32) -> Material {
        Material::from_maps(&Maps::new(lobe, 2, 2, vec![value; 4 * lobe.planes()]).unwrap(), 1.0).unwrap()
    }

    fn content(folder: &Path) -> BTreeMap<String, Vec<u8>> {
        let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
        entries.map(|entry| (entry.file_name().into_string().unwrap(), fs::read(entry.path()).unwrap())).collect()
    }

    #[test]
    fn a_failing_disk_leaves_the_whole_old_or_the_whole_new_export() {
        let options = ExportOptions::new(ExportTarget::Gltf);
        let (old, new) = (material(Lobe::Anisotropic, 0.25), material(Lobe::Isotropic, 0.75));
        let whole = |material: &Material| {
            let dir = TempDir::new().unwrap();
            material.export(dir.path(), &options).unwrap();
            content(dir.path())
        };
        let (whole_old, whole_new) = (whole(&old), whole(&new));
        let mut seen = BTreeSet::new();
        for at in 0.. {
            let dir = TempDir::new().unwrap();
            old.export(dir.path(), &options).unwrap();
            let (result, reached) = failing::at(at, true, || new.export(dir.path(), &options));
            // Whoever comes next in this folder finishes it or clears it away.
            read_whole(dir.path(), Description::Export.file(), 1 << 20, &CancelToken::new(), |_: &Files<'_>| Ok(()))
                .unwrap();
            let found = content(dir.path());
            assert!(found == whole_old || found == whole_new, "step {at}: {:?}", found.keys());
            if !reached {
                result.unwrap();
                assert!(found == whole_new);
                break;
            }
            seen.insert(found == whole_old);
        }
        assert_eq!(seen.len(), 2);
    }
}
