//! `svbrdf-gcn export`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::{Budget, degrees, load_material, say, say_json};
use crate::cancel::CancelToken;
use crate::error::Result;
use crate::export::principled::Loss;
use crate::export::{ExportOptions, ExportReport, ExportTarget, NormalConvention};

#[derive(Args)]
pub struct ExportArgs {
    /// Folder of a material.
    material: PathBuf,
    /// Program to write for.
    #[arg(long, value_enum)]
    to: TargetArg,
    /// Folder for the files and `export.json`.
    #[arg(long, short)]
    out: PathBuf,
    /// What the material is called: letters, digits and underscores, a letter first.
    #[arg(long, default_value = "material")]
    name: String,
    /// Which way green points in normal maps; the target's own convention if not given.
    #[arg(long, value_enum)]
    normals: Option<NormalsArg>,
    /// Keep the tilt of the whole surface, as it lay in the capture.
    #[arg(long)]
    no_level: bool,
    /// Take the tilt of the whole surface out of its normals, so that tiles of it make a plane; the default.
    #[arg(long, conflicts_with = "no_level")]
    level: bool,
    /// Print one JSON object instead of text.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    budget: Budget,
}

#[derive(Clone, Copy, ValueEnum)]
enum TargetArg {
    #[value(name = "materialx")]
    MaterialX,
    Gltf,
    Principled,
    Unreal,
}

#[derive(Clone, Copy, ValueEnum)]
enum NormalsArg {
    #[value(name = "opengl")]
    OpenGl,
    #[value(name = "directx")]
    DirectX,
}

impl ExportArgs {
    fn options(&self) -> ExportOptions {
        let mut options = ExportOptions::new(match self.to {
            TargetArg::MaterialX => ExportTarget::MaterialX,
            TargetArg::Gltf => ExportTarget::Gltf,
            TargetArg::Principled => ExportTarget::Principled,
            TargetArg::Unreal => ExportTarget::Unreal,
        })
        .name(&self.name)
        .level(self.level || !self.no_level);
        options.normals = self.normals.map(|normals| match normals {
            NormalsArg::OpenGl => NormalConvention::OpenGl,
            NormalsArg::DirectX => NormalConvention::DirectX,
        });
        options
    }
}

pub fn run(args: &ExportArgs, cancel: &CancelToken) -> Result<()> {
    let material = load_material(&args.material, &args.budget, cancel)?;
    args.budget.check("exporting", args.options().memory(&material), material.memory())?;
    let report = material.export_unless(&args.out, &args.options(), cancel)?;
    if args.json { say_json(&report) } else { say(&summary(&report)) }
}

fn summary(report: &ExportReport) -> String {
    let mut lines: Vec<String> = report
        .files
        .iter()
        .map(|file| match (file.color_space, file.bits) {
            (Some(space), Some(bits)) => format!("{:<28}{bits:>2} bit {space:<5} {}", file.file, file.holds),
            _ => format!("{:<28}             {}", file.file, file.holds),
        })
        .collect();
    if let Some(ior) = report.ior {
        lines.push(format!("index of refraction to set: {ior:.4}"));
    }
    lines.extend(report.tilt_removed.map(|tilt| format!("taken out: a tilt of {:.1} degrees", degrees(tilt))));
    lines.push(errors("off at normal incidence", &report.loss));
    lines.extend(report.loss_without_extensions.map(|loss| errors("without extensions", &loss)));
    lines.extend(report.lost.iter().map(|line| format!("lost: {line}")));
    lines.join("\n")
}

fn errors(what: &str, loss: &Loss) -> String {
    let Loss { diffuse, specular, .. } = loss;
    format!(
        "{what}: diffuse {:.4} (largest {:.4}), specular {:.4} (largest {:.4})",
        diffuse.mean, diffuse.max, specular.mean, specular.max
    )
}
