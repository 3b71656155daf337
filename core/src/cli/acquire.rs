//! `svbrdf-gcn acquire`.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::{Args, ValueEnum};
use serde_json::json;

use super::bar::Bar;
use super::{Budget, Millimetres, complain, say, say_json};
use crate::acquire::{AcquireOptions, Corners, Report, Sheet, acquire, check_folder};
use crate::cancel::CancelToken;
use crate::error::{Error, Result, printable};
use crate::io::read_file;
use crate::shot::Shot;

/// The window and the bar of the sheet where nothing else is said, in mm.
const SHEET_LENGTH: f64 = 100.0;
/// Diffuse albedo of paper where nothing else is said.
const PAPER_WHITE: f64 = 0.8;

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
    /// There is no sheet: in each photo, in their order, the four corners of the sample's square patch in pixels, x,y,x,y,x,y,x,y from the upper left on clockwise. Or one JSON file: an
    /// object of the photos' names, each with four [x, y].
    #[arg(long, value_name = "X,Y,...|JSON", allow_hyphen_values = true, requires = "patch_width",
        conflicts_with_all = ["sheet", "window", "frame_width", "printed_bar", "depth", "dark", "paper_white"])]
    corners: Vec<CornersArg>,
    /// Width of the patch whose corners are given.
    #[arg(long, value_name = "LENGTH", allow_hyphen_values = true, requires = "corners")]
    patch_width: Option<Millimetres>,
    /// Where the flash is, seen from the lens: to the right and up in photos as they were taken, before they were turned upright, in mm; auto: found from the paper.
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true, default_value = "0,0")]
    light_offset: LightOffset,
    /// A photo of the sheet without flash, exposed as the others: what it shows is subtracted.
    #[arg(long, value_name = "PHOTO")]
    dark: Option<PathBuf>,
    /// Diffuse albedo of the paper.
    #[arg(long, default_value_t = PAPER_WHITE, allow_negative_numbers = true)]
    paper_white: f64,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SheetArg {
    Own,
    Tags16,
}

/// Corners of the patch in one photo, or the file that has those of all.
#[derive(Clone)]
enum CornersArg {
    Photo([[f64; 2]; 4]),
    File(PathBuf),
}

impl FromStr for CornersArg {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
        match numbers.map(<[f64; 8]>::try_from) {
            Some(Ok([a, b, c, d, e, f, g, h])) => Ok(Self::Photo([[a, b], [c, d], [e, f], [g, h]])),
            Some(Err(numbers)) => {
                Err(format!("expected eight numbers x,y,x,y,x,y,x,y or a JSON file, got {} numbers", numbers.len()))
            }
            None => Ok(Self::File(text.into())),
        }
    }
}

/// Corners by the names of photos.
type CornersByName = BTreeMap<String, [[f64; 2]; 4]>;

/// The largest file of corners, in bytes.
const MAX_CORNERS_BYTES: u64 = 1 << 20;

/// The corners of `photos` in a JSON file.
fn corners_in(file: &Path, photos: &[PathBuf]) -> Result<Vec<[[f64; 2]; 4]>> {
    let wrong = |reason: String| Error::invalid("corners", format!("{}: {reason}", file.display()));
    let bytes = read_file(file, MAX_CORNERS_BYTES)?;
    let by_name: CornersByName = serde_json::from_slice(&bytes)
        .map_err(|error| wrong(format!("expected an object of photos' names with four [x, y] each: {error}")))?;
    let of = |photo: &PathBuf| {
        let name = photo.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let names = || by_name.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
        by_name
            .get(&name)
            .copied()
            .ok_or_else(|| wrong(format!("expected corners of {name}, got those of {}", names())))
    };
    photos.iter().map(of).collect()
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
    /// Whether the patch's corners are given in place of a sheet.
    pub fn has_corners(&self) -> bool {
        !self.corners.is_empty()
    }

    /// An option that is not at its default.
    pub fn given(&self) -> Option<&'static str> {
        let options = [
            ("sheet", self.sheet != SheetArg::Own),
            ("window", self.window.0 != SHEET_LENGTH),
            ("frame-width", self.frame_width.is_some()),
            ("printed-bar", self.printed_bar.0 != SHEET_LENGTH),
            ("depth", self.depth.0 != 0.0),
            ("corners", self.has_corners()),
            ("light-offset", self.light_offset.0 != Some([0.0; 2])),
            ("dark", self.dark.is_some()),
            ("paper-white", self.paper_white != PAPER_WHITE),
        ];
        options.into_iter().find_map(|(name, given)| given.then_some(name))
    }

    pub fn options(
        &self,
        photos: &[PathBuf],
        size: Option<usize>,
        max_memory: Option<u64>,
        cancel: &CancelToken,
    ) -> Result<AcquireOptions> {
        let mut options = match self.patch_width {
            Some(Millimetres(width)) => AcquireOptions::of_corners(Corners::new(width, self.corners(photos)?)?),
            None => AcquireOptions::new(self.sheet()?.with_printed_bar(self.printed_bar.0)?),
        };
        options.depth = self.depth.0;
        options.size = size;
        options.max_memory = max_memory;
        options.light_offset = self.light_offset.0;
        options.dark = self.dark.clone();
        options.paper_white = self.paper_white;
        options.cancel = cancel.clone();
        Ok(options)
    }

    /// Of each photo.
    fn corners(&self, photos: &[PathBuf]) -> Result<Vec<[[f64; 2]; 4]>> {
        if let [CornersArg::File(file)] = self.corners.as_slice() {
            return corners_in(file, photos);
        }
        let one = |corners: &CornersArg| match corners {
            CornersArg::Photo(corners) => Ok(*corners),
            CornersArg::File(file) => {
                let got = format!("expected eight numbers for each photo or one JSON file, got {}", file.display());
                Err(Error::invalid("corners", got))
            }
        };
        self.corners.iter().map(one).collect()
    }

    fn sheet(&self) -> Result<Sheet> {
        match (self.sheet, self.frame_width) {
            (SheetArg::Own, None) => Sheet::new(self.window.0),
            (SheetArg::Own, Some(_)) => {
                Err(Error::invalid("frame-width", "is for --sheet tags16; our own sheet has --window"))
            }
            (SheetArg::Tags16, Some(width)) => Sheet::tags16(width.0),
            (SheetArg::Tags16, None) => {
                Err(Error::invalid("frame-width", "expected the width of the frame for --sheet tags16, got none"))
            }
        }
    }
}

#[derive(Args)]
pub struct AcquireArgs {
    /// Photos that show the sample in the window of a printed sheet, or of which --corners are known.
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
    let options = args.sheet.options(&args.photos, args.size, args.budget.max_memory, cancel)?;
    let mut bar = Bar::new(args.quiet || args.json);
    let (report, shots) = make_capture(&args.photos, &args.out, &options, &mut bar)?;
    remark(&report);
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

/// What was assumed, and what a user should know.
pub fn remark(report: &Report) {
    for assumption in &report.assumptions {
        complain(&format!("assumed: {}", printable(assumption)));
    }
    for warning in &report.warnings {
        complain(&format!("warning: {}", printable(warning)));
    }
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
