//! Image files as their stored pixels.

use std::io::{BufRead, BufReader, Cursor, Seek};
use std::path::Path;

use image::codecs::png::PngDecoder;
use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageError};
use zune_jpeg::JpegDecoder;
use zune_jpeg::errors::DecodeErrors;
use zune_jpeg::zune_core::colorspace::ColorSpace as JpegColors;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::exif::{CameraData, Exif};
use super::file::{self, read_file_unless};
use super::profile::{Decoding, FileColors};
use super::{exr, jpeg, tiff};
use crate::cancel::{CancelToken, Cancellable};
use crate::color::{Chromaticities, Transfer};
use crate::error::{Error, Result};
use crate::image::Image;
use crate::memory;

/// The largest image that is read, in bytes of its stored pixels.
pub const MAX_DECODED_BYTES: u64 = 1 << 30;

/// No compression these formats use packs pixels tighter: deflate reaches 1032 : 1, progressive JPEG 1024 : 1.
/// A header that promises more than that lies, and nothing is allocated for it.
const MAX_COMPRESSION: u64 = 2048;
const SMALL_FILE: u64 = 1 << 16;
/// The largest file that is read.
const MAX_FILE_BYTES: u64 = MAX_DECODED_BYTES + SMALL_FILE;
/// What the decoder of PNG holds: rows, and a window of what was unpacked.
const PNG_BESIDE: u64 = 1 << 18;

/// Integer samples from here on are saturated: 98 % of the top code. Compression and resampling smear what a camera clipped over the codes below the
/// top one (half of the clipped pixels of a JPEG-compressed capture lie there), and a highlight that is believed to end at 99 % has the wrong shape and colour.
const SATURATED_U8: u8 = 250;
const SATURATED_U16: u16 = 64225;

/// Stored pixel values: integers stand for the range from 0 to 1, floats for themselves.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Samples<'a> {
    /// 255 stands for 1.
    U8(&'a [u8]),
    /// 65535 stands for 1.
    U16(&'a [u16]),
    /// Stored values as they are.
    F32(&'a [f32]),
}

impl Samples<'_> {
    /// How many values there are.
    pub fn len(&self) -> usize {
        match self {
            Self::U8(values) => values.len(),
            Self::U16(values) => values.len(),
            Self::F32(values) => values.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Stored pixels, borrowed: rows from the top, channels interleaved: grey, grey and alpha, RGB, or RGB and alpha.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pixels<'a> {
    pub width: usize,
    pub height: usize,
    pub channels: usize,
    pub samples: Samples<'a>,
}

impl Pixels<'_> {
    /// Channels without alpha.
    pub fn colors(&self) -> usize {
        if self.channels >= 3 { 3 } else { 1 }
    }

    /// Whether the last channel is alpha.
    pub fn has_alpha(&self) -> bool {
        self.channels.is_multiple_of(2)
    }
}

/// The samples of a decoded file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum OwnedSamples {
    U8(Vec<u8>),
    U16(Vec<u16>),
    F32(Vec<f32>),
}

/// A decoded file: its pixels as they are stored.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Stored {
    pub width: usize,
    pub height: usize,
    pub channels: usize,
    pub samples: OwnedSamples,
    /// What the file says of its colours; nothing where it does not.
    pub colors: Option<FileColors>,
    /// How it was taken, as far as the file says.
    pub camera: CameraData,
    /// What a user may want to know about how the file was read.
    pub notes: Vec<String>,
}

impl Stored {
    pub fn pixels(&self) -> Pixels<'_> {
        let samples = match &self.samples {
            OwnedSamples::U8(values) => Samples::U8(values),
            OwnedSamples::U16(values) => Samples::U16(values),
            OwnedSamples::F32(values) => Samples::F32(values),
        };
        Pixels { width: self.width, height: self.height, channels: self.channels, samples }
    }

    /// The linear values, grey or RGB, without alpha.
    pub fn to_image(&self, transfer: Transfer) -> Result<Image> {
        let pixels = self.pixels();
        let colors = pixels.colors();
        let decoding = Decoding::transfer(transfer);
        let reader = RowReader::new(pixels, &decoding, None);
        let mut data = memory::filled(0.0, self.width * self.height * colors)?;
        for (y, row) in data.chunks_exact_mut(self.width * colors).enumerate() {
            reader.read(y, row, None);
        }
        Image::new(self.width, self.height, colors, data)
    }

    /// Turns the image the way its orientation tag asks for.
    pub(super) fn orient(self, orientation: Orientation, cancel: &CancelToken) -> Result<Self> {
        if orientation == Orientation::NoTransforms {
            return Ok(self);
        }
        let (width, height, channels) = (self.width, self.height, self.channels);
        let samples = match self.samples {
            OwnedSamples::U8(values) => {
                OwnedSamples::U8(oriented(&values, width, height, channels, orientation, cancel)?)
            }
            OwnedSamples::U16(values) => {
                OwnedSamples::U16(oriented(&values, width, height, channels, orientation, cancel)?)
            }
            OwnedSamples::F32(values) => {
                OwnedSamples::F32(oriented(&values, width, height, channels, orientation, cancel)?)
            }
        };
        let (width, height) = if swaps_axes(orientation) { (height, width) } else { (width, height) };
        let mut camera = self.camera;
        camera.orientation = Some(orientation.to_exif());
        Ok(Self { width, height, samples, camera, ..self })
    }
}

fn swaps_axes(orientation: Orientation) -> bool {
    use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    matches!(orientation, Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH)
}

/// The values of an image of `width` x `height` turned by `orientation`.
fn oriented<T: Copy>(
    values: &[T],
    width: usize,
    height: usize,
    channels: usize,
    orientation: Orientation,
    cancel: &CancelToken,
) -> Result<Vec<T>> {
    let (out_width, out_height) = if swaps_axes(orientation) { (height, width) } else { (width, height) };
    let mut out = memory::reserved(values.len())?;
    for row in 0..out_height {
        cancel.check()?;
        for column in 0..out_width {
            let (x, y) = match orientation {
                Orientation::NoTransforms => (column, row),
                Orientation::FlipHorizontal => (width - 1 - column, row),
                Orientation::Rotate180 => (width - 1 - column, height - 1 - row),
                Orientation::FlipVertical => (column, height - 1 - row),
                Orientation::Rotate90FlipH => (row, column),
                Orientation::Rotate90 => (row, height - 1 - column),
                Orientation::Rotate270FlipH => (width - 1 - row, height - 1 - column),
                Orientation::Rotate270 => (width - 1 - row, column),
            };
            let start = (y * width + x) * channels;
            out.extend_from_slice(&values[start..start + channels]);
        }
    }
    Ok(out)
}

/// Rows of stored pixels as values without alpha that `decoding` makes linear.
pub(crate) struct RowReader<'a> {
    pixels: Pixels<'a>,
    decoding: &'a Decoding,
    /// The value of every code of an integer format; for each channel, or one for all.
    tables: Vec<Vec<f32>>,
    white_level: Option<f32>,
}

impl<'a> RowReader<'a> {
    /// `white_level` is the stored value at which float samples are saturated.
    pub fn new(pixels: Pixels<'a>, decoding: &'a Decoding, white_level: Option<f32>) -> Self {
        let codes: u32 = match pixels.samples {
            Samples::U8(_) => 1 << 8,
            Samples::U16(_) => 1 << 16,
            Samples::F32(_) => 0,
        };
        let channels = if decoding.is_uniform() { 1 } else { pixels.colors() };
        let value = |channel, code| decoding.value(channel, code as f32 / (codes - 1) as f32);
        let table = |channel| (0..codes).map(|code| value(channel, code)).collect();
        Self { pixels, decoding, tables: (0..channels).map(table).collect(), white_level }
    }

    /// Row `y` as `colors` linear values per pixel, but for [`Decoding::to_rec709`]; where `saturated` is given, it gets one byte per
    /// pixel whose bit c says that channel c stands at the encoding's upper end, or so near that compression may have moved it.
    pub fn read(&self, y: usize, row: &mut [f32], saturated: Option<&mut [u8]>) {
        let stride = self.pixels.width * self.pixels.channels;
        let range = y * stride..(y + 1) * stride;
        let table = |channel: usize| &self.tables[channel % self.tables.len()];
        match self.pixels.samples {
            Samples::U8(values) => {
                self.convert(&values[range], row, saturated, |c, v| table(c)[usize::from(v)], |v| v >= SATURATED_U8)
            }
            Samples::U16(values) => {
                self.convert(&values[range], row, saturated, |c, v| table(c)[usize::from(v)], |v| v >= SATURATED_U16)
            }
            Samples::F32(values) => {
                let white = self.white_level.unwrap_or(f32::INFINITY);
                self.convert(&values[range], row, saturated, |c, v| self.decoding.value(c, v), |v| v >= white)
            }
        }
        self.decoding.finish(row);
    }

    fn convert<T: Copy>(
        &self,
        stored: &[T],
        row: &mut [f32],
        saturated: Option<&mut [u8]>,
        linear: impl Fn(usize, T) -> f32,
        full: impl Fn(T) -> bool,
    ) {
        let colors = self.pixels.colors();
        let pixels = stored.chunks_exact(self.pixels.channels);
        for (pixel, out) in pixels.clone().zip(row.chunks_exact_mut(colors)) {
            for (channel, (out, &value)) in out.iter_mut().zip(pixel).enumerate() {
                *out = linear(channel, value);
            }
        }
        if let Some(saturated) = saturated {
            for (pixel, bits) in pixels.zip(saturated) {
                *bits = pixel[..colors].iter().enumerate().fold(0, |bits, (c, &v)| bits | (u8::from(full(v)) << c));
            }
        }
    }
}

/// What reading an image file takes, as its header says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Demand {
    /// Columns and rows of the picture as it is read.
    pub size: (usize, usize),
    /// 1 for grey, 3 for colour.
    pub colors: usize,
    /// Bytes of its pixels as they are stored.
    pub stored: u64,
    /// Bytes at the peak of decoding: the file, what the decoder holds, the pixels, and a second time those of a picture that is turned.
    pub decoding: u64,
}

impl Demand {
    /// `beside` are bytes that are held beside the pixels while they are decoded.
    pub fn new(size: (usize, usize), colors: usize, stored: u64, beside: u64, orientation: Orientation) -> Self {
        let (width, height) = size;
        let size = if swaps_axes(orientation) { (height, width) } else { size };
        let turned = if orientation == Orientation::NoTransforms { 0 } else { stored };
        Self { size, colors, stored, decoding: beside + stored + turned }
    }
}

/// What reading the image file `path` takes. No more than its header is looked at; a TIFF, whose header may be anywhere, is read.
///
/// # Errors
/// As [`read_stored`], but for what is wrong with the pixels.
pub(crate) fn demand(path: &Path, cancel: &CancelToken) -> Result<Demand> {
    let (file, len) = file::open(path)?;
    let mut reader = BufReader::new(Cancellable::new(file, cancel));
    match Kind::of(reader.fill_buf().map_err(|e| Error::io(path, e))?) {
        Some(Kind::Tiff) => demand_of_bytes(path, &read_file_unless(path, MAX_FILE_BYTES, cancel)?, cancel),
        _ => demand_of(path, reader, len),
    }
}

/// [`demand`] of the bytes of a file.
///
/// # Errors
/// As [`demand`].
pub(crate) fn demand_of_bytes(path: &Path, bytes: &[u8], cancel: &CancelToken) -> Result<Demand> {
    match Kind::of(bytes) {
        Some(Kind::Tiff) => tiff::demand(path, bytes, cancel),
        _ => demand_of(path, Cursor::new(bytes), bytes.len() as u64),
    }
}

/// [`demand`] of what is no TIFF.
fn demand_of(path: &Path, mut reader: impl BufRead + Seek, len: u64) -> Result<Demand> {
    let start = reader.fill_buf().map_err(|e| Error::io(path, e))?;
    match Kind::of(start) {
        Some(Kind::Png) => {
            let (decoder, header) = open_png(path, reader, len)?;
            let colors = if decoder.color_type().has_color() { 3 } else { 1 };
            Ok(header.demand(colors, len + PNG_BESIDE))
        }
        Some(Kind::Jpeg) => {
            let (decoder, header) = open_jpeg(path, reader, len)?;
            let progressive = decoder.info().is_some_and(|info| info.sof.is_progressive());
            // Progressive files unfold into the coefficients of the whole picture.
            let (channels, samples) = (header.bytes_per_pixel, header.width * header.height * header.bytes_per_pixel);
            Ok(header.demand(channels, len + if progressive { 2 * samples as u64 } else { 0 }))
        }
        Some(Kind::OpenExr) => exr::demand(path, reader, len),
        Some(Kind::Tiff) | None => Err(not_read(path, start)),
    }
}

/// Reads and decodes the file `path`, until `cancel` is cancelled.
pub(crate) fn read_stored(path: &Path, cancel: &CancelToken) -> Result<Stored> {
    decode(path, &read_file_unless(path, MAX_FILE_BYTES, cancel)?, cancel)
}

/// Decodes the bytes of an image file, until `cancel` is cancelled; `path` is its name in messages.
pub(crate) fn decode(path: &Path, bytes: &[u8], cancel: &CancelToken) -> Result<Stored> {
    let decoded = decode_by_kind(path, bytes, cancel);
    // A decoder makes of the end of its reader what it likes, a damaged file or a grey picture.
    cancel.check()?;
    decoded
}

fn decode_by_kind(path: &Path, bytes: &[u8], cancel: &CancelToken) -> Result<Stored> {
    match Kind::of(bytes) {
        Some(Kind::Png) => decode_png(path, bytes, cancel),
        Some(Kind::Jpeg) => decode_jpeg(path, bytes, cancel),
        Some(Kind::Tiff) => tiff::decode(path, bytes, cancel),
        Some(Kind::OpenExr) => exr::decode(path, bytes, cancel),
        None => Err(not_read(path, bytes)),
    }
}

/// What is wrong with a file of none of the [`Kind`]s.
fn not_read(path: &Path, bytes: &[u8]) -> Error {
    match known_by_name(bytes) {
        _ if bytes.is_empty() => broken(path, "the file is empty"),
        Some(kind) => unsupported(path, kind),
        None => {
            let start: Vec<String> = bytes.iter().take(4).map(|byte| format!("{byte:02x}")).collect();
            unsupported(path, format!("starts with {}; read are PNG, JPEG, TIFF and OpenEXR", start.join(" ")))
        }
    }
}

/// The image files that are read.
#[derive(Clone, Copy)]
pub(super) enum Kind {
    Png,
    Jpeg,
    Tiff,
    OpenExr,
}

impl Kind {
    /// By the first bytes of a file.
    pub fn of(start: &[u8]) -> Option<Self> {
        match start {
            [0x89, b'P', b'N', b'G', ..] => Some(Self::Png),
            [0xff, 0xd8, 0xff, ..] => Some(Self::Jpeg),
            [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => Some(Self::Tiff),
            [0x76, 0x2f, 0x31, 0x01, ..] => Some(Self::OpenExr),
            _ => None,
        }
    }

    /// What such a file is called.
    pub fn name(self) -> &'static str {
        match self {
            Self::Png => "a PNG",
            Self::Jpeg => "a JPEG",
            Self::Tiff => "a TIFF",
            Self::OpenExr => "an OpenEXR",
        }
    }
}

/// What a file is that cameras write and that is not read, and what to do with it. Raw files that are TIFF are told there.
fn known_by_name(bytes: &[u8]) -> Option<&'static str> {
    const TELEPHONE: &str = "a HEIF picture (HEIC or AVIF), which telephones write; convert it to a PNG or TIFF of 16 bit, or to a JPEG of high \
        quality, or set the camera to JPEG";
    let raw = Some(tiff::CAMERA_RAW);
    match bytes {
        [_, _, _, _, b'f', b't', b'y', b'p', b'c', b'r', b'x', b' ', ..] => raw,
        [_, _, _, _, b'f', b't', b'y', b'p', brand @ ..] => {
            let brands = [b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1", b"avif", b"avis"];
            brands.iter().any(|known| brand.starts_with(*known)).then_some(TELEPHONE)
        }
        // Fujifilm, Olympus, Panasonic, Canon before 2004, Sigma, Minolta.
        [b'F', b'U', b'J', b'I', b'F', b'I', b'L', b'M', b'C', b'C', b'D', b'-', b'R', b'A', b'W', ..] => raw,
        [b'I', b'I', b'R', b'O' | b'S', ..] | [b'M', b'M', b'O', b'R', ..] | [b'I', b'I', b'U', 0, ..] => raw,
        [b'I', b'I', _, _, _, _, b'H', b'E', b'A', b'P', b'C', b'C', b'D', b'R', ..] => raw,
        [b'F', b'O', b'V', b'b', ..] | [0, b'M', b'R', b'M', ..] => raw,
        _ => None,
    }
}

/// An error for a file that its decoder cannot read.
pub(super) fn broken(path: &Path, reason: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Error {
    Error::io(path, std::io::Error::new(std::io::ErrorKind::InvalidData, reason))
}

pub(super) fn unsupported(path: &Path, got: impl Into<String>) -> Error {
    Error::UnsupportedFormat { name: path.display().to_string(), got: got.into() }
}

/// Refuses an image whose pixels are more than is read, or more than its file can hold, before anything is allocated for it.
pub(super) fn check_size(path: &Path, width: u64, height: u64, bytes_per_pixel: u64, file_bytes: u64) -> Result<()> {
    let name = || path.display().to_string();
    let needed = width.checked_mul(height).and_then(|n| n.checked_mul(bytes_per_pixel));
    if width == 0 || height == 0 {
        return Err(Error::invalid(name(), format!("image of {width} x {height} pixels")));
    }
    let Some(needed) = needed.filter(|&needed| needed <= MAX_DECODED_BYTES) else {
        return Err(Error::invalid(
            name(),
            format!(
                "image of {width} x {height} pixels with {bytes_per_pixel} bytes each, at most {MAX_DECODED_BYTES} bytes are read"
            ),
        ));
    };
    if needed > plausible_bytes(file_bytes) {
        return Err(Error::invalid(
            name(),
            format!("image of {width} x {height} pixels in a file of {file_bytes} bytes: truncated or no image"),
        ));
    }
    Ok(())
}

/// More bytes than a file of this size can decode to.
pub(super) fn plausible_bytes(file_bytes: u64) -> u64 {
    file_bytes.saturating_mul(MAX_COMPRESSION).saturating_add(SMALL_FILE)
}

/// What the header of a PNG or a JPEG says.
struct Header {
    width: usize,
    height: usize,
    bytes_per_pixel: usize,
    orientation: Orientation,
    colors: Option<FileColors>,
    camera: CameraData,
}

impl Header {
    fn new(
        path: &Path,
        (width, height): (usize, usize),
        bytes_per_pixel: usize,
        file_bytes: u64,
        (exif, profile): (Option<&[u8]>, Option<Vec<u8>>),
    ) -> Result<Self> {
        check_size(path, width as u64, height as u64, bytes_per_pixel as u64, file_bytes)?;
        let exif = exif.map(Exif::read).unwrap_or_default();
        let profile = profile.filter(|profile| !profile.is_empty()).map(FileColors::Icc);
        let orientation = exif.orientation.unwrap_or(Orientation::NoTransforms);
        let (colors, camera) = (profile.or(exif.colors), exif.camera);
        Ok(Self { width, height, bytes_per_pixel, orientation, colors, camera })
    }

    /// What reading takes that holds `beside` bytes beside the pixels, the file's among them.
    fn demand(&self, colors: usize, beside: u64) -> Demand {
        let Self { width, height, bytes_per_pixel, orientation, .. } = *self;
        let stored = (width * height * bytes_per_pixel) as u64;
        Demand::new((width, height), colors, stored, beside, orientation)
    }
}

fn open_png<R: BufRead + Seek>(path: &Path, reader: R, file_bytes: u64) -> Result<(PngDecoder<R>, Header)> {
    let mut limits = image::Limits::no_limits();
    limits.max_alloc = Some(plausible_bytes(file_bytes).min(MAX_DECODED_BYTES));
    let mut decoder = PngDecoder::with_limits(reader, limits).map_err(|e| image_error(path, e))?;
    let (width, height) = decoder.dimensions();
    let (exif, profile) = (decoder.exif_metadata().ok().flatten(), decoder.icc_profile().ok().flatten());
    let bytes_per_pixel = decoder.color_type().bytes_per_pixel().into();
    let (size, said) = ((width as usize, height as usize), (exif.as_deref(), profile));
    let header = Header::new(path, size, bytes_per_pixel, file_bytes, said)?;
    Ok((decoder, header))
}

fn decode_png(path: &Path, bytes: &[u8], cancel: &CancelToken) -> Result<Stored> {
    let reader = Cancellable::new(Cursor::new(bytes), cancel);
    let (decoder, header) = open_png(path, reader, bytes.len() as u64)?;
    let (channels, samples) = match DynamicImage::from_decoder(decoder).map_err(|e| image_error(path, e))? {
        DynamicImage::ImageLuma8(image) => (1, OwnedSamples::U8(image.into_raw())),
        DynamicImage::ImageLumaA8(image) => (2, OwnedSamples::U8(image.into_raw())),
        DynamicImage::ImageRgb8(image) => (3, OwnedSamples::U8(image.into_raw())),
        DynamicImage::ImageRgba8(image) => (4, OwnedSamples::U8(image.into_raw())),
        DynamicImage::ImageLuma16(image) => (1, OwnedSamples::U16(image.into_raw())),
        DynamicImage::ImageLumaA16(image) => (2, OwnedSamples::U16(image.into_raw())),
        DynamicImage::ImageRgb16(image) => (3, OwnedSamples::U16(image.into_raw())),
        DynamicImage::ImageRgba16(image) => (4, OwnedSamples::U16(image.into_raw())),
        other => return Err(unsupported(path, format!("{:?} pixels", other.color()))),
    };
    let Header { width, height, orientation, colors, camera, .. } = header;
    let (colors, notes) = (png_colors(bytes, colors), Vec::new());
    Stored { width, height, channels, samples, colors, camera, notes }.orient(orientation, cancel)
}

/// What the chunks of a PNG say of its colours beside its profile, by their rank: `cICP`, the profile, `sRGB`, `gAMA` and `cHRM`.
///
/// # Source
/// W3C, Portable Network Graphics (Third Edition), 11.3.2 and 4.3.
fn png_colors(bytes: &[u8], profile: Option<FileColors>) -> Option<FileColors> {
    let (mut gamma, mut chromaticities, mut is_srgb) = (None, None, false);
    let mut rest = bytes.get(8..)?;
    while let Some((head, tail)) = rest.split_first_chunk::<8>() {
        let [length @ .., _, _, _, _] = *head;
        let (Ok(length), name) = (usize::try_from(u32::from_be_bytes(length)), &head[4..]) else { break };
        let Some((data, after)) = tail.split_at_checked(length) else { break };
        let hundred_thousandths = || data.as_chunks().0.iter().map(|&word| f64::from(u32::from_be_bytes(word)) / 1e5);
        match (name, data) {
            (b"IDAT", _) => break,
            (b"cICP", &[primaries, transfer, ..]) => return Some(FileColors::CodePoints { primaries, transfer }),
            (b"sRGB", _) => is_srgb = true,
            (b"gAMA", _) => gamma = hundred_thousandths().next(),
            (b"cHRM", _) => {
                let numbers: Vec<f64> = hundred_thousandths().collect();
                if let &[x, y, rx, ry, gx, gy, bx, by] = numbers.as_slice() {
                    chromaticities = Some(Chromaticities { primaries: [[rx, ry], [gx, gy], [bx, by]], white: [x, y] });
                }
            }
            _ => {}
        }
        rest = after.get(4..)?;
    }
    if profile.is_some() || is_srgb {
        return profile;
    }
    // 1/2.2 is what programs write for sRGB itself.
    let gamma =
        gamma.filter(|&gamma| gamma > 0.0 && (gamma - 1.0 / 2.2).abs() > 0.005).map(|gamma| (1.0 / gamma) as f32);
    if gamma.is_none() && chromaticities.is_none() {
        return None;
    }
    let chromaticities = chromaticities.unwrap_or(Chromaticities::REC709);
    Some(FileColors::Chromaticities { chromaticities, gamma, source: "the chunks gAMA and cHRM" })
}

fn open_jpeg<R: BufRead + Seek>(path: &Path, reader: R, file_bytes: u64) -> Result<(JpegDecoder<R>, Header)> {
    // What is damaged the check of its codes finds; of the rest the decoder is to make what other programs do.
    let options = DecoderOptions::default().set_strict_mode(false).set_max_width(usize::MAX).set_max_height(usize::MAX);
    let mut decoder = JpegDecoder::new_with_options(reader, options);
    decoder.decode_headers().map_err(|e| jpeg_error(path, e))?;
    let (Some(size), Some(stored_as)) = (decoder.dimensions(), decoder.input_colorspace()) else {
        return Err(broken(path, "JPEG without a picture"));
    };
    let (channels, read_as) = match stored_as {
        JpegColors::Luma => (1, JpegColors::Luma),
        _ => (3, JpegColors::RGB),
    };
    decoder.set_options(options.jpeg_set_out_colorspace(read_as));
    let said = (decoder.exif().map(Vec::as_slice), decoder.icc_profile());
    let header = Header::new(path, size, channels, file_bytes, said)?;
    Ok((decoder, header))
}

pub(super) fn decode_jpeg(path: &Path, bytes: &[u8], cancel: &CancelToken) -> Result<Stored> {
    let notes = jpeg::check(path, bytes, cancel)?.into_iter().collect();
    let reader = Cancellable::new(Cursor::new(bytes), cancel);
    let (mut decoder, header) = open_jpeg(path, reader, bytes.len() as u64)?;
    let Header { width, height, bytes_per_pixel: channels, orientation, colors, camera } = header;
    let mut samples = memory::filled(0, width * height * channels)?;
    decoder.decode_into(&mut samples).map_err(|e| jpeg_error(path, e))?;
    let samples = OwnedSamples::U8(samples);
    Stored { width, height, channels, samples, colors, camera, notes }.orient(orientation, cancel)
}

fn jpeg_error(path: &Path, error: DecodeErrors) -> Error {
    match error {
        DecodeErrors::Unsupported(scheme) => unsupported(path, format!("{scheme:?}")),
        error => broken(path, format!("{error:?}")),
    }
}

fn image_error(path: &Path, error: ImageError) -> Error {
    match error {
        ImageError::Unsupported(error) => unsupported(path, error.to_string()),
        ImageError::IoError(error) => Error::io(path, error),
        error => broken(path, error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orientations_follow_the_exif_table() {
        // The letter F in 3 x 2 pixels as the viewer shall see it, and what each orientation stores for it: EXIF 2.3 table 6
        // names the place of the visual row 0 and column 0 in the file.
        let upright = [1, 2, 3, 4, 5, 6];
        let stored: [(u8, usize, [i32; 6]); 8] = [
            (1, 3, [1, 2, 3, 4, 5, 6]),
            (2, 3, [3, 2, 1, 6, 5, 4]),
            (3, 3, [6, 5, 4, 3, 2, 1]),
            (4, 3, [4, 5, 6, 1, 2, 3]),
            (5, 2, [1, 4, 2, 5, 3, 6]),
            (6, 2, [3, 6, 2, 5, 1, 4]),
            (7, 2, [6, 3, 5, 2, 4, 1]),
            (8, 2, [4, 1, 5, 2, 6, 3]),
        ];
        for (exif, width, values) in stored {
            let orientation = Orientation::from_exif(exif).unwrap();
            assert_eq!(
                oriented(&values, width, 6 / width, 1, orientation, &CancelToken::new()).unwrap(),
                upright,
                "orientation {exif}"
            );
        }
    }

    /// Large pictures in every kind of file, in few bytes where the kind allows it.
    fn large() -> Vec<(&'static str, Vec<u8>)> {
        const SIDE: usize = 800;
        let path = Path::new("large");
        let grey = Image::new(SIDE, SIDE, 1, vec![0.25; SIDE * SIDE]).unwrap();
        let noise = (0..3 * SIDE * SIDE).map(|i| (i * 7919 % 1009) as f32 / 1009.0).collect();
        let noise = Image::new(SIDE, SIDE, 3, noise).unwrap();
        let jpeg = |image: &Image| super::super::encode::jpeg(path, image, Transfer::Srgb).unwrap();
        let exr = |image: &Image| {
            let channels = super::super::encode::named_channels(image).unwrap();
            let color_space = crate::color::ColorSpace::Rec709;
            exr::encode(path, SIDE, SIDE, &channels, exr::Precision::Half, color_space).unwrap()
        };
        vec![
            ("smooth PNG", super::super::png8(path, &grey, Transfer::Srgb).unwrap()),
            ("PNG", super::super::png16(path, &noise, Transfer::Srgb).unwrap()),
            ("smooth JPEG", jpeg(&grey)),
            ("JPEG", jpeg(&noise)),
            ("TIFF", super::super::encode::tiff_float(path, &noise).unwrap()),
            ("smooth OpenEXR", exr(&grey)),
            ("OpenEXR", exr(&noise)),
        ]
    }

    #[test]
    fn every_decoder_stops_when_it_is_cancelled() {
        for (kind, bytes) in large() {
            let path = Path::new(kind);
            let cancel = CancelToken::at_look(usize::MAX);
            decode(path, &bytes, &cancel).unwrap();
            let looks = cancel.looks();
            assert!(looks > 3 && looks > bytes.len() >> 20, "{kind}: {looks} looks at {} bytes", bytes.len());
            for last in [1, 2, looks / 2, looks - 1, looks] {
                let cancel = CancelToken::at_look(last);
                let error = decode(path, &bytes, &cancel).unwrap_err();
                assert!(matches!(error, Error::Cancelled), "{kind}, look {last}: {error}");
                // Errors may be met with a few more attempts to read.
                assert!(cancel.looks() < last + 100, "{kind}, look {last}: {} looks", cancel.looks());
            }
        }
    }

    #[test]
    fn lying_headers_are_refused() {
        let path = Path::new("x.png");
        assert!(check_size(path, 4096, 4096, 3, 1 << 20).is_ok());
        assert!(check_size(path, 0, 4, 3, 100).is_err());
        assert!(check_size(path, u64::MAX, 2, 3, 100).is_err());
        assert!(check_size(path, 30_000, 30_000, 3, u64::MAX).is_err());
        assert!(check_size(path, 4096, 4096, 3, 1000).is_err());
    }
}
