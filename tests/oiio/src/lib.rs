//! What OpenImageIO reads and writes, as plain floats.

#![allow(unsafe_code, reason = "the bridge to C++ is unsafe code that cxx generates")]
#![allow(missing_docs, reason = "cxx gives its own items no documentation")]

#[cxx::bridge(namespace = "svbrdf_gcn_oiio")]
pub mod bridge {
    /// The pixels of a file's data window, and where that lies.
    #[derive(Clone, Debug, Default)]
    struct Picture {
        width: i32,
        height: i32,
        /// The data window's corner.
        x: i32,
        y: i32,
        /// The display window, or as the data window where its size is 0.
        full_x: i32,
        full_y: i32,
        full_width: i32,
        full_height: i32,
        /// Names of the channels, separated by commas.
        channels: String,
        /// Interleaved, rows from the top; integers as their share of the top code.
        values: Vec<f32>,
    }

    /// How a file is written.
    #[derive(Clone, Debug, Default)]
    struct Encoding {
        /// `uint8`, `uint16`, `half` or `float`.
        format: String,
        /// The format's own name of it; its default if empty.
        compression: String,
        /// Tiles of this size, if above 0.
        tile: i32,
        /// Planes one after another instead of interleaved.
        separate: bool,
        /// How often the picture is written, as that many parts of the file; 0 is once, without parts.
        parts: i32,
        /// EXIF orientation; none if 0.
        orientation: i32,
    }

    unsafe extern "C++" {
        include!("svbrdf-gcn-oiio-tests/src/bridge.h");

        /// Reads a file's first part; alpha stays unassociated.
        fn read(path: &str) -> Result<Picture>;
        /// Writes a file in the format of its extension.
        fn write(path: &str, picture: &Picture, encoding: &Encoding) -> Result<()>;
        /// Converts colours with the OpenColorIO configuration at `config`.
        fn convert(config: &str, from: &str, to: &str, picture: &Picture) -> Result<Picture>;
    }
}

pub use bridge::{Encoding, Picture, convert, read, write};
