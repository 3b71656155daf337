//! The text and JSON files of captures and materials: an error or a capture with what it promises.
//!
//! The first byte of an input picks the layout; a byte 0 ends one text file and begins the next.
#![no_main]

use std::cell::LazyCell;
use std::fs;
use std::path::Path;

use libfuzzer_sys::{Corpus, fuzz_target};
use svbrdf_gcn::{Capture, Material};
use tempfile::TempDir;

/// A PNG of one black pixel.
const PIXEL: &[u8] = include_bytes!("../seeds/image/pixel.png");

thread_local! {
    static FOLDER: LazyCell<TempDir> = LazyCell::new(|| {
        let folder = TempDir::new().expect("a temporary folder");
        for name in ["00.png", "1.png", "02.png"] {
            fs::write(folder.path().join(name), PIXEL).expect("a photo");
        }
        folder
    });
}

fuzz_target!(|bytes: &[u8]| -> Corpus { FOLDER.with(|folder| run(folder.path(), bytes)) });

fn run(folder: &Path, bytes: &[u8]) -> Corpus {
    let Some((&layout, text)) = bytes.split_first() else { return Corpus::Reject };
    let names: &[&str] = match layout {
        b'0' => &["capture.json"],
        b'1' => &["other.json"],
        b'2' => &["camera_pos.txt", "light_pos.txt", "image_size.txt", "light_power.txt"],
        b'3' => &["material.json"],
        _ => return Corpus::Reject,
    };
    for (name, text) in names.iter().zip(text.split(|&byte| byte == 0)) {
        fs::write(folder.join(name), text).expect("a text file");
    }
    match layout {
        b'3' => drop(Material::load(folder)),
        b'1' => check(Capture::open(folder.join("other.json"))),
        _ => check(Capture::open(folder)),
    }
    for name in names {
        drop(fs::remove_file(folder.join(name)));
    }
    Corpus::Keep
}

fn check(capture: svbrdf_gcn::Result<Capture>) {
    let Ok(capture) = capture else { return };
    assert!(capture.patch_size() > 0.0 && !capture.photos().is_empty());
    for photo in capture.photos() {
        assert!(photo.shot.camera[2] > 0.0 && photo.shot.light[2] > 0.0);
    }
}
