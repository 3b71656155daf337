//! The picture beside the maps.

use std::path::Path;

use crate::capture::{Capture, Photo, Shot};
use crate::error::Result;
use crate::io::preview::{Comparison, preview_png};
use crate::material::Material;
use crate::render::render;

/// Photos shown beside their re-renderings.
const COMPARED: usize = 2;

/// Writes maps, the first and the last photo beside their re-renderings, and a view with the light at the upper left.
pub fn write(path: &Path, material: &Material, capture: &Capture) -> Result<()> {
    let photos = capture.photos();
    let shown: Vec<&Photo> = photos.iter().step_by((photos.len() - 1).max(1)).take(COMPARED).collect();
    let renderings = shown.iter().map(|photo| render(material, &photo.shot)).collect::<Result<Vec<_>>>()?;
    let comparisons: Vec<Comparison<'_>> = shown
        .iter()
        .zip(&renderings)
        .map(|(photo, rendering)| Comparison { name: &photo.name, photo: &photo.image, rendering })
        .collect();
    preview_png(path, material, &comparisons, &render(material, &new_shot(&photos[0].shot))?)
}

/// The camera straight above the centre, as far as that of `shot`; the light 40 degrees off at the upper left, as bright at the centre.
fn new_shot(shot: &Shot) -> Shot {
    let distance = |p: [f64; 3]| p.iter().map(|x| x * x).sum::<f64>().sqrt();
    let (far, light_far) = (distance(shot.camera), distance(shot.light));
    let (sin, cos) = 40f64.to_radians().sin_cos();
    let side = light_far * sin / 2f64.sqrt();
    Shot { camera: [0.0, 0.0, far], light: [-side, side, light_far * cos], light_intensity: shot.light_intensity }
}
