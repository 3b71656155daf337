//! What photo files say of their colours, what captures state, and which of them counts.

use std::fs;
use std::path::Path;

use crate::{common, files};
use moxcms::ColorProfile;
use svbrdf_gcn::io::{read_image, write_image};
use svbrdf_gcn::{Capture, CaptureOptions, ColorSpace, Error, Image, Result, Transfer};
use tempfile::TempDir;

/// Linear Display P3 to linear Rec. 709, from the primaries and the common white D65: SMPTE EG 432-1 and ITU-R BT.709.
const P3_TO_REC709: [[f64; 3]; 3] = [
    [1.224_940_176_280_6, -0.224_940_176_280_6, 0.0],
    [-0.042_056_954_709_7, 1.042_056_954_709_7, 0.0],
    [-0.019_637_554_590_3, -0.078_636_045_550_6, 1.098_273_600_141_0],
];

const AP1: [f32; 8] = [0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767];

/// Codes of two pixels: one inside of Rec. 709 and a green of Display P3 that it has not.
const CODES: [u16; 6] = [180, 120, 60, 10, 250, 10];

fn profile(profile: &ColorProfile) -> Vec<u8> {
    profile.encode().unwrap()
}

/// A capture of one photo with these bytes.
fn open_with(bytes: &[u8], transfer: &str, fields: &str, options: &CaptureOptions) -> Result<Capture> {
    let dir = TempDir::new().unwrap();
    fs::write(dir.path().join("photo"), bytes).unwrap();
    let text = format!(
        r#"{{"format": "svbrdf-gcn capture", "version": 1, "patch_size": 1, "transfer": "{transfer}", {fields}
            "light_intensity": [1, 1, 1], "photos": [{{"file": "photo", "camera": [0, 0, 1]}}]}}"#
    );
    fs::write(dir.path().join("capture.json"), text).unwrap();
    Capture::open_with(dir.path(), options)
}

fn open(bytes: &[u8], transfer: &str, fields: &str) -> Capture {
    open_with(bytes, transfer, fields, &CaptureOptions::new()).unwrap()
}

fn png(chunks: &[(&[u8; 4], Vec<u8>)]) -> Vec<u8> {
    files::png_with(2, 1, 2, 8, &CODES, chunks)
}

fn linear(transfer: Transfer) -> [f64; 6] {
    CODES.map(|code| transfer.decode(f32::from(code) / 255.0).into())
}

fn through(matrix: [[f64; 3]; 3], values: [f64; 6]) -> Vec<f64> {
    values.chunks(3).flat_map(|v| matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])).collect()
}

#[track_caller]
fn assert_close(capture: &Capture, expected: &[f64], tolerance: f64) {
    let got = capture.photos()[0].image.data();
    assert_eq!(got.len(), expected.len());
    for (got, expected) in got.iter().zip(expected) {
        assert!((f64::from(*got) - expected).abs() <= tolerance, "{got} instead of {expected}");
    }
}

#[track_caller]
fn assert_warns(capture: &Capture, parts: &[&str]) {
    let [warning] = capture.warnings() else { panic!("one warning expected: {:?}", capture.warnings()) };
    assert!(parts.iter().all(|part| warning.contains(part)), "{warning}");
}

/// The same profile in every format that holds one.
#[test]
fn a_profile_counts_where_the_transfer_function_is_srgb() {
    let p3 = profile(&ColorProfile::new_display_p3());
    // Profiles round their primaries to 1/65536 and the white D50 to four digits.
    let expected = through(P3_TO_REC709, linear(Transfer::Srgb));
    assert!(expected[3] < -0.05, "a green that Rec. 709 has not");
    let tiff = files::Tiff {
        width: 2,
        height: 1,
        bits: 8,
        profile: p3.clone().leak(),
        sample: |x, _, c| CODES[3 * x + c].into(),
        ..files::Tiff::RGB16
    };
    for file in [png(&[files::iccp(&p3)]), tiff.file()] {
        let capture = open(&file, "srgb", "");
        assert_close(&capture, &expected, 5e-4);
        assert_warns(&capture, &["photo", "Rec. 709", "Display P3"]);
        // One saturated channel reaches all.
        assert_eq!(capture.photos()[0].saturated, [0, 7]);

        // Ignored when asked for, or when a colour space is stated; the latter is worth a warning.
        let plain = open(&png(&[]), "srgb", "");
        assert!(plain.warnings().is_empty());
        let ignored = open_with(&file, "srgb", "", &CaptureOptions::new().ignore_profiles(true)).unwrap();
        assert_eq!(ignored, plain);
        let stated = open(&file, "srgb", r#""color_space": "rec709","#);
        assert_eq!(stated.photos(), plain.photos());
        assert_warns(&stated, &["Display P3", "not used", "rec709"]);
        let asked = open_with(&file, "srgb", "", &CaptureOptions::new().color_space(ColorSpace::Rec709)).unwrap();
        assert_eq!(asked, stated);
        // ACEScg says nothing of photos in sRGB.
        let acescg = open_with(&file, "srgb", "", &CaptureOptions::new().color_space(ColorSpace::AcesCg)).unwrap();
        assert_eq!(acescg.photos(), capture.photos());
        assert!(acescg.warnings().iter().any(|warning| warning.contains("acescg is for linear photos")));
    }
    let segment = [b"ICC_PROFILE\0\x01\x01".as_slice(), &p3].concat();
    let restart = include_bytes!("fixtures/restart.jpg");
    let jpeg = open(&files::jpeg_with(restart, 0xe2, &segment), "srgb", "");
    assert_warns(&jpeg, &["Display P3"]);
    let plain = open(restart, "srgb", "");
    let (got, expected) = (&jpeg.photos()[0].image.data()[..3], &plain.photos()[0].image.data()[..3]);
    let first = std::array::from_fn(|i| f64::from(expected[i % 3]));
    for (got, expected) in got.iter().zip(through(P3_TO_REC709, first)) {
        assert!((f64::from(*got) - expected).abs() < 3e-4, "{got} instead of {expected}");
    }
}

#[test]
fn what_is_srgb_changes_nothing() {
    let plain = open(&png(&[]), "srgb", "");
    let rec709 = [31270u32, 32900, 64000, 33000, 30000, 60000, 15000, 6000].map(u32::to_be_bytes).concat();
    let p3 = files::iccp(&profile(&ColorProfile::new_display_p3()));
    for chunks in [
        vec![files::iccp(&profile(&ColorProfile::new_srgb()))],
        vec![(b"sRGB", vec![0])],
        vec![(b"gAMA", 45455u32.to_be_bytes().to_vec()), (b"cHRM", rec709)],
        vec![(b"cICP", vec![1, 13, 0, 1])],
        // cICP is of higher rank than a profile, sRGB than gAMA.
        vec![(b"cICP", vec![1, 13, 0, 1]), p3],
        vec![(b"sRGB", vec![0]), (b"gAMA", 100_000u32.to_be_bytes().to_vec())],
    ] {
        assert_eq!(open(&png(&chunks), "srgb", ""), plain, "{chunks:?}");
    }
}

#[test]
fn chunks_of_png() {
    let p3 = [31270u32, 32900, 68000, 32000, 26500, 69000, 15000, 6000].map(u32::to_be_bytes).concat();
    let expected = through(P3_TO_REC709, linear(Transfer::Srgb));
    for chunk in [(b"cICP", vec![12, 13, 0, 1]), (b"cHRM", p3)] {
        let capture = open(&png(std::slice::from_ref(&chunk)), "srgb", "");
        assert_close(&capture, &expected, 1e-5);
        assert_warns(&capture, &["converted to Rec. 709"]);
    }
    // Stored values are linear, says the file.
    let capture = open(&png(&[(b"gAMA", 100_000u32.to_be_bytes().to_vec())]), "srgb", "");
    assert_close(&capture, &CODES.map(|code| f64::from(code) / 255.0), 1e-6);
    assert_warns(&capture, &["gAMA"]);
    // BT.709's own curve, to the value that the recommendation gives for grey of 18 %: 1.099 * 0.18^0.45 - 0.099 = 0.409.
    let grey = files::png_with(1, 1, 2, 16, &[26802; 3], &[(b"cICP", vec![1, 1, 0, 1])]);
    assert_close(&open(&grey, "srgb", ""), &[0.18; 3], 2e-4);
    for (code, name) in [(16, "PQ"), (18, "HLG")] {
        let file = png(&[(b"cICP", vec![9, code, 0, 1])]);
        let error = open_with(&file, "srgb", "", &CaptureOptions::new()).unwrap_err();
        assert!(matches!(error, Error::UnsupportedFormat { .. }) && error.to_string().contains(name), "{error}");
        let ignored = open_with(&file, "srgb", "", &CaptureOptions::new().ignore_profiles(true)).unwrap();
        assert_eq!(ignored.photos(), open(&png(&[]), "srgb", "").photos());
    }
    assert_warns(&open(&png(&[(b"cICP", vec![77, 13, 0, 1])]), "srgb", ""), &["cICP 77, 13", "not known", "srgb"]);
}

#[test]
fn a_stated_curve_wins() {
    let p3 = png(&[files::iccp(&profile(&ColorProfile::new_display_p3()))]);
    // The profile's curve is nothing like linear.
    let capture = open(&p3, "linear", "");
    assert_close(&capture, &CODES.map(|code| f64::from(code) / 255.0), 1e-6);
    assert_warns(&capture, &["Display P3", "not used", "linear"]);
    // It is nearly gamma 2.2, which is used; nobody has stated the primaries.
    let capture = open(&p3, "gamma2.2", "");
    assert_close(&capture, &through(P3_TO_REC709, linear(Transfer::Gamma22)), 5e-4);
    assert_warns(&capture, &["Display P3"]);
    let replaced = open_with(&p3, "linear", "", &CaptureOptions::new().transfer(Transfer::Srgb)).unwrap();
    assert_close(&replaced, &through(P3_TO_REC709, linear(Transfer::Srgb)), 5e-4);
}

#[test]
fn profiles_of_other_kinds() {
    // Grey with a curve of its own.
    let grey = profile(&ColorProfile::new_gray_with_gamma(1.8));
    let file = files::png_with(3, 1, 0, 8, &[0, 128, 255], &[files::iccp(&grey)]);
    let half = (128.0f64 / 255.0).powf(1.8);
    assert_close(&open(&file, "srgb", ""), &[0.0, 0.0, 0.0, half, half, half, 1.0, 1.0, 1.0], 2e-4);
    // A table of linear values.
    let capture = open(&png(&[files::iccp(&files::table_profile())]), "srgb", "");
    assert_close(&capture, &CODES.map(|code| f64::from(code) / 255.0), 1e-3);
    assert_warns(&capture, &["converted"]);
    // What cannot be used is said, and the photo read as is stated.
    let plain = open(&png(&[]), "srgb", "");
    let cut = &profile(&ColorProfile::new_display_p3())[..200];
    for unusable in [grey.as_slice(), b"no profile", cut] {
        let capture = open(&png(&[files::iccp(unusable)]), "srgb", "");
        assert_eq!(capture.photos(), plain.photos());
        assert_warns(&capture, &["colour profile", "read as srgb"]);
    }
}

/// Bytes of profiles changed at random: a photo or an error, never a panic, and values that are finite.
#[test]
fn damaged_profiles() {
    let mut state = 7u32;
    let mut random = move |below: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as usize % below
    };
    let profiles = [profile(&ColorProfile::new_display_p3()), files::table_profile()];
    let mut converted = 0;
    for _ in 0..800 {
        let mut damaged = profiles[random(2)].clone();
        for _ in 0..1 + random(4) {
            let at = random(damaged.len());
            damaged[at] = random(256) as u8;
        }
        if random(8) == 0 {
            damaged.truncate(random(damaged.len()));
        }
        match open_with(&png(&[files::iccp(&damaged)]), "srgb", "", &CaptureOptions::new()) {
            Ok(capture) => {
                assert!(capture.photos()[0].image.data().iter().all(|value| value.is_finite()));
                converted += usize::from(capture.warnings().iter().any(|warning| warning.contains("converted")));
            }
            Err(error) => assert!(error.to_string().contains("photo"), "{error}"),
        }
    }
    assert!(converted > 100, "{converted}");
}

#[test]
fn adobe_rgb_in_exif_data() {
    // An EXIF directory that has "uncalibrated" and the index of interoperability R03.
    let uncalibrated = [(0xa001, 3, 1, 0xffff), (0xa005, 4, 1, 56)];
    let exif = files::exif(&[&uncalibrated, &[(1, 2, 4, u32::from_le_bytes(*b"R03\0"))]]);
    let restart = include_bytes!("fixtures/restart.jpg");
    let capture = open(&files::jpeg_with(restart, 0xe1, &exif), "srgb", "");
    assert_warns(&capture, &["Adobe RGB"]);
    // Adobe RGB (1998) to Rec. 709: only red and green mix.
    let stored = read_image_bytes(restart);
    let linear = std::array::from_fn(|i| stored[i % 3].powf(563.0 / 256.0));
    let matrix = [[1.398_3, -0.398_3, 0.0], [0.0, 1.0, 0.0], [0.0, -0.0429, 1.0429]];
    let got = &capture.photos()[0].image.data()[..3];
    for (got, expected) in got.iter().zip(through(matrix, linear)) {
        assert!((f64::from(*got) - expected).abs() < 1e-3, "{got} instead of {expected}");
    }
}

fn read_image_bytes(bytes: &[u8]) -> Vec<f64> {
    let image = svbrdf_gcn::io::decode_image("a", bytes, Transfer::Linear).unwrap();
    image.data().iter().map(|&v| v.into()).collect()
}

#[test]
fn chromaticities_of_openexr() {
    let window = [0, 0, 1, 1];
    let channels: [(&str, &[f32]); 3] = [("B", &[0.2]), ("G", &[0.1]), ("R", &[0.1])];
    let file = files::exr_with(window, window, &channels, Some(AP1));
    let rec709 = ColorSpace::AcesCg.convert(ColorSpace::Rec709, [0.1, 0.1, 0.2]);
    for (value, digits) in rec709.iter().zip([0.092, 0.099, 0.215]) {
        assert!((value - digits).abs() < 5e-4);
    }
    let capture = open(&file, "linear", "");
    assert_close(&capture, &rec709, 1e-5);
    assert_warns(&capture, &["chromaticities", "Rec. 709"]);
    // The light is what the capture says.
    assert_eq!(capture.photos()[0].shot.light_intensity, [1.0; 3]);
    // The same stated: no word. Something else stated: it wins, with a word.
    let same = open(&file, "linear", r#""color_space": "acescg","#);
    assert_close(&same, &rec709, 1e-6);
    assert!(same.warnings().is_empty(), "{:?}", same.warnings());
    let other = open(&file, "linear", r#""color_space": "rec709","#);
    assert_close(&other, &[0.1, 0.1, 0.2].map(|v: f32| v.into()), 0.0);
    assert_warns(&other, &["chromaticities", "not used", "rec709"]);
    let ignored = open_with(&file, "linear", "", &CaptureOptions::new().ignore_profiles(true)).unwrap();
    assert_eq!(ignored.photos(), other.photos());
    let broken = files::exr_with(window, window, &channels, Some([0.0; 8]));
    assert_warns(&open(&broken, "linear", ""), &["chromaticities", "no colours", "linear"]);
    // They are no matter where maps and pictures are read.
    let dir = TempDir::new().unwrap();
    fs::write(dir.path().join("a.exr"), &file).unwrap();
    assert_eq!(read_image(dir.path().join("a.exr"), Transfer::Linear).unwrap().data(), [0.1, 0.1, 0.2]);
}

#[test]
fn float_photos_in_the_layout_of_the_literature_are_linear() {
    let dir = TempDir::new().unwrap();
    let write = |name: &str, text: &str| fs::write(dir.path().join(name), text).unwrap();
    write("camera_pos.txt", "0,0,15\n-4,3,14\n");
    write("light_pos.txt", "0,0,15\n-4,3,14\n");
    write("image_size.txt", "10");
    write("light_power.txt", "700,700,700");
    let photo = Image::new(2, 1, 3, vec![0.5, 0.25, 0.125, 1.5, 0.0, -0.25]).unwrap();
    for name in ["00.exr", "01.exr"] {
        write_image(dir.path().join(name), &photo, Transfer::Linear).unwrap();
    }
    let open = |options: &CaptureOptions| Capture::open_with(dir.path(), options).unwrap();
    let capture = open(&CaptureOptions::new());
    assert_eq!(capture.photos()[0].image, photo);
    assert_eq!(capture.transfer(), Transfer::Linear);
    assert_warns(&capture, &["00.exr, 01.exr", "linear", "gamma2.2"]);
    // An explicit one is obeyed.
    let asked = open(&CaptureOptions::new().transfer(Transfer::Gamma22));
    assert_eq!(asked.photos()[0].image.data()[0], Transfer::Gamma22.decode(0.5));
    assert!(asked.warnings().is_empty());
    // Integers of the layout are what they always were.
    fs::remove_file(dir.path().join("01.exr")).unwrap();
    fs::write(dir.path().join("01.png"), files::png(2, 1, 2, 8, &CODES)).unwrap();
    let mixed = open(&CaptureOptions::new());
    assert_eq!(mixed.transfer(), Transfer::Gamma22);
    assert_eq!(mixed.photos()[0].image, photo);
    let expected = linear(Transfer::Gamma22);
    for (got, expected) in mixed.photos()[1].image.data().iter().zip(expected) {
        assert!((f64::from(*got) - expected).abs() < 1e-6);
    }
    // ACEScg is for linear photos, which these turn out to be.
    let acescg = open(&CaptureOptions::new().color_space(ColorSpace::AcesCg).views([0]));
    let light = ColorSpace::AcesCg.convert(ColorSpace::Rec709, [700.0; 3]);
    assert_eq!(acescg.photos()[0].shot.light_intensity, light);
    assert_ne!(acescg.photos()[0].image, photo);
}

/// The values of a .npy file of float32 in C order.
fn npy(path: &Path, len: usize) -> Vec<f32> {
    let bytes = fs::read(path).unwrap();
    let data = bytes.as_chunks().0;
    data[data.len() - len..].iter().map(|&value| f32::from_le_bytes(value)).collect()
}

/// Files that programs and cameras wrote, and what other readers make of them.
#[test]
fn files_that_are_easily_read_wrongly() {
    let Some(folder) = common::shared("faults") else { return };
    // JPEG decoders round differently, by a code or two; LittleCMS gave eight bits and nothing below 0.
    for (name, tolerance) in [
        ("01-tiff-extra-sample-lzw", 0.0),
        ("02-tiff-extra-sample-tiled", 0.0),
        ("03-tiff-planar-tiled", 0.0),
        ("04-exif-orientation-long", 4.01 / 255.0),
        ("06-tiff-reduced-page-first", 0.0),
        ("13-png-display-p3", 0.004),
    ] {
        let capture = Capture::open(folder.join(name)).unwrap();
        let image = &capture.photos()[0].image;
        let expected = npy(&folder.join(name).join("expect.npy"), image.data().len());
        for (got, expected) in image.data().iter().zip(expected) {
            let got = if name.starts_with("13") { got.max(0.0) } else { *got };
            assert!((got - expected).abs() <= tolerance, "{name}: {got} instead of {expected}");
        }
    }
    for (name, parts) in [
        ("05-raw-thumbnail-first", &["photo.NEF", "camera raw"][..]),
        ("07-exr-xyz", &["photo.exr", "X, Y, Z"]),
        ("11-jpeg-half-with-end", &["photo.jpg", "truncated"]),
        ("12-jpeg-corrupt", &["photo.jpg", "damaged"]),
    ] {
        let error = Capture::open(folder.join(name)).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{name}: {error}");
    }
    let open = |name: &str| Capture::open(folder.join(name)).unwrap();
    assert_warns(&open("08-exr-red-green"), &["photo.exr", "no channel B"]);
    let literature = open("09-materialgan-exr");
    assert_warns(&literature, &["00.exr, 01.exr, 02.exr", "linear"]);
    for photo in literature.photos() {
        let stored = read_image(folder.join("09-materialgan-exr").join(&photo.name), Transfer::Linear).unwrap();
        assert_eq!(photo.image, stored);
        // A Lambertian surface of albedo 0.5: what the light's intensity and distance leave of it in the middle.
        let [x, y, z] = photo.shot.light;
        let distance2 = x * x + y * y + z * z;
        let expected = 0.5 / std::f64::consts::PI * photo.shot.light_intensity[0] * z / distance2.powf(1.5);
        let middle = photo.image.data()[3 * (8 * 16 + 8)];
        assert!((f64::from(middle) / expected - 1.0).abs() < 0.05, "{middle} instead of {expected}");
    }
    let aces = open("10-exr-ap1");
    for (got, expected) in aces.photos()[0].image.data().iter().zip([0.092, 0.099, 0.215]) {
        assert!((got - expected).abs() < 5e-4, "{got} instead of {expected}");
    }
}
