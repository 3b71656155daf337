//! `svbrdf-gcn train`: starts the trainer of the Python package, which needs PyTorch.

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::Command;

use clap::Args;

use crate::error::{Error, Result, printable};

/// Prints what the trainer needs and this Python has not.
const MISSING: &str = "import importlib.util as u; print(*[m for m in ('svbrdf_gcn', 'torch', 'numpy', 'PIL') if u.find_spec(m) is None])";
/// Exit code of a trainer that a signal ended.
const KILLED: i32 = 1;

#[derive(Args)]
#[command(disable_help_flag = true)]
pub struct TrainArgs {
    /// The Python that has the package `svbrdf-gcn[training]`; before all other arguments.
    #[arg(long, default_value = "python3", value_name = "PATH")]
    python: PathBuf,
    /// What `python3 -m svbrdf_gcn.training` takes, such as `CONFIG -o FOLDER`; `--help` shows all. docs/training.md describes it.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    arguments: Vec<OsString>,
}

/// Runs the trainer and returns its exit code.
pub fn run(args: &TrainArgs) -> Result<i32> {
    let python = printable(args.python.display());
    let unfit = |reason: String| {
        let advice = format!("{python} -m pip install 'svbrdf-gcn[training]'");
        Error::invalid(
            "--python",
            format!("{reason}; install it with `{advice}`, or name another Python, see docs/training.md"),
        )
    };
    let probe = Command::new(&args.python).args(["-c", MISSING]).output();
    let probe = probe.map_err(|error| unfit(format!("{python} does not start: {error}")))?;
    let missing = String::from_utf8_lossy(&probe.stdout).trim().to_owned();
    if !probe.status.success() || !missing.is_empty() {
        let missing = if missing.is_empty() { "what the trainer needs".into() } else { printable(missing) };
        return Err(unfit(format!("{python} does not have {missing}")));
    }
    // Ctrl-C reaches both: the trainer ends with a checkpoint, and this program after it.
    let status = Command::new(&args.python).args(["-m", "svbrdf_gcn.training"]).args(&args.arguments).status();
    let status = status.map_err(|error| unfit(format!("{python} does not start: {error}")))?;
    Ok(status.code().unwrap_or(KILLED))
}
