//! `svbrdf-gcn render`.

use std::path::PathBuf;

use clap::Args;

use super::{TransferArg, Triple};
use crate::capture::Shot;
use crate::color::Transfer;
use crate::error::Result;
use crate::io::write_image;
use crate::material::Material;
use crate::render::render;

#[derive(Args)]
pub struct RenderArgs {
    /// Folder of a material.
    material: PathBuf,
    /// Camera position, in the unit of the material's patch size.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    camera: Triple,
    /// Position of the point light.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    light: Triple,
    /// Light intensity: a white diffuse patch at distance r gets the radiance intensity / (pi r^2). Without it, pi times the squared
    /// distance of the light from the centre, so that such a patch is white there.
    #[arg(long, value_name = "R,G,B")]
    light_intensity: Option<Triple>,
    /// Longer side of the picture; maps are resampled by area, never enlarged.
    #[arg(long)]
    size: Option<usize>,
    /// Encoding of a PNG, JPEG or TIFF; OpenEXR files are linear.
    #[arg(long, value_enum, default_value = "srgb")]
    transfer: TransferArg,
    /// The picture: .png, .jpg, .tif or .exr.
    #[arg(long, short)]
    out: PathBuf,
}

pub fn run(args: &RenderArgs) -> Result<()> {
    let material = Material::load(&args.material)?;
    let material = match args.size {
        Some(size) => material.resized(size)?,
        None => material,
    };
    let distance2: f64 = args.light.0.iter().map(|x| x * x).sum();
    let light_intensity = args.light_intensity.map_or([std::f64::consts::PI * distance2; 3], |intensity| intensity.0);
    let shot = Shot { camera: args.camera.0, light: args.light.0, light_intensity };
    write_image(&args.out, &render(&material, &shot)?, Transfer::from(args.transfer))
}
