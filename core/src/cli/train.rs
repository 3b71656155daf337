//! `svbrdf-gcn train`.

use std::path::PathBuf;

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};

use super::{complain, say};
use crate::cancel::CancelToken;
use crate::error::{Error, Result, printable};
use crate::pool::pool;
use crate::train::{Configuration, Event, RunOptions, Validation, run as train};

/// Positions of the progress bar.
const TICKS: f64 = 1000.0;

#[derive(Args)]
pub struct TrainArgs {
    /// Configuration, a TOML file; `docs/training.md` describes it.
    config: PathBuf,
    /// Folder for checkpoints, `log.jsonl` and `model.safetensors`; a training that is there goes on.
    #[arg(long, short, value_name = "FOLDER")]
    output: PathBuf,
    /// End after so many seconds, with a checkpoint.
    #[arg(long, allow_negative_numbers = true)]
    seconds: Option<f64>,
    /// Change a setting: optimiser.rate=5e-4.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    changes: Vec<String>,
    /// Licence that the weights state.
    #[arg(long, default_value = "not stated")]
    license: String,
    /// Threads; all if not given.
    #[arg(long, allow_negative_numbers = true)]
    threads: Option<usize>,
    /// No progress bar and no lines but errors.
    #[arg(long, short)]
    quiet: bool,
}

pub fn run(args: &TrainArgs, cancel: &CancelToken) -> Result<()> {
    let config = Configuration::load(&args.config, &args.changes)?;
    let options = RunOptions { seconds: args.seconds, license: args.license.clone(), cancel: cancel.clone() };
    let pool = pool(args.threads)?;
    let bar = Bar::new(args.quiet);
    let summary = pool.install(|| train(&config, &args.output, &options, &mut |event| bar.show(event)));
    bar.bar.finish_and_clear();
    let summary = summary?;
    if summary.cancelled {
        return Err(Error::Cancelled);
    }
    if args.quiet {
        return Ok(());
    }
    say(&format!(
        "{}: {} steps, {:.0} s of training, {:.1} % of the schedule",
        printable(summary.model.display()),
        summary.steps,
        summary.seconds,
        100.0 * summary.progress.min(1.0)
    ))
}

/// The progress bar: share of the schedule, step, losses, time left; above it, what happens.
struct Bar {
    bar: ProgressBar,
    quiet: bool,
}

impl Bar {
    fn new(quiet: bool) -> Self {
        let bar = if quiet { ProgressBar::hidden() } else { ProgressBar::new(TICKS as u64) };
        if let Ok(style) = ProgressStyle::with_template("{bar:40} {percent:>3} % {msg}  {eta} left") {
            bar.set_style(style);
        }
        Self { bar, quiet }
    }

    fn line(&self, text: &str) {
        // Where standard error is no terminal there is no bar to keep clear of.
        self.bar.suspend(|| complain(text));
    }

    fn show(&self, event: &Event<'_>) {
        if self.quiet {
            return;
        }
        match event {
            Event::Started { materials, held_out, parameters, step } => {
                let parameters = *parameters as f64 / 1e6;
                self.line(&format!(
                    "{materials} materials, {held_out} held out; {parameters:.2} M parameters; from step {step}"
                ));
            }
            Event::Changed(settings) => {
                self.line(&format!("changed since the checkpoint: {}", printable(settings.join(", "))))
            }
            Event::Stepped { step, progress, entry } => {
                // What earlier runs did tells nothing about the time left.
                if self.bar.position() == 0 {
                    self.bar.set_position((TICKS * progress) as u64);
                    self.bar.reset_eta();
                }
                self.bar.set_position((TICKS * progress) as u64);
                self.bar.set_message(format!("step {step}"));
                if let Some(entry) = entry {
                    let value = |name: &str| entry.get(name).and_then(serde_json::Value::as_f64).unwrap_or(f64::NAN);
                    self.line(&format!(
                        "step {step} {:.0} s: loss {:.3} maps {:.4} rendering {:.4} certainty {:.2}",
                        value("seconds"),
                        value("loss"),
                        value("maps"),
                        value("rendering"),
                        value("certainty")
                    ));
                }
            }
            Event::Validating => self.bar.set_message("validation"),
            Event::Validated(results) => self.line(&table(results)),
        }
    }
}

/// Scores of a validation, a line each.
fn table(results: &Validation) -> String {
    let row = |(name, row): (&String, &crate::train::Scores)| {
        format!(
            "  {name:7} D {:.3} N {:.3} R {:.3} S {:.3} rendering {:.3}  {:.1} deg  within sigma {:.2}/{:.2}/{:.2}/{:.2}",
            row.diffuse,
            row.normal,
            row.roughness,
            row.specular,
            row.rendering,
            row.normal_deg,
            row.cover_diffuse,
            row.cover_normal,
            row.cover_roughness,
            row.cover_specular
        )
    };
    let rows: Vec<String> = results.iter().map(row).collect();
    format!("validation\n{}", rows.join("\n"))
}
