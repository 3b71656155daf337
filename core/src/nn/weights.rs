//! Reading weights files, which may be broken or hostile.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::io::{Read, Seek, SeekFrom, Write};

use crc32fast::Hasher;
use half::f16;
use safetensors::Dtype;
use safetensors::tensor::{Metadata, TensorInfo};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// Longest header accepted; that of a file with the released networks has some 100 kB.
const MAX_HEADER: u64 = 8 << 20;
/// Bytes read at a time.
const BUFFER: usize = 1 << 16;

/// The entry of the metadata with the [`Checksums`].
pub(crate) const CHECKSUMS: &str = "checksums";

/// CRC-32 (of zlib), as eight hexadecimal digits, of what a file holds. It finds what happens to files: any one flipped bit, any burst of up to
/// 32 bits, and of other damage all but one in 4 billion. It is no proof against intent, which would write its own.
#[derive(Serialize, Deserialize)]
struct Checksums {
    /// Of all other entries of the metadata; see [`metadata_checksum`].
    metadata: String,
    /// Of the bytes of each tensor as they are stored, by its name.
    tensors: BTreeMap<String, String>,
}

/// The checksum of the metadata without [`CHECKSUMS`]: for each entry, in the order of their keys, key, NUL, value, NUL.
fn metadata_checksum(metadata: &HashMap<String, String>) -> String {
    let entries: BTreeMap<_, _> = metadata.iter().filter(|(key, _)| key.as_str() != CHECKSUMS).collect();
    let mut hasher = Hasher::new();
    for text in entries.into_iter().flat_map(|(key, value)| [key, value]) {
        hasher.update(text.as_bytes());
        hasher.update(&[0]);
    }
    digits(hasher)
}

fn digits(hasher: Hasher) -> String {
    format!("{:08x}", hasher.finalize())
}

/// The bytes of `values` as a file has them, piece by piece.
fn stored(values: &[f32]) -> impl Iterator<Item = Vec<u8>> {
    values.chunks(BUFFER / size_of::<f32>()).map(|piece| piece.iter().flat_map(|value| value.to_le_bytes()).collect())
}

/// An [`Error::Weights`].
pub(crate) fn broken(reason: impl Into<String>) -> Error {
    Error::Weights { reason: reason.into() }
}

/// A tensor to be written: name, shape, values.
pub(crate) type Named<'a> = (String, Vec<usize>, &'a [f32]);

/// Writes a safetensors file of `tensors` as `f32`, with checksums, the data aligned to 8 bytes.
pub(crate) fn write(
    mut out: impl Write,
    mut metadata: HashMap<String, String>,
    tensors: &[Named<'_>],
) -> std::io::Result<()> {
    let mut end = 0;
    let info = |(name, shape, values): &Named<'_>| {
        let start = end;
        end += size_of_val(*values);
        (name.clone(), TensorInfo { dtype: Dtype::F32, shape: shape.clone(), data_offsets: (start, end) })
    };
    let infos = tensors.iter().map(info).collect();
    let checksum = |values: &[f32]| {
        let mut hasher = Hasher::new();
        stored(values).for_each(|bytes| hasher.update(&bytes));
        digits(hasher)
    };
    let checksums = Checksums {
        metadata: metadata_checksum(&metadata),
        tensors: tensors.iter().map(|(name, _, values)| (name.clone(), checksum(values))).collect(),
    };
    metadata.insert(CHECKSUMS.into(), serde_json::to_string(&checksums)?);
    let header = Metadata::new(Some(metadata), infos).map_err(std::io::Error::other)?;
    let mut header = serde_json::to_vec(&header)?;
    header.resize(header.len().next_multiple_of(8), b' ');
    out.write_all(&(header.len() as u64).to_le_bytes())?;
    out.write_all(&header)?;
    for bytes in tensors.iter().flat_map(|tensor| stored(tensor.2)) {
        out.write_all(&bytes)?;
    }
    out.flush()
}

/// A safetensors file whose header has been checked; tensors are read one by one, each against its checksum if the file has them.
pub(crate) struct Reader<R> {
    source: R,
    header: Metadata,
    /// Of the tensors; none in files of before there were any.
    checksums: Option<BTreeMap<String, String>>,
    start: u64,
}

impl<R: Read + Seek> Reader<R> {
    /// Reads and checks the header.
    pub fn open(mut source: R) -> Result<Self> {
        let unreadable = |error: std::io::Error| broken(format!("cannot be read: {error}"));
        let total = source.seek(SeekFrom::End(0)).map_err(unreadable)?;
        source.seek(SeekFrom::Start(0)).map_err(unreadable)?;
        let mut len = [0; 8];
        source.read_exact(&mut len).map_err(|_| broken(format!("expected 8 bytes or more, got {total}")))?;
        let len = u64::from_le_bytes(len);
        if len > MAX_HEADER || len > total - 8 {
            return Err(broken(format!(
                "header of {len} bytes in a file of {total}, at most {MAX_HEADER} are accepted"
            )));
        }
        let mut header = Vec::new();
        source.by_ref().take(len).read_to_end(&mut header).map_err(unreadable)?;
        // Fails where tensors overlap, leave gaps or do not have the bytes their shapes need.
        let header: Metadata = serde_json::from_slice(&header).map_err(|error| broken(format!("header: {error}")))?;
        let (expected, got) = (header.data_len() as u64, total - 8 - len);
        if expected != got {
            return Err(broken(format!("expected {expected} bytes of data, got {got}")));
        }
        let checksums = checked_metadata(&header)?;
        Ok(Self { source, header, checksums, start: 8 + len })
    }

    /// Whether the file has checksums.
    pub fn has_checksums(&self) -> bool {
        self.checksums.is_some()
    }

    /// An entry of the file's metadata.
    pub fn metadata(&self, key: &str) -> Result<&str> {
        let found = self.header.metadata().as_ref().and_then(|metadata| metadata.get(key));
        found.map(String::as_str).ok_or_else(|| broken(format!("metadata entry \"{key}\" is missing")))
    }

    /// Whether the file's metadata have this entry.
    pub fn has_metadata(&self, key: &str) -> bool {
        self.metadata(key).is_ok()
    }

    /// The entries of the file's metadata whose keys are not among `known`.
    pub fn other_metadata(&self, known: &[&str]) -> BTreeMap<String, String> {
        let all = self.header.metadata().iter().flatten();
        all.filter(|(key, _)| !known.contains(&key.as_str())).map(|(key, value)| (key.clone(), value.clone())).collect()
    }

    /// The names of all tensors.
    pub fn names(&self) -> BTreeSet<String> {
        self.header.offset_keys().into_iter().collect()
    }

    /// Reads tensor `name` of `shape`, up to dimensions of one, as `f32`.
    pub fn read(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        let info = self.header.info(name).ok_or_else(|| broken(format!("tensor {name} is missing")))?;
        let sides = |shape: &[usize]| shape.iter().copied().filter(|&side| side != 1).collect::<Vec<_>>();
        if sides(&info.shape) != sides(shape) {
            return Err(broken(format!("tensor {name}: expected shape {shape:?}, got {:?}", info.shape)));
        }
        let size = match info.dtype {
            Dtype::F32 => 4,
            Dtype::F16 => 2,
            other => return Err(broken(format!("tensor {name}: expected F32 or F16, got {other}"))),
        };
        let unreadable = |error: std::io::Error| broken(format!("tensor {name}: {error}"));
        self.source.seek(SeekFrom::Start(self.start + info.data_offsets.0 as u64)).map_err(unreadable)?;
        // The file is as long as its header says, so that this allocates no more than it holds.
        let mut left = info.data_offsets.1 - info.data_offsets.0;
        let mut values = Vec::with_capacity(left / size);
        let mut buffer = vec![0; BUFFER.min(left)];
        let mut hasher = Hasher::new();
        while left > 0 {
            let bytes = &mut buffer[..BUFFER.min(left)];
            self.source.read_exact(bytes).map_err(unreadable)?;
            left -= bytes.len();
            hasher.update(bytes);
            if size == 4 {
                values.extend(bytes.as_chunks().0.iter().map(|&value| f32::from_le_bytes(value)));
            } else {
                values.extend(bytes.as_chunks().0.iter().map(|&value| f16::from_le_bytes(value).to_f32()));
            }
        }
        if let Some(checksums) = &self.checksums {
            compare(&format!("tensor {name}"), checksums.get(name), digits(hasher))?;
        }
        match values.iter().position(|value| !value.is_finite()) {
            Some(place) => Err(broken(format!("tensor {name}: value {place} is {}", values[place]))),
            None => Ok(values),
        }
    }
}

/// The tensors' checksums that a file states, if the metadata are those that it was written with.
fn checked_metadata(header: &Metadata) -> Result<Option<BTreeMap<String, String>>> {
    let Some(metadata) = header.metadata() else { return Ok(None) };
    let Some(text) = metadata.get(CHECKSUMS) else { return Ok(None) };
    let stated: Checksums =
        serde_json::from_str(text).map_err(|error| broken(format!("metadata entry \"{CHECKSUMS}\": {error}")))?;
    compare("the metadata", Some(&stated.metadata), metadata_checksum(metadata))?;
    Ok(Some(stated.tensors))
}

/// Fails unless the checksum of `what` is the one stated.
fn compare(what: &str, stated: Option<&String>, got: String) -> Result<()> {
    if stated == Some(&got) {
        return Ok(());
    }
    let stated = stated.map_or("none", String::as_str);
    Err(broken(format!(
        "{what}: the checksum is {got}, the file states {stated}: it is damaged, fetch or export it again"
    )))
}
