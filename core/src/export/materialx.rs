//! MaterialX 1.39: an OpenPBR surface whose inputs are 16-bit images.

use std::fmt::Write;

use super::Content;
use super::principled::{Dielectric, Metallic, alphas};
use super::writer::Writer;
use crate::error::Result;
use crate::image::Image;
use crate::material::Material;

/// The brightest dielectric written: its index of refraction, 399, is still finite.
const BRIGHTEST: f32 = 0.99;

pub fn write(material: &Material, writer: &mut Writer<'_>) -> Result<Content> {
    let (width, height) = (material.width(), material.height());
    let maps = Metallic::new(material, Dielectric::FREE)?;
    let (mut level, tint) = maps.level_and_tint()?;
    for value in level.data_mut() {
        *value = value.min(BRIGHTEST).sqrt();
    }
    let mut graph = Graph::default();
    graph.color("base_color", &writer.color("base_color", 16, &maps.base_color, "base_color")?);
    graph.float("base_metalness", &writer.data("metalness", 16, &maps.metallic, "base_metalness")?);
    graph.color("specular_color", &writer.color("specular_color", 16, &tint, "specular_color")?);
    let holds = "q, the square root of the dielectric part's normal reflectance; specular_ior = (1 + q) / (1 - q)";
    graph.ior(&writer.data("specular_ior", 16, &level, holds)?);
    graph.vector("geometry_normal", &writer.vectors("normal", 16, &material.normal, "(n + 1) / 2")?);
    match &material.tangent {
        None => {
            graph
                .float("specular_roughness", &writer.data("roughness", 16, &material.roughness, "specular_roughness")?);
        }
        Some(tangent) => {
            // alpha along = r^2 sqrt(2 / (1 + (1 - a)^2)), across = (1 - a) alpha along.
            let pixels = alphas(material, tangent);
            let image = |channels: usize, data: Vec<f32>| Image::new(width, height, channels, data);
            let roughness = pixels.iter().map(|([g, l], _)| ((g * g + l * l) / 2.0).sqrt().sqrt() as f32).collect();
            let amount =
                pixels.iter().map(|([g, l], _)| (1.0 - l / g.max(f64::MIN_POSITIVE)).min(1.0) as f32).collect();
            let tangents = pixels.iter().flat_map(|(_, t)| t.map(|v| v as f32)).collect();
            let roughness = writer.data("roughness", 16, &image(1, roughness)?, "specular_roughness")?;
            graph.float("specular_roughness", &roughness);
            let amount = writer.data("anisotropy", 16, &image(1, amount)?, "specular_roughness_anisotropy")?;
            graph.float("specular_roughness_anisotropy", &amount);
            graph.vector("geometry_tangent", &writer.vectors("tangent", 16, &image(3, tangents)?, "(t + 1) / 2")?);
        }
    }
    let name = writer.name();
    writer.other(&format!("{name}.mtlx"), graph.document(name).into_bytes(), "the MaterialX document");
    let mut content = Content::new(maps.loss);
    content.lost.push(
        "specular_color tints the dielectric part at all angles and is the F82 tint of the metallic part".to_owned(),
    );
    Ok(content)
}

/// The nodes between the images and the inputs of the surface.
#[derive(Default)]
struct Graph {
    nodes: String,
    outputs: String,
    inputs: String,
}

impl Graph {
    /// An image node called after the input, with `_image` where another node follows.
    fn image(&mut self, node: &str, kind: &str, file: &str) {
        let space = if kind == "color3" { " colorspace=\"srgb_texture\"" } else { "" };
        self.line(&format!("    <image name=\"{node}\" type=\"{kind}\">"));
        self.line(&format!("      <input name=\"file\" type=\"filename\" value=\"{file}\"{space} />"));
        self.line("    </image>");
    }

    fn line(&mut self, line: &str) {
        self.nodes.push_str(line);
        self.nodes.push('\n');
    }

    /// A node with inputs that are other nodes' outputs (`Ok`) or values (`Err`).
    fn node(&mut self, category: &str, node: &str, kind: &str, inputs: &[(&str, std::result::Result<&str, &str>)]) {
        self.line(&format!("    <{category} name=\"{node}\" type=\"{kind}\">"));
        for (input, source) in inputs {
            let source = match source {
                Ok(name) => format!("nodename=\"{name}\""),
                Err(value) => format!("value=\"{value}\""),
            };
            self.line(&format!("      <input name=\"{input}\" type=\"{kind}\" {source} />"));
        }
        self.line(&format!("    </{category}>"));
    }

    /// Connects the node `node` to the surface's input `input`.
    fn connect(&mut self, input: &str, kind: &str, node: &str) {
        let output = format!("{input}_out");
        // Writing to a string cannot fail.
        let _ = writeln!(self.outputs, "    <output name=\"{output}\" type=\"{kind}\" nodename=\"{node}\" />");
        let _ = writeln!(
            self.inputs,
            "    <input name=\"{input}\" type=\"{kind}\" nodegraph=\"maps\" output=\"{output}\" />"
        );
    }

    fn color(&mut self, input: &str, file: &str) {
        self.image(input, "color3", file);
        self.connect(input, "color3", input);
    }

    fn float(&mut self, input: &str, file: &str) {
        self.image(input, "float", file);
        self.connect(input, "float", input);
    }

    /// A vector of the picture's frame, brought into the world's.
    fn vector(&mut self, input: &str, file: &str) {
        let image = format!("{input}_image");
        self.image(&image, "vector3", file);
        self.node("normalmap", input, "vector3", &[("in", Ok(&image))]);
        self.connect(input, "vector3", input);
    }

    fn ior(&mut self, file: &str) {
        self.image("q", "float", file);
        self.node("add", "one_plus_q", "float", &[("in1", Err("1.0")), ("in2", Ok("q"))]);
        self.node("subtract", "one_minus_q", "float", &[("in1", Err("1.0")), ("in2", Ok("q"))]);
        let ratio = [("in1", Ok("one_plus_q")), ("in2", Ok("one_minus_q"))];
        self.node("divide", "specular_ior", "float", &ratio);
        self.connect("specular_ior", "float", "specular_ior");
    }

    fn document(&self, name: &str) -> String {
        let Self { nodes, outputs, inputs } = self;
        format!(
            r#"<?xml version="1.0"?>
<materialx version="1.39" colorspace="lin_rec709">
  <nodegraph name="maps">
{nodes}{outputs}  </nodegraph>
  <open_pbr_surface name="{name}_surface" type="surfaceshader">
{inputs}  </open_pbr_surface>
  <surfacematerial name="{name}" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="{name}_surface" />
  </surfacematerial>
</materialx>
"#
        )
    }
}
