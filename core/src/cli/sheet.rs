//! `svbrdf-gcn sheet`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::Millimetres;
use crate::acquire::{Paper, Sheet};
use crate::error::{Error, Result};
use crate::io::save::write_file;

#[derive(Args)]
pub struct SheetArgs {
    /// The sheet: .pdf or .svg.
    #[arg(long, short)]
    out: PathBuf,
    /// Format of the paper.
    #[arg(long, value_enum, default_value = "a4")]
    paper: PaperArg,
    /// Width of the square window that the sample is seen through.
    #[arg(long, default_value = "100mm", value_name = "LENGTH", allow_hyphen_values = true)]
    window: Millimetres,
}

#[derive(Clone, Copy, ValueEnum)]
enum PaperArg {
    A4,
    Letter,
    A3,
}

pub fn run(args: &SheetArgs) -> Result<()> {
    let paper = match args.paper {
        PaperArg::A4 => Paper::A4,
        PaperArg::Letter => Paper::Letter,
        PaperArg::A3 => Paper::A3,
    };
    let sheet = Sheet::new(args.window.0)?;
    let extension = args.out.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let file = match extension.as_str() {
        "pdf" => sheet.to_pdf(paper)?,
        "svg" => sheet.to_svg(paper)?.into_bytes(),
        other => {
            let got = format!("extension {other:?}; written are .pdf and .svg");
            return Err(Error::UnsupportedFormat { name: args.out.display().to_string(), got });
        }
    };
    write_file(&args.out, &file)
}
