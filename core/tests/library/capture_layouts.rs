//! The layouts of captures on disk and every way they can be wrong.

use std::fs;
use std::path::Path;

use crate::files;
use svbrdf_gcn::io::Samples;
use svbrdf_gcn::{Capture, CaptureOptions, ColorSpace, PhotoPixels, Shot, Transfer, Unit};
use tempfile::TempDir;

const CAMERAS: &str = "1.0,0.5,16.0\n-2.0, 1.0, 15.5\n0 0 17\n";
const LIGHTS: &str = "1.0,0.5,18.0\n-2.0,1.0,15.5\n0,0,17\n\n# done\n";

fn rgb(width: u32, height: u32, value: u16) -> Vec<u8> {
    files::png(width, height, 2, 8, &vec![value; (width * height * 3) as usize])
}

/// A folder in the layout of MaterialGAN, three photos of 4 x 2 pixels.
fn folder() -> TempDir {
    let dir = TempDir::new().unwrap();
    let write = |name: &str, bytes: &[u8]| fs::write(dir.path().join(name), bytes).unwrap();
    write("camera_pos.txt", CAMERAS.as_bytes());
    write("light_pos.txt", LIGHTS.as_bytes());
    write("image_size.txt", b"6.848\n");
    write("light_power.txt", b"1500.0,1400,1300\n");
    write("00.png", &rgb(4, 2, 255));
    write("1.png", &rgb(4, 2, 128));
    write("02.png", &rgb(4, 2, 0));
    write("rendered.png", b"not a photo");
    dir
}

fn json(extra: &str, photos: &str) -> String {
    format!(
        r#"{{"format": "svbrdf-gcn capture", "version": 1, "patch_size": 10.0, "transfer": "srgb",
            "light_intensity": [3, 2, 1], {extra} "photos": {photos}}}"#
    )
}

const ONE_PHOTO: &str = r#"[{"file": "a.png", "camera": [0, 0, 20]}]"#;

/// A folder with a `capture.json` of this text and the photos `a.png` and `sub/b.png` of 4 x 2 pixels.
fn json_folder(text: &str) -> TempDir {
    let dir = TempDir::new().unwrap();
    fs::create_dir(dir.path().join("sub")).unwrap();
    fs::write(dir.path().join("capture.json"), text).unwrap();
    fs::write(dir.path().join("a.png"), rgb(4, 2, 100)).unwrap();
    fs::write(dir.path().join("sub/b.png"), rgb(4, 2, 200)).unwrap();
    dir
}

fn message(path: &Path) -> String {
    Capture::open(path).unwrap_err().to_string()
}

fn assert_mentions(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "{part:?} is missing in: {message}");
    }
}

#[test]
fn folder_of_the_literature() {
    let dir = folder();
    let capture = Capture::open(dir.path()).unwrap();
    assert_eq!(capture.len(), 3);
    assert_eq!((capture.width(), capture.height()), (4, 2));
    assert_eq!(capture.patch_size(), 6.848);
    assert_eq!(capture.transfer(), Transfer::Gamma22);
    assert_eq!(capture.unit(), None);
    assert!(capture.warnings().is_empty());
    let photo = &capture.photos()[0];
    assert_eq!(photo.name, "00.png");
    assert_eq!(photo.shot.camera, [1.0, 0.5, 16.0]);
    assert_eq!(photo.shot.light, [1.0, 0.5, 18.0]);
    assert_eq!(photo.shot.light_intensity, [1500.0, 1400.0, 1300.0]);
    assert!(photo.image.data().iter().all(|&v| v == 1.0));
    assert!(photo.saturated.iter().all(|&bits| bits == 7));
    let second = &capture.photos()[1];
    assert_eq!(second.name, "1.png");
    assert!((second.image.data()[0] - (128f32 / 255.0).powf(2.2)).abs() < 1e-6);
    assert!(second.saturated.iter().all(|&bits| bits == 0));
}

#[test]
fn own_json_and_its_folder() {
    let text = json(
        r#""unit": "mm", "white_level": null, "notes": {"made": "by hand"},"#,
        r#"[{"file": "a.png", "camera": [0, 0, 20]},
            {"file": "sub/b.png", "camera": [1, 2, 30], "light": [4, 5, 6], "light_intensity": [7, 8, 9]}]"#,
    );
    let dir = json_folder(&text);
    let capture = Capture::open(dir.path()).unwrap();
    assert_eq!(capture, Capture::open(dir.path().join("capture.json")).unwrap());
    assert_eq!(capture.unit().map(Unit::name), Some("mm"));
    assert_eq!(capture.transfer(), Transfer::Srgb);
    let [a, b] = capture.photos() else { panic!("two photos") };
    assert_eq!(a.shot, Shot { camera: [0.0, 0.0, 20.0], light: [0.0, 0.0, 20.0], light_intensity: [3.0, 2.0, 1.0] });
    assert_eq!(b.shot, Shot { camera: [1.0, 2.0, 30.0], light: [4.0, 5.0, 6.0], light_intensity: [7.0, 8.0, 9.0] });
    assert!((a.image.data()[0] - Transfer::Srgb.decode(100.0 / 255.0)).abs() < 1e-7);
}

#[test]
fn json_of_svbrdf_diff_renderer() {
    let dir = TempDir::new().unwrap();
    fs::create_dir_all(dir.path().join("target/img/256")).unwrap();
    for (name, value) in [("00.png", 10), ("02.png", 20)] {
        fs::write(dir.path().join("target/img/256").join(name), rgb(4, 2, value)).unwrap();
    }
    let text = r#"{"_comment": "cm", "target_dir": "target/img/256", "optimize_dir": "o", "im_size": 6.848, "idx": [2, 0],
        "camera_pos": [[0,0,1],[0,0,2],[0,0,3]], "light_pos": [[0,0,4],[0,0,5],[0,0,6]], "light_pow": [1500,1500,1500]}"#;
    let file = dir.path().join("optim.json");
    fs::write(&file, text).unwrap();
    let capture = Capture::open(&file).unwrap();
    assert_eq!(capture.transfer(), Transfer::Gamma22);
    let names: Vec<_> = capture.photos().iter().map(|photo| photo.name.as_str()).collect();
    assert_eq!(names, ["02.png", "00.png"]);
    assert_eq!(capture.photos()[0].shot.camera, [0.0, 0.0, 3.0]);
    assert_eq!(capture.photos()[0].shot.light, [0.0, 0.0, 6.0]);
    assert_eq!(capture.patch_size(), 6.848);

    fs::write(&file, text.replace("[2, 0]", "[2, 3]")).unwrap();
    assert_mentions(&message(&file), &["optim.json", "idx 3", "3 positions"]);
    fs::write(&file, text.replace(",[0,0,6]", "")).unwrap();
    assert_mentions(&message(&file), &["3 entries of light_pos", "got 2"]);
}

#[test]
fn options() {
    let dir = folder();
    let options = CaptureOptions::new().views([2, 0]).size(2).transfer(Transfer::Linear);
    let capture = Capture::open_with(dir.path(), &options).unwrap();
    assert_eq!((capture.len(), capture.width(), capture.height()), (2, 2, 1));
    assert_eq!(capture.transfer(), Transfer::Linear);
    assert_eq!(capture.photos()[0].name, "02.png");
    assert_eq!(capture.select(&[1]).unwrap().photos()[0].name, "00.png");

    let large = Capture::open_with(dir.path(), &CaptureOptions::new().size(64)).unwrap();
    assert_eq!(large.width(), 4);
    assert_mentions(&large.warnings()[0], &["64", "4 x 2"]);

    for (views, part) in [(vec![0, 3], "photo 3"), (vec![1, 1], "twice"), (vec![], "none")] {
        let error = Capture::open_with(dir.path(), &CaptureOptions::new().views(views.clone())).unwrap_err();
        assert_mentions(&error.to_string(), &["views", part]);
        assert_mentions(&large.select(&views).unwrap_err().to_string(), &["views", part]);
    }
    let error = Capture::open_with(dir.path(), &CaptureOptions::new().size(0)).unwrap_err();
    assert_mentions(&error.to_string(), &["size", "0"]);
}

#[test]
fn unused_views_are_not_opened() {
    let dir = folder();
    fs::write(dir.path().join("1.png"), b"broken").unwrap();
    assert!(Capture::open_with(dir.path(), &CaptureOptions::new().views([0, 2])).is_ok());
    assert!(Capture::open(dir.path()).is_err());
}

#[test]
fn wrong_folders() {
    let cases: [(&str, &str, &[&str]); 16] = [
        ("camera_pos.txt", "0,0,1\n0,0,1\n", &["light_pos.txt", "2 positions", "camera_pos.txt", "got 3"]),
        ("light_pos.txt", "0,0,1\n", &["light_pos.txt", "3 positions", "got 1"]),
        ("camera_pos.txt", "0,0,1\n0,0,1,4\n0,0,1", &["camera_pos.txt", "three numbers", "4"]),
        ("camera_pos.txt", "0,0,1\n0,zero,1\n0,0,1", &["camera_pos.txt", "line 2", "zero"]),
        ("camera_pos.txt", "0,0,1\n0,nan,1\n0,0,1", &["1.png", "camera", "NaN"]),
        ("camera_pos.txt", "0,0,1\n0,0,1\n0,inf,1", &["02.png", "camera", "inf"]),
        ("camera_pos.txt", "0,0,1\n0,0,0\n0,0,1", &["1.png", "camera", "behind", "got 0"]),
        ("light_pos.txt", "0,0,1\n0,0,1\n1,2,-3.5", &["02.png", "light", "behind", "-3.5"]),
        ("image_size.txt", "0", &["patch_size", "got 0"]),
        ("image_size.txt", "-2", &["patch_size", "-2"]),
        ("image_size.txt", "nan", &["patch_size", "NaN"]),
        ("image_size.txt", "", &["image_size.txt", "one number"]),
        ("light_power.txt", "1,2", &["light_power.txt", "three numbers", "2.0"]),
        ("light_power.txt", "1,2,-3", &["light_intensity", "-3"]),
        ("light_power.txt", "0,0,0", &["light_intensity", "0.0, 0.0, 0.0"]),
        ("light_power.txt", "1,2,3\n1,2,3", &["light_power.txt", "one line", "2 lines"]),
    ];
    for (file, text, parts) in cases {
        let dir = folder();
        fs::write(dir.path().join(file), text).unwrap();
        assert_mentions(&message(dir.path()), parts);
    }
}

#[test]
fn missing_and_superfluous_files() {
    for file in ["light_pos.txt", "image_size.txt", "light_power.txt"] {
        let dir = folder();
        fs::remove_file(dir.path().join(file)).unwrap();
        assert_mentions(&message(dir.path()), &[file, "No such file"]);
    }
    let dir = folder();
    fs::remove_file(dir.path().join("1.png")).unwrap();
    assert_mentions(&message(dir.path()), &["01.png", "no photo 1"]);

    let dir = folder();
    fs::write(dir.path().join("03.jpg"), b"").unwrap();
    assert_mentions(&message(dir.path()), &["camera_pos.txt", "03.jpg", "3 positions"]);

    let dir = folder();
    fs::write(dir.path().join("0.png"), b"").unwrap();
    assert_mentions(&message(dir.path()), &["0.png and 00.png", "photo 0"]);

    let dir = TempDir::new().unwrap();
    assert_mentions(&message(dir.path()), &["capture.json", "camera_pos.txt"]);
    assert_mentions(&message(&dir.path().join("none")), &["none", "No such file"]);
}

#[test]
fn wrong_photos() {
    let dir = folder();
    fs::write(dir.path().join("02.png"), rgb(4, 3, 0)).unwrap();
    assert_mentions(&message(dir.path()), &["02.png", "4 x 2", "00.png", "4 x 3"]);

    let whole = rgb(4, 2, 9);
    let cases: [(&[u8], &str); 4] = [
        (b"", "empty"),
        (b"GIF89a......", "47 49 46 38"),
        (&whole[..whole.len() - 20], "02.png"),
        (&whole[..20], "02.png"),
    ];
    for (bytes, part) in cases {
        fs::write(dir.path().join("02.png"), bytes).unwrap();
        assert_mentions(&message(dir.path()), &["02.png", part]);
    }
    fs::remove_file(dir.path().join("02.png")).unwrap();
    fs::create_dir(dir.path().join("02.png")).unwrap();
    assert_mentions(&message(dir.path()), &["02.png", "a folder"]);
}

#[test]
fn wrong_json() {
    let good = json("", ONE_PHOTO);
    assert!(Capture::open(json_folder(&good).path()).is_ok());
    let cases: [(String, &[&str]); 16] = [
        (String::new(), &["capture.json", "EOF"]),
        ("{".to_owned(), &["capture.json", "EOF"]),
        ("[]".to_owned(), &["capture.json"]),
        ("{}".to_owned(), &["capture.json", "missing", "svbrdf-gcn capture"]),
        (good.replace("svbrdf-gcn capture", "other"), &["other", "svbrdf-gcn capture"]),
        (good.replace("\"version\": 1", "\"version\": 3"), &["version 3", "versions 1 and 2"]),
        (good.replace("\"version\": 1,", ""), &["version missing"]),
        (good.replace("srgb", "Adobe"), &["Adobe", "gamma2.2"]),
        (good.replace("10.0", "0"), &["patch_size", "got 0"]),
        (good.replace("10.0", "1e999"), &["capture.json", "out of range"]),
        (good.replace("\"light_intensity\": [3, 2, 1],", ""), &["light_intensity missing", "a.png"]),
        (json("\"white_level\": 0,", ONE_PHOTO), &["white_level", "got 0"]),
        (json("\"patchsize\": 4,", ONE_PHOTO), &["patchsize"]),
        (json("", "[]"), &["at least one photo", "got 0"]),
        (json("", r#"[{"file": "c.png", "camera": [0, 0, 2]}]"#), &["c.png", "No such file"]),
        (json("", r#"[{"file": "a.png", "camera": [0, 0]}]"#), &["capture.json", "array of length 3"]),
    ];
    for (text, parts) in cases {
        assert_mentions(&message(json_folder(&text).path()), parts);
    }
}

#[test]
fn all_that_is_wrong_is_told_at_once() {
    let text = r#"{"format": "svbrdf-gcn capture", "version": 1, "patchsize": 4, "transfer": "Adobe", "white_level": 0, "unit": 7,
        "photos": [{"file": "a.png", "camera": [0, 0]}, {"camera": [0, 0, -1]}, {"file": "b.png", "camera": [0, 0, -1], "light_intensity": 2},
                   {"file": "c.png", "camera": [0, 0, 1], "camera": [0, 0, 2], "lite": 1}]}"#;
    let message = message(json_folder(text).path());
    assert_mentions(
        &message,
        &[
            "patch_size missing",
            "patchsize unknown, expected",
            "transfer: unknown variant `Adobe`",
            "white_level: expected a finite number above 0",
            "unit: invalid type",
            "photos[0].camera: invalid length 2",
            "photos[1].file missing",
            "b.png: camera [0.0, 0.0, -1.0] lies behind",
            "photos[3].camera given twice",
            "photos[3].lite unknown",
            "light_intensity missing, for the capture and for photo c.png",
        ],
    );
    let many = json("", &format!("[{}]", vec!["{}"; 50].join(",")));
    let message = self::message(json_folder(&many).path());
    assert!(
        message.contains("photos[0].file missing; photos[0].camera missing;") && message.ends_with("and 80 more"),
        "{message}"
    );

    // Of a folder of the literature, too.
    let dir = folder();
    for file in ["light_pos.txt", "light_power.txt"] {
        fs::remove_file(dir.path().join(file)).unwrap();
    }
    assert_mentions(
        &self::message(dir.path()),
        &["No such file", "light_pos.txt, light_power.txt", "docs/captures.md"],
    );
}

#[test]
fn one_number_is_a_white_light() {
    let photos = r#"[{"file": "a.png", "camera": [0, 0, 20]}, {"file": "sub/b.png", "camera": [1, 0, 20], "light_intensity": 2.5}]"#;
    let text = json("", photos).replace("[3, 2, 1]", "1200");
    let capture = Capture::open(json_folder(&text).path()).unwrap();
    let intensities: Vec<_> = capture.photos().iter().map(|photo| photo.shot.light_intensity).collect();
    assert_eq!(intensities, [[1200.0; 3], [2.5; 3]]);
    for (wrong, got) in [("\"bright\"", "bright"), ("[1, 2]", "[1,2]"), ("-3", "[-3.0, -3.0, -3.0]")] {
        let text = json("", ONE_PHOTO).replace("[3, 2, 1]", wrong);
        assert_mentions(&message(json_folder(&text).path()), &["light_intensity", got]);
    }
}

#[test]
fn photos_in_memory() {
    let shot = Shot { camera: [0.0, 0.0, 2.0], light: [0.0, 0.0, 2.0], light_intensity: [1.0; 3] };
    let photo = |samples, channels| PhotoPixels { name: "p", shot, width: 2, height: 1, channels, samples };
    let open = |photos: &[PhotoPixels<'_>], white| {
        Capture::from_photos(photos, 1.0, Transfer::Linear, white, &CaptureOptions::new())
    };
    let bytes = open(&[photo(Samples::U8(&[0, 255, 51, 255, 102, 153]), 3)], None).unwrap();
    assert_eq!(bytes.photos()[0].image.data(), [0.0, 1.0, 0.2, 1.0, 0.4, 0.6]);
    assert_eq!(bytes.photos()[0].saturated, [2, 1]);
    let words = open(&[photo(Samples::U16(&[65535, 13107]), 1)], None).unwrap();
    assert_eq!(words.photos()[0].image.data(), [1.0, 1.0, 1.0, 0.2, 0.2, 0.2]);
    assert_eq!(words.photos()[0].saturated, [7, 0]);
    let values = [0.5f32, 2.0, 1.0, 0.0, 3.0, 1.0, 1.0, 1.0];
    let floats = open(&[photo(Samples::F32(&values), 4)], None).unwrap();
    assert_eq!(floats.photos()[0].image.data(), [0.5, 2.0, 1.0, 3.0, 1.0, 1.0]);
    assert_eq!(floats.photos()[0].saturated, [0, 0]);
    assert_mentions(&floats.warnings()[0], &["p", "alpha"]);
    let white = open(&[photo(Samples::F32(&values), 4)], Some(1.5)).unwrap();
    assert_eq!(white.photos()[0].saturated, [2, 1]);

    let nan = open(&[photo(Samples::F32(&[0.0, f32::NAN]), 1)], None).unwrap_err();
    assert_mentions(&nan.to_string(), &["p", "NaN"]);
    for (samples, channels) in [(Samples::U8(&[0; 5]), 3), (Samples::U8(&[0; 10]), 5), (Samples::U8(&[]), 0)] {
        let error = open(&[photo(samples, channels)], None).unwrap_err();
        assert_mentions(&error.to_string(), &["p", &format!("{} values", samples.len())]);
    }
    assert!(open(&[], None).is_err());
    // Floats of 0 to 255 that are said to be encoded; linear ones have no upper end, alpha is nobody's business.
    let codes = [8.5f32, 255.0, 1.0, 0.5, 0.5, 0.5];
    for transfer in [Transfer::Srgb, Transfer::Gamma22] {
        let floats = |values, channels| {
            Capture::from_photos(&[photo(values, channels)], 1.0, transfer, None, &CaptureOptions::new())
        };
        let error = floats(Samples::F32(&codes), 3).unwrap_err().to_string();
        assert_mentions(&error, &["p: ", transfer.name(), "at most 8, got up to 255", "divide"]);
        assert!(floats(Samples::F32(&[8.0, 255.0, 0.5, 255.0]), 2).is_ok());
    }
    assert!(open(&[photo(Samples::F32(&codes), 3)], None).is_ok());
    let mut behind = photo(Samples::U8(&[0; 6]), 3);
    behind.shot.light[2] = -1.0;
    assert_mentions(&open(&[behind], None).unwrap_err().to_string(), &["p", "light", "-1"]);
}

#[test]
fn linear_photos_in_acescg_become_rec709() {
    let pixels = [0.2f32, 0.5, 0.1, 0.9, 0.0, 0.0];
    let shot = Shot { camera: [0.0, 0.0, 9.0], light: [1.0, 0.0, 9.0], light_intensity: [30.0, 20.0, 10.0] };
    let photo = |samples| PhotoPixels { name: "a", shot, width: 2, height: 1, channels: 3, samples };
    let open = |samples, transfer, options: &CaptureOptions| {
        Capture::from_photos(&[photo(samples)], 4.0, transfer, Some(0.9), options).unwrap()
    };
    let acescg = CaptureOptions::new().color_space(ColorSpace::AcesCg);
    let capture = open(Samples::F32(&pixels), Transfer::Linear, &acescg);
    let to_rec709 = |rgb: [f64; 3]| ColorSpace::AcesCg.convert(ColorSpace::Rec709, rgb);
    let converted = &capture.photos()[0];
    assert_eq!(converted.shot.light_intensity, to_rec709([30.0, 20.0, 10.0]));
    let expected = [to_rec709([0.2, 0.5, 0.1]), to_rec709([0.9, 0.0, 0.0])].concat();
    for (got, expected) in converted.image.data().iter().zip(expected) {
        assert!((f64::from(*got) - expected).abs() < 1e-6);
    }
    assert!(converted.image.data()[4] < 0.0, "a red that Rec. 709 has not");
    assert_eq!(converted.saturated, [0, 7], "one saturated channel reaches all");
    assert!(capture.warnings().is_empty());

    // Encoded photos are Rec. 709, and a warning says so.
    let capture = open(Samples::U8(&[10, 20, 30, 40, 50, 255]), Transfer::Srgb, &acescg);
    let plain = open(Samples::U8(&[10, 20, 30, 40, 50, 255]), Transfer::Srgb, &CaptureOptions::new());
    assert_eq!(capture.photos(), plain.photos());
    assert!(capture.warnings().iter().any(|w| w.contains("acescg") && w.contains("srgb")), "{:?}", capture.warnings());

    // A light that Rec. 709 has not.
    let green =
        PhotoPixels { shot: Shot { light_intensity: [0.0, 20.0, 0.0], ..shot }, ..photo(Samples::F32(&pixels)) };
    let error = Capture::from_photos(&[green], 4.0, Transfer::Linear, None, &acescg).unwrap_err();
    assert!(error.to_string().contains("light_intensity"), "{error}");
}

#[test]
fn a_capture_states_its_colour_space() {
    let linear = |extra: &str| json(extra, ONE_PHOTO).replace("srgb", "linear");
    let (rec709, acescg) = (json_folder(&linear("")), json_folder(&linear(r#""color_space": "acescg","#)));
    let open = |dir: &TempDir, options: &CaptureOptions| Capture::open_with(dir.path(), options).unwrap();
    let asked = CaptureOptions::new().color_space(ColorSpace::AcesCg);
    let stated = open(&acescg, &CaptureOptions::new());
    assert_eq!(stated, open(&rec709, &asked));
    assert_ne!(stated, open(&rec709, &CaptureOptions::new()));
    let replaced = CaptureOptions::new().color_space(ColorSpace::Rec709);
    assert_eq!(open(&acescg, &replaced), open(&rec709, &CaptureOptions::new()));
    let unknown = json_folder(&linear(r#""color_space": "p3","#));
    assert_mentions(&message(unknown.path()), &["capture.json", "p3", "acescg"]);
}

/// A JPEG with EXIF data of a lens of 26 mm (on film) and a flash that did not fire, for a photo of this size.
fn jpeg_of_lens(width: u32, height: u32) -> Vec<u8> {
    let lens = [(0x9209, 3, 1, 16), (0xa002, 4, 1, width), (0xa003, 4, 1, height), (0xa405, 3, 1, 26)];
    files::jpeg_with(include_bytes!("fixtures/restart.jpg"), 0xe1, &files::exif(&[&lens]))
}

#[test]
fn one_photo_takes_its_lens_from_exif_data_of_its_size() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("photo.jpg");
    let (width, height) = {
        fs::write(&path, include_bytes!("fixtures/restart.jpg")).unwrap();
        let capture = Capture::open(&path).unwrap();
        (capture.width() as u32, capture.height() as u32)
    };
    let shorter = f64::from(width.min(height));
    fs::write(&path, jpeg_of_lens(width, height)).unwrap();
    let capture = Capture::open(&path).unwrap();
    let assumed = capture.assumed().unwrap();
    // The diagonal of film is 43.27 mm long.
    let focal_length = 26.0 / 43.2666 * f64::from(width).hypot(f64::from(height));
    assert!(assumed.field_of_view_is_from_exif);
    assert!((assumed.distance - 2.0 * focal_length / shorter).abs() < 1e-4, "{assumed:?}");
    assert_eq!(capture.patch_size(), 2.0 * f64::from(width) / shorter);
    let shot = capture.photos()[0].shot;
    assert_eq!((shot.camera, shot.light), ([0.0, 0.0, assumed.distance], shot.camera));
    assert_mentions(&capture.warnings().join("\n"), &["as EXIF says", "flash did not fire", "light_intensity states"]);

    fs::write(&path, jpeg_of_lens(2 * width, 2 * height)).unwrap();
    let scaled = Capture::open(&path).unwrap();
    assert!(!scaled.assumed().unwrap().field_of_view_is_from_exif);
    assert_mentions(&scaled.warnings().join("\n"), &["50.0 degrees across the shorter side"]);

    let options = CaptureOptions::new().light_intensity([3.0, 2.0, 1.0]).size(8);
    let stated = Capture::open_with(&path, &options).unwrap();
    assert_eq!(stated.photos()[0].shot.light_intensity, [3.0, 2.0, 1.0]);
    assert!(!stated.assumed().unwrap().light_is_chosen);
    assert_eq!(stated.width().max(stated.height()), 8);
    assert_eq!(stated.patch_size(), capture.patch_size());
    let negative = Capture::open_with(&path, &CaptureOptions::new().light_intensity([-1.0, 1.0, 1.0]));
    assert_mentions(&negative.unwrap_err().to_string(), &["photo.jpg", "light_intensity", "-1"]);
}

#[test]
fn another_light_intensity_replaces_what_is_stated() {
    let dir = folder();
    let options = CaptureOptions::new().light_intensity([5.0, 6.0, 7.0]);
    let capture = Capture::open_with(dir.path(), &options).unwrap();
    assert!(capture.photos().iter().all(|photo| photo.shot.light_intensity == [5.0, 6.0, 7.0]));
    assert!(capture.assumed().is_none());
}

#[test]
fn what_acquire_found_is_read() {
    let photos = r#"[{"file": "a.png", "camera": [0, 0, 20]}]"#;
    let folder = |acquisition: &str| {
        json_folder(
            &json(&format!("\"acquisition\": {acquisition},"), photos).replace("\"version\": 1", "\"version\": 2"),
        )
    };
    let found = r#"{"photos": [{"file": "a.png", "photo": "1.jpg", "position_error": 0.004, "paper_error": 0.1}], "assumptions": ["flat"], "size": 4}"#;
    let capture = Capture::open(folder(found).path()).unwrap();
    let acquired = capture.acquired().unwrap();
    assert_eq!((acquired.photos.len(), acquired.photos[0].file.as_str()), (1, "a.png"));
    assert_eq!((acquired.photos[0].position_error, acquired.photos[0].paper_error), (Some(0.004), Some(0.1)));
    assert_eq!(acquired.assumptions, ["flat"]);
    assert_eq!(capture.select(&[0]).unwrap(), capture);
    assert_eq!(Capture::open(folder("null").path()).unwrap().acquired(), None);
    assert_mentions(&message(folder(r#"{"photos": 3}"#).path()), &["acquisition", "expected a sequence"]);
}

#[test]
fn masks_of_version_2_say_what_is_saturated() {
    let mask = |size: &[u16]| files::png(4, 2, 2, 8, size);
    let photos = r#"[{"file": "a.png", "camera": [0, 0, 20], "saturated": "mask.png"}]"#;
    let dir =
        json_folder(&json(r#""acquisition": {"anything": 1},"#, photos).replace("\"version\": 1", "\"version\": 2"));
    let mut bits = [0u16; 24];
    (bits[1], bits[6], bits[7], bits[8]) = (255, 255, 255, 255);
    fs::write(dir.path().join("mask.png"), mask(&bits)).unwrap();
    let capture = Capture::open(dir.path()).unwrap();
    assert_eq!(capture.photos()[0].saturated, [0b010, 0, 0b111, 0, 0, 0, 0, 0]);
    let small = Capture::open_with(dir.path(), &CaptureOptions::new().size(2)).unwrap();
    assert_eq!(small.photos()[0].saturated, [0b010, 0b111]);
    fs::write(dir.path().join("mask.png"), rgb(2, 2, 0)).unwrap();
    assert_mentions(&message(dir.path()), &["mask.png", "4 x 2 pixels as its photo", "2 x 2"]);
    // Version 1 has no masks.
    let old = json_folder(&json("", photos));
    assert_mentions(&message(old.path()), &["photos[0].saturated unknown"]);
}
