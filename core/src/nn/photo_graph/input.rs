//! What the network sees of a photo.

use std::f64::consts::PI;
use std::ops::Range;

use rayon::prelude::*;

use super::config::{INPUTS, RATIO_MAX};
use super::mirror::Mirror;
use crate::capture::Photo;
use crate::color::GAMMA;
use crate::error::Result;
use crate::nn::layout::Layout;
use crate::nn::tape::{Planes, Pool};
use crate::shot::Shot;

/// Smallest radiance of the white surface, and smallest ratio to it.
const WHITE_MIN: f64 = 1e-4;
const RATIO_MIN: f32 = 1e-6;

/// How a photo is shown to the network.
#[derive(Clone, Copy, Debug)]
pub(super) struct View {
    pub mirror: Mirror,
    /// The mean of so many pixels in each direction makes one.
    pub step: usize,
}

/// The [`INPUTS`] planes of a photo of a patch `patch_size` wide, zero beyond the photo. `layout` has as many channels.
///
/// Planes: the photo in gamma 2.2, clamped to [0, 1], 3; the gamma 2.2 encoding of its ratio to what a white diffuse patch facing +z would
/// show, at most 4, 3; saturation, 1; direction to the light, 3; half vector, 3 (`network_input` in `tests/training/fixture.py`). Half the
/// width of the patch is the unit of length.
pub(super) fn planes(
    photo: &Photo,
    patch_size: f64,
    View { mirror, step }: View,
    layout: Layout,
    pool: &Pool<f32>,
) -> Result<Planes<f32>> {
    let (width, height) = (photo.image.width(), photo.image.height());
    let view = PhotoView::new(&mirror.shot(&photo.shot), patch_size);
    let mut out = pool.take(layout.len());
    out.par_chunks_mut(layout.band_len()).enumerate().for_each(|(band, out)| {
        out.fill(0.0);
        let rows = layout.band_rows(band);
        let plane = rows.len() * layout.width;
        debug_assert_eq!(out.len(), INPUTS * plane);
        for row in rows.start..rows.end.min(height.div_ceil(step)) {
            let lines = row * step..height.min((row + 1) * step);
            let y =
                -((lines.start + lines.end) as f64 / 2.0 / height as f64 - 0.5) * 2.0 * height as f64 / width as f64;
            let start = (row - rows.start) * layout.width;
            for column in 0..width.div_ceil(step) {
                let columns = column * step..width.min((column + 1) * step);
                let x = ((columns.start + columns.end) as f64 / 2.0 / width as f64 - 0.5) * 2.0;
                let (linear, saturated) = mean(photo, mirror, lines.clone(), columns);
                for (channel, value) in view.planes(linear, saturated, x, y).into_iter().enumerate() {
                    out[channel * plane + start + column] = value;
                }
            }
        }
    });
    Planes::of(out, layout)
}

/// The mean radiance of pixels that are seen in a mirror, and whether more than half of them are saturated.
fn mean(photo: &Photo, mirror: Mirror, rows: Range<usize>, columns: Range<usize>) -> ([f32; 3], bool) {
    let (width, height) = (photo.image.width(), photo.image.height());
    let count = rows.len() * columns.len();
    let (mut sum, mut saturated) = ([0.0; 3], 0);
    for row in rows {
        for column in columns.clone() {
            let pixel = mirror.row(row, height) * width + mirror.column(column, width);
            let values = &photo.image.data()[3 * pixel..3 * pixel + 3];
            sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
            saturated += usize::from(photo.saturated[pixel] != 0);
        }
    }
    (sum.map(|sum| sum / count as f32), 2 * saturated > count)
}

/// A shot as the network sees it: half the width of the patch is the unit of length.
pub(crate) struct PhotoView {
    camera: [f64; 3],
    light: [f64; 3],
    /// Radiance of the white surface where light falls straight on it from the distance 1.
    white: [f64; 3],
}

impl PhotoView {
    pub fn new(shot: &Shot, patch_size: f64) -> Self {
        let unit = patch_size / 2.0;
        Self {
            camera: shot.camera.map(|value| value / unit),
            light: shot.light.map(|value| value / unit),
            white: shot.light_intensity.map(|value| value / (unit * unit * PI)),
        }
    }

    /// What the network sees of the pixel at (x, y) that shows `linear` radiance, in the order of [`planes`].
    #[inline]
    pub fn planes(&self, linear: [f32; 3], saturated: bool, x: f64, y: f64) -> [f32; INPUTS] {
        let ratio_max = RATIO_MAX.powf(GAMMA) as f32;
        let root = (1.0 / GAMMA) as f32;
        let (to_light, distance2) = direction(self.light, x, y);
        let (view, _) = direction(self.camera, x, y);
        let sum = [0, 1, 2].map(|axis| view[axis] + to_light[axis]);
        let half = scaled(sum, 1.0 / square(sum).max(1e-30).sqrt());
        let falloff = to_light[2].max(0.0) / distance2;
        let mut out = [0.0; INPUTS];
        for channel in 0..3 {
            let linear = linear[channel].clamp(0.0, 1.0);
            let ratio = linear / (self.white[channel] * falloff).max(WHITE_MIN) as f32;
            out[channel] = linear.powf(root);
            out[3 + channel] = ratio.clamp(RATIO_MIN, ratio_max).powf(root);
            out[7 + channel] = to_light[channel] as f32;
            out[10 + channel] = half[channel] as f32;
        }
        out[6] = f32::from(u8::from(saturated));
        out
    }
}

fn square(v: [f64; 3]) -> f64 {
    v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
}

fn scaled(v: [f64; 3], factor: f64) -> [f64; 3] {
    v.map(|value| value * factor)
}

/// The unit vector from (x, y, 0) to `position`, and the squared distance.
fn direction(position: [f64; 3], x: f64, y: f64) -> ([f64; 3], f64) {
    let to = [position[0] - x, position[1] - y, position[2]];
    let distance2 = square(to);
    (scaled(to, 1.0 / distance2.max(1e-30).sqrt()), distance2)
}
