//! The picture beside the maps.

use crate::cancel::CancelToken;
use crate::capture::{Capture, Photo};
use crate::error::Result;
use crate::image::Image;
use crate::material::Material;
use crate::preview::{self, Comparison, new_view};
use crate::render::render;
use crate::shot::Shot;

/// Photos shown beside their re-renderings.
const COMPARED: usize = 2;

/// Maps, the first and the last photo beside their re-renderings, and a view with the light at the upper left.
pub fn preview(material: &Material, capture: &Capture, cancel: &CancelToken) -> Result<Image> {
    let photos = capture.photos();
    let shown: Vec<&Photo> = photos.iter().step_by((photos.len() - 1).max(1)).take(COMPARED).collect();
    let render = |shot: &Shot| {
        cancel.check()?;
        render(material, shot)
    };
    let renderings = shown.iter().map(|photo| render(&photo.shot)).collect::<Result<Vec<_>>>()?;
    let comparisons: Vec<Comparison<'_>> = shown
        .iter()
        .zip(&renderings)
        .map(|(photo, rendering)| Comparison { name: &photo.name, photo: &photo.image, rendering })
        .collect();
    preview::preview(material, &comparisons, &render(&new_view(&photos[0].shot))?)
}
