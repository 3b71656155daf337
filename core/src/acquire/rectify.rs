//! From a photo to the patch as it looks from straight above, in linear light.

use rayon::prelude::*;

use super::camera::{Lens, Place};
use super::light::Tone;
use crate::cancel::CancelToken;
use crate::color::{Transfer, apply_to_image};
use crate::error::{Error, Result};
use crate::image::Image;
use crate::io::RowReader;
use crate::io::profile::{Decoding, Stated};
use crate::io::{Samples, Stored};
use crate::memory;

use super::tags::Grey;

/// How a photo's stored values become linear, and what is to be said of that: floats are linear, all else is what programs show.
///
/// # Errors
/// [`Error::UnsupportedFormat`] naming the photo, for pictures of HDR video.
pub fn decoding(name: &str, photo: &Stored) -> Result<(Decoding, Option<String>)> {
    let pixels = photo.pixels();
    let transfer = if matches!(pixels.samples, Samples::F32(_)) { Transfer::Linear } else { Transfer::Srgb };
    let stated = Stated { transfer, color_space: None, ignore_profiles: false };
    Decoding::new(stated, photo.colors.as_ref(), pixels.colors())
        .map_err(|got| Error::UnsupportedFormat { name: name.to_owned(), got })
}

/// The brightness of a whole photo: the mean of its channels.
pub fn grey(photo: &Stored, decoding: &Decoding, cancel: &CancelToken) -> Result<Grey> {
    let pixels = photo.pixels();
    let (width, height, colors) = (photo.width, photo.height, pixels.colors());
    let reader = RowReader::new(pixels, decoding, None);
    let mut values = memory::filled(0.0f32, width * height)?;
    values.par_chunks_exact_mut(width).enumerate().try_for_each_init(
        || vec![0.0f32; width * colors],
        |row, (y, out)| {
            cancel.check()?;
            reader.read(y, row, None);
            for (out, pixel) in out.iter_mut().zip(row.chunks_exact(colors)) {
                let mean = pixel.iter().sum::<f32>() / colors as f32;
                *out = if mean.is_finite() { mean } else { 0.0 };
            }
            Ok(())
        },
    )?;
    Ok(Grey { width, height, values })
}

/// What values that were decoded as sRGB stand for, by a tone curve.
pub struct ToneTable {
    /// At equal steps of the square root; none for sRGB's own curve.
    values: Vec<f32>,
}

/// Steps of a [`ToneTable`]: more than codes have.
const TONE_STEPS: usize = 4096;

impl ToneTable {
    pub fn new(tone: Tone) -> Self {
        let value = |i: usize| tone.corrected((i as f64 / TONE_STEPS as f64).powi(2)) as f32;
        Self { values: if tone == Tone::default() { Vec::new() } else { (0..=TONE_STEPS).map(value).collect() } }
    }

    fn at(&self, value: f32) -> f32 {
        if self.values.is_empty() || !(0.0..1.0).contains(&value) {
            return value;
        }
        let place = value.sqrt() * TONE_STEPS as f32;
        let i = (place as usize).min(TONE_STEPS - 1);
        self.values[i] + (place - i as f32) * (self.values[i + 1] - self.values[i])
    }
}

/// The part of a photo around some of its points.
pub struct Part {
    left: usize,
    top: usize,
    image: Image,
    saturated: Vec<u8>,
}

impl Part {
    /// The part that `points`, in pixels from the upper left corner, lie in; `None` if they do not lie in the photo. Without a tone curve in the file's own primaries, else
    /// corrected by it and in Rec. 709.
    pub fn around(
        photo: &Stored,
        decoding: &Decoding,
        tone: Option<&ToneTable>,
        points: &[[f64; 2]],
        cancel: &CancelToken,
    ) -> Result<Option<Self>> {
        let bound = |i: usize, least: bool| {
            let values = points.iter().map(|point| point[i]);
            if least {
                values.fold(f64::INFINITY, f64::min).floor() - 1.0
            } else {
                values.fold(f64::NEG_INFINITY, f64::max).ceil() + 1.0
            }
        };
        let [left, top] = [bound(0, true), bound(1, true)];
        let [right, bottom] = [bound(0, false), bound(1, false)];
        let inside = left >= 0.0 && top >= 0.0 && right <= photo.width as f64 && bottom <= photo.height as f64;
        if !inside {
            return Ok(None);
        }
        let [left, top, right, bottom] = [left, top, right, bottom].map(|x| x as usize);
        let (width, height) = (right - left, bottom - top);
        let (pixels, colors) = (photo.pixels(), photo.pixels().colors());
        let reader = RowReader::new(pixels, decoding, None);
        let mut values = memory::filled(0.0f32, 3 * width * height)?;
        let mut saturated = memory::filled(0u8, width * height)?;
        let rows = values.par_chunks_exact_mut(3 * width).zip(saturated.par_chunks_exact_mut(width));
        rows.enumerate().try_for_each_init(
            || (vec![0.0f32; photo.width * colors], vec![0u8; photo.width]),
            |(row, mask), (y, (out, bits))| {
                cancel.check()?;
                reader.read(top + y, row, Some(mask));
                let part = &row[left * colors..right * colors];
                for (out, pixel) in out.chunks_exact_mut(3).zip(part.chunks_exact(colors)) {
                    (0..3).for_each(|c| out[c] = pixel[c % colors]);
                }
                bits.copy_from_slice(&mask[left..right]);
                if colors == 1 {
                    bits.iter_mut().for_each(|bits| *bits *= 7);
                }
                Ok(())
            },
        )?;
        if let Some(tone) = tone {
            values.par_iter_mut().for_each(|value| *value = tone.at(*value));
        }
        let mut image = Image::new(width, height, 3, values)?;
        if let (Some(to_rec709), Some(_)) = (&decoding.to_rec709, tone) {
            apply_to_image(to_rec709, &mut image);
            // A conversion mixes the channels.
            saturated.iter_mut().for_each(|bits| *bits = if *bits == 0 { 0 } else { 7 });
        }
        if let Some(at) = image.data().iter().position(|value| !value.is_finite()) {
            return Err(Error::invalid(
                "photo",
                format!("pixel value {} in row {}", image.data()[at], top + at / (3 * width)),
            ));
        }
        Ok(Some(Self { left, top, image, saturated }))
    }

    /// The colour at a point of the photo, between pixels linear, and the channels that are saturated in any of them.
    pub fn at(&self, [x, y]: [f64; 2]) -> ([f64; 3], u8) {
        let (width, height) = (self.image.width(), self.image.height());
        let x = (x - self.left as f64 - 0.5).clamp(0.0, (width - 1) as f64);
        let y = (y - self.top as f64 - 0.5).clamp(0.0, (height - 1) as f64);
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f64, y - row as f64);
        let (right, below) = ((column + 1).min(width - 1), (row + 1).min(height - 1));
        let mut color = [0.0; 3];
        let mut bits = 0;
        for (row, column, weight) in [
            (row, column, (1.0 - fy) * (1.0 - fx)),
            (row, right, (1.0 - fy) * fx),
            (below, column, fy * (1.0 - fx)),
            (below, right, fy * fx),
        ] {
            let p = row * width + column;
            (0..3).for_each(|c| color[c] += weight * f64::from(self.image.data()[3 * p + c]));
            if weight > 0.0 {
                bits |= self.saturated[p];
            }
        }
        (color, bits)
    }
}

/// The map from the sheet's plane to a photo.
pub struct View<'a> {
    pub lens: &'a Lens,
    pub place: &'a Place,
    /// Columns and rows of the photo.
    pub size: [usize; 2],
}

impl View<'_> {
    /// Where a point of the sheet's frame is in the photo, in pixels from its upper left corner.
    pub fn pixel(&self, point: [f64; 3]) -> [f64; 2] {
        let [x, y] = self.place.project(self.lens, point);
        [x + self.size[0] as f64 / 2.0, y + self.size[1] as f64 / 2.0]
    }
}

/// The square of `width` around the origin, `depth` below the sheet, as `side` x `side` pixels, with its saturation; `None` if it is not all in the photo.
///
/// Every pixel is the mean over a grid of places in its square that are no farther apart than the photo's pixels.
pub fn rectified(
    photo: &Stored,
    (decoding, tone): (&Decoding, &ToneTable),
    view: &View<'_>,
    (width, depth, side): (f64, f64, usize),
    cancel: &CancelToken,
) -> Result<Option<(Image, Vec<u8>)>> {
    let half = width / 2.0;
    // With lenses that bend lines the middle of a side may lie farther out than its ends.
    let along = (0..=16).map(|i| f64::from(i) / 8.0 - 1.0);
    let outline: Vec<[f64; 2]> = along
        .flat_map(|t| [[t, 1.0], [t, -1.0], [1.0, t], [-1.0, t]])
        .map(|[x, y]| view.pixel([half * x, half * y, -depth]))
        .collect();
    let Some(part) = Part::around(photo, decoding, Some(tone), &outline, cancel)? else { return Ok(None) };
    let pitch = width / side as f64;
    let grid = (pixels_across(view, width, depth) / side as f64).ceil().max(1.0) as usize;
    let mut values = memory::filled(0.0f32, 3 * side * side)?;
    let mut saturated = memory::filled(0u8, side * side)?;
    let rows = values.par_chunks_exact_mut(3 * side).zip(saturated.par_iter_mut().chunks(side));
    rows.enumerate().try_for_each(|(row, (out, mut bits))| {
        cancel.check()?;
        for (column, out) in out.chunks_exact_mut(3).enumerate() {
            let mut sum = [0.0; 3];
            for i in 0..grid * grid {
                let place = |cell: usize, step: usize| cell as f64 + (step as f64 + 0.5) / grid as f64;
                let (x, y) = (place(column, i % grid) * pitch - half, half - place(row, i / grid) * pitch);
                let (color, full) = part.at(view.pixel([x, y, -depth]));
                (0..3).for_each(|c| sum[c] += color[c]);
                *bits[column] |= full;
            }
            (0..3).for_each(|c| out[c] = (sum[c] / (grid * grid) as f64) as f32);
        }
        Ok(())
    })?;
    Ok(Some((Image::new(side, side, 3, values)?, saturated)))
}

/// How many pixels of the photo lie across the square of `width`, where it is nearest.
pub fn pixels_across(view: &View<'_>, width: f64, depth: f64) -> f64 {
    let half = width / 2.0;
    let corners = [[-half, half], [half, half], [half, -half], [-half, -half]].map(|[x, y]| view.pixel([x, y, -depth]));
    let side = |i: usize| {
        let (a, b) = (corners[i], corners[(i + 1) % 4]);
        (a[0] - b[0]).hypot(a[1] - b[1])
    };
    (0..4).map(side).fold(0.0, f64::max)
}
