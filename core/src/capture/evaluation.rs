//! A material as a photo of a capture would show it.

use super::Capture;
use crate::error::{Error, Result};
use crate::image::Image;
use crate::material::Material;
use crate::render::rendered;
use crate::unit::Unit;

/// [`render`](crate::render::render) as photo `index` of `capture`, counted from 0, was taken.
///
/// The material and the photos must show the same patch. Widths in known units are compared as lengths, to a thousandth; the photo's
/// positions count in the capture's unit. Where a unit is not stated, or both are the same one, the numbers must agree.
///
/// # Errors
/// [`Error::InvalidArgument`] naming both widths if they differ or their units cannot be converted, and for a photo that does not exist; as [`render`](crate::render::render).
pub fn render_photo(material: &Material, capture: &Capture, index: usize) -> Result<Image> {
    let count = capture.len();
    let photo = capture.photos().get(index);
    let photo = photo.ok_or_else(|| {
        Error::invalid("index", format!("photo {index} of a capture of {count} photos, counted from 0"))
    })?;
    check_patch(material, capture)?;
    rendered(material, capture.patch_size(), &photo.shot)
}

/// How far the widths of a material and of a capture may differ, as a share.
const PATCH_SLACK: f64 = 1e-3;

/// Fails unless the patches of both are equally wide.
fn check_patch(material: &Material, capture: &Capture) -> Result<()> {
    let (ours, theirs) = (material.unit.as_ref(), capture.unit());
    let factor = match (ours, theirs) {
        (Some(ours), Some(theirs)) => ours.factor_to(theirs),
        _ => Some(1.0),
    };
    let (width, expected) = (material.patch_size, capture.patch_size());
    if factor.is_some_and(|factor| (width * factor - expected).abs() <= PATCH_SLACK * expected) {
        return Ok(());
    }
    let told = |width: f64, unit: Option<&Unit>| match unit {
        Some(unit) => format!("{width} {unit}"),
        None => format!("{width} (no unit stated)"),
    };
    let (width, expected) = (told(width, ours), told(expected, theirs));
    let advice = "state the units, mm, cm, m or in, in material.json and capture.json, or fit the capture anew";
    Err(Error::invalid(
        "patch_size",
        format!("the capture's patch is {expected} wide, the material's {width}: {advice}"),
    ))
}
