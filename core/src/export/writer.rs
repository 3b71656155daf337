//! The files of an export, collected and then written together.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{Content, ExportReport, ExportTarget, ExportedFile, NormalConvention};
use crate::color::Transfer;
use crate::error::{Error, Result};
use crate::image::Image;
use crate::io::save::write_files;
use crate::io::{png8, png16};
use crate::material::Material;

/// The file that describes an export.
const EXPORT_JSON: &str = "export.json";

pub struct Writer<'a> {
    folder: &'a Path,
    name: &'a str,
    normals: NormalConvention,
    files: Vec<(PathBuf, Vec<u8>)>,
    entries: Vec<ExportedFile>,
}

impl<'a> Writer<'a> {
    pub fn new(folder: &'a Path, name: &'a str, normals: NormalConvention) -> Self {
        Self { folder, name, normals, files: Vec::new(), entries: Vec::new() }
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
        let data = stored.flat_map(|[x, y, z]| [x, &(up * y), z].map(|v| (v + 1.0) / 2.0)).collect();
        let holds = format!("{holds}, {}", self.normals.name());
        self.data(stem, bits, &Image::new(image.width(), image.height(), 3, data)?, &holds)
    }

    fn png(&mut self, stem: &str, bits: u8, image: &Image, transfer: Transfer, holds: &str) -> Result<String> {
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
        self.files.push((self.folder.join(file), bytes));
        self.entries.push(ExportedFile { file: file.to_owned(), holds: holds.to_owned(), color_space, bits });
    }

    /// Writes everything, `export.json` last.
    pub fn finish(mut self, material: &Material, target: ExportTarget, content: Content) -> Result<ExportReport> {
        #[derive(Serialize)]
        struct Sidecar<'a> {
            format: &'static str,
            version: u64,
            written_by: &'static str,
            name: &'a str,
            width: usize,
            height: usize,
            patch_size: f64,
            #[serde(flatten)]
            report: &'a ExportReport,
        }
        let Content { ior, loss, loss_without_extensions, lost } = content;
        let (normals, files) = (self.normals, self.entries);
        let report = ExportReport { target, normals, files, ior, loss, loss_without_extensions, lost };
        let sidecar = Sidecar {
            format: "svbrdf-gcn export",
            version: 1,
            written_by: concat!("svbrdf-gcn ", env!("CARGO_PKG_VERSION")),
            name: self.name,
            width: material.width(),
            height: material.height(),
            patch_size: material.patch_size,
            report: &report,
        };
        let path = self.folder.join(EXPORT_JSON);
        let mut text = serde_json::to_vec_pretty(&sidecar).map_err(|e| Error::io(&path, e))?;
        text.push(b'\n');
        self.files.push((path, text));
        std::fs::create_dir_all(self.folder).map_err(|e| Error::io(self.folder, e))?;
        write_files(&self.files)?;
        Ok(report)
    }
}
