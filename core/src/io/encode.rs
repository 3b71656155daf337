//! Images to files.

use std::borrow::Cow;
use std::io::Cursor;
use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use tiff::TiffResult;
use tiff::encoder::TiffEncoder;
use tiff::encoder::colortype::{self, ColorType};
use tiff::tags::Tag;

use super::decode::{broken, unsupported};
use super::exr::{self, Precision};
use super::ours::SOFTWARE;
use super::save::write_file;
use crate::color::{ColorSpace, Transfer};
use crate::error::{Error, Result};
use crate::image::Image;
use crate::memory;

const JPEG_QUALITY: u8 = 95;

/// Writes a linear image, one or three channels, in the format of the file's extension: `.png` and `.jpg` (8 bit, encoded with `transfer`
/// and clamped to [0, 1]), `.exr` or `.tif`/`.tiff` (32-bit float, linear; `transfer` is not used). The file appears whole or
/// not at all.
///
/// # Errors
/// [`Error::UnsupportedFormat`] for another extension, [`Error::ShapeMismatch`] for another number of channels,
/// [`Error::InvalidArgument`] for a value that is not finite, [`Error::Io`] if the file cannot be written.
pub fn write_image(path: impl AsRef<Path>, image: &Image, transfer: Transfer) -> Result<()> {
    write_image_in(path.as_ref(), image, transfer, ColorSpace::Rec709)
}

/// [`write_image`] of values in `color_space`, which OpenEXR files state.
pub(crate) fn write_image_in(path: &Path, image: &Image, transfer: Transfer, color_space: ColorSpace) -> Result<()> {
    if !matches!(image.channels(), 1 | 3) {
        return Err(Error::shape("image", "1 or 3 channels", image.channels().to_string()));
    }
    if let Some(at) = image.data().iter().position(|value| !value.is_finite()) {
        let pixel = at / image.channels();
        let (x, y) = (pixel % image.width(), pixel / image.width());
        return Err(Error::invalid("image", format!("{} at column {x}, row {y}", image.data()[at])));
    }
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let bytes = match extension.as_str() {
        "png" => png8(path, image, transfer)?,
        "jpg" | "jpeg" => jpeg(path, image, transfer)?,
        "exr" => {
            exr::encode(path, image.width(), image.height(), &named_channels(image)?, Precision::Float, color_space)?
        }
        "tif" | "tiff" => tiff_float(path, image)?,
        other => return Err(unsupported(path, format!("extension {other:?}; written are .png, .jpg, .exr and .tif"))),
    };
    write_file(path, &bytes)
}

/// An OpenEXR file of a linear Rec. 709 image, in half precision.
pub(crate) fn exr_half(path: &Path, image: &Image) -> Result<Vec<u8>> {
    exr::encode(path, image.width(), image.height(), &named_channels(image)?, Precision::Half, ColorSpace::Rec709)
}

/// The channels of an image under the names OpenEXR gives them: Y for one, R, G for two, R, G, B for three.
pub(super) fn named_channels(image: &Image) -> Result<Vec<(&'static str, Vec<f32>)>> {
    let names: &[&'static str] = if image.channels() == 1 { &["Y"] } else { &["R", "G", "B"] };
    let (pixels, channels) = (image.width() * image.height(), image.channels());
    let plane = |c: usize| memory::collected(pixels, image.data().iter().skip(c).step_by(channels).copied());
    names.iter().take(channels).enumerate().map(|(c, &name)| Ok((name, plane(c)?))).collect()
}

/// The 8-bit codes of an image.
fn codes8(image: &Image, transfer: Transfer) -> Result<(Vec<u8>, ExtendedColorType)> {
    let code = |&v: &f32| (transfer.encode(v).clamp(0.0, 1.0) * 255.0).round() as u8;
    let color = if image.channels() == 1 { ExtendedColorType::L8 } else { ExtendedColorType::Rgb8 };
    Ok((memory::collected(image.data().len(), image.data().iter().map(code))?, color))
}

/// A PNG of 8 bits, the values encoded with `transfer`; one or three channels.
pub(crate) fn png8(path: &Path, image: &Image, transfer: Transfer) -> Result<Vec<u8>> {
    let (codes, color) = codes8(image, transfer)?;
    png(path, image, &codes, color)
}

pub(super) fn jpeg(path: &Path, image: &Image, transfer: Transfer) -> Result<Vec<u8>> {
    let (width, height) = size32(path, image)?;
    let (codes, color) = codes8(image, transfer)?;
    let mut out = Vec::new();
    JpegEncoder::new_with_quality(&mut out, JPEG_QUALITY)
        .write_image(&codes, width, height, color)
        .map_err(|e| broken(path, e))?;
    Ok(out)
}

/// A PNG of 16 bits, the values encoded with `transfer`; two channels are written as R, G and B = 0.
pub(crate) fn png16(path: &Path, image: &Image, transfer: Transfer) -> Result<Vec<u8>> {
    let image = &with_blue(image)?;
    let code = |v: f32| (transfer.encode(v).clamp(0.0, 1.0) * 65535.0).round() as u16;
    let values = image.data();
    let bytes = memory::collected(2 * values.len(), values.iter().flat_map(|&v| code(v).to_ne_bytes()))?;
    let color = if image.channels() == 1 { ExtendedColorType::L16 } else { ExtendedColorType::Rgb16 };
    png(path, image, &bytes, color)
}

fn png(path: &Path, image: &Image, bytes: &[u8], color: ExtendedColorType) -> Result<Vec<u8>> {
    let (width, height) = size32(path, image)?;
    let mut out = Vec::new();
    PngEncoder::new(&mut out).write_image(bytes, width, height, color).map_err(|e| broken(path, e))?;
    // The encoder has no text; it may stand right after the header, a chunk of 13 bytes.
    out.splice(PNG_HEADER..PNG_HEADER, png_text("Software", SOFTWARE));
    Ok(out)
}

/// The signature and the first chunk of every PNG file, in bytes.
const PNG_HEADER: usize = 8 + 12 + 13;

/// A chunk of Latin text.
fn png_text(keyword: &str, text: &str) -> Vec<u8> {
    let named = [b"tEXt", keyword.as_bytes(), b"\0", text.as_bytes()].concat();
    let length = (keyword.len() + 1 + text.len()) as u32;
    [&length.to_be_bytes()[..], &named, &crc32fast::hash(&named).to_be_bytes()].concat()
}

/// A TIFF of 32-bit floats, the values as they are; two channels are written as R, G and B = 0.
pub(super) fn tiff_float(path: &Path, image: &Image) -> Result<Vec<u8>> {
    let image = &with_blue(image)?;
    let (width, height) = size32(path, image)?;
    let mut out = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut out).map_err(|e| broken(path, e))?;
    match image.channels() {
        1 => write_tiff::<colortype::Gray32Float>(&mut encoder, width, height, image.data()),
        _ => write_tiff::<colortype::RGB32Float>(&mut encoder, width, height, image.data()),
    }
    .map_err(|e| broken(path, e))?;
    Ok(out.into_inner())
}

fn write_tiff<C: ColorType<Inner = f32>>(
    encoder: &mut TiffEncoder<&mut Cursor<Vec<u8>>>,
    width: u32,
    height: u32,
    values: &[f32],
) -> TiffResult<()> {
    let mut image = encoder.new_image::<C>(width, height)?;
    image.encoder().write_tag(Tag::Software, SOFTWARE)?;
    image.write_data(values)
}

fn with_blue(image: &Image) -> Result<Cow<'_, Image>> {
    if image.channels() != 2 {
        return Ok(Cow::Borrowed(image));
    }
    let values = image.data().chunks_exact(2).flat_map(|pixel| [pixel[0], pixel[1], 0.0]);
    let data = memory::collected(image.data().len() / 2 * 3, values)?;
    Image::new(image.width(), image.height(), 3, data).map(Cow::Owned)
}

fn size32(path: &Path, image: &Image) -> Result<(u32, u32)> {
    match (u32::try_from(image.width()), u32::try_from(image.height())) {
        (Ok(width), Ok(height)) => Ok((width, height)),
        _ => Err(unsupported(path, format!("an image of {} x {} pixels", image.width(), image.height()))),
    }
}
