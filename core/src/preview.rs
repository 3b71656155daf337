//! The picture that shows a person what a fit came to.

use std::path::Path;

use crate::color::Transfer;
use crate::error::{Error, Result};
use crate::image::Image;
use crate::io::png8;
use crate::io::resize::{fit_size, shrink};
use crate::material::Material;
use crate::metrics::photo_rmse;
use crate::picture::{Picture, on_screen};
use crate::render::render;
use crate::shot::Shot;

/// The longer side of a panel in pixels.
const PANEL: usize = 256;
/// Between panels and around them.
const MARGIN: usize = 12;
/// Height of the line above a panel.
const LABEL: usize = 24;
const BACKGROUND: f32 = 0.12;
const INK: f32 = 0.92;

/// A photo beside the material rendered as it was taken; both linear, (H, W, 3), of the same size.
#[derive(Clone, Copy, Debug)]
pub struct Comparison<'a> {
    /// The photo's name.
    pub name: &'a str,
    /// The photo.
    pub photo: &'a Image,
    /// The material under the photo's camera and light.
    pub rendering: &'a Image,
}

/// Composes the preview: the maps side by side, below them photos beside their renderings with the error of each, and to the right of all a
/// view that is no photo, in double size.
///
/// Colours are sRGB-encoded for the screen and clamped to [0, 1]; roughness, normal (n + 1) / 2 and tangent are shown as stored. Large
/// images are resampled by area, small ones enlarged pixel by pixel. The result is (H, W, 3) in screen values.
///
/// # Errors
/// [`Error::ShapeMismatch`] if an image that must be RGB is not, or a rendering differs from its photo in size.
pub fn preview(material: &Material, comparisons: &[Comparison<'_>], new_view: &Image) -> Result<Image> {
    let mut maps = vec![
        panel("diffuse", PANEL, &material.diffuse_albedo, on_screen)?,
        panel("specular", PANEL, &material.specular_albedo, on_screen)?,
        panel("roughness", PANEL, &material.roughness, as_stored)?,
        panel("normal", PANEL, &material.normal, half_range)?,
    ];
    if let Some(tangent) = &material.tangent {
        maps.push(panel("tangent", PANEL, tangent, half_range)?);
    }
    let mut rows = vec![maps];
    for pair in comparisons.chunks(2) {
        let mut row = Vec::new();
        for &Comparison { name, photo, rendering } in pair {
            let error = photo_rmse(rendering, photo)?;
            row.push(panel(&format!("photo {name}"), PANEL, photo, on_screen)?);
            row.push(panel(&format!("rendered, RMSE {error:.3}"), PANEL, rendering, on_screen)?);
        }
        rows.push(row);
    }
    let large = panel("new view", 2 * PANEL, new_view, on_screen)?;

    let across = |row: &[Panel]| row.iter().map(|panel| panel.image.width() + MARGIN).sum::<usize>();
    let down = |row: &[Panel]| row.iter().map(|panel| panel.image.height()).max().unwrap_or(0) + LABEL + MARGIN;
    let left = rows.iter().map(|row| across(row)).max().unwrap_or(0);
    let width = MARGIN + left + large.image.width() + MARGIN;
    let height = MARGIN + rows.iter().map(|row| down(row)).sum::<usize>().max(large.image.height() + LABEL + MARGIN);

    let mut canvas = Picture::new(width, height, [BACKGROUND; 3])?;
    let mut y = MARGIN;
    for row in &rows {
        let mut x = MARGIN;
        for panel in row {
            panel.draw(&mut canvas, x, y);
            x += panel.image.width() + MARGIN;
        }
        y += down(row);
    }
    large.draw(&mut canvas, MARGIN + left, MARGIN);
    Ok(canvas.into_image())
}

/// The bytes of a PNG file with the maps of a material side by side and a view of it under a light at the upper left, for hosts that show
/// pictures themselves.
///
/// # Errors
/// As [`preview`].
pub fn material_png(material: &Material) -> Result<Vec<u8>> {
    let above = [0.0, 0.0, 2.0 * material.patch_size];
    let light_intensity = [std::f64::consts::PI * above[2] * above[2]; 3];
    let view = new_view(&Shot { camera: above, light: above, light_intensity });
    let picture = preview(material, &[], &render(material, &view)?)?;
    png8(Path::new("preview"), &picture, Transfer::Linear)
}

/// The camera straight above the centre, as far as that of `shot`; the light 40 degrees off at the upper left, as bright at the centre.
pub(crate) fn new_view(shot: &Shot) -> Shot {
    let distance = |p: [f64; 3]| p.iter().map(|x| x * x).sum::<f64>().sqrt();
    let (far, light_far) = (distance(shot.camera), distance(shot.light));
    let (sin, cos) = 40f64.to_radians().sin_cos();
    let side = light_far * sin / 2f64.sqrt();
    Shot { camera: [0.0, 0.0, far], light: [-side, side, light_far * cos], light_intensity: shot.light_intensity }
}

/// An image in screen values with a line of text above.
struct Panel {
    label: String,
    image: Image,
}

fn as_stored(value: f32) -> f32 {
    value.clamp(0.0, 1.0)
}

fn half_range(value: f32) -> f32 {
    as_stored((value + 1.0) / 2.0)
}

/// A panel whose longer side is at most `side`: the image shrunk by area or enlarged by a whole number, then its values for the screen. One
/// channel is shown as grey, two as red and green.
fn panel(label: &str, side: usize, image: &Image, screen: impl Fn(f32) -> f32) -> Result<Panel> {
    let (full, channels) = ((image.width(), image.height()), image.channels());
    if !(1..=3).contains(&channels) {
        return Err(Error::shape(label, "1 to 3 channels", channels.to_string()));
    }
    let size = fit_size(full.0, full.1, Some(side));
    let (values, _) = shrink(full, size, channels, |y, row, _| {
        row.copy_from_slice(&image.data()[y * full.0 * channels..(y + 1) * full.0 * channels]);
        Ok(())
    })?;
    let scale = (side / size.0.max(size.1)).max(1);
    let (width, height) = (size.0 * scale, size.1 * scale);
    let mut data = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        for x in 0..width {
            let pixel = &values[(y / scale * size.0 + x / scale) * channels..][..channels];
            data.extend((0..3).map(|c| match (channels, c) {
                (1, _) => screen(pixel[0]),
                (2, 2) => 0.0,
                (_, c) => screen(pixel[c]),
            }));
        }
    }
    Ok(Panel { label: label.to_owned(), image: Image::new(width, height, 3, data)? })
}

impl Panel {
    /// Draws the panel with its upper left corner, the label's, at (x, y).
    fn draw(&self, canvas: &mut Picture, x: usize, y: usize) {
        canvas.text([x, y], self.image.width(), &self.label, [INK; 3]);
        canvas.image(&self.image, [x, y + LABEL]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(width: usize, height: usize, rgb: [f32; 3]) -> Image {
        Image::new(width, height, 3, rgb.repeat(width * height)).unwrap()
    }

    #[test]
    fn panels_lie_where_they_should() {
        let (width, height) = (32, 16);
        let material = Material {
            diffuse_albedo: flat(width, height, [0.5, 0.25, 0.0]),
            specular_albedo: flat(width, height, [0.04; 3]),
            roughness: Image::new(width, height, 1, vec![0.3; width * height]).unwrap(),
            normal: flat(width, height, [0.0, 0.0, 1.0]),
            tangent: None,
            patch_size: 1.0,
            unit: None,
            warnings: Vec::new(),
        };
        let photo = flat(width, height, [0.2; 3]);
        let rendering = flat(width, height, [9.0, 0.0, 0.2]);
        let pair = Comparison { name: "00.png", photo: &photo, rendering: &rendering };
        let picture = preview(&material, &[pair, pair, pair], &flat(64, 64, [1.0; 3])).unwrap();
        // Four panels of 256 x 128 (the maps enlarged eight times), three rows of them, and the large one of 512 x 512.
        assert_eq!(picture.width(), MARGIN + 4 * (256 + MARGIN) + 512 + MARGIN);
        assert_eq!(picture.height(), MARGIN + 512 + LABEL + MARGIN);
        let at = |x: usize, y: usize| picture.data()[(y * picture.width() + x) * 3..][..3].to_vec();
        let panel = |column: usize, row: usize| {
            at(MARGIN + column * (256 + MARGIN) + 255, MARGIN + row * (128 + LABEL + MARGIN) + LABEL + 127)
        };
        let srgb = |v: f32| Transfer::Srgb.encode(v);
        assert_eq!(panel(0, 0), [srgb(0.5), srgb(0.25), 0.0]);
        assert_eq!(panel(1, 0), [srgb(0.04); 3]);
        assert_eq!(panel(2, 0), [0.3; 3]);
        assert_eq!(panel(3, 0), [0.5, 0.5, 1.0]);
        assert_eq!(panel(2, 1), [srgb(0.2); 3]);
        assert_eq!(panel(3, 1), [1.0, 0.0, srgb(0.2)]);
        assert_eq!(panel(1, 2), [1.0, 0.0, srgb(0.2)]);
        assert_eq!(panel(2, 2), [BACKGROUND; 3]);
        assert_eq!(at(picture.width() - MARGIN - 1, MARGIN + LABEL), [srgb(1.0); 3]);
        // The D of "diffuse": its first column is set, the pixel left of it is not.
        assert_eq!(at(MARGIN, MARGIN), [INK; 3]);
        assert_eq!(at(MARGIN - 1, MARGIN), [BACKGROUND; 3]);

        let small = flat(8, 8, [0.0; 3]);
        let mismatch = Comparison { name: "00.png", photo: &photo, rendering: &small };
        assert!(preview(&material, &[mismatch], &small).is_err());
    }
}
