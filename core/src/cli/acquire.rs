//! `svbrdf-gcn acquire`.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::{Args, ValueEnum};
use serde_json::json;

use super::bar::Bar;
use super::{Budget, Millimetres, complain, say, say_json};
use crate::acquire::{AcquireOptions, Report, Sheet, acquire, check_folder};
use crate::cancel::CancelToken;
use crate::error::{Error, Result, printable};
use crate::shot::Shot;

/// How raw photos are read; the same wherever they are.
#[derive(Args)]
pub struct SheetOptions {
    /// The sheet in the photos: that of svbrdf-gcn sheet, or the frame of svbrdf-diff-renderer.
    #[arg(long, value_enum, default_value = "own")]
    sheet: SheetArg,
    /// Width of the window of our own sheet.
    #[arg(long, default_value = "100mm", value_name = "LENGTH", allow_hyphen_values = true)]
    window: Millimetres,
    /// Width of the frame of svbrdf-diff-renderer, from outer edge to outer edge.
    #[arg(long, value_name = "LENGTH", allow_hyphen_values = true)]
    frame_width: Option<Millimetres>,
    /// Length of the sheet's bar of 100 mm as it was printed.
    #[arg(long, default_value = "100mm", value_name = "LENGTH", allow_hyphen_values = true)]
    printed_bar: Millimetres,
    /// How far the sample lies below the sheet's face.
    #[arg(long, default_value = "0mm", value_name = "LENGTH", allow_hyphen_values = true)]
    depth: Millimetres,
    /// Where the flash is, seen from the lens: to the right and up in photos as they were taken, before they were turned upright, in mm; auto: found from the paper.
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true, default_value = "0,0")]
    light_offset: LightOffset,
    /// A photo of the sheet without flash, exposed as the others: what it shows is subtracted.
    #[arg(long, value_name = "PHOTO")]
    dark: Option<PathBuf>,
    /// Diffuse albedo of the paper.
    #[arg(long, default_value_t = 0.8, allow_negative_numbers = true)]
    paper_white: f64,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SheetArg {
    Own,
    Tags16,
}

/// Two numbers, or none where they are to be found.
#[derive(Clone, Copy)]
struct LightOffset(Option<[f64; 2]>);

impl FromStr for LightOffset {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        if text == "auto" {
            return Ok(Self(None));
        }
        let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
        let offset = numbers.and_then(|numbers| <[f64; 2]>::try_from(numbers).ok());
        offset.map(|offset| Self(Some(offset))).ok_or_else(|| format!("expected auto or two numbers x,y, got {text}"))
    }
}

impl SheetOptions {
    pub fn options(
        &self,
        size: Option<usize>,
        max_memory: Option<u64>,
        cancel: &CancelToken,
    ) -> Result<AcquireOptions> {
        let sheet = match (self.sheet, self.frame_width) {
            (SheetArg::Own, None) => Sheet::new(self.window.0)?,
            (SheetArg::Own, Some(_)) => {
                return Err(Error::invalid("frame-width", "is for --sheet tags16; our own sheet has --window"));
            }
            (SheetArg::Tags16, Some(width)) => Sheet::tags16(width.0)?,
            (SheetArg::Tags16, None) => {
                return Err(Error::invalid(
                    "frame-width",
                    "expected the width of the frame for --sheet tags16, got none",
                ));
            }
        };
        let mut options = AcquireOptions::new(sheet.with_printed_bar(self.printed_bar.0)?);
        options.depth = self.depth.0;
        options.size = size;
        options.max_memory = max_memory;
        options.light_offset = self.light_offset.0;
        options.dark = self.dark.clone();
        options.paper_white = self.paper_white;
        options.cancel = cancel.clone();
        Ok(options)
    }
}

#[derive(Args)]
pub struct AcquireArgs {
    /// Photos that show the sample in the window of a printed sheet.
    #[arg(required = true)]
    photos: Vec<PathBuf>,
    /// Folder for the capture.
    #[arg(long, short)]
    out: PathBuf,
    #[command(flatten)]
    sheet: SheetOptions,
    /// Side of the rectified photos in pixels; 1024 if not given. They are never finer than the photos.
    #[arg(long, allow_negative_numbers = true)]
    size: Option<usize>,
    #[command(flatten)]
    budget: Budget,
    /// Print one JSON object instead of text.
    #[arg(long)]
    json: bool,
    /// No summary.
    #[arg(long, short)]
    quiet: bool,
}

pub fn run(args: &AcquireArgs, cancel: &CancelToken) -> Result<()> {
    let options = args.sheet.options(args.size, args.budget.max_memory, cancel)?;
    let mut bar = Bar::new(args.quiet || args.json);
    let (report, shots) = make_capture(&args.photos, &args.out, &options, &mut bar)?;
    for warning in &report.warnings {
        complain(&format!("warning: {}", printable(warning)));
    }
    if args.json {
        say_json(&json!({ "capture": args.out, "report": report }))
    } else if args.quiet {
        Ok(())
    } else {
        say(&format!("{}\n{}", summary(&report, &shots), printable(args.out.display())))
    }
}

/// Makes a capture of raw photos in `folder`.
pub fn make_capture(
    photos: &[PathBuf],
    folder: &Path,
    options: &AcquireOptions,
    bar: &mut Bar,
) -> Result<(Report, Vec<Shot>)> {
    check_folder(folder)?;
    let acquisition = acquire(photos, options, &mut |progress| {
        bar.show(progress);
        ControlFlow::Continue(())
    });
    bar.finish();
    let acquisition = acquisition?;
    acquisition.save_unless(folder, &options.cancel)?;
    let shots = acquisition.capture.photos().iter().map(|photo| photo.shot).collect();
    Ok((acquisition.report, shots))
}

/// A line for each photo.
fn summary(report: &Report, shots: &[Shot]) -> String {
    let head =
        format!("{:<24}{:>5}{:>10}{:>26}{:>24}", "photo", "tags", "off by", "camera in mm", "light in 1000 mm^2");
    let line = |(photo, shot): (&crate::acquire::PhotoReport, &Shot)| {
        let camera = shot.camera.map(|x| format!("{x:.1}")).join(", ");
        let light = shot.light_intensity.map(|x| format!("{:.1}", x / 1000.0)).join(", ");
        format!("{:<24}{:>5}{:>7.2} px{camera:>26}{light:>24}", printable(&photo.photo), photo.tags, photo.tag_error)
    };
    let lines = report.photos.iter().zip(shots).map(line);
    std::iter::once(head).chain(lines).collect::<Vec<_>>().join("\n")
}
