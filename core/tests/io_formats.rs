//! Every image format, read from bytes written by hand, and written and read back.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

#[allow(dead_code, reason = "shared by several tests")]
mod common;
#[path = "common/files.rs"]
mod files;

use std::fs;

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

/// Strips and tiles of LZW codes, as programs write them: rows end inside of codes, and some leave the closing code out.
#[test]
fn tiff_in_lzw() {
    for seed in 0..40u64 {
        let (width, height) = (37, 21);
        let values: Vec<u16> =
            (0..width * height * 3).map(|i| ((i * 37 + i / 7) as u64 * (seed + 3) / 5 % 251) as u16 * 257).collect();
        let expected: Vec<f32> = values.iter().map(|&value| f32::from(value) / 65535.0).collect();
        for layout in files::LZW_LAYOUTS {
            let image = decode(&files::tiff_lzw(width, height, &values, layout));
            assert_eq!(
                (image.width(), image.height(), image.channels()),
                (width, height, 3),
                "seed {seed}, {layout:?}"
            );
            assert_eq!(image.data(), expected, "seed {seed}, {layout:?}");
        }
    }
    // Half of a stream is an error, not half of an image; a stream that is longer than its tile is cut.
    let whole = files::tiff_lzw(16, 16, &[7; 768], files::LZW_LAYOUTS[0]);
    let short = files::tiff_lzw(16, 16, &[7; 384], files::LZW_LAYOUTS[0]);
    assert_close(&decode(&whole), &[7.0 / 65535.0; 768], 0.0);
    assert!(decode_image("x.tif", &short, Transfer::Linear).is_err());
    assert_close(&decode(&files::tiff_lzw(16, 16, &[7; 800], files::LZW_LAYOUTS[0])), &[7.0 / 65535.0; 768], 0.0);
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

#[test]
fn exr_windows() {
    let window = [0, 0, 2, 2];
    let image =
        decode(&files::exr(window, window, &[("B", &[3.0; 4]), ("G", &[2.0; 4]), ("R", &[1.0, 5.0, 1.0, 1.0])]));
    assert_eq!(image.data(), [1.0, 2.0, 3.0, 5.0, 2.0, 3.0, 1.0, 2.0, 3.0, 1.0, 2.0, 3.0]);
    assert_eq!(decode(&files::exr(window, window, &[("Y", &[0.5, 1.0, 1.5, 2.0])])).data(), [0.5, 1.0, 1.5, 2.0]);
    let two = decode(&files::exr(window, window, &[("G", &[2.0; 4]), ("R", &[1.0; 4])]));
    assert_eq!(two.data()[..3], [1.0, 2.0, 0.0]);

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

    let error = decode_image("x.exr", &files::exr(window, window, &[("Z", &[1.0; 4])]), Transfer::Linear).unwrap_err();
    assert!(error.to_string().contains("channels Z"), "{error}");
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
    fn damaged_files_are_errors_or_images(which in 0usize..6, changes in vec((any::<Index>(), any::<u8>()), 1..6), cut in any::<Index>()) {
        let mut file = match which {
            0 => files::png(4, 4, 6, 16, &[700; 64]),
            1 => files::tiff(4, 4, 3, 16, 1, 5, &[7; 96]),
            2 => files::exr([1, 0, 4, 3], [0, 0, 4, 4], &[("G", &[0.5; 12]), ("R", &[0.25; 12])]),
            3 => files::tiff_lzw(5, 4, &[9; 60], files::LZW_LAYOUTS[0]),
            4 => files::tiff_lzw(5, 4, &[9; 60], files::LZW_LAYOUTS[3]),
            _ => jpeg_file(),
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
