//! Every image format, read from bytes written by hand, and written and read back.

use std::fs;

use crate::{common, files};
use image::codecs::jpeg::JpegEncoder;
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::Index;
use svbrdf_gcn::io::{Samples, decode_image, read_image, write_image};
use svbrdf_gcn::{Capture, CaptureOptions, Error, Image, PhotoPixels, Shot, Transfer};
use tempfile::TempDir;

/// Values whose 8- and 16-bit codes, half and float are all different.
const RGB: [f32; 12] = [0.0, 0.25, 0.5, 1.0, 0.125, 0.75, 0.0625, 0.875, 0.375, 0.5, 0.03125, 1.0];

fn decode(bytes: &[u8]) -> Image {
    decode_image("file", bytes, Transfer::Linear).unwrap()
}

fn le<const N: usize, T: Copy>(values: &[T], bytes: impl Fn(T) -> [u8; N]) -> Vec<u8> {
    values.iter().flat_map(|&v| bytes(v)).collect()
}

fn assert_close(got: &Image, expected: &[f32], tolerance: f32) {
    assert_eq!(got.data().len(), expected.len());
    for (got, expected) in got.data().iter().zip(expected) {
        assert!((got - expected).abs() <= tolerance, "{got} instead of {expected}");
    }
}

#[test]
fn png() {
    let codes: Vec<u16> = (0..12).map(|i| i * 23).collect();
    let expected: Vec<f32> = codes.iter().map(|&code| f32::from(code) / 255.0).collect();
    let image = decode(&files::png(2, 2, 2, 8, &codes));
    assert_eq!((image.width(), image.height(), image.channels()), (2, 2, 3));
    assert_eq!(image.data(), expected);
    assert_eq!(decode(&files::png(4, 3, 0, 8, &codes)).data(), expected);
    let opaque = [0, 3, 6, 9].map(|i| expected[i]);
    let with_alpha: Vec<u16> = codes.iter().step_by(3).flat_map(|&v| [v, 17]).collect();
    assert_eq!(decode(&files::png(2, 2, 4, 8, &with_alpha)).data(), opaque);
    let rgba: Vec<u16> = codes.chunks(3).flat_map(|p| [p[0], p[1], p[2], 17]).collect();
    assert_eq!(decode(&files::png(2, 2, 6, 8, &rgba)).data(), expected);

    let codes: Vec<u16> = (0..12).map(|i| i * 5957 + 8).collect();
    let expected: Vec<f32> = codes.iter().map(|&code| f32::from(code) / 65535.0).collect();
    assert_eq!(decode(&files::png(2, 2, 2, 16, &codes)).data(), expected);
    assert_eq!(decode(&files::png(12, 1, 0, 16, &codes)).data(), expected);
    let encoded = decode_image("file", &files::png(12, 1, 0, 16, &codes), Transfer::Srgb).unwrap();
    for (decoded, stored) in encoded.data().iter().zip(expected) {
        assert_eq!(*decoded, Transfer::Srgb.decode(stored));
    }
}

#[test]
fn tiff() {
    let half = |v: f32| half::f16::from_f32(v).to_le_bytes();
    let byte = |v: f32| [(v * 255.0).round() as u8];
    let word = |v: f32| ((v * 65535.0).round() as u16).to_le_bytes();
    for (channels, width) in [(1, 6), (3, 2)] {
        let file = |bits, format, data: &[u8]| files::tiff(width, 2, channels, bits, format, 1, data);
        assert_close(&decode(&file(8, 1, &le(&RGB, byte))), &RGB, 0.5001 / 255.0);
        assert_close(&decode(&file(16, 1, &le(&RGB, word))), &RGB, 0.5001 / 65535.0);
        assert_close(&decode(&file(16, 3, &le(&RGB, half))), &RGB, 0.0);
        assert_close(&decode(&file(32, 3, &le(&RGB, f32::to_le_bytes))), &RGB, 0.0);
        assert_close(&decode(&file(64, 3, &le(&RGB, |v| f64::from(v).to_le_bytes()))), &RGB, 0.0);
        let error = decode_image("x.tif", &file(32, 1, &[0; 48]), Transfer::Linear).unwrap_err();
        assert!(matches!(error, Error::UnsupportedFormat { .. }), "{error}");
    }
    let rgba: Vec<f32> = RGB.chunks(3).flat_map(|p| [p[0], p[1], p[2], 0.3]).collect();
    assert_close(&decode(&files::tiff(2, 2, 4, 32, 3, 1, &le(&rgba, f32::to_le_bytes))), &RGB, 0.0);
    let grey_alpha: Vec<f32> = RGB.iter().flat_map(|&v| [v, 0.3]).collect();
    assert_close(&decode(&files::tiff(4, 3, 2, 32, 3, 1, &le(&grey_alpha, f32::to_le_bytes))), &RGB, 0.0);
}

/// What a page holds of its samples, as it should be read.
fn colors(page: &files::Tiff) -> Vec<f32> {
    let value = |bits: u64| match (page.bits, page.float) {
        (8, _) => bits as f32 / 255.0,
        (16, false) => bits as f32 / 65535.0,
        (16, true) => half::f16::from_bits(bits as u16).to_f32(),
        (32, _) => f32::from_bits(bits as u32),
        _ => f64::from_bits(bits) as f32,
    };
    let pixels = (0..page.height).flat_map(|y| (0..page.width).map(move |x| (x, y)));
    pixels.flat_map(|(x, y)| (0..page.colors).map(move |c| value((page.sample)(x, y, c)))).collect()
}

/// Every compression with every predictor it takes, in strips and tiles, planes together and apart, with samples beyond colour,
/// in every depth and either byte order and form.
#[test]
fn tiff_in_every_layout() {
    // Smooth and rough by turns, so that codes and runs of all lengths occur.
    fn noise(x: usize, y: usize, c: usize) -> usize {
        (x / 3 * 1543 + y * 377 + c * 20011 + x * y % 11 * 2477) % 65536
    }
    let depths: [(usize, bool, files::Sample); 5] = [
        (8, false, |x, y, c| noise(x, y, c) as u64 % 256),
        (16, false, |x, y, c| noise(x, y, c) as u64),
        (16, true, |x, y, c| half::f16::from_f32(noise(x, y, c) as f32 / 8192.0).to_bits().into()),
        (32, true, |x, y, c| (noise(x, y, c) as f32 / 7777.0 - 2.0).to_bits().into()),
        (64, true, |x, y, c| (noise(x, y, c) as f64 / 7777.0).to_bits()),
    ];
    let mut count = 0;
    for (bits, float, sample) in depths {
        for (compression, predictor) in [(1, 1), (5, 1), (5, 2), (5, 3), (8, 1), (8, 2), (8, 3), (32773, 1)] {
            if predictor == 3 && !float {
                continue;
            }
            for (planar, tile, rows) in
                [(false, 0, 4), (false, 0, usize::MAX), (false, 16, 0), (true, 0, 4), (true, 16, 0)]
            {
                for (colors, extra) in [(1, 0), (1, 1), (3, 0), (3, 1), (3, 2)] {
                    for (big_endian, big_tiff) in [(false, false), (true, false), (false, true), (true, true)] {
                        let page = files::Tiff {
                            width: 19,
                            height: 18,
                            colors,
                            extra,
                            bits,
                            float,
                            compression,
                            predictor,
                            planar,
                            tile,
                            rows,
                            big_endian,
                            big_tiff,
                            closed: count % 2 == 0,
                            photometric: if colors == 3 { 2 } else { 1 },
                            sample,
                            ..files::Tiff::RGB16
                        };
                        let image = decode(&page.file());
                        assert_eq!((image.width(), image.height(), image.channels()), (19, 18, colors), "{page:?}");
                        assert_eq!(image.data(), self::colors(&page), "{page:?}");
                        count += 1;
                    }
                }
            }
        }
    }
    assert_eq!(count, 2 * 6 * 100 + 3 * 8 * 100);
}

#[test]
fn tiff_in_jpeg() {
    for (colors, photometric) in [(1, 1), (3, 6)] {
        for (tile, rows) in [(0, 8), (16, 0)] {
            let sample: files::Sample = |x, y, c| (50 + 4 * x + 5 * y - 20 * c) as u64;
            let page = files::Tiff {
                width: 23,
                height: 17,
                bits: 8,
                compression: 7,
                colors,
                photometric,
                tile,
                rows,
                sample,
                ..files::Tiff::RGB16
            };
            let image = decode(&page.file());
            assert_eq!((image.width(), image.height(), image.channels()), (23, 17, colors));
            assert_close(&image, &self::colors(&page), 0.04);
        }
    }
}

#[test]
fn tiff_streams_that_are_short_or_long() {
    for compression in [1, 5, 8, 32773] {
        let page = files::Tiff { width: 16, height: 16, compression, ..files::Tiff::RGB16 };
        let short = files::Tiff { stored_rows: Some(8), ..page };
        let error = decode_image("x.tif", &short.file(), Transfer::Linear).unwrap_err().to_string();
        assert!(error.contains("x.tif") && error.contains("strip or tile 0"), "{error}");
        // One that is longer than its strip is cut.
        let long = files::Tiff { stored_rows: Some(20), ..page };
        assert_eq!(decode(&long.file()).data(), colors(&page));
    }
    let white_is_zero = files::Tiff { colors: 1, photometric: 0, ..files::Tiff::RGB16 };
    let black_is_zero = files::Tiff { photometric: 1, ..white_is_zero };
    for (white, black) in decode(&white_is_zero.file()).data().iter().zip(decode(&black_is_zero.file()).data()) {
        assert!((white + black - 1.0).abs() < 1e-6);
    }
}

#[test]
fn samples_beyond_colour_are_left_out_and_said() {
    let page = files::Tiff { extra: 1, compression: 5, predictor: 2, rows: 4, ..files::Tiff::RGB16 };
    let capture = capture_of(&page.file(), "a.tif", "").unwrap();
    assert_eq!(capture.photos()[0].image.data(), colors(&page));
    assert_eq!(capture.warnings().len(), 1);
    assert!(capture.warnings()[0].contains("1 of the samples of a pixel"), "{:?}", capture.warnings());
    let alpha = files::Tiff { extra_kind: 2, ..page };
    assert_eq!(capture_of(&alpha.file(), "a.tif", "").unwrap().warnings(), ["a.tif: alpha ignored"]);
}

#[test]
fn the_full_page_of_a_tiff_is_read() {
    let full = files::Tiff { width: 8, height: 6, ..files::Tiff::RGB16 };
    let reduced = files::Tiff { width: 4, height: 3, subfile: 1, ..full };
    for file in [
        files::tiff_pages(&[full, reduced], &[]),
        files::tiff_pages(&[reduced, full], &[]),
        files::tiff_pages(&[reduced], &[full]),
        files::tiff_pages(&[reduced, reduced], &[reduced, full]),
    ] {
        let image = decode(&file);
        assert_eq!((image.width(), image.height()), (8, 6));
        assert_eq!(image.data(), colors(&full));
        assert!(capture_of(&file, "a.tif", "").unwrap().warnings().is_empty());
    }
    // Of several full ones the first, and that is said.
    let other = files::Tiff { sample: |_, _, _| 7, ..full };
    let capture = capture_of(&files::tiff_pages(&[full, other], &[]), "a.tif", "").unwrap();
    assert_eq!(capture.photos()[0].image.data(), colors(&full));
    assert!(capture.warnings()[0].contains("first of 2 pages"), "{:?}", capture.warnings());
    // A chain that leads back into itself.
    let mut circle = files::tiff_pages(&[full], &[]);
    let next = circle.len() - 4;
    let first = circle[4..8].to_vec();
    circle[next..].copy_from_slice(&first);
    assert_eq!(decode(&circle).data(), colors(&full));
}

#[test]
fn files_of_cameras_say_what_to_convert_to() {
    let preview = files::Tiff { width: 8, height: 6, subfile: 1, ..files::Tiff::RGB16 };
    let sensor = files::Tiff { colors: 1, photometric: 32803, ..files::Tiff::RGB16 };
    let mut canon = preview.file();
    canon.splice(8..10, *b"CR");
    for (name, file, part) in [
        ("a.nef", files::tiff_pages(&[preview], &[sensor]), "camera raw"),
        ("a.dng", files::Tiff { photometric: 34892, ..files::Tiff::RGB16 }.file(), "camera raw"),
        ("a.cr2", canon, "camera raw"),
        ("a.cr3", b"\0\0\0\x18ftypcrx \0\0\0\x01".to_vec(), "camera raw"),
        ("a.raf", b"FUJIFILMCCD-RAW 0201".to_vec(), "camera raw"),
        ("a.orf", b"IIRO\x08\0\0\0".to_vec(), "camera raw"),
        ("a.rw2", b"IIU\0\x08\0\0\0".to_vec(), "camera raw"),
        ("a.heic", b"\0\0\0\x18ftypheic\0\0\0\0".to_vec(), "HEIC"),
        ("a.avif", b"\0\0\0\x1cftypavif\0\0\0\0".to_vec(), "AVIF"),
    ] {
        let error = decode_image(name, &file, Transfer::Linear).unwrap_err();
        assert!(matches!(error, Error::UnsupportedFormat { .. }), "{error}");
        let error = error.to_string();
        assert!([name, part, "convert it to"].iter().all(|part| error.contains(part)), "{error}");
    }
}

#[test]
fn tiff_orientation_is_applied_and_said() {
    // Orientation 6: the first stored row is the right edge of the picture.
    let stored = [1.0f32, 2.0, 3.0, 4.0, 5.0, 6.0];
    let file = files::tiff(3, 2, 1, 32, 3, 6, &le(&stored, f32::to_le_bytes));
    let image = decode(&file);
    assert_eq!((image.width(), image.height()), (2, 3));
    assert_eq!(image.data(), [4.0, 1.0, 5.0, 2.0, 6.0, 3.0]);

    let capture = capture_of(&file, "a.tif", "").unwrap();
    assert_eq!((capture.width(), capture.height()), (2, 3));
    assert!(capture.warnings()[0].contains("orientation 6"), "{:?}", capture.warnings());
}

/// A capture of one photo with these bytes.
fn capture_of(bytes: &[u8], name: &str, fields: &str) -> svbrdf_gcn::Result<Capture> {
    let dir = TempDir::new().unwrap();
    fs::write(dir.path().join(name), bytes).unwrap();
    let text = format!(
        r#"{{"format": "svbrdf-gcn capture", "version": 1, "patch_size": 1, "transfer": "linear", {fields}
            "light_intensity": [1, 1, 1], "photos": [{{"file": "{name}", "camera": [0, 0, 1]}}]}}"#
    );
    fs::write(dir.path().join("capture.json"), text).unwrap();
    Capture::open(dir.path())
}

#[test]
fn jpeg() {
    // Smooth, so that JPEG's own loss is small.
    let codes: Vec<u8> = (0..32 * 24).flat_map(|i| [(i % 32 * 7) as u8, (i / 32 * 9) as u8, 90]).collect();
    let mut file = Vec::new();
    JpegEncoder::new_with_quality(&mut file, 98).encode(&codes, 32, 24, image::ExtendedColorType::Rgb8).unwrap();
    let expected: Vec<f32> = codes.iter().map(|&code| f32::from(code) / 255.0).collect();
    let image = decode(&file);
    assert_eq!((image.width(), image.height(), image.channels()), (32, 24, 3));
    assert_close(&image, &expected, 0.03);
    for length in [2, 10, file.len() / 2, file.len() - 1] {
        let error = decode_image("x.jpg", &file[..length], Transfer::Linear).unwrap_err();
        assert!(error.to_string().contains("x.jpg"), "{error}");
    }
    // Trailing bytes after the end marker, as some cameras append them.
    assert_eq!(decode(&[&file[..], b"MPF data"].concat()), image);

    // The same photo held upside down: an EXIF segment with orientation 3.
    let exif = b"Exif\0\0II\x2a\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x03\0\0\0\0\0\0\0";
    let mut turned = vec![0xff, 0xd8, 0xff, 0xe1];
    turned.extend((exif.len() as u16 + 2).to_be_bytes());
    turned.extend(exif);
    turned.extend(&file[2..]);
    let reversed: Vec<f32> = image.data().chunks(3).rev().flatten().copied().collect();
    assert_eq!(decode(&turned).data(), reversed);

    let mut grey = Vec::new();
    JpegEncoder::new_with_quality(&mut grey, 98).encode(&codes[..768], 32, 24, image::ExtendedColorType::L8).unwrap();
    assert_eq!(decode(&grey).channels(), 1);
}

/// Smooth colours in 8 x 8 blocks of 4 : 2 : 0, with noise, so that blocks have coefficients of every kind.
/// Written by libjpeg: `progressive.jpg` in scans with successive approximation, `restart.jpg` with a restart marker every 3 units, `grey.jpg` in grey.
const JPEGS: [(&str, &[u8]); 3] = [
    ("progressive.jpg", include_bytes!("fixtures/progressive.jpg")),
    ("restart.jpg", include_bytes!("fixtures/restart.jpg")),
    ("grey.jpg", include_bytes!("fixtures/grey.jpg")),
];

#[test]
fn jpeg_without_part_of_its_picture() {
    for (name, file) in JPEGS {
        let image = decode(file);
        assert_eq!((image.width(), image.height()), (83, 61), "{name}");
        assert!(capture_of(file, name, "").unwrap().warnings().is_empty(), "{name}");
        // Cut anywhere in the data, with an end marker put behind: an error, or for a cut between scans a warning. The marker may also
        // stand for the last few bits of a scan.
        let start = file.windows(2).position(|pair| pair == [0xff, 0xda]).unwrap();
        let (mut errors, mut warnings) = (0, 0);
        for length in (start + 14..file.len() - 8).step_by(7) {
            let cut = [&file[..length], &[0xff, 0xd9]].concat();
            match capture_of(&cut, name, "") {
                Err(error) => {
                    assert!(error.to_string().contains(name), "{error}");
                    errors += 1;
                }
                Ok(capture) => {
                    assert!(capture.warnings().iter().any(|w| w.contains("truncated")), "{name} cut at {length}");
                    warnings += 1;
                }
            }
        }
        assert!(errors > 20 * warnings, "{name}: {errors} errors, {warnings} warnings");
        // A quarter of the data replaced: nothing in the format protects them, but mostly the codes do not come out even.
        let mut noticed = 0;
        let places = start + 20..file.len() - 420;
        let tries = places.clone().step_by(7).count();
        for at in places.step_by(7) {
            let mut damaged = file.to_vec();
            for (i, byte) in damaged[at..at + 400].iter_mut().enumerate() {
                *byte = (at * 31 + i * 57) as u8 & 0x7f;
            }
            noticed += usize::from(capture_of(&damaged, name, "").map_or(true, |c| !c.warnings().is_empty()));
        }
        assert!(noticed * 100 >= tries * 80, "{name}: {noticed} of {tries}");
    }
}

#[test]
fn jpeg_orientation_of_any_number_type() {
    let image = decode(JPEGS[0].1);
    // 1 byte, 3 short, 4 long, 8 signed short, 9 signed long.
    for kind in [1u8, 3, 4, 8, 9] {
        for big_endian in [false, true] {
            let mut exif = if big_endian {
                b"Exif\0\0MM\0\x2a\0\0\0\x08\0\x01".to_vec()
            } else {
                b"Exif\0\0II\x2a\0\x08\0\0\0\x01\0".to_vec()
            };
            let word = |value: u32, bytes: usize| {
                if big_endian {
                    value.to_be_bytes()[4 - bytes..].to_vec()
                } else {
                    value.to_le_bytes()[..bytes].to_vec()
                }
            };
            exif.extend([word(274, 2), word(kind.into(), 2), word(1, 4)].concat());
            let mut value = word(
                6,
                match kind {
                    1 => 1,
                    3 | 8 => 2,
                    _ => 4,
                },
            );
            value.resize(4, 0);
            exif.extend([value, vec![0; 4]].concat());
            let mut file = vec![0xff, 0xd8, 0xff, 0xe1];
            file.extend((exif.len() as u16 + 2).to_be_bytes());
            file.extend(exif);
            file.extend(&JPEGS[0].1[2..]);
            let turned = decode(&file);
            assert_eq!((turned.width(), turned.height()), (61, 83), "type {kind}");
            assert_eq!(turned.data()[..3], image.data()[83 * 60 * 3..][..3], "type {kind}");
        }
    }
}

#[test]
fn exr_windows() {
    let window = [0, 0, 2, 2];
    let image =
        decode(&files::exr(window, window, &[("B", &[3.0; 4]), ("G", &[2.0; 4]), ("R", &[1.0, 5.0, 1.0, 1.0])]));
    assert_eq!(image.data(), [1.0, 2.0, 3.0, 5.0, 2.0, 3.0, 1.0, 2.0, 3.0, 1.0, 2.0, 3.0]);
    assert_eq!(decode(&files::exr(window, window, &[("Y", &[0.5, 1.0, 1.5, 2.0])])).data(), [0.5, 1.0, 1.5, 2.0]);
    for (present, missing, pixel) in
        [("GR", "B", [1.0, 2.0, 0.0]), ("BR", "G", [1.0, 0.0, 3.0]), ("BG", "R", [0.0, 2.0, 3.0])]
    {
        let samples = |name: char| {
            if name == 'R' {
                &[1.0; 4]
            } else if name == 'G' {
                &[2.0; 4]
            } else {
                &[3.0; 4]
            }
        };
        let channels: Vec<(&str, &[f32])> =
            present.char_indices().map(|(i, name)| (&present[i..=i], samples(name).as_slice())).collect();
        let two = capture_of(&files::exr(window, window, &channels), "a.exr", "").unwrap();
        assert_eq!(two.photos()[0].image.data()[..3], pixel);
        let warning = &two.warnings()[0];
        assert!(warning.contains("a.exr") && warning.contains(&format!("no channel {missing}")), "{warning}");
    }

    // A data window that reaches over the display window on the left and leaves out its last column and first row.
    let samples = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0];
    let file = files::exr([-3, 6, 4, 2], [-1, 5, 3, 3], &[("Y", &samples)]);
    let image = decode(&file);
    assert_eq!((image.width(), image.height()), (3, 3));
    assert_eq!(image.data(), [0.0, 0.0, 0.0, 3.0, 4.0, 0.0, 7.0, 8.0, 0.0]);
    let capture = capture_of(&file, "a.exr", "").unwrap();
    assert!(capture.warnings()[0].contains("data window"), "{:?}", capture.warnings());
    // A data window beyond the display window on every side is only cropped.
    let cropped = capture_of(&files::exr([0, 0, 4, 2], [1, 0, 2, 1], &[("Y", &samples)]), "a.exr", "").unwrap();
    assert!(cropped.warnings().is_empty());
    assert_eq!(cropped.photos()[0].image.data(), [2.0, 2.0, 2.0, 3.0, 3.0, 3.0]);
    // No overlap at all.
    assert_eq!(decode(&files::exr([10, 10, 4, 2], [0, 0, 1, 1], &[("Y", &samples)])).data(), [0.0]);

    let ones: &[f32] = &[1.0; 4];
    for (channels, part) in [
        (vec![("Z", ones)], "channels Z;"),
        (vec![("X", ones), ("Y", ones), ("Z", ones)], "channels X, Y, Z;"),
        (vec![("BY", ones), ("RY", ones), ("Y", ones)], "channels BY, RY, Y;"),
        (vec![("R", ones)], "channels R;"),
    ] {
        let error = decode_image("x.exr", &files::exr(window, window, &channels), Transfer::Linear).unwrap_err();
        assert!(error.to_string().contains(part), "{error}");
    }
    let alpha = files::exr(window, window, &[("A", &[1.0; 4]), ("Y", &[1.0; 4])]);
    assert!(capture_of(&alpha, "a.exr", "").unwrap().warnings()[0].contains("alpha"));
}

#[test]
fn saturation_of_files() {
    // From 98 % of the top code on.
    let png = files::png(2, 1, 2, 16, &[65535, 64224, 0, 1, 2, 64225]);
    assert_eq!(capture_of(&png, "a.png", "").unwrap().photos()[0].saturated, [1, 4]);
    let warned = capture_of(&png, "a.png", r#""white_level": 0.5,"#).unwrap();
    assert_eq!(warned.photos()[0].saturated, [1, 4]);
    assert!(warned.warnings()[0].contains("white_level"));
    let png = files::png(2, 1, 2, 8, &[255, 249, 0, 1, 2, 250]);
    assert_eq!(capture_of(&png, "a.png", "").unwrap().photos()[0].saturated, [1, 4]);
    let exr = files::exr([0, 0, 2, 1], [0, 0, 2, 1], &[("Y", &[1.0, 4.0])]);
    assert_eq!(capture_of(&exr, "a.exr", "").unwrap().photos()[0].saturated, [0, 0]);
    assert_eq!(capture_of(&exr, "a.exr", r#""white_level": 4,"#).unwrap().photos()[0].saturated, [0, 7]);
    let nan = files::exr([0, 0, 2, 1], [0, 0, 2, 1], &[("Y", &[1.0, f32::NAN])]);
    let error = capture_of(&nan, "a.exr", "").unwrap_err().to_string();
    assert!(error.contains("a.exr") && error.contains("NaN"), "{error}");
}

#[test]
fn resampling_is_linear_and_saturation_comes_first() {
    // Two pixels, 255 and 0 in sRGB: their mean in linear light is 0.5, not the decoded mean code.
    let shot = Shot { camera: [0.0, 0.0, 1.0], light: [0.0, 0.0, 1.0], light_intensity: [1.0; 3] };
    let samples = Samples::U8(&[255, 0]);
    let photo = PhotoPixels { name: "p", shot, width: 2, height: 1, channels: 1, samples };
    let options = CaptureOptions::new().size(1);
    let capture = Capture::from_photos(&[photo], 1.0, Transfer::Srgb, None, &options).unwrap();
    assert_eq!(capture.photos()[0].image.data(), [0.5; 3]);
    assert_eq!(capture.photos()[0].saturated, [7]);
}

#[test]
fn lying_and_broken_headers() {
    // A PNG header of 60000 x 60000 pixels in a hundred bytes.
    let mut png = files::png(1, 1, 0, 8, &[1]);
    png[16..24].copy_from_slice(&[0, 0, 0xea, 0x60, 0, 0, 0xea, 0x60]);
    assert!(decode_image("x.png", &png, Transfer::Linear).is_err());
    for side in [20_000u32, 4000] {
        let mut tiff = files::tiff(1, 1, 1, 32, 3, 1, &[0; 4]);
        // Width, height and rows per strip.
        for entry in [0, 1, 8] {
            tiff[10 + entry * 12 + 8..][..4].copy_from_slice(&side.to_le_bytes());
        }
        let error = decode_image("x.tif", &tiff, Transfer::Linear).unwrap_err().to_string();
        assert!(error.contains(&side.to_string()), "{error}");
    }
    let exr = files::exr([0, 0, 1, 1], [0, 0, 30_000, 30_000], &[("Y", &[1.0])]);
    let error = decode_image("x.exr", &exr, Transfer::Linear).unwrap_err().to_string();
    assert!(error.contains("30000"), "{error}");
    // A bit of a PNG's pixels or of their checksum.
    let png = files::png(4, 4, 2, 8, &[9; 48]);
    for at in 41..png.len() - 12 {
        let mut damaged = png.clone();
        damaged[at] ^= 1 << (at % 8);
        assert!(decode_image("x.png", &damaged, Transfer::Linear).is_err(), "{at}");
    }
    let whole = [
        files::png(4, 4, 2, 8, &[9; 48]),
        files::tiff(4, 4, 1, 32, 3, 1, &[0; 64]),
        files::exr([0, 0, 4, 4], [0, 0, 4, 4], &[("Y", &[0.0; 16])]),
    ];
    for file in &whole {
        decode(file);
        for length in 0..file.len() - 13 {
            assert!(decode_image("x", &file[..length], Transfer::Linear).is_err(), "{length} of {}", file.len());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn damaged_files_are_errors_or_images(which in 0usize..8, changes in vec((any::<Index>(), any::<u8>()), 1..6), cut in any::<Index>()) {
        let mut file = match which {
            0 => files::png(4, 4, 6, 16, &[700; 64]),
            1 => files::tiff(4, 4, 3, 16, 1, 5, &[7; 96]),
            2 => files::exr([1, 0, 4, 3], [0, 0, 4, 4], &[("G", &[0.5; 12]), ("R", &[0.25; 12])]),
            3 => files::Tiff { width: 5, height: 4, compression: 5, predictor: 2, extra: 1, ..files::Tiff::RGB16 }.file(),
            4 => files::Tiff { width: 5, height: 4, compression: 8, tile: 16, planar: true, big_tiff: true, ..files::Tiff::RGB16 }.file(),
            5 => jpeg_file(),
            6 => JPEGS[0].1.to_vec(),
            _ => JPEGS[1].1.to_vec(),
        };
        for (at, byte) in changes {
            let at = at.index(file.len());
            file[at] = byte;
        }
        if let Ok(image) = decode_image("x", &file, Transfer::Gamma22) {
            prop_assert_eq!(image.data().len(), image.width() * image.height() * image.channels());
        }
        file.truncate(cut.index(file.len()));
        drop(decode_image("x", &file, Transfer::Gamma22));
    }
}

fn jpeg_file() -> Vec<u8> {
    let mut file = Vec::new();
    JpegEncoder::new_with_quality(&mut file, 80)
        .encode(&[90; 17 * 9 * 3], 17, 9, image::ExtendedColorType::Rgb8)
        .unwrap();
    file
}

#[test]
fn written_images_come_back() {
    let dir = TempDir::new().unwrap();
    for channels in [1, 3] {
        let image = Image::new(12 / channels, 1, channels, RGB.to_vec()).unwrap();
        for name in ["a.exr", "a.tif", "a.TIFF"] {
            let path = dir.path().join(name);
            write_image(&path, &image, Transfer::Srgb).unwrap();
            assert_eq!(read_image(&path, Transfer::Linear).unwrap(), image, "{name}");
        }
        let path = dir.path().join("a.png");
        for transfer in [Transfer::Srgb, Transfer::Gamma22, Transfer::Linear] {
            write_image(&path, &image, transfer).unwrap();
            let back = read_image(&path, transfer).unwrap();
            assert_eq!(back.channels(), channels);
            let stored = |image: &Image| image.data().iter().map(|&v| transfer.encode(v)).collect::<Vec<_>>();
            let back = Image::new(12, 1, 1, stored(&back)).unwrap();
            assert_close(&back, &stored(&image), 0.5001 / 255.0);
        }
    }
    let left: Vec<_> = fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left.len(), 4, "{left:?}");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        fs::write(dir.path().join("plain"), b"").unwrap();
        let mode = |name: &str| fs::metadata(dir.path().join(name)).unwrap().permissions().mode();
        assert_eq!(mode("a.exr"), mode("plain"));
    }
}

#[test]
fn images_that_cannot_be_written() {
    let dir = TempDir::new().unwrap();
    let image = Image::new(1, 1, 3, vec![0.5; 3]).unwrap();
    let error = |name: &str, image: &Image| write_image(dir.path().join(name), image, Transfer::Srgb).unwrap_err();
    assert!(matches!(error("a.bmp", &image), Error::UnsupportedFormat { .. }));
    assert!(matches!(error("a", &image), Error::UnsupportedFormat { .. }));
    assert!(matches!(error("none/a.png", &image), Error::Io { .. }));
    assert!(matches!(error("a.png", &Image::new(1, 1, 2, vec![0.5; 2]).unwrap()), Error::ShapeMismatch { .. }));
    let nan = Image::new(2, 1, 1, vec![0.5, f32::NAN]).unwrap();
    assert!(error("a.exr", &nan).to_string().contains("column 1, row 0"));
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn real_captures_open() {
    for (name, size) in [("cards-blue", 1024), ("wood-walnut", 512), ("giftbag1", 512)] {
        let Some(path) = common::shared(&format!("captures/{name}")) else { return };
        let capture = Capture::open_with(&path, &CaptureOptions::new().size(200).views([0, 8])).unwrap();
        assert_eq!((capture.len(), capture.width(), capture.height()), (2, 200, 200));
        assert!(capture.warnings().is_empty());
        // Area resampling keeps the mean of the linear photo.
        let file = path.join(&capture.photos()[0].name);
        let full = read_image(file, Transfer::Gamma22).unwrap();
        assert_eq!(full.width(), size);
        let mean = |image: &Image| image.data().iter().map(|&v| f64::from(v)).sum::<f64>() / image.data().len() as f64;
        assert!((mean(&full) - mean(&capture.photos()[0].image)).abs() < 1e-6);
    }
}

/// The stream of `zip.tif`: another byte in it is an error, or the picture is the same (bits that pad it).
#[test]
fn a_damaged_deflate_stream_is_an_error() {
    let whole = fs::read(std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/seeds/image/zip.tif")).unwrap();
    let number = |at: usize| u32::from_le_bytes(whole[at..at + 4].try_into().unwrap()) as usize;
    let directory = number(4);
    let entries = usize::from(u16::from_le_bytes([whole[directory], whole[directory + 1]]));
    let value = |tag: u16| {
        let entry = (0..entries).map(|i| directory + 2 + 12 * i);
        number(entry.into_iter().find(|&at| whole[at..at + 2] == tag.to_le_bytes()).unwrap() + 8)
    };
    let (offset, length) = (value(273), value(279));
    let picture = decode_image("zip.tif", &whole, Transfer::Linear).unwrap();
    let mut errors = 0;
    for at in offset..offset + length {
        let mut damaged = whole.clone();
        damaged[at] ^= 0x10;
        match decode_image("zip.tif", &damaged, Transfer::Linear) {
            Ok(read) => assert_eq!(read, picture, "byte {at}"),
            Err(_) => errors += 1,
        }
    }
    assert!(errors >= length - 2, "{errors} of {length}");
}
