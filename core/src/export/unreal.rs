//! Unreal: base colour, occlusion-roughness-metallic in one file, specular, normal. Texture names follow its habit, `T_NAME_WHAT`.

use super::Content;
use super::principled::{DIELECTRIC_MAX, Dielectric, Metallic, alphas};
use super::writer::Writer;
use crate::error::Result;
use crate::image::Image;
use crate::material::Material;

pub fn write(material: &Material, writer: &mut Writer<'_>) -> Result<Content> {
    let (width, height) = (material.width(), material.height());
    let maps = Metallic::new(material, Dielectric::UNREAL)?;
    let stem = |what: &str| format!("T_{}_{what}", writer.name());
    let [base, packed, specular_map, normal, amount, direction] =
        ["BaseColor", "ORM", "Specular", "Normal", "Anisotropy", "Tangent"].map(stem);

    let mut roughness = material.roughness.data().to_vec();
    let mut anisotropy = None;
    if let Some(tangent) = &material.tangent {
        // alpha (1 + a) along the tangent, alpha (1 - a) across.
        let pixels = alphas(material, tangent);
        roughness = pixels.iter().map(|([greater, lesser], _)| ((greater + lesser) / 2.0).sqrt() as f32).collect();
        let ratio = |[greater, lesser]: [f64; 2]| (greater - lesser) / (greater + lesser).max(f64::MIN_POSITIVE);
        let amounts = pixels.iter().map(|&(alpha, _)| ratio(alpha) as f32).collect();
        let tangents = pixels.iter().flat_map(|(_, tangent)| tangent.map(|v| v as f32)).collect();
        anisotropy = Some((Image::new(width, height, 1, amounts)?, Image::new(width, height, 3, tangents)?));
    }
    let orm = roughness.iter().zip(maps.metallic.data()).flat_map(|(&r, &m)| [1.0, r, m]).collect();
    let (mut specular, _) = maps.level_and_tint()?;
    for value in specular.data_mut() {
        *value /= DIELECTRIC_MAX as f32;
    }

    writer.color(&base, 8, &maps.base_color, "Base Color; sRGB on")?;
    let holds = "R: ambient occlusion (1), G: roughness, B: metallic; sRGB off, compression Masks";
    writer.data(&packed, 8, &Image::new(width, height, 3, orm)?, holds)?;
    writer.data(
        &specular_map,
        8,
        &specular,
        "Specular: 12.5 times the normal reflectance of the dielectric part; sRGB off",
    )?;
    writer.vectors(&normal, 16, &material.normal, "Normal: (n + 1) / 2; sRGB off, compression Normalmap")?;
    if let Some((amounts, tangents)) = anisotropy {
        writer.data(&amount, 8, &amounts, "Anisotropy along the tangent; sRGB off, compression Masks")?;
        writer.vectors(&direction, 16, &tangents, "Tangent: (t + 1) / 2; sRGB off, compression Normalmap")?;
    }
    let mut content = Content::new(maps.loss);
    content.lost.push("the dielectric part reflects without colour and at most 0.08 at normal incidence".to_owned());
    Ok(content)
}
