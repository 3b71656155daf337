//! `svbrdf-gcn evaluate`.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::{CaptureArgs, load_material, say, say_json};
use crate::cancel::CancelToken;
use crate::capture::render_photo;
use crate::error::{Error, Result, printable};
use crate::metrics::{MapErrors, photo_rmse, photo_rmse_smooth_gain};
use crate::render::rendering_memory;

#[derive(Args)]
pub struct EvaluateArgs {
    /// Folder of a material.
    material: PathBuf,
    #[command(flatten)]
    capture: CaptureArgs,
    /// Folder of the true maps, to compare the material's with.
    #[arg(long)]
    truth: Option<PathBuf>,
    /// Print one JSON object instead of text.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Evaluation {
    /// RMSE of each photo, gamma 2.2, clamped to [0, 1].
    photos: Vec<PhotoError>,
    /// Mean of these.
    rmse: f64,
    /// Mean of the errors after a smooth gain: the material's part.
    rmse_smooth_gain: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    maps: Option<MapErrors>,
}

#[derive(Serialize)]
struct PhotoError {
    name: String,
    rmse: f64,
    /// After a smooth gain: [`photo_rmse_smooth_gain`].
    rmse_smooth_gain: f64,
}

pub fn run(args: &EvaluateArgs, cancel: &CancelToken) -> Result<()> {
    let budget = &args.capture.budget;
    let material = load_material(&args.material, budget, cancel)?;
    let size = material.width().max(material.height());
    let capture = args.capture.open(Some(size), material.memory(), cancel)?;
    if (capture.width(), capture.height()) != (material.width(), material.height()) {
        return Err(Error::shape(
            args.capture.capture.display().to_string(),
            format!(
                "photos that can be brought to the {} x {} pixels of the material",
                material.width(),
                material.height()
            ),
            format!("{} x {}", capture.width(), capture.height()),
        ));
    }
    let in_use = material.memory() + capture.memory();
    budget.check("comparing renderings with photos", capture.memory() + rendering_memory(&material), in_use)?;
    let photos = capture
        .photos()
        .iter()
        .enumerate()
        .map(|(index, photo)| {
            cancel.check()?;
            let rendering = render_photo(&material, &capture, index)?;
            Ok(PhotoError {
                name: photo.name.clone(),
                rmse: photo_rmse(&rendering, &photo.image)?,
                rmse_smooth_gain: photo_rmse_smooth_gain(&rendering, &photo.image)?,
            })
        })
        .collect::<Result<Vec<_>>>()?;
    let mean = |error: fn(&PhotoError) -> f64| photos.iter().map(error).sum::<f64>() / photos.len() as f64;
    let (rmse, rmse_smooth_gain) = (mean(|photo| photo.rmse), mean(|photo| photo.rmse_smooth_gain));
    let maps = match &args.truth {
        Some(truth) => {
            let truth = load_material(truth, budget, cancel)?;
            Some(MapErrors::between(&material, &truth.resized(size)?)?)
        }
        None => None,
    };
    let evaluation = Evaluation { photos, rmse, rmse_smooth_gain, maps };
    if args.json { say_json(&evaluation) } else { say(&text(&evaluation)) }
}

fn text(evaluation: &Evaluation) -> String {
    let line = |name: &str, rmse: f64, smooth: f64| format!("{name:<24}{rmse:<10.4}{smooth:.4}");
    let mut lines = vec![format!("{:<24}{:<10}after a smooth gain", "RMSE, gamma 2.2", "as stated")];
    lines.extend(
        evaluation
            .photos
            .iter()
            .map(|photo| line(&printable(&photo.name).to_string(), photo.rmse, photo.rmse_smooth_gain)),
    );
    lines.push(line("mean", evaluation.rmse, evaluation.rmse_smooth_gain));
    lines.extend(evaluation.maps.as_ref().map(ToString::to_string));
    lines.join("\n")
}
