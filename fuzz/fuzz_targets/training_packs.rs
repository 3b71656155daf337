//! Packs of materials to train on: an error or materials, never a panic or a huge allocation.
//!
//! The first byte of an input says what the rest is: 0, a whole pack; 1, its index and, after a byte 0, its JPEGs of albedo.
#![no_main]

use std::cell::LazyCell;
use std::io::{Cursor, Write};
use std::path::Path;

use libfuzzer_sys::{Corpus, fuzz_target};
use svbrdf_gcn::train::Library;
use tempfile::TempDir;
use zip::write::{SimpleFileOptions, ZipWriter};

/// A JPEG of 9 x 9 pixels.
const SMALL: &[u8] = include_bytes!("../seeds/image/grey8.jpg");

thread_local! {
    static FOLDER: LazyCell<TempDir> = LazyCell::new(|| TempDir::new().expect("a temporary folder"));
}

fuzz_target!(|bytes: &[u8]| -> Corpus { FOLDER.with(|folder| run(&folder.path().join("pack.zip"), bytes)) });

fn run(path: &Path, bytes: &[u8]) -> Corpus {
    let pack = match bytes.split_first() {
        Some((b'0', pack)) => pack.to_vec(),
        Some((b'1', parts)) => {
            let mut parts = parts.splitn(2, |&byte| byte == 0);
            packed(parts.next().unwrap_or_default(), parts.next().unwrap_or(SMALL))
        }
        _ => return Corpus::Reject,
    };
    std::fs::write(path, pack).expect("a pack");
    if let Ok(library) = Library::open(path) {
        assert!(library.facts()["materials"].as_u64().is_some_and(|count| count > 0));
    }
    Corpus::Keep
}

/// A pack of two materials, `a` and `b`.
fn packed(index: &[u8], albedo: &[u8]) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let mut add = |name: &str, bytes: &[u8]| {
        zip.start_file(name, SimpleFileOptions::default()).expect("an entry");
        zip.write_all(bytes).expect("an entry");
    };
    add("materials.json", index);
    for material in ["a", "b"] {
        for (kind, bytes) in [("basecolor", albedo), ("normal", SMALL), ("roughness", SMALL), ("metallic", SMALL)] {
            add(&format!("{material}/{kind}.jpg"), bytes);
        }
    }
    zip.finish().expect("a pack").into_inner()
}
