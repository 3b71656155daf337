//! `svbrdf-gcn render`.

use std::path::PathBuf;

use clap::Args;

use super::outputs::keep_maps_and_photos;
use super::{Budget, ColorSpaceArg, TransferArg, Triple, complain, load_material};
use crate::cancel::CancelToken;
use crate::color::{ColorSpace, Transfer};
use crate::error::{Error, Result};
use crate::io::write_image_in;
use crate::render::{render, rendering_memory};
use crate::shot::Shot;

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
    #[arg(long, value_name = "R,G,B", allow_hyphen_values = true)]
    light_intensity: Option<Triple>,
    /// Longer side of the picture in pixels, that of the maps if not given. Larger maps are averaged down to it before rendering; smaller ones are never
    /// enlarged: the picture is then as large as they are, with a warning.
    #[arg(long, allow_negative_numbers = true)]
    size: Option<usize>,
    /// Encoding of a PNG or JPEG; OpenEXR and TIFF files are floats, linear.
    #[arg(long, value_enum, default_value = "srgb")]
    transfer: TransferArg,
    /// Colour space of a linear picture and of the light intensity.
    #[arg(long, value_enum, default_value = "rec709")]
    color_space: ColorSpaceArg,
    /// The picture: .png, .jpg, .tif or .exr.
    #[arg(long, short)]
    out: PathBuf,
    #[command(flatten)]
    budget: Budget,
}

pub fn run(args: &RenderArgs, cancel: &CancelToken) -> Result<()> {
    keep_maps_and_photos(&args.out, &args.material)?;
    let material = load_material(&args.material, &args.budget, cancel)?;
    let (width, height) = (material.width(), material.height());
    if let Some(size) = args.size.filter(|&size| size > width.max(height)) {
        complain(&format!("warning: size: {size} pixels asked for, maps of {width} x {height} are not enlarged"));
    }
    let material = match args.size {
        Some(size) => material.resized(size)?,
        None => material,
    };
    let (transfer, color_space) = (Transfer::from(args.transfer), ColorSpace::from(args.color_space));
    let extension = args.out.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let is_linear = transfer == Transfer::Linear || matches!(extension.as_str(), "exr" | "tif" | "tiff");
    if color_space != ColorSpace::Rec709 && !is_linear {
        let reason =
            format!("{} is for linear pictures, got a .{extension} in {}", color_space.name(), transfer.name());
        return Err(Error::invalid("color_space", reason));
    }
    let distance2: f64 = args.light.0.iter().map(|x| x * x).sum();
    let light_intensity = args.light_intensity.map_or([std::f64::consts::PI * distance2; 3], |intensity| intensity.0);
    let light_intensity = color_space.convert(ColorSpace::Rec709, light_intensity);
    let shot = Shot { camera: args.camera.0, light: args.light.0, light_intensity };
    args.budget.check("rendering", rendering_memory(&material), material.memory())?;
    cancel.check()?;
    let mut picture = render(&material, &shot)?;
    cancel.check()?;
    ColorSpace::Rec709.convert_image(color_space, &mut picture);
    write_image_in(&args.out, &picture, transfer, color_space)
}
