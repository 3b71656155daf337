//! The command line, as a library function so that every package can offer it.

mod acquire;
mod bar;
mod evaluate;
mod export;
mod fit;
mod info;
mod outputs;
mod preview;
mod render;
mod sheet;
mod train;

use std::ffi::OsString;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::cancel::CancelToken;
use crate::capture::{Capture, CaptureOptions};
use crate::color::{ColorSpace, Transfer};
use crate::error::{Error, Result, printable};
use crate::io::describe::{describe, is_image};
use crate::io::material::{LoadOptions, MATERIAL_JSON};
use crate::material::Material;
use crate::memory::{self, parse_bytes};

/// Material maps from flash photos.
#[derive(Parser)]
#[command(name = "svbrdf-gcn", version, about, after_help = EXIT_CODES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Log what happens on standard error.
    #[arg(long, short, global = true)]
    verbose: bool,
}

const EXIT_CODES: &str = "Exit codes: 0 done, 2 bad arguments or capture, 3 a file cannot be read or written, \
4 weights, 5 values that are not finite, 6 not enough memory, 130 cancelled.";

#[derive(Subcommand)]
enum Command {
    /// Write a sheet to print: its tags around the sample tell where photos were taken from.
    Sheet(sheet::SheetArgs),
    /// Make a capture of photos that show the sample in the window of a printed sheet.
    Acquire(acquire::AcquireArgs),
    /// Fit a material to a capture.
    Fit(fit::FitArgs),
    /// Render a material from a camera and a light position.
    Render(render::RenderArgs),
    /// Compare re-renderings of a material with photos that the fit did not use.
    Evaluate(evaluate::EvaluateArgs),
    /// Write a material for MaterialX, glTF, Blender or Unreal.
    Export(export::ExportArgs),
    /// Tell what a weights file or a material folder holds.
    Info(info::InfoArgs),
    /// Train a network on your own materials, with the Python package and PyTorch.
    Train(train::TrainArgs),
}

/// How a capture is read; the same for every command that takes one.
#[derive(Args)]
struct CaptureArgs {
    /// Folder of a capture, or its JSON file; or one photo, taken from straight above with the flash. `fit` takes several photos of a sheet, too.
    capture: PathBuf,
    /// More photos, that show the sample in the window of a printed sheet (fit only).
    more: Vec<PathBuf>,
    /// Photos to take, counted from 0: 0,2,5.
    #[arg(long, value_delimiter = ',', value_name = "I,J,...", allow_hyphen_values = true)]
    views: Option<Vec<usize>>,
    /// Light intensity of every photo, one number or three, instead of what the capture states or what is chosen for one photo: a white diffuse patch
    /// at distance r has the radiance intensity / (pi r^2).
    #[arg(long, value_name = "R,G,B", allow_hyphen_values = true)]
    light_intensity: Option<Intensity>,
    /// Transfer function of the photos, instead of what the capture states.
    #[arg(long)]
    transfer: Option<TransferArg>,
    /// Colour space of linear photos and of their light, instead of what the capture states; `fit` also writes the albedos in it.
    #[arg(long, value_enum)]
    color_space: Option<ColorSpaceArg>,
    /// Read photos as if their files held no colour profiles.
    #[arg(long)]
    ignore_profiles: bool,
    #[command(flatten)]
    budget: Budget,
}

/// What a command may use.
#[derive(Args)]
struct Budget {
    /// Most bytes the run may use, reading included, such as 4000000000, 500M or 2G; three quarters of the free memory if not given.
    #[arg(long, value_parser = parse_bytes, value_name = "BYTES", allow_negative_numbers = true)]
    max_memory: Option<u64>,
}

impl Budget {
    /// # Errors
    /// [`Error::OutOfMemory`] if `what` needs more in all than is allowed; `in_use` bytes of it are taken already.
    fn check(&self, what: &str, needed: u64, in_use: u64) -> Result<()> {
        memory::check(what, needed, memory::allowed(self.max_memory, in_use))
    }
}

impl CaptureArgs {
    /// The one capture that was given.
    fn path(&self) -> Result<&Path> {
        if let Some(second) = self.more.first() {
            let reason = format!(
                "expected one folder or JSON file, or one photo, got {}: {} ({}), {} ({}){}; several photos need a capture, which says where camera and light stood for each, see docs/captures.md; photos of a printed sheet, or with corners, become one, see docs/capturing.md",
                self.more.len() + 1,
                self.capture.display(),
                describe(&self.capture),
                second.display(),
                describe(second),
                if self.more.len() > 1 { " ..." } else { "" },
            );
            return Err(Error::invalid("capture", reason));
        }
        Ok(&self.capture)
    }

    /// The photos, if several were given, or one or more whose corners are known.
    fn photos(&self, has_corners: bool) -> Option<Vec<PathBuf>> {
        let all: Vec<PathBuf> = std::iter::once(&self.capture).chain(&self.more).cloned().collect();
        ((all.len() > 1 || has_corners) && all.iter().all(|path| is_image(path))).then_some(all)
    }

    /// The capture, beside `in_use` bytes of the budget.
    fn open(&self, size: Option<usize>, in_use: u64, cancel: &CancelToken) -> Result<Capture> {
        Capture::open_with(self.path()?, &self.options(size).in_use(in_use).cancel(cancel.clone()))
    }

    fn options(&self, size: Option<usize>) -> CaptureOptions {
        let mut options = CaptureOptions::new();
        options.size = size;
        options.views.clone_from(&self.views);
        options.light_intensity = self.light_intensity.map(|intensity| intensity.0);
        options.transfer = self.transfer.map(Transfer::from);
        options.color_space = self.color_space.map(ColorSpace::from);
        options.ignore_profiles = self.ignore_profiles;
        options.max_memory = self.budget.max_memory;
        options
    }
}

#[derive(Clone, Copy, ValueEnum)]
enum TransferArg {
    #[value(name = "gamma2.2")]
    Gamma22,
    Srgb,
    Linear,
}

impl From<TransferArg> for Transfer {
    fn from(transfer: TransferArg) -> Self {
        match transfer {
            TransferArg::Gamma22 => Self::Gamma22,
            TransferArg::Srgb => Self::Srgb,
            TransferArg::Linear => Self::Linear,
        }
    }
}

#[derive(Clone, Copy, ValueEnum)]
enum ColorSpaceArg {
    Rec709,
    #[value(name = "acescg")]
    AcesCg,
}

impl From<ColorSpaceArg> for ColorSpace {
    fn from(color_space: ColorSpaceArg) -> Self {
        match color_space {
            ColorSpaceArg::Rec709 => Self::Rec709,
            ColorSpaceArg::AcesCg => Self::AcesCg,
        }
    }
}

/// Three numbers separated by commas.
#[derive(Clone, Copy)]
struct Triple([f64; 3]);

impl std::str::FromStr for Triple {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let values: Vec<f64> = text
            .split(',')
            .map(|part| part.trim().parse().map_err(|_| format!("expected three numbers x,y,z, got {part:?}")))
            .collect::<std::result::Result<_, _>>()?;
        let found = values.len();
        values.try_into().map(Self).map_err(|_| format!("expected three numbers x,y,z, got {found}"))
    }
}

/// Intensity of a light: one number for all channels, or three.
#[derive(Clone, Copy)]
struct Intensity([f64; 3]);

impl std::str::FromStr for Intensity {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match text.trim().parse() {
            Ok(value) => Ok(Self([value; 3])),
            Err(_) => text
                .parse()
                .map(|Triple(values)| Self(values))
                .map_err(|_| format!("expected one number or three r,g,b, got {text:?}")),
        }
    }
}

/// A length with its unit, millimetres without one.
#[derive(Clone, Copy)]
struct Millimetres(f64);

impl std::str::FromStr for Millimetres {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let text = text.trim();
        let units = [("mm", 1.0), ("cm", 10.0), ("m", 1000.0), ("in", 25.4)];
        let unit = units.into_iter().find_map(|(name, size)| text.strip_suffix(name).map(|number| (number, size)));
        let (number, size) = unit.unwrap_or((text, 1.0));
        match number.trim().parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(Self(value * size)),
            _ => Err(format!("expected a length in mm, cm, m or in, such as 100mm, got {text:?}")),
        }
    }
}

/// Runs the command line with `arguments` (the program's name first) and returns its exit code.
///
/// Results go to standard output, progress, warnings and one-line errors to standard error.
pub fn main(arguments: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> i32 {
    let arguments: Vec<OsString> = arguments.into_iter().map(Into::into).collect();
    let cli = match Cli::try_parse_from(&arguments) {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version go to standard output, errors to standard error; a closed pipe is nobody's loss. What the parser repeats of
            // the arguments may be names of files.
            let shown = arguments.iter().map(|argument| printable(argument.display()));
            let error = Cli::try_parse_from(shown).err().unwrap_or(error);
            drop(error.print());
            return error.exit_code();
        }
    };
    if cli.verbose {
        // A host may have set a subscriber of its own; it keeps it.
        drop(tracing_subscriber::fmt().with_writer(std::io::stderr).with_max_level(tracing::Level::DEBUG).try_init());
    }
    let cancel = CancelToken::new();
    let on_interrupt = cancel.clone();
    // A host that has its own handler keeps it.
    drop(ctrlc::set_handler(move || on_interrupt.cancel()));
    let result = match cli.command {
        Command::Sheet(args) => sheet::run(&args),
        Command::Acquire(args) => acquire::run(&args, &cancel),
        Command::Fit(args) => fit::run(&args, &cancel),
        Command::Render(args) => render::run(&args, &cancel),
        Command::Evaluate(args) => evaluate::run(&args, &cancel),
        Command::Export(args) => export::run(&args, &cancel),
        Command::Info(args) => info::run(&args, &cancel),
        Command::Train(args) => {
            return train::run(&args).unwrap_or_else(|error| {
                complain(&format!("error: {error}"));
                exit_code(&error)
            });
        }
    };
    match result {
        Ok(()) => 0,
        Err(error) => {
            complain(&format!("error: {error}"));
            exit_code(&error)
        }
    }
}

fn exit_code(error: &Error) -> i32 {
    match error {
        Error::InvalidArgument { .. } | Error::ShapeMismatch { .. } => 2,
        Error::Io { .. } | Error::UnsupportedFormat { .. } => 3,
        Error::Weights { .. } => 4,
        Error::NonFinite { .. } => 5,
        Error::OutOfMemory { .. } => 6,
        Error::Cancelled => 130,
    }
}

/// A material folder, with what there is to say about how it was read, or about what is there instead.
fn load_material(folder: &Path, budget: &Budget, cancel: &CancelToken) -> Result<Material> {
    let material = Material::load_within(folder, &LoadOptions::new(), budget.max_memory, cancel).map_err(|error| {
        if matches!(error, Error::Cancelled | Error::OutOfMemory { .. }) || !folder.exists() || folder.join(MATERIAL_JSON).exists() {
            return error;
        }
        let got = format!(
            "{}: expected the folder of a material with its {MATERIAL_JSON}, which fit makes of a capture; see docs/materials.md",
            describe(folder)
        );
        Error::UnsupportedFormat { name: folder.display().to_string(), got }
    })?;
    for warning in &material.warnings {
        complain(&format!("warning: {}", printable(warning)));
    }
    Ok(material)
}

/// A line on standard error; texts of files go through [`printable`] first.
fn complain(line: &str) {
    drop(writeln!(std::io::stderr(), "{line}"));
}

/// Text on standard output; names and texts of files go through [`printable`] first.
///
/// # Errors
/// [`Error::Io`] if it cannot be written.
fn say(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{text}").and_then(|()| out.flush()).map_err(|source| Error::io("standard output".as_ref(), source))
}

/// The angle of a surface that leans by these slopes.
fn degrees([x, y]: [f64; 2]) -> f64 {
    x.hypot(y).atan().to_degrees()
}

/// A value as one JSON object on standard output.
fn say_json(value: &impl serde::Serialize) -> Result<()> {
    let text = serde_json::to_string(value).map_err(|error| Error::invalid("--json", error.to_string()))?;
    say(&text)
}
