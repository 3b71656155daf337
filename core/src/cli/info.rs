//! `svbrdf-gcn info`.

use std::path::PathBuf;

use clap::Args;
use serde_json::{Value, json};

use super::{Budget, load_material, say, say_json};
use crate::cancel::CancelToken;
use crate::error::{Error, Result, printable};
use crate::io::describe::{describe, is_image};
use crate::io::material::read_report;
use crate::maps::Lobe;
use crate::nn::{Model, PhotoGraph};

#[derive(Args)]
pub struct InfoArgs {
    /// A weights file or the folder of a material.
    file: PathBuf,
    /// Print one JSON object instead of text.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &InfoArgs, cancel: &CancelToken) -> Result<()> {
    if is_image(&args.file) {
        let got = format!(
            "{}: expected a weights file or the folder of a material, see docs/weights.md and docs/materials.md; photos are for captures, see docs/captures.md",
            describe(&args.file)
        );
        return Err(Error::UnsupportedFormat { name: args.file.display().to_string(), got });
    }
    let facts = if args.file.is_dir() { material(args, cancel)? } else { weights(args)? };
    if args.json { say_json(&facts) } else { say(&lines(&facts, 0)) }
}

fn material(args: &InfoArgs, cancel: &CancelToken) -> Result<Value> {
    let material = load_material(&args.file, &Budget { max_memory: None }, cancel)?;
    Ok(json!({
        "kind": "material",
        "width": material.width(),
        "height": material.height(),
        "patch_size": material.patch_size,
        "unit": material.unit,
        "lobe": match material.lobe() { Lobe::Isotropic => "isotropic", Lobe::Anisotropic => "anisotropic" },
        "warnings": material.warnings,
        "report": read_report(&args.file)?,
    }))
}

fn weights(args: &InfoArgs) -> Result<Value> {
    let model = Model::load(&args.file)?;
    if let Some(graph) = model.photo_graph() {
        return photo_graph(&model, graph);
    }
    let networks: Vec<Value> = model
        .networks()
        .iter()
        .map(|network| json!({ "config": network.config(), "parameters": network.parameters() }))
        .collect();
    Ok(json!({
        "kind": "weights",
        "license": model.license(),
        "checksums": checksums(&model),
        "networks": networks,
    }))
}

/// What is known of damage to the file.
fn checksums(model: &Model) -> &'static str {
    if model.has_checksums() { "verified" } else { "none, damage would go unnoticed" }
}

fn photo_graph(model: &Model, graph: &PhotoGraph) -> Result<Value> {
    let architecture = graph.architecture()?;
    // Where the file says it in JSON, show what it says.
    let fact = |text: &String| serde_json::from_str(text).unwrap_or_else(|_| Value::String(text.clone()));
    let facts: serde_json::Map<_, _> = model.facts().iter().map(|(key, text)| (key.clone(), fact(text))).collect();
    let mut all = json!({
        "kind": "weights",
        "license": model.license(),
        "checksums": checksums(model),
        "architecture": architecture,
        "parameters": graph.parameters(),
    });
    if let (Value::Object(all), false) = (&mut all, facts.is_empty()) {
        all.insert("facts".into(), facts.into());
    }
    Ok(all)
}

/// A JSON value as indented lines.
fn lines(value: &Value, depth: usize) -> String {
    let indent = "  ".repeat(depth);
    let entry = |name: &str, value: &Value| {
        let name = printable(name);
        match value {
            Value::Object(_) => format!("{indent}{name}:\n{}", lines(value, depth + 1)),
            Value::Array(items) if items.iter().any(Value::is_object) => {
                format!("{indent}{name}:\n{}", lines(value, depth + 1))
            }
            Value::Array(items) => {
                format!("{indent}{name}: {}", items.iter().map(scalar).collect::<Vec<_>>().join(", "))
            }
            other => format!("{indent}{name}: {}", scalar(other)),
        }
    };
    match value {
        Value::Object(map) => map.iter().map(|(name, value)| entry(name, value)).collect::<Vec<_>>().join("\n"),
        Value::Array(items) => {
            items.iter().enumerate().map(|(i, value)| entry(&i.to_string(), value)).collect::<Vec<_>>().join("\n")
        }
        other => format!("{indent}{}", scalar(other)),
    }
}

fn scalar(value: &Value) -> String {
    match value {
        Value::String(text) => printable(text),
        Value::Null => "-".to_owned(),
        other => other.to_string(),
    }
}
