//! OpenEXR, in and out. A file is the picture in its display window; pixels of the display window that the data window leaves
//! out are black, as the format defines.

use std::io::{Cursor, Read, Seek};
use std::path::Path;

use exr::image::read::read;
use exr::image::write::WritableImage;
use exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image as ExrImage, Layer};
use exr::math::Vec2;
use exr::meta::attribute;
use exr::meta::header::LayerAttributes;
use exr::prelude::{ReadChannels, ReadLayers, f16};
use image::metadata::Orientation;

use super::decode::{Demand, OwnedSamples, Stored, broken, check_size, unsupported};
use super::exif::CameraData;
use super::ours::SOFTWARE;
use super::profile::FileColors;
use crate::cancel::{CancelToken, Cancellable};
use crate::color::{Chromaticities, ColorSpace};
use crate::error::{Error, Result};
use crate::memory;

/// How the values of a written file are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Precision {
    Half,
    Float,
}

/// The decoder's arithmetic overflows on some hostile files (B44), which is a panic where overflow checks are on: that is an error of the file.
pub(super) fn decode(path: &Path, bytes: &[u8], cancel: &CancelToken) -> Result<Stored> {
    std::panic::catch_unwind(|| decode_unguarded(path, bytes, cancel))
        .unwrap_or_else(|_| Err(broken(path, "values that no OpenEXR file has")))
}

fn decode_unguarded(path: &Path, bytes: &[u8], cancel: &CancelToken) -> Result<Stored> {
    let error = |e| exr_error(path, e);
    let reader = exr::block::read(Cancellable::new(Cursor::new(bytes), cancel), false).map_err(error)?;
    // One part is read, with all its channels; the picture takes up to three of them.
    for header in reader.headers() {
        let bytes_per_pixel = 4 * header.channels.list.len() as u64;
        for size in [header.layer_size, header.shared_attributes.display_window.size] {
            check_size(path, size.width() as u64, size.height() as u64, bytes_per_pixel, bytes.len() as u64)?;
        }
    }
    let Some(attributes) = reader.headers().first().map(|header| &header.shared_attributes) else {
        return Err(broken(path, "no image in the file"));
    };
    let display = attributes.display_window;
    let colors = attributes.chromaticities.map(|c| FileColors::Chromaticities {
        chromaticities: Chromaticities {
            primaries: [c.red, c.green, c.blue].map(|xy| [xy.x().into(), xy.y().into()]),
            white: [c.white.x().into(), c.white.y().into()],
        },
        gamma: None,
        source: "the chromaticities of the OpenEXR file",
    });

    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_chunks(reader)
        .map_err(error)?;
    let layer = image.layer_data;
    let names: Vec<String> = layer.channel_data.list.iter().map(|channel| channel.name.to_string()).collect();
    let find = |name: &str| names.iter().position(|other| other == name);
    let rgb = ["R", "G", "B"].map(|name| (name, find(name)));
    let missing: Vec<&str> = rgb.iter().filter(|(_, place)| place.is_none()).map(|&(name, _)| name).collect();
    let is_grey = missing.len() == 3 && find("Y").is_some();
    // Luminance with chroma, and CIE XYZ.
    let is_other = ["RY", "BY", "X", "Z"].iter().filter(|name| find(name).is_some()).count() == 2;
    if !(missing.len() <= 1 || is_grey && !is_other) {
        let read = "read are R, G and B, or Y alone: convert other colours to them";
        return Err(unsupported(path, format!("channels {}; {read}", names.join(", "))));
    }
    let picked = if is_grey { vec![find("Y")] } else { rgb.map(|(_, place)| place).to_vec() };

    let mut notes = Vec::new();
    if let (&[name], false) = (missing.as_slice(), is_grey) {
        notes.push(format!("no channel {name}, only {}: read as 0", names.join(", ")));
    }
    if find("A").is_some() {
        notes.push("alpha ignored".to_owned());
    }
    let window = Window {
        width: display.size.width(),
        height: display.size.height(),
        offset_x: i64::from(layer.attributes.layer_position.x()) - i64::from(display.position.x()),
        offset_y: i64::from(layer.attributes.layer_position.y()) - i64::from(display.position.y()),
        data_width: layer.size.width(),
        data_height: layer.size.height(),
    };
    if !window.is_filled() {
        notes.push("the data window leaves out part of the display window: read as 0".to_owned());
    }
    let mut values = memory::filled(0.0, window.width * window.height * picked.len())?;
    for (c, &index) in picked.iter().enumerate() {
        let Some(index) = index else { continue };
        match &layer.channel_data.list[index].sample_data {
            FlatSamples::F16(samples) => window.place(samples, |v| v.to_f32(), &mut values, c, picked.len()),
            FlatSamples::F32(samples) => window.place(samples, |v| v, &mut values, c, picked.len()),
            FlatSamples::U32(_) => return Err(unsupported(path, "integer channels; read are half and float")),
        }
    }
    let (width, height) = (window.width, window.height);
    Ok(Stored {
        width,
        height,
        channels: picked.len(),
        samples: OwnedSamples::F32(values),
        colors,
        camera: CameraData::default(),
        notes,
    })
}

/// What reading takes: all channels of the first part, and beside them the picture.
pub(super) fn demand(path: &Path, reader: impl Read + Seek, file_bytes: u64) -> Result<Demand> {
    let reader = exr::block::read(reader, false).map_err(|e| exr_error(path, e))?;
    let Some(header) = reader.headers().first() else { return Err(broken(path, "no image in the file")) };
    let size = header.shared_attributes.display_window.size;
    let is_color = header.channels.list.iter().any(|channel| ["R", "G", "B"].contains(&&*channel.name.to_string()));
    let colors = if is_color { 3 } else { 1 };
    let pixels = (size.width() as u64).saturating_mul(size.height() as u64);
    let data = (header.layer_size.width() as u64).saturating_mul(header.layer_size.height() as u64);
    check_size(path, size.width() as u64, size.height() as u64, 4 * colors as u64, file_bytes)?;
    let all = data.saturating_mul(header.channels.bytes_per_pixel as u64);
    let stored = 4 * colors as u64 * pixels;
    Ok(Demand::new(
        (size.width(), size.height()),
        colors,
        stored,
        file_bytes.saturating_add(all),
        Orientation::NoTransforms,
    ))
}

/// The display window, and where the data window lies in it.
struct Window {
    width: usize,
    height: usize,
    offset_x: i64,
    offset_y: i64,
    data_width: usize,
    data_height: usize,
}

impl Window {
    /// Whether the data window covers the display window.
    fn is_filled(&self) -> bool {
        self.offset_x <= 0
            && self.offset_y <= 0
            && self.offset_x + self.data_width as i64 >= self.width as i64
            && self.offset_y + self.data_height as i64 >= self.height as i64
    }

    /// Copies the data window's samples of one channel to where they lie in the display window.
    fn place<T: Copy>(
        &self,
        samples: &[T],
        value: impl Fn(T) -> f32,
        out: &mut [f32],
        channel: usize,
        channels: usize,
    ) {
        for y in 0..self.height {
            let data_y = y as i64 - self.offset_y;
            if data_y < 0 || data_y >= self.data_height as i64 {
                continue;
            }
            let start = self.offset_x.max(0);
            let end = (self.offset_x + self.data_width as i64).min(self.width as i64);
            for x in start..end {
                let sample = samples[data_y as usize * self.data_width + (x - self.offset_x) as usize];
                out[(y * self.width + x as usize) * channels + channel] = value(sample);
            }
        }
    }
}

fn exr_error(path: &Path, error: exr::error::Error) -> Error {
    match error {
        exr::error::Error::NotSupported(reason) => unsupported(path, reason),
        exr::error::Error::Io(error) => Error::io(path, error),
        error => broken(path, error),
    }
}

/// An OpenEXR file of the named channels, losslessly compressed. `color_space` is stated where it is not Rec. 709, which is what the format
/// means by nothing.
pub(super) fn encode(
    path: &Path,
    width: usize,
    height: usize,
    channels: &[(&str, Vec<f32>)],
    precision: Precision,
    color_space: ColorSpace,
) -> Result<Vec<u8>> {
    let list = channels
        .iter()
        .map(|(name, values)| {
            let samples = match precision {
                Precision::Half => {
                    FlatSamples::F16(memory::collected(values.len(), values.iter().copied().map(f16::from_f32))?)
                }
                Precision::Float => FlatSamples::F32(memory::collected(values.len(), values.iter().copied())?),
            };
            Ok(AnyChannel::new(*name, samples))
        })
        .collect::<Result<_>>()?;
    let attributes = LayerAttributes { software_name: Some(SOFTWARE.into()), ..LayerAttributes::default() };
    let layer = Layer::new(Vec2(width, height), attributes, Encoding::SMALL_LOSSLESS, AnyChannels::sort(list));
    let mut bytes = Cursor::new(Vec::new());
    let mut image = ExrImage::from_layer(layer);
    if color_space != ColorSpace::Rec709 {
        let Chromaticities { primaries, white } = color_space.chromaticities();
        let [red, green, blue, white] =
            [primaries[0], primaries[1], primaries[2], white].map(|[x, y]| Vec2(x as f32, y as f32));
        image.attributes.chromaticities = Some(attribute::Chromaticities { red, green, blue, white });
    }
    image.write().non_parallel().to_buffered(&mut bytes).map_err(|e| exr_error(path, e))?;
    Ok(bytes.into_inner())
}

#[cfg(test)]
mod tests {
    use exr::meta::attribute::LineOrder;
    use exr::prelude::{Blocks, Compression};

    use super::*;

    #[test]
    fn a_hostile_b44_block_is_no_panic() {
        let noise = (0..64).map(|i| f16::from_f32(((i * 37 + 11) % 64) as f32 / 64.0)).collect();
        let channels = AnyChannels::sort(std::iter::once(AnyChannel::new("Y", FlatSamples::F16(noise))).collect());
        let encoding =
            Encoding { compression: Compression::B44, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
        let layer = Layer::new(Vec2(8, 8), LayerAttributes::default(), encoding, channels);
        let mut file = Cursor::new(Vec::new());
        ExrImage::from_layer(layer).write().non_parallel().to_buffered(&mut file).unwrap();
        let mut file = file.into_inner();
        assert!(decode(Path::new("good.exr"), &file, &CancelToken::new()).is_ok());
        // The last block of 4 x 4 samples takes 14 bytes: all differences at their most negative, from 0.
        let start = file.len() - 14;
        file[start..].fill(0);
        match decode(Path::new("hostile.exr"), &file, &CancelToken::new()) {
            Ok(stored) => assert_eq!((stored.width, stored.height), (8, 8)),
            Err(error) => assert!(error.to_string().contains("hostile.exr"), "{error}"),
        }
    }
}
