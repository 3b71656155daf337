//! LZW-compressed TIFF, unpacked before the decoder sees it.
//!
//! The `tiff` crate (0.11) pulls pixels out of an LZW stream row by row and refuses valid files where a row ends inside of a code
//! (<https://github.com/image-rs/image-tiff/issues/395>), as tiles do; it also refuses streams without the closing code, which some
//! programs write and libtiff reads. Here every strip or tile is decoded in one go, until it is full, and the file handed on is the
//! same one without compression. Delete this module when a release of `tiff` reads them.

use std::io::{Read, Seek};
use std::path::Path;

use tiff::decoder::{ChunkType, Decoder};
use tiff::tags::{ByteOrder, Tag};
use weezl::{BitOrder, LzwStatus, decode::Configuration};

use super::decode::{broken, tiff_error};
use crate::error::Result;

const LZW: u16 = 5;
const UNCOMPRESSED: u16 = 1;
const SEPARATE_PLANES: u16 = 2;
const LONG: u64 = 4;

/// The file `bytes` with its first image unpacked, or none where that image is not LZW-compressed. `sample_bytes` and `channels`
/// are its own; at most `limit` bytes are unpacked.
pub(super) fn unpacked<R: Read + Seek>(
    path: &Path,
    bytes: &[u8],
    decoder: &mut Decoder<R>,
    sample_bytes: usize,
    channels: usize,
    limit: u64,
) -> Result<Option<Vec<u8>>> {
    let error = |e| tiff_error(path, e);
    if decoder.find_tag_unsigned::<u16>(Tag::Compression).map_err(error)? != Some(LZW) {
        return Ok(None);
    }
    let (offsets_tag, counts_tag) = match decoder.get_chunk_type() {
        ChunkType::Strip => (Tag::StripOffsets, Tag::StripByteCounts),
        ChunkType::Tile => (Tag::TileOffsets, Tag::TileByteCounts),
    };
    let separate = decoder.find_tag_unsigned::<u16>(Tag::PlanarConfiguration).map_err(error)? == Some(SEPARATE_PLANES);
    let (width, height) = decoder.chunk_dimensions();
    let samples = if separate { 1 } else { channels };
    let chunk_bytes = u64::from(width) * u64::from(height);
    let chunk_bytes = chunk_bytes.saturating_mul((sample_bytes * samples) as u64);
    let offsets = decoder.get_tag_u64_vec(offsets_tag).map_err(error)?;
    let counts = decoder.get_tag_u64_vec(counts_tag).map_err(error)?;
    if offsets.len() != counts.len() {
        let message = format!("{} offsets of strips or tiles and {} lengths", offsets.len(), counts.len());
        return Err(broken(path, message));
    }

    let mut out = bytes.to_vec();
    let mut places = Vec::with_capacity(offsets.len());
    let mut lengths = Vec::with_capacity(offsets.len());
    let mut unpacked_bytes = 0;
    for (&offset, &count) in offsets.iter().zip(&counts) {
        let end = offset.checked_add(count).filter(|&end| end <= bytes.len() as u64);
        let Some(end) = end else {
            let message = format!("a strip or tile ends at byte {offset} + {count}, the file at {}", bytes.len());
            return Err(broken(path, message));
        };
        let start = out.len();
        unpack(&bytes[offset as usize..end as usize], chunk_bytes.min(limit - unpacked_bytes) as usize, &mut out)
            .map_err(|reason| broken(path, reason))?;
        unpacked_bytes += (out.len() - start) as u64;
        places.push(start as u64);
        lengths.push((out.len() - start) as u64);
    }

    let directory = Directory::of(&out, decoder.byte_order());
    let rewritten = directory.is_some_and(|directory| {
        directory.set(&mut out, offsets_tag, &places)
            && directory.set(&mut out, counts_tag, &lengths)
            && directory.set(&mut out, Tag::Compression, &[UNCOMPRESSED.into()])
    });
    if rewritten { Ok(Some(out)) } else { Err(broken(path, "the directory of the image is not where its header says")) }
}

/// Appends what the LZW stream `packed` holds, `wanted` bytes at most.
fn unpack(packed: &[u8], wanted: usize, out: &mut Vec<u8>) -> std::result::Result<(), weezl::LzwError> {
    const STEP: usize = 1 << 16;
    let mut decoder = Configuration::with_tiff_size_switch(BitOrder::Msb, 8).build();
    let (mut rest, end) = (packed, out.len() + wanted);
    while out.len() < end {
        let start = out.len();
        out.resize(end.min(start + STEP), 0);
        let step = decoder.decode_bytes(rest, &mut out[start..]);
        out.truncate(start + step.consumed_out);
        rest = &rest[step.consumed_in..];
        // What follows a full strip does not matter, valid or not.
        if out.len() == end {
            break;
        }
        match step.status? {
            LzwStatus::Ok if step.consumed_out + step.consumed_in > 0 => {}
            _ => break,
        }
    }
    Ok(())
}

/// The first directory of a TIFF: where its entries stand and how wide their fields are.
struct Directory {
    order: ByteOrder,
    /// BigTIFF: counts and values of 8 bytes instead of 4.
    wide: bool,
    first: usize,
    entries: usize,
}

impl Directory {
    fn of(file: &[u8], order: ByteOrder) -> Option<Self> {
        let number = |at: usize, bytes: usize| read_number(file, order, at, bytes);
        let wide = number(2, 2)? == 43;
        let start = usize::try_from(if wide { number(8, 8)? } else { number(4, 4)? }).ok()?;
        let width = if wide { 8 } else { 2 };
        let entries = usize::try_from(number(start, width)?).ok()?;
        Some(Self { order, wide, first: start + width, entries: entries.min(file.len()) })
    }

    /// Makes `values` the value of the entry `tag`; what does not fit into the entry goes to the end of the file. False where
    /// there is no such entry or the numbers do not fit.
    fn set(&self, file: &mut Vec<u8>, tag: Tag, values: &[u64]) -> bool {
        let (size, width) = if self.wide { (20, 8) } else { (12, 4) };
        let entry = (0..self.entries)
            .map(|i| self.first + i * size)
            .find(|&at| at + size <= file.len() && read_number(file, self.order, at, 2) == Some(tag.to_u16().into()));
        let Some(entry) = entry else { return false };
        let end = file.len() as u64;
        if values.iter().chain([&end]).any(|&value| value > u32::MAX.into()) {
            return false;
        }
        let number = |value: u64, bytes: usize| written_number(self.order, value, bytes);
        let data: Vec<u8> = values.iter().flat_map(|&value| number(value, 4)).collect();
        file[entry + 2..entry + 4].copy_from_slice(&number(LONG, 2));
        file[entry + 4..][..width].copy_from_slice(&number(values.len() as u64, width));
        let value = &mut file[entry + 4 + width..][..width];
        if data.len() <= width {
            value[..data.len()].copy_from_slice(&data);
        } else {
            value.copy_from_slice(&number(end, width));
            file.extend(data);
        }
        true
    }
}

/// The lowest `bytes` of `value` as a file of this order has them.
fn written_number(order: ByteOrder, value: u64, bytes: usize) -> Vec<u8> {
    match order {
        ByteOrder::LittleEndian => value.to_le_bytes()[..bytes].to_vec(),
        ByteOrder::BigEndian => value.to_be_bytes()[8 - bytes..].to_vec(),
    }
}

fn read_number(file: &[u8], order: ByteOrder, at: usize, bytes: usize) -> Option<u64> {
    let field = file.get(at..at.checked_add(bytes)?)?.iter();
    let push = |number: u64, &byte: &u8| number << 8 | u64::from(byte);
    Some(match order {
        ByteOrder::LittleEndian => field.rev().fold(0, push),
        ByteOrder::BigEndian => field.fold(0, push),
    })
}
