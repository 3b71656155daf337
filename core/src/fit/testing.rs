//! What tests of several stages need.

use crate::capture::Photo;
use crate::image::Image;
use crate::maps::Maps;
use crate::render::render_maps;
use crate::shot::Shot;

/// What `shot` shows of `maps` on a patch of width 2: nothing is saturated.
pub(crate) fn photo(maps: &Maps<f32>, shot: Shot) -> Photo {
    let (width, height) = (maps.width(), maps.height());
    let image = Image::from_planar(width, height, 3, &render_maps(maps, 2.0, &shot).unwrap()).unwrap();
    Photo { name: String::new(), shot, image, saturated: vec![0; width * height] }
}
