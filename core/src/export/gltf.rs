//! glTF 2.0: a plane with the material, KHR_materials_specular for the colour and strength of the dielectric part, KHR_materials_anisotropy where the
//! material is anisotropic.

use serde_json::{Value, json};

use super::Content;
use super::principled::{DIELECTRIC_USUAL, Dielectric, Metallic, alphas};
use super::writer::Writer;
use crate::error::{Error, Result};
use crate::image::Image;
use crate::material::Material;

pub fn write(material: &Material, writer: &mut Writer<'_>) -> Result<Content> {
    let (width, height) = (material.width(), material.height());
    let maps = Metallic::new(material, Dielectric::FREE)?;
    let mut textures = Textures::default();
    let mut roughness = material.roughness.data().to_vec();
    let mut extensions = serde_json::Map::new();

    // The texture holds what lies in [0, 1], the factor carries the rest; 0.04 is the reflectance of the default index of refraction.
    let brightest = maps.dielectric.data().iter().fold(0.0f32, |a, &b| a.max(b));
    let scaled = maps.dielectric.data().iter().map(|&v| if brightest > 0.0 { v / brightest } else { 0.0 }).collect();
    let tint = Image::new(width, height, 3, scaled)?;
    let factor = f64::from(brightest) / DIELECTRIC_USUAL;
    let specular = writer.color("specular_color", 8, &tint, &format!("specularColor, divided by {factor}"))?;
    let specular =
        json!({ "specularColorFactor": [factor, factor, factor], "specularColorTexture": textures.add(&specular) });
    extensions.insert("KHR_materials_specular".to_owned(), specular);

    if let Some(tangent) = &material.tangent {
        // alpha across is the roughness squared, alpha along mixes it with 1 by the strength squared.
        let pixels = alphas(material, tangent);
        roughness = pixels.iter().map(|([_, lesser], _)| lesser.sqrt() as f32).collect();
        let stored = pixels.iter().flat_map(|([greater, lesser], [x, y, _])| {
            let strength = if *lesser < 1.0 { ((greater - lesser) / (1.0 - lesser)).sqrt() } else { 0.0 };
            let length = x.hypot(*y).max(f64::MIN_POSITIVE);
            [(x / length + 1.0) / 2.0, (y / length + 1.0) / 2.0, strength].map(|v| v as f32)
        });
        let image = Image::new(width, height, 3, stored.collect())?;
        let holds = "R, G: (direction + 1) / 2 of the greater roughness, B: anisotropy strength";
        let file = writer.data("anisotropy", 8, &image, holds)?;
        let anisotropy = json!({ "anisotropyStrength": 1.0, "anisotropyTexture": textures.add(&file) });
        extensions.insert("KHR_materials_anisotropy".to_owned(), anisotropy);
    }

    let base = writer.color("base_color", 8, &maps.base_color, "baseColor")?;
    let packed = roughness.iter().zip(maps.metallic.data()).flat_map(|(&r, &m)| [1.0, r, m]).collect();
    let packed = Image::new(width, height, 3, packed)?;
    let packed = writer.data("metallic_roughness", 8, &packed, "R: 1, G: roughness, B: metallic")?;
    let normal = writer.vectors("normal", 8, &material.normal, "(n + 1) / 2")?;
    let used: Vec<String> = extensions.keys().cloned().collect();
    let surface = json!({
        "name": writer.name(),
        "pbrMetallicRoughness": {
            "baseColorTexture": textures.add(&base),
            "metallicRoughnessTexture": textures.add(&packed),
        },
        "normalTexture": textures.add(&normal),
        "doubleSided": true,
        "extensions": extensions,
    });
    write_scene(material, writer, surface, &textures, &used)?;

    let mut content = Content::new(maps.loss);
    content.loss_without_extensions = Some(maps.loss_with_usual_dielectric(material)?);
    if material.tangent.is_some() {
        content.lost.push("viewers without KHR_materials_anisotropy show the lesser roughness only".to_owned());
    }
    Ok(content)
}

/// Image files, one texture each.
#[derive(Default)]
struct Textures(Vec<String>);

impl Textures {
    /// A reference to the texture of this file.
    fn add(&mut self, file: &str) -> Value {
        self.0.push(file.to_owned());
        json!({ "index": self.0.len() - 1 })
    }
}

/// The `.gltf` and its `.bin`: a plane of width 1 that faces +z, texture row 0 on top.
fn write_scene(
    material: &Material,
    writer: &mut Writer<'_>,
    surface: Value,
    textures: &Textures,
    used: &[String],
) -> Result<()> {
    let (x, y) = (0.5f32, 0.5 * material.height() as f32 / material.width() as f32);
    let corners = [[-x, y], [-x, -y], [x, -y], [x, y]];
    let mut bytes = Vec::new();
    let mut views = Vec::new();
    let mut part = |values: &[f32], components: usize| {
        views.push(json!({ "buffer": 0, "byteOffset": bytes.len(), "byteLength": 4 * values.len(), "target": 34962 }));
        bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        json!({ "bufferView": views.len() - 1, "componentType": 5126, "count": 4, "type": format!("VEC{components}") })
    };
    let mut position = part(&corners.map(|[x, y]| [x, y, 0.0]).concat(), 3);
    position["min"] = json!([-x, -y, 0.0]);
    position["max"] = json!([x, y, 0.0]);
    let normals = part(&[0.0, 0.0, 1.0].repeat(4), 3);
    let tangents = part(&[1.0, 0.0, 0.0, 1.0].repeat(4), 4);
    let coordinates = part(&[0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0], 2);
    let indices: [u16; 6] = [0, 1, 2, 0, 2, 3];
    views.push(json!({ "buffer": 0, "byteOffset": bytes.len(), "byteLength": 12, "target": 34963 }));
    bytes.extend(indices.iter().flat_map(|v| v.to_le_bytes()));
    let triangles = json!({ "bufferView": views.len() - 1, "componentType": 5123, "count": 6, "type": "SCALAR" });
    let accessors = [position, normals, tangents, coordinates, triangles];

    let buffer = format!("{}.bin", writer.name());
    let primitive = json!({
        "attributes": { "POSITION": 0, "NORMAL": 1, "TANGENT": 2, "TEXCOORD_0": 3 },
        "indices": 4,
        "material": 0,
    });
    let document = json!({
        "asset": { "version": "2.0", "generator": concat!("svbrdf-gcn ", env!("CARGO_PKG_VERSION")) },
        "extensionsUsed": used,
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "name": writer.name() }],
        "meshes": [{ "primitives": [primitive] }],
        "materials": [surface],
        "textures": (0..textures.0.len()).map(|source| json!({ "sampler": 0, "source": source })).collect::<Vec<_>>(),
        "images": textures.0.iter().map(|uri| json!({ "uri": uri })).collect::<Vec<_>>(),
        "samplers": [{ "magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 10497 }],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{ "uri": buffer, "byteLength": bytes.len() }],
    });
    let file = format!("{}.gltf", writer.name());
    let text = serde_json::to_vec_pretty(&document).map_err(|error| Error::io(file.as_ref(), error))?;
    writer.other(&buffer, bytes, "a plane: positions, normals, tangents, texture coordinates, triangles");
    writer.other(&file, text, "the glTF document");
    Ok(())
}
