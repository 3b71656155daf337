//! Image files of every format: an error or an image, never a panic or a huge allocation.
#![no_main]

use libfuzzer_sys::fuzz_target;
use svbrdf_gcn::Transfer;
use svbrdf_gcn::io::decode_image;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(image) = decode_image("input", bytes, Transfer::Srgb) {
        assert_eq!(image.data().len(), image.width() * image.height() * image.channels());
    }
});
