//! `svbrdf-gcn fit`.

use std::io::ErrorKind;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde_json::json;

use super::acquire::{SheetOptions, make_capture, remark};
use super::bar::Bar;
use super::outputs::keep;
use super::{CaptureArgs, complain, degrees, say, say_json};
use crate::cancel::CancelToken;
use crate::capture::{Capture, photo_files};
use crate::color::ColorSpace;
use crate::error::{Error, Result, printable};
use crate::fit::options::{FitOptions, Method, Preset, Refine, Reflectance};
use crate::fit::report::FitReport;
use crate::fit::verdict::Verdict;
use crate::fit::{Fit, fit_material};
use crate::io::material::{self, MaterialFormat, PREVIEW_PNG, SaveOptions, file_names};
use crate::nn::Model;

/// The folder beside the maps for the capture that several photos become.
const CAPTURE: &str = "capture";
/// Degrees from which a tilt of the whole surface is worth a line.
const TILT_SHOWN: f64 = 0.5;

#[derive(Args)]
pub struct FitArgs {
    #[command(flatten)]
    capture: CaptureArgs,
    #[command(flatten)]
    sheet: SheetOptions,
    /// Folder for the maps, `material.json` and `preview.png`.
    #[arg(long, short)]
    out: PathBuf,
    /// Longer side of the maps in pixels; larger photos are resampled.
    #[arg(long, allow_negative_numbers = true)]
    size: Option<usize>,
    /// How much time to spend.
    #[arg(long, value_enum, default_value = "balanced")]
    preset: PresetArg,
    /// How to get from photos to maps; auto: network.
    #[arg(long, value_enum, default_value = "auto")]
    method: MethodArg,
    /// What the surface is made of; auto: the simplest that predicts photos left out as well as the others do.
    #[arg(long, value_enum, default_value = "auto")]
    reflectance: ReflectanceArg,
    /// What of the capture's statements may be corrected; auto: the light of each photo, where photos left out are predicted better with it.
    #[arg(long, value_enum, default_value = "auto")]
    refine: RefineArg,
    /// Other weights than those built in (safetensors).
    #[arg(long)]
    weights: Option<PathBuf>,
    /// Steps on the latent code, instead of the preset's.
    #[arg(long, allow_negative_numbers = true)]
    latent_steps: Option<usize>,
    /// Steps on the adapters, instead of the preset's.
    #[arg(long, allow_negative_numbers = true)]
    adapter_steps: Option<usize>,
    /// Steps on the maps themselves, instead of the preset's.
    #[arg(long, allow_negative_numbers = true)]
    direct_steps: Option<usize>,
    /// Steps of the per-pixel finish, instead of the preset's; 0: none. With --direct-steps 0 too, the maps are the network's.
    #[arg(long, allow_negative_numbers = true)]
    finish_steps: Option<usize>,
    /// Take every step, also when the loss has flattened.
    #[arg(long)]
    no_early_stop: bool,
    /// Seed of everything random.
    #[arg(long, allow_negative_numbers = true, default_value_t = 0)]
    seed: u64,
    /// Threads; all if not given.
    #[arg(long, allow_negative_numbers = true)]
    threads: Option<usize>,
    /// File format of the maps.
    #[arg(long, value_enum, default_value = "exr")]
    format: FormatArg,
    /// Print one JSON object instead of text.
    #[arg(long)]
    json: bool,
    /// No progress bar and no summary.
    #[arg(long, short)]
    quiet: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum PresetArg {
    Draft,
    Balanced,
    High,
}

#[derive(Clone, Copy, ValueEnum)]
enum MethodArg {
    Auto,
    Network,
    Direct,
}

#[derive(Clone, Copy, ValueEnum)]
enum ReflectanceArg {
    Auto,
    Diffuse,
    Dielectric,
    Isotropic,
    Anisotropic,
}

#[derive(Clone, Copy, ValueEnum)]
enum RefineArg {
    Auto,
    None,
    Light,
    All,
}

#[derive(Clone, Copy, ValueEnum)]
enum FormatArg {
    Exr,
    Png16,
    Tiff,
}

impl FitArgs {
    fn fit_options(&self, cancel: CancelToken) -> FitOptions {
        let mut options = FitOptions::preset(match self.preset {
            PresetArg::Draft => Preset::Draft,
            PresetArg::Balanced => Preset::Balanced,
            PresetArg::High => Preset::High,
        });
        options.method = match self.method {
            MethodArg::Auto => Method::Auto,
            MethodArg::Network => Method::Network,
            MethodArg::Direct => Method::Direct,
        };
        options.reflectance = match self.reflectance {
            ReflectanceArg::Auto => Reflectance::Auto,
            ReflectanceArg::Diffuse => Reflectance::Diffuse,
            ReflectanceArg::Dielectric => Reflectance::Dielectric,
            ReflectanceArg::Isotropic => Reflectance::Isotropic,
            ReflectanceArg::Anisotropic => Reflectance::Anisotropic,
        };
        options.refine = match self.refine {
            RefineArg::Auto => Refine::Auto,
            RefineArg::None => Refine::None,
            RefineArg::Light => Refine::Light,
            RefineArg::All => Refine::All,
        };
        options.latent_steps = self.latent_steps;
        options.adapter_steps = self.adapter_steps;
        options.direct_steps = self.direct_steps;
        options.finish_steps = self.finish_steps;
        options.max_memory = self.capture.budget.max_memory;
        options.seed = self.seed;
        options.threads = self.threads;
        options.early_stop = self.no_early_stop.then_some(false);
        options.cancel = cancel;
        options
    }

    fn format(&self) -> MaterialFormat {
        match self.format {
            FormatArg::Exr => MaterialFormat::Exr,
            FormatArg::Png16 => MaterialFormat::Png16,
            FormatArg::Tiff => MaterialFormat::Tiff,
        }
    }

    fn save_options(&self) -> SaveOptions {
        SaveOptions::new(self.format()).color_space(self.capture.color_space.map(ColorSpace::from).unwrap_or_default())
    }
}

pub fn run(args: &FitArgs, cancel: &CancelToken) -> Result<()> {
    check_folder(&args.out)?;
    let raw = args.capture.photos(args.sheet.has_corners());
    if let (None, Some(option)) = (&raw, args.sheet.given()) {
        let got = args.capture.path()?.display();
        let got = format!("is for photos of a sheet: expected two image files or more (acquire takes one), got {got}");
        return Err(Error::invalid(option, got));
    }
    let photos = match &raw {
        Some(photos) => photos.clone(),
        None => photo_files(args.capture.path()?)?,
    };
    for name in file_names(args.format()) {
        keep(&args.out.join(name), "a photo that this command reads", photos.clone())?;
    }
    material::check_folder(&args.out, args.format())?;
    let mut bar = Bar::new(args.quiet || args.json);
    let capture = match raw {
        Some(photos) => {
            if args.capture.transfer.is_some() || args.capture.ignore_profiles {
                let reason =
                    "raw photos are read as their files say: expected neither --transfer nor --ignore-profiles";
                return Err(Error::invalid("transfer", reason));
            }
            let folder = args.out.join(CAPTURE);
            let options = args.sheet.options(&photos, args.size, args.capture.budget.max_memory, cancel)?;
            let (report, _) = make_capture(&photos, &folder, &options, &mut bar)?;
            remark(&report);
            // What was acquired is linear Rec. 709.
            let mut reading = args.capture.options(args.size).cancel(cancel.clone());
            reading.color_space = None;
            Capture::open_with(&folder, &reading)?
        }
        None => args.capture.open(args.size, 0, cancel)?,
    };
    let model = args.weights.as_deref().map(|path| Model::load_for(path, capture.len())).transpose()?;
    let fit = fit_material(&capture, model.as_ref(), &args.fit_options(cancel.clone()), &mut |progress| {
        bar.show(progress);
        ControlFlow::Continue(())
    });
    bar.finish();
    let Fit { material, deviations, report } = fit?;
    let report_json = serde_json::to_value(&report).map_err(|error| Error::invalid("report", error.to_string()))?;
    let capture = match report.assumed {
        Some(assumed) => capture.with_assumed(assumed)?,
        None => capture,
    };
    let preview = super::preview::preview(&material, &capture, cancel)?;
    let save_options = args.save_options().report(report_json.clone()).deviations(deviations).preview(preview);
    material.save_unless(&args.out, &save_options, cancel)?;

    for warning in &report.warnings {
        complain(&format!("warning: {}", printable(warning)));
    }
    if args.json {
        say_json(&json!({ "material": args.out, "preview": args.out.join(PREVIEW_PNG), "report": report_json }))
    } else if args.quiet {
        Ok(())
    } else {
        say(&summary(&report, &args.out))
    }
}

/// Whether `folder` is one, or can become one as far as names tell: better said before the fit than after it.
fn check_folder(folder: &Path) -> Result<()> {
    for place in folder.ancestors() {
        match place.metadata() {
            Ok(found) if found.is_dir() => return Ok(()),
            Ok(_) => return Err(Error::io(place, ErrorKind::NotADirectory)),
            Err(_) => {}
        }
    }
    Ok(())
}

fn summary(report: &FitReport, out: &Path) -> String {
    let mut lines: Vec<String> = report
        .stages
        .iter()
        .map(|stage| {
            format!(
                "{:<9}{:>5} steps  loss {:>9.4} -> {:>9.4}  {:>6.1} s{}",
                stage.stage.name(),
                stage.steps,
                stage.first_loss,
                stage.best_loss,
                stage.seconds,
                if stage.stopped_early { "  (flat)" } else { "" }
            )
        })
        .collect();
    let used: Vec<f64> = std::iter::zip(&report.photos, &report.photo_errors)
        .filter(|(photo, _)| !report.photos_left_out.contains(photo))
        .map(|(_, error)| *error)
        .collect();
    let error = used.iter().sum::<f64>() / used.len() as f64;
    lines.push(format!("photos used: RMSE {error:.4} (gamma 2.2) over {}", used.len()));
    lines.push(reflectance(report));
    if degrees(report.tilt) > TILT_SHOWN {
        lines.push(format!("the surface leans by {:.1} degrees; an export takes that out", degrees(report.tilt)));
    }
    lines.extend(verdict(&report.verdict));
    lines.push(format!("{} in {:.1} s", printable(out.display()), report.seconds));
    lines.join("\n")
}

/// What the surface was taken to be made of, and what decided that.
fn reflectance(report: &FitReport) -> String {
    let errors = report.reflectance_errors.iter();
    let errors: Vec<String> = errors.map(|one| format!("{} {:.4}", one.reflectance.name(), one.error)).collect();
    let decided = match errors.len() {
        0 => String::new(),
        _ => format!(" (photos left out are missed by: {})", errors.join(", ")),
    };
    format!("reflectance: {}{decided}; refined: {}", report.reflectance.name(), report.refine.name())
}

/// The verdict, and why it is not better.
fn verdict(verdict: &Verdict) -> Vec<String> {
    let mut line = format!("verdict: {}", verdict.grade.name());
    if let (Some(error), Some(material)) = (verdict.expected_error, verdict.material_error) {
        line += &match verdict.estimated {
            true => format!(
                ", a new photo is expected to be missed by some {error:.3}, estimated from the network's certainty"
            ),
            false => {
                format!(", a new photo is expected to be missed by {error:.3}, by {material:.3} after a smooth gain")
            }
        };
    }
    let reasons =
        verdict.reasons.iter().map(|reason| printable(format!("- {}; {}", reason.text, reason.advice)).to_string());
    std::iter::once(line).chain(reasons).collect()
}
