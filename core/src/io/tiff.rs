//! TIFF, in: strips or tiles, samples interleaved or in planes, either byte order, classic or BigTIFF.
//!
//! Every chunk (a strip or a tile, of one plane where planes are apart) is unpacked whole, its predictor undone over all of its samples,
//! and only then are the colours taken out of it. The `tiff` crate (0.11), which writes our files, counts samples beyond colour
//! wrongly in several of these layouts and refuses valid LZW streams.
//!
//! # Source
//! Adobe, TIFF 6.0; Adobe, TIFF technical note 3 (floating point predictor); Aware Systems, BigTIFF. Where they leave something
//! open, what libtiff does.

use std::io::Read;
use std::path::Path;

use image::metadata::Orientation;
use weezl::{BitOrder, LzwStatus, decode::Configuration};

use super::decode::{
    Demand, MAX_DECODED_BYTES, OwnedSamples, Stored, broken, check_size, decode_jpeg, plausible_bytes, unsupported,
};
use super::exif::{CameraData, Exif};
use super::profile::FileColors;
use crate::cancel::{CancelToken, Cancellable};
use crate::color::Chromaticities;
use crate::error::Result;
use crate::memory;

/// More directories than this no photo file has.
const MAX_DIRECTORIES: usize = 1024;

pub(super) mod tag {
    pub const NEW_SUBFILE_TYPE: u16 = 254;
    pub const SUBFILE_TYPE: u16 = 255;
    pub const WIDTH: u16 = 256;
    pub const HEIGHT: u16 = 257;
    pub const BITS_PER_SAMPLE: u16 = 258;
    pub const COMPRESSION: u16 = 259;
    pub const PHOTOMETRIC: u16 = 262;
    pub const FILL_ORDER: u16 = 266;
    pub const STRIP_OFFSETS: u16 = 273;
    pub const ORIENTATION: u16 = 274;
    pub const SAMPLES_PER_PIXEL: u16 = 277;
    pub const ROWS_PER_STRIP: u16 = 278;
    pub const STRIP_BYTE_COUNTS: u16 = 279;
    pub const PLANAR_CONFIGURATION: u16 = 284;
    pub const PREDICTOR: u16 = 317;
    pub const TILE_WIDTH: u16 = 322;
    pub const TILE_HEIGHT: u16 = 323;
    pub const TILE_OFFSETS: u16 = 324;
    pub const TILE_BYTE_COUNTS: u16 = 325;
    pub const SUB_DIRECTORIES: u16 = 330;
    pub const EXTRA_SAMPLES: u16 = 338;
    pub const SAMPLE_FORMAT: u16 = 339;
    pub const JPEG_TABLES: u16 = 347;
    pub const WHITE_POINT: u16 = 318;
    pub const PRIMARY_CHROMATICITIES: u16 = 319;
    pub const ICC_PROFILE: u16 = 34675;
    pub const EXIF_DIRECTORY: u16 = 34665;
    pub const EXIF_COLOR_SPACE: u16 = 40961;
    pub const EXPOSURE_TIME: u16 = 33434;
    pub const F_NUMBER: u16 = 33437;
    pub const SENSITIVITY: u16 = 34855;
    pub const FLASH: u16 = 37385;
    pub const FOCAL_LENGTH: u16 = 37386;
    pub const PIXEL_X_DIMENSION: u16 = 40962;
    pub const PIXEL_Y_DIMENSION: u16 = 40963;
    pub const FOCAL_PLANE_X_RESOLUTION: u16 = 41486;
    pub const FOCAL_PLANE_RESOLUTION_UNIT: u16 = 41488;
    pub const FOCAL_LENGTH_35MM: u16 = 41989;
    pub const INTEROPERABILITY_DIRECTORY: u16 = 40965;
    pub const DNG_VERSION: u16 = 50706;
}

mod photometric {
    pub const WHITE_IS_ZERO: u64 = 0;
    pub const BLACK_IS_ZERO: u64 = 1;
    pub const RGB: u64 = 2;
    pub const YCBCR: u64 = 6;
    pub const COLOR_FILTER_ARRAY: u64 = 32803;
    pub const LINEAR_RAW: u64 = 34892;
}

const JPEG: u64 = 7;
/// Compressions of sensor data: Sony and Samsung, Epson, Nikon, Kodak, Pentax, DNG's lossy one.
const RAW_COMPRESSIONS: [u64; 7] = [32767, 32769, 32770, 34713, 65000, 65535, 34892];

/// What to do with a file of sensor data.
pub(super) const CAMERA_RAW: &str = "a camera raw file: sensor data that a raw converter has to develop; convert it to a TIFF of 16 bit or an OpenEXR, \
    linear, with one white balance and exposure for all photos";

/// The bytes of a TIFF structure, which also holds EXIF data.
#[derive(Clone, Copy)]
pub(super) struct File<'a> {
    bytes: &'a [u8],
    little_endian: bool,
    /// BigTIFF: counts and offsets of 8 bytes instead of 4.
    big: bool,
}

impl<'a> File<'a> {
    /// The structure, and where its first directory is.
    pub fn open(bytes: &'a [u8]) -> Option<(Self, u64)> {
        let little_endian = match bytes.get(..2)? {
            b"II" => true,
            b"MM" => false,
            _ => return None,
        };
        let classic = Self { bytes, little_endian, big: false };
        match classic.number(2, 2)? {
            42 => Some((classic, classic.number(4, 4)?)),
            43 => Some((Self { big: true, ..classic }, classic.number(8, 8)?)),
            _ => None,
        }
    }

    /// The unsigned number in the `size` bytes from `at`.
    fn number(&self, at: usize, size: usize) -> Option<u64> {
        let field = self.bytes.get(at..at.checked_add(size)?)?.iter();
        let push = |number: u64, &byte: &u8| number << 8 | u64::from(byte);
        Some(if self.little_endian { field.rev().fold(0, push) } else { field.fold(0, push) })
    }

    /// The directory at `offset`; entries that lie beyond the end of the file are left out.
    pub fn directory(&self, offset: u64) -> Option<Directory<'a>> {
        let start = usize::try_from(offset).ok()?;
        let (count_size, entry_size, word) = if self.big { (8, 20, 8) } else { (2, 12, 4) };
        let count = usize::try_from(self.number(start, count_size)?).ok()?;
        let first = start + count_size;
        let mut entries = Vec::new();
        let room = (self.bytes.len() - first) / entry_size;
        for at in (0..count.min(room)).map(|i| first + i * entry_size) {
            let (tag, kind) = (self.number(at, 2)? as u16, self.number(at + 2, 2)? as u16);
            let count = usize::try_from(self.number(at + 4, word)?).ok()?;
            let size = match kind {
                1 | 2 | 6 | 7 => 1,
                3 | 8 => 2,
                4 | 9 | 11 | 13 => 4,
                5 | 10 | 12 | 16 | 17 | 18 => 8,
                _ => continue,
            };
            let inline = at + 4 + word;
            let start = match count.checked_mul(size) {
                Some(length) if length <= word => inline,
                Some(_) => usize::try_from(self.number(inline, word)?).ok()?,
                None => continue,
            };
            let Some(data) = start.checked_add(count * size).and_then(|end| self.bytes.get(start..end)) else {
                continue;
            };
            entries.push(Entry { tag, kind, size, data });
        }
        let next = if count <= room { self.number(first + count * entry_size, word).unwrap_or(0) } else { 0 };
        Some(Directory { file: *self, entries, next })
    }
}

struct Entry<'a> {
    tag: u16,
    kind: u16,
    /// Bytes of one value.
    size: usize,
    data: &'a [u8],
}

/// One directory: what its tags say.
pub(super) struct Directory<'a> {
    file: File<'a>,
    entries: Vec<Entry<'a>>,
    /// Where the next one is; 0 after the last.
    next: u64,
}

impl<'a> Directory<'a> {
    fn entry(&self, tag: u16) -> Option<&Entry<'a>> {
        self.entries.iter().find(|entry| entry.tag == tag)
    }

    /// The values of a tag of whole numbers of any kind.
    pub fn numbers(&self, tag: u16) -> Option<Vec<u64>> {
        let entry = self.entry(tag)?;
        if matches!(entry.kind, 2 | 5 | 10 | 11 | 12) {
            return None;
        }
        let file = File { bytes: entry.data, ..self.file };
        (0..entry.data.len() / entry.size).map(|i| file.number(i * entry.size, entry.size)).collect()
    }

    pub fn number(&self, tag: u16) -> Option<u64> {
        self.numbers(tag)?.first().copied()
    }

    /// The directory that a tag points to.
    pub fn below(&self, tag: u16) -> Option<Self> {
        self.file.directory(self.number(tag)?)
    }

    /// The bytes of a tag.
    pub fn bytes(&self, tag: u16) -> Option<&'a [u8]> {
        Some(self.entry(tag)?.data)
    }

    /// The values of a tag of fractions.
    pub fn fractions(&self, tag: u16) -> Option<Vec<f64>> {
        let entry = self.entry(tag).filter(|entry| entry.kind == 5)?;
        let file = File { bytes: entry.data, ..self.file };
        let fraction = |i: usize| Some(file.number(8 * i, 4)? as f64 / file.number(8 * i + 4, 4)? as f64);
        (0..entry.data.len() / 8).map(fraction).collect()
    }

    /// What the page says of its colours.
    fn colors(&self) -> Option<FileColors> {
        if let Some(profile) = self.bytes(tag::ICC_PROFILE) {
            return Some(FileColors::Icc(profile.to_vec()));
        }
        let (white, primaries) = (self.fractions(tag::WHITE_POINT)?, self.fractions(tag::PRIMARY_CHROMATICITIES)?);
        let (&[x, y], &[rx, ry, gx, gy, bx, by]) = (white.as_slice(), primaries.as_slice()) else { return None };
        let chromaticities = Chromaticities { primaries: [[rx, ry], [gx, gy], [bx, by]], white: [x, y] };
        Some(FileColors::Chromaticities { chromaticities, gamma: None, source: "the chromaticities of the TIFF" })
    }

    fn is_reduced(&self) -> bool {
        self.number(tag::NEW_SUBFILE_TYPE).unwrap_or(0) & 1 == 1 || self.number(tag::SUBFILE_TYPE) == Some(2)
    }

    /// A mask that says which pixels of another page count.
    fn is_mask(&self) -> bool {
        self.number(tag::NEW_SUBFILE_TYPE).unwrap_or(0) & 4 == 4
    }

    fn is_camera_raw(&self) -> bool {
        let says = |tag, values: &[u64]| self.number(tag).is_some_and(|value| values.contains(&value));
        self.entry(tag::DNG_VERSION).is_some()
            || says(tag::PHOTOMETRIC, &[photometric::COLOR_FILTER_ARRAY, photometric::LINEAR_RAW])
            || says(tag::COMPRESSION, &RAW_COMPRESSIONS)
    }

    /// What its orientation tag asks for.
    pub fn orientation(&self) -> Option<Orientation> {
        Orientation::from_exif(u8::try_from(self.number(tag::ORIENTATION)?).ok()?)
    }
}

/// The directories of a file: those of its chain, each followed by those below it.
fn directories<'a>(file: File<'a>, first: u64) -> Vec<Directory<'a>> {
    let mut list = Vec::new();
    let mut seen = Vec::new();
    let mut next = first;
    while next != 0 && list.len() < MAX_DIRECTORIES && !seen.contains(&next) {
        seen.push(next);
        let Some(directory) = file.directory(next) else { break };
        next = directory.next;
        let below = directory.numbers(tag::SUB_DIRECTORIES).unwrap_or_default();
        list.push(directory);
        for offset in below {
            if list.len() < MAX_DIRECTORIES && !seen.contains(&offset) {
                seen.push(offset);
                list.extend(file.directory(offset));
            }
        }
    }
    list
}

pub(super) fn decode(path: &Path, bytes: &[u8], cancel: &CancelToken) -> Result<Stored> {
    let Opened { page, orientation, camera, pages } = open(path, bytes, cancel)?;
    let mut stored = Stored { camera, ..page.read()? };
    if pages > 1 {
        stored.notes.push(format!("the first of {pages} pages read"));
    }
    stored.orient(orientation, cancel)
}

/// What reading takes: the picture, and beside it one strip or tile, unpacked.
pub(super) fn demand(path: &Path, bytes: &[u8], cancel: &CancelToken) -> Result<Demand> {
    let Opened { page, orientation, .. } = open(path, bytes, cancel)?;
    let chunk = (page.chunk_width * page.chunk_height * page.samples * page.size) as u64;
    let sample = match page.kind {
        Kind::U8 => 1,
        Kind::U16 => 2,
        Kind::F16 | Kind::F32 | Kind::F64 => 4,
    };
    let stored = (page.width * page.height * page.colors * sample) as u64;
    // A JPEG's pixels are there twice.
    let chunks = if page.compression == Compression::Jpeg { 2 * chunk } else { chunk };
    let beside = bytes.len() as u64 + chunks;
    Ok(Demand::new((page.width, page.height), page.colors, stored, beside, orientation))
}

/// The page that is read, and what else is said of it.
struct Opened<'a> {
    page: Page<'a>,
    orientation: Orientation,
    camera: CameraData,
    /// How many there are.
    pages: usize,
}

fn open<'a>(path: &'a Path, bytes: &'a [u8], cancel: &'a CancelToken) -> Result<Opened<'a>> {
    let (file, first) = File::open(bytes).ok_or_else(|| broken(path, "TIFF without a directory: truncated"))?;
    let directories = directories(file, first);
    // Canon's raw files are told by their third word, their tags do not.
    if bytes.get(8..10) == Some(b"CR") || directories.iter().any(Directory::is_camera_raw) {
        return Err(unsupported(path, CAMERA_RAW));
    }
    let full: Vec<_> = directories.iter().filter(|page| !page.is_reduced() && !page.is_mask()).collect();
    let Some(page) = full.first().copied().or(directories.first()) else {
        return Err(broken(path, "TIFF whose first directory lies beyond its end: truncated"));
    };
    let orientation = page.orientation().unwrap_or(Orientation::NoTransforms);
    let camera = Exif::of(page).camera;
    Ok(Opened { page: Page::new(path, bytes, page, cancel)?, orientation, camera, pages: full.len() })
}

/// How the samples of a page are stored.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    U8,
    U16,
    F16,
    F32,
    F64,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Compression {
    None,
    Lzw,
    Deflate,
    PackBits,
    Jpeg,
}

/// One page whose layout is understood and whose size is one that is read.
struct Page<'a> {
    path: &'a Path,
    cancel: &'a CancelToken,
    file: File<'a>,
    width: usize,
    height: usize,
    kind: Kind,
    /// Bytes of a sample.
    size: usize,
    /// Samples of a pixel in one chunk.
    samples: usize,
    /// How many of a pixel's samples are colours: 1 or 3.
    colors: usize,
    /// Grey whose 0 is white.
    inverted: bool,
    /// Every plane has chunks of its own.
    planar: bool,
    compression: Compression,
    predictor: u64,
    /// Bits of the packed data from the lowest to the highest.
    reversed: bool,
    tiled: bool,
    chunk_width: usize,
    chunk_height: usize,
    offsets: Vec<u64>,
    lengths: Vec<u64>,
    /// For JPEG: what all chunks share, and whether they hold YCbCr.
    jpeg_tables: &'a [u8],
    ycbcr: bool,
    file_colors: Option<FileColors>,
    notes: Vec<String>,
}

impl<'a> Page<'a> {
    fn new(path: &'a Path, bytes: &'a [u8], page: &Directory<'a>, cancel: &'a CancelToken) -> Result<Self> {
        let required = |tag: u16, name: &str| {
            page.number(tag)
                .ok_or_else(|| broken(path, format!("TIFF without {name} (tag {tag}): truncated or damaged")))
        };
        let (width, height) = (required(tag::WIDTH, "a width")?, required(tag::HEIGHT, "a height")?);
        let samples = page.number(tag::SAMPLES_PER_PIXEL).unwrap_or(1);
        let (kind, size) = kind_of(path, page)?;
        let compression = match page.number(tag::COMPRESSION).unwrap_or(1) {
            1 => Compression::None,
            5 => Compression::Lzw,
            8 | 32946 => Compression::Deflate,
            32773 => Compression::PackBits,
            JPEG => Compression::Jpeg,
            other => {
                let reason = format!(
                    "TIFF compression {other}{}; read are none, LZW, deflate, PackBits and JPEG",
                    compression_name(other)
                );
                return Err(unsupported(path, reason));
            }
        };
        let assumed = if samples >= 3 { photometric::RGB } else { photometric::BLACK_IS_ZERO };
        let photometric = page.number(tag::PHOTOMETRIC).unwrap_or(assumed);
        let colors = match photometric {
            photometric::WHITE_IS_ZERO | photometric::BLACK_IS_ZERO => 1,
            photometric::RGB => 3,
            photometric::YCBCR if compression == Compression::Jpeg => 3,
            other => {
                let name = photometric_name(other);
                return Err(unsupported(path, format!("TIFF of {name} pixels; read are grey and RGB")));
            }
        };
        if samples < colors {
            return Err(broken(path, format!("TIFF of {samples} samples a pixel where colour needs {colors}")));
        }
        check_size(path, width, height, colors * size, bytes.len() as u64)?;

        let planar = page.number(tag::PLANAR_CONFIGURATION) == Some(2) && samples > 1;
        let tiled = page.entry(tag::TILE_OFFSETS).is_some();
        let (chunk_width, chunk_height) = if tiled {
            (required(tag::TILE_WIDTH, "a width of tiles")?, required(tag::TILE_HEIGHT, "a height of tiles")?)
        } else {
            (width, page.number(tag::ROWS_PER_STRIP).unwrap_or(height).min(height))
        };
        let (offsets_tag, lengths_tag) = if tiled {
            (tag::TILE_OFFSETS, tag::TILE_BYTE_COUNTS)
        } else {
            (tag::STRIP_OFFSETS, tag::STRIP_BYTE_COUNTS)
        };
        let missing =
            || broken(path, "TIFF without the places and lengths of its strips or tiles: truncated or damaged");
        let offsets = page.numbers(offsets_tag).ok_or_else(missing)?;
        let lengths = page.numbers(lengths_tag).ok_or_else(missing)?;
        if chunk_width == 0 || chunk_height == 0 {
            return Err(broken(path, format!("TIFF in strips or tiles of {chunk_width} x {chunk_height} pixels")));
        }
        // What is unpacked in all, with samples beyond colour and what tiles reach over the edge.
        let planes = if planar { colors } else { 1 };
        let chunks = width.div_ceil(chunk_width) * height.div_ceil(chunk_height);
        let unpacked = chunk_width
            .checked_mul(chunk_height)
            .and_then(|n| n.checked_mul(if planar { 1 } else { samples }))
            .and_then(|n| n.checked_mul(size * planes * chunks));
        if unpacked.is_none_or(|unpacked| unpacked > plausible_bytes(bytes.len() as u64).min(2 * MAX_DECODED_BYTES)) {
            let reason = format!(
                "TIFF of {width} x {height} pixels in {chunks} strips or tiles of {chunk_width} x {chunk_height} pixels of {samples} samples, \
                in a file of {} bytes: more than is read, or damaged",
                bytes.len()
            );
            return Err(broken(path, reason));
        }
        let count = (planes * chunks) as usize;
        if offsets.len() < count || lengths.len() < count {
            let (offsets, lengths) = (offsets.len(), lengths.len());
            let reason = format!("{offsets} offsets and {lengths} lengths of strips or tiles where {count} are needed");
            return Err(broken(path, reason));
        }
        Ok(Self {
            path,
            cancel,
            file: page.file,
            width: width as usize,
            height: height as usize,
            kind,
            size: size as usize,
            samples: if planar { 1 } else { samples as usize },
            colors: colors as usize,
            inverted: photometric == photometric::WHITE_IS_ZERO,
            planar,
            compression,
            predictor: predictor_of(path, page, compression, kind)?,
            reversed: page.number(tag::FILL_ORDER) == Some(2),
            tiled,
            chunk_width: chunk_width as usize,
            chunk_height: chunk_height as usize,
            offsets,
            lengths,
            jpeg_tables: page.bytes(tag::JPEG_TABLES).unwrap_or_default(),
            ycbcr: photometric == photometric::YCBCR,
            file_colors: page.colors(),
            notes: extra_note(page, samples - colors).into_iter().collect(),
        })
    }

    fn read(self) -> Result<Stored> {
        let samples = match self.kind {
            Kind::U8 => OwnedSamples::U8(self.values(|[v]| if self.inverted { !v } else { v })?),
            Kind::U16 => {
                let value = u16::from_ne_bytes;
                OwnedSamples::U16(self.values(|v| if self.inverted { !value(v) } else { value(v) })?)
            }
            Kind::F16 => OwnedSamples::F32(self.floats(|v| half::f16::from_ne_bytes(v).to_f32())?),
            Kind::F32 => OwnedSamples::F32(self.floats(f32::from_ne_bytes)?),
            Kind::F64 => OwnedSamples::F32(self.floats(|v| f64::from_ne_bytes(v) as f32)?),
        };
        let (channels, colors) = (self.colors, self.file_colors);
        Ok(Stored {
            width: self.width,
            height: self.height,
            channels,
            samples,
            colors,
            camera: CameraData::default(),
            notes: self.notes,
        })
    }

    fn floats<const N: usize>(&self, value: impl Fn([u8; N]) -> f32) -> Result<Vec<f32>> {
        self.values(|bytes| if self.inverted { 1.0 - value(bytes) } else { value(bytes) })
    }

    /// The colours of all pixels, made by `value` of the bytes of a sample in this machine's order.
    fn values<const N: usize, T: Copy + Default>(&self, value: impl Fn([u8; N]) -> T) -> Result<Vec<T>> {
        let mut out = memory::filled(T::default(), self.width * self.height * self.colors)?;
        let across = self.width.div_ceil(self.chunk_width);
        let chunks = across * self.height.div_ceil(self.chunk_height);
        let (planes, colors_in_chunk) = if self.planar { (self.colors, 1) } else { (1, self.colors) };
        for plane in 0..planes {
            for chunk in 0..chunks {
                let (left, top) = (chunk % across * self.chunk_width, chunk / across * self.chunk_height);
                let rows = self.chunk_height.min(self.height - top);
                let columns = self.chunk_width.min(self.width - left);
                let data = self.chunk(plane * chunks + chunk, if self.tiled { self.chunk_height } else { rows })?;
                let row_bytes = self.chunk_width * self.samples * N;
                for (row, stored) in data.chunks_exact(row_bytes).take(rows).enumerate() {
                    let start = ((top + row) * self.width + left) * self.colors;
                    let pixels = out[start..start + columns * self.colors].chunks_exact_mut(self.colors);
                    for (pixel, stored) in pixels.zip(stored.chunks_exact(self.samples * N)) {
                        let colors = pixel[plane..].iter_mut().take(colors_in_chunk);
                        for (color, &bytes) in colors.zip(stored.as_chunks::<N>().0) {
                            *color = value(bytes);
                        }
                    }
                }
            }
        }
        Ok(out)
    }

    /// The samples of one chunk of `rows` rows, in this machine's byte order.
    fn chunk(&self, index: usize, rows: usize) -> Result<Vec<u8>> {
        self.cancel.check()?;
        let (offset, length) = (self.offsets[index], self.lengths[index]);
        let file = self.file.bytes;
        let end = offset.checked_add(length).filter(|&end| end <= file.len() as u64);
        let Some(end) = end else {
            let reason = format!("strip or tile {index} ends at byte {offset} + {length}, the file at {}", file.len());
            return Err(broken(self.path, reason));
        };
        let mut packed = std::borrow::Cow::Borrowed(&file[offset as usize..end as usize]);
        if self.reversed {
            packed.to_mut().iter_mut().for_each(|byte| *byte = byte.reverse_bits());
        }
        let row_bytes = self.chunk_width * self.samples * self.size;
        let wanted = rows * row_bytes;
        let mut data = match self.compression {
            Compression::None => packed[..wanted.min(packed.len())].to_vec(),
            Compression::Lzw => self.unpack_lzw(&packed, wanted)?,
            Compression::Deflate => {
                let mut data = Vec::new();
                let mut reader =
                    flate2::read::ZlibDecoder::new(Cancellable::new(&*packed, self.cancel)).take(wanted as u64);
                reader.read_to_end(&mut data).map_err(|reason| broken(self.path, reason))?;
                // Only its end tells whether the stream is sound. Some writers fill the last strip; what is far longer is not looked at.
                let mut rest = reader.into_inner().take(4 * wanted as u64 + (1 << 16));
                std::io::copy(&mut rest, &mut std::io::sink()).map_err(|reason| broken(self.path, reason))?;
                data
            }
            Compression::PackBits => unpack_bits(&packed, wanted),
            Compression::Jpeg => self.jpeg(&packed, rows)?,
        };
        if data.len() < wanted {
            let reason = format!("strip or tile {index} holds {} bytes of {wanted}: truncated or damaged", data.len());
            return Err(broken(self.path, reason));
        }
        // The floating-point predictor stores bytes from the highest on, whatever the file's order.
        if self.predictor != 3 && self.file.little_endian != cfg!(target_endian = "little") {
            data.chunks_exact_mut(self.size).for_each(<[u8]>::reverse);
        }
        for row in data.chunks_exact_mut(row_bytes) {
            match (self.predictor, self.size) {
                (2, 1) => accumulate(row, self.samples, |a, b| {
                    u8::from_ne_bytes(a).wrapping_add(u8::from_ne_bytes(b)).to_ne_bytes()
                }),
                (2, 2) => accumulate(row, self.samples, |a, b| {
                    u16::from_ne_bytes(a).wrapping_add(u16::from_ne_bytes(b)).to_ne_bytes()
                }),
                (2, 4) => accumulate(row, self.samples, |a, b| {
                    u32::from_ne_bytes(a).wrapping_add(u32::from_ne_bytes(b)).to_ne_bytes()
                }),
                (2, _) => accumulate(row, self.samples, |a, b| {
                    u64::from_ne_bytes(a).wrapping_add(u64::from_ne_bytes(b)).to_ne_bytes()
                }),
                (3, _) => gather_floats(row, self.samples, self.size),
                _ => {}
            }
        }
        Ok(data)
    }

    /// What the LZW stream `packed` holds, `wanted` bytes at most. What follows a full chunk does not matter, valid or not; the closing
    /// code may be missing.
    fn unpack_lzw(&self, packed: &[u8], wanted: usize) -> Result<Vec<u8>> {
        const STEP: usize = 1 << 16;
        let mut decoder = Configuration::with_tiff_size_switch(BitOrder::Msb, 8).build();
        let (mut rest, mut out) = (packed, Vec::new());
        while out.len() < wanted {
            self.cancel.check()?;
            let start = out.len();
            out.resize(wanted.min(start + STEP), 0);
            let step = decoder.decode_bytes(rest, &mut out[start..]);
            out.truncate(start + step.consumed_out);
            rest = &rest[step.consumed_in..];
            if out.len() == wanted {
                break;
            }
            match step.status.map_err(|reason| broken(self.path, reason))? {
                LzwStatus::Ok if step.consumed_out + step.consumed_in > 0 => {}
                _ => break,
            }
        }
        Ok(out)
    }

    /// A chunk that is a JPEG picture but for its tables.
    fn jpeg(&self, packed: &[u8], rows: usize) -> Result<Vec<u8>> {
        // A marker of Adobe's says what TIFF's own tag says: 0 for RGB as it is, 1 for YCbCr.
        let adobe =
            [0xff, 0xd8, 0xff, 0xee, 0, 14, b'A', b'd', b'o', b'b', b'e', 0, 100, 0, 0, 0, 0, u8::from(self.ycbcr)];
        let tables = self.jpeg_tables.strip_prefix(&[0xff, 0xd8]).unwrap_or(self.jpeg_tables);
        let tables = tables.strip_suffix(&[0xff, 0xd9]).unwrap_or(tables);
        let body = packed.strip_prefix(&[0xff, 0xd8]).unwrap_or(packed);
        let decoded = decode_jpeg(self.path, &[&adobe, tables, body].concat(), self.cancel)?;
        if let Some(note) = decoded.notes.first() {
            return Err(broken(self.path, note.clone()));
        }
        match decoded.samples {
            OwnedSamples::U8(data)
                if decoded.width == self.chunk_width && decoded.height >= rows && decoded.channels == self.samples =>
            {
                Ok(data[..rows * self.chunk_width * self.samples].to_vec())
            }
            _ => {
                let reason = format!(
                    "a JPEG of {} x {} pixels of {} channels where TIFF says {} x {rows} of {}",
                    decoded.width, decoded.height, decoded.channels, self.chunk_width, self.samples
                );
                Err(broken(self.path, reason))
            }
        }
    }
}

/// How a page's samples are stored, and their bytes.
fn kind_of(path: &Path, page: &Directory<'_>) -> Result<(Kind, u64)> {
    let bits = page.numbers(tag::BITS_PER_SAMPLE).unwrap_or_else(|| vec![1]);
    let formats = page.numbers(tag::SAMPLE_FORMAT).unwrap_or_else(|| vec![1]);
    let same = |values: &[u64]| values.first().is_some_and(|first| values.iter().all(|value| value == first));
    let read = "read are 8 and 16 bit and floats of 16, 32 and 64";
    if !same(&bits) || !same(&formats) {
        return Err(unsupported(path, format!("TIFF samples of {bits:?} bits in formats {formats:?}; {read}")));
    }
    match (bits[0], formats[0]) {
        (8, 1 | 4) => Ok((Kind::U8, 1)),
        (16, 1 | 4) => Ok((Kind::U16, 2)),
        (16, 3) => Ok((Kind::F16, 2)),
        (32, 3) => Ok((Kind::F32, 4)),
        (64, 3) => Ok((Kind::F64, 8)),
        (bits, format) => {
            let name = match format {
                1 | 4 => "",
                2 => " signed",
                3 => " float",
                _ => " complex",
            };
            Err(unsupported(path, format!("TIFF samples of {bits} bits{name}; {read}")))
        }
    }
}

/// What was done to the samples before they were packed. As in libtiff only LZW and deflate have it.
fn predictor_of(path: &Path, page: &Directory<'_>, compression: Compression, kind: Kind) -> Result<u64> {
    match (compression, page.number(tag::PREDICTOR).unwrap_or(1)) {
        (Compression::Lzw | Compression::Deflate, predictor) => match predictor {
            1 | 2 => Ok(predictor),
            3 if !matches!(kind, Kind::U8 | Kind::U16) => Ok(predictor),
            other => Err(unsupported(path, format!("TIFF predictor {other} of these samples"))),
        },
        _ => Ok(1),
    }
}

fn compression_name(compression: u64) -> &'static str {
    match compression {
        2..=4 => " (fax)",
        6 => " (JPEG in its old form)",
        34887 => " (LERC)",
        34925 => " (LZMA)",
        50000 => " (Zstandard)",
        50001 => " (WebP)",
        50002 => " (JPEG XL)",
        _ => "",
    }
}

fn photometric_name(photometric: u64) -> String {
    match photometric {
        3 => "palette".to_owned(),
        4 => "mask".to_owned(),
        5 => "CMYK".to_owned(),
        photometric::YCBCR => "YCbCr".to_owned(),
        8..=10 => "Lab".to_owned(),
        other => format!("photometric interpretation {other}"),
    }
}

/// What is said of the samples beyond colour.
fn extra_note(page: &Directory<'_>, extra: u64) -> Option<String> {
    let alpha = page.numbers(tag::EXTRA_SAMPLES).is_some_and(|kinds| kinds.iter().any(|kind| matches!(kind, 1 | 2)));
    match extra {
        0 => None,
        1 if alpha => Some("alpha ignored".to_owned()),
        _ => Some(format!("{extra} of the samples of a pixel are no colour: ignored")),
    }
}

/// What the PackBits runs of `packed` hold, `wanted` bytes at most.
fn unpack_bits(packed: &[u8], wanted: usize) -> Vec<u8> {
    let mut out = Vec::new();
    let mut rest = packed;
    while let (true, Some((&head, tail))) = (out.len() < wanted, rest.split_first()) {
        rest = match head as i8 {
            -128 => tail,
            count @ 0.. => {
                let (literal, tail) = tail.split_at(tail.len().min(count as usize + 1));
                out.extend(literal);
                tail
            }
            count => match tail.split_first() {
                Some((&byte, tail)) => {
                    out.extend(std::iter::repeat_n(byte, 1 + usize::from(count.unsigned_abs())));
                    tail
                }
                None => tail,
            },
        };
    }
    out.truncate(wanted);
    out
}

/// Undoes horizontal differencing: every sample was stored less the one `stride` samples before it.
fn accumulate<const N: usize>(row: &mut [u8], stride: usize, sum: impl Fn([u8; N], [u8; N]) -> [u8; N]) {
    let samples = row.as_chunks_mut::<N>().0;
    for i in stride..samples.len() {
        samples[i] = sum(samples[i - stride], samples[i]);
    }
}

/// Undoes the floating-point predictor: bytes are differences, and the highest bytes of a row's samples come first, the lowest last.
fn gather_floats(row: &mut [u8], stride: usize, size: usize) {
    accumulate(row, stride, |[a], [b]| [a.wrapping_add(b)]);
    let planes = row.to_vec();
    let samples = row.len() / size;
    for (i, sample) in row.chunks_exact_mut(size).enumerate() {
        for (place, byte) in sample.iter_mut().enumerate() {
            let plane = if cfg!(target_endian = "little") { size - 1 - place } else { place };
            *byte = planes[plane * samples + i];
        }
    }
}
