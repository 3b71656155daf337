//! Files: photos and renderings in and out, material folders.
//!
//! Images are recognised by their first bytes, not by their names. What is read: PNG 8 and 16 bit, JPEG, TIFF 8 and 16 bit and
//! half, single and double float, OpenEXR half and float. Orientation tags (EXIF, TIFF) are applied, so that row 0 is the row a
//! viewer shows on top; an OpenEXR image is its display window. Colour profiles count where photos of a capture are read
//! ([`CaptureOptions::ignore_profiles`](crate::CaptureOptions::ignore_profiles)); everywhere else the encoding is what the caller states.

mod decode;
pub(crate) mod describe;
mod encode;
mod exif;
mod exr;
pub(crate) mod file;
mod jpeg;
pub mod material;
pub(crate) mod ours;
pub(crate) mod profile;
pub(crate) mod resize;
pub(crate) mod save;
mod tiff;

use std::path::Path;

pub use encode::write_image;
#[cfg(feature = "cli")]
pub(crate) use encode::write_image_in;
pub(crate) use encode::{exr_half, png8, png16};

use crate::cancel::CancelToken;
use crate::color::Transfer;
use crate::error::Result;
use crate::image::Image;

pub(crate) use decode::{Demand, Pixels, RowReader, Stored, demand, read_stored};
pub use decode::{MAX_DECODED_BYTES, Samples};
pub(crate) use exif::CameraData;
pub(crate) use file::read_file;

/// Reads an image file as linear values: (H, W, 3) for colour, (H, W, 1) for grey. An alpha channel is left out.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) for a missing, truncated or broken file, [`Error::UnsupportedFormat`](crate::Error::UnsupportedFormat)
/// for one of a kind that is not read, [`Error::InvalidArgument`](crate::Error::InvalidArgument) for one whose header states an absurd size.
pub fn read_image(path: impl AsRef<Path>, transfer: Transfer) -> Result<Image> {
    read_stored(path.as_ref(), &CancelToken::new())?.to_image(transfer)
}

/// [`read_image`] of a file that is already in memory; `name` is what messages call it.
///
/// # Errors
/// As [`read_image`].
pub fn decode_image(name: &str, bytes: &[u8], transfer: Transfer) -> Result<Image> {
    decode::decode(Path::new(name), bytes, &CancelToken::new())?.to_image(transfer)
}
