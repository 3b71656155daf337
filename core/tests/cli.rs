//! The command line as a user sees it: exit codes, messages, files.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

#[allow(dead_code, reason = "shared by several tests")]
#[path = "library/common/files.rs"]
mod files;
#[path = "library/common/material.rs"]
mod material;

fn samples(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../samples").join(path)
}

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_svbrdf-gcn")).args(arguments).output().unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

fn json(output: &Output) -> Value {
    assert!(output.status.success(), "{}", stderr(output));
    let stdout = String::from_utf8(output.stdout.clone()).unwrap();
    assert_eq!(stdout.trim_end().lines().count(), 1, "one JSON object and nothing else: {stdout}");
    serde_json::from_str(&stdout).unwrap()
}

#[test]
fn fit_evaluate_render_info() {
    let folder = tempfile::tempdir().unwrap();
    let (out, picture) = (folder.path().join("out"), folder.path().join("new.png"));
    let capture = samples("lambert");
    let fit = run(&[
        "fit",
        text(&capture),
        "-o",
        text(&out),
        "--views",
        "0,1,2,3",
        "--size",
        "32",
        "--direct-steps",
        "150",
        "--json",
    ]);
    let report = json(&fit);
    assert_eq!(report["report"]["method"], "network");
    let stages: Vec<_> = report["report"]["stages"].as_array().unwrap().iter().map(|stage| &stage["stage"]).collect();
    assert_eq!(stages[..3], ["encode", "direct", "finish"]);
    // Another pass may be kept, and no more than one.
    assert!(stages[3..].is_empty() || stages[3..] == ["direct", "finish"], "{stages:?}");
    assert_eq!(report["report"]["stages"][1]["steps"], 150);
    assert!(stderr(&fit).is_empty(), "{}", stderr(&fit));
    for file in ["diffuse.exr", "specular.exr", "roughness.exr", "normal.exr", "material.json", "preview.png"] {
        assert!(out.join(file).is_file(), "{file}");
    }

    let evaluation = json(&run(&[
        "evaluate",
        text(&out),
        text(&capture),
        "--views",
        "4",
        "--truth",
        text(&capture.join("truth")),
        "--json",
    ]));
    let rmse = evaluation["rmse"].as_f64().unwrap();
    assert!(rmse < 0.02, "a photo that the fit did not use: {rmse}");
    assert!(evaluation["maps"].is_object());

    let render = run(&[
        "render",
        text(&out),
        "--camera",
        "0,0,15",
        "--light=-3,3,15",
        "--light-intensity",
        "640,620,590",
        "-o",
        text(&picture),
    ]);
    assert!(render.status.success(), "{}", stderr(&render));
    assert!(picture.is_file());
    let info = json(&run(&["info", text(&out), "--json"]));
    assert_eq!(info["width"], 32);
    assert_eq!(info["report"]["method"], "network");
}

#[test]
fn info_of_a_photo_graph() {
    let weights = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/default/weights.safetensors");
    let info = json(&run(&["info", text(&weights), "--json"]));
    assert_eq!(info["kind"], "weights");
    assert_eq!(info["license"], "CC0-1.0");
    assert_eq!(info["checksums"], "verified");
    assert_eq!(info["architecture"]["kind"], "photo graph");
    assert_eq!(info["architecture"]["window"], 16);
    assert_eq!(info["facts"]["data"], "random weights");
    // 4 bytes each, behind the header.
    assert!(info["parameters"].as_u64().unwrap() * 4 < std::fs::metadata(&weights).unwrap().len());
    let printed = run(&["info", text(&weights)]);
    assert!(String::from_utf8_lossy(&printed.stdout).contains("kind: photo graph"));
    let old = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/seeds/weights/two_networks.safetensors");
    assert!(json(&run(&["info", text(&old), "--json"]))["checksums"].as_str().unwrap().starts_with("none"));
}

#[test]
fn same_seed_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let capture = samples("lambert");
    let maps: Vec<Vec<u8>> = ["a", "b"]
        .iter()
        .map(|name| {
            let out = folder.path().join(name);
            let fit = run(&[
                "fit",
                text(&capture),
                "-o",
                text(&out),
                "--size",
                "24",
                "--direct-steps",
                "30",
                "--threads",
                "2",
                "--seed",
                "5",
                "-q",
            ]);
            assert!(fit.status.success(), "{}", stderr(&fit));
            assert!(fit.stdout.is_empty());
            ["diffuse.exr", "specular.exr", "roughness.exr", "normal.exr"]
                .iter()
                .flat_map(|file| std::fs::read(out.join(file)).unwrap())
                .collect()
        })
        .collect();
    assert_eq!(maps[0], maps[1]);
}

/// A Python of a few lines of shell: it says that `missing` are missing, and else repeats its arguments and exits with 7.
#[cfg(unix)]
fn fake_python(folder: &Path, missing: &str) -> std::path::PathBuf {
    use std::os::unix::fs::PermissionsExt;

    let path = folder.join("python");
    let script = format!("#!/bin/sh\nif [ \"$1\" = -c ]; then echo {missing}; exit; fi\nprintf '%s|' \"$@\"\nexit 7\n");
    std::fs::write(&path, script).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    path
}

#[cfg(unix)]
#[test]
fn train_starts_the_trainer_of_the_python_package() {
    let folder = tempfile::tempdir().unwrap();
    let python = fake_python(folder.path(), "");
    let output = run(&["train", "--python", text(&python), "some.toml", "-o", "some folder", "--set", "a=1", "--help"]);
    assert_eq!(output.status.code(), Some(7), "{}", stderr(&output));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(said, "-m|svbrdf_gcn.training|some.toml|-o|some folder|--set|a=1|--help|");

    let output = run(&["train", "--python", text(&fake_python(folder.path(), "torch numpy")), "some.toml"]);
    assert_eq!(output.status.code(), Some(2));
    let message = stderr(&output);
    assert!(message.contains("torch numpy") && message.contains("pip install 'svbrdf-gcn[training]'"), "{message}");
}

/// Exit code and what the one line on standard error must name.
#[test]
fn bad_input_is_one_line_that_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let (capture, out) = (samples("lambert"), text(&out));
    let capture = text(&capture);
    let missing = folder.path().join("nowhere");
    let garbage = folder.path().join("garbage.safetensors");
    std::fs::write(&garbage, [0xffu8; 64]).unwrap();
    let below_a_file = garbage.join("material");
    let cases: [(&[&str], i32, &[&str]); 10] = [
        (&["fit", text(&missing), "-o", out], 3, &["nowhere"]),
        (&["fit", capture, "-o", out, "--views", "0,9"], 2, &["9", "5"]),
        (&["fit", capture, "-o", out, "--max-memory", "1000"], 6, &["max_memory", "1000"]),
        // Said before the fit, which would be too large.
        (&["fit", capture, "-o", text(&below_a_file), "--max-memory", "1000"], 3, &["garbage"]),
        (&["fit", capture, "-o", out, "--threads", "0"], 2, &["threads", "0"]),
        (&["fit", capture, "-o", out, "--size", "0"], 2, &["size", "0"]),
        (&["fit", capture, "-o", out, "--weights", text(&garbage)], 4, &["weights"]),
        (&["render", capture, "--camera", "0,0,1", "--light", "0,0,1", "-o", out], 3, &["material.json"]),
        (&["evaluate", text(&missing), capture], 3, &["nowhere"]),
        (&["train", "--python", text(&missing), "some.toml", "-o", out], 2, &["nowhere", "--python", "pip install"]),
    ];
    for (arguments, code, names) in cases {
        let output = run(arguments);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
        assert!(output.stdout.is_empty(), "{arguments:?}");
        assert!(
            message.trim_end().lines().all(|line| line.starts_with("error: ") || line.starts_with("warning: ")),
            "{message}"
        );
        for name in names {
            assert!(message.contains(name), "{arguments:?}: {message}");
        }
        assert!(!Path::new(out).exists(), "{arguments:?} leaves nothing behind");
    }
    // Usage errors are the parser's.
    for arguments in [
        &["fit", capture][..],
        &["fit", capture, "-o", out, "--preset", "best"],
        &["render", capture, "--camera", "1,2"],
    ] {
        assert_eq!(run(arguments).status.code(), Some(2), "{arguments:?}");
    }
}

#[test]
fn exports_and_colour_spaces() {
    let folder = tempfile::tempdir().unwrap();
    let truth = samples("lambert/truth");
    let at = |name: &str| folder.path().join(name);
    for target in ["materialx", "gltf", "principled", "unreal"] {
        let out = at(target);
        let report =
            json(&run(&["export", text(&truth), "--to", target, "-o", text(&out), "--name", "Card", "--json"]));
        assert_eq!(report["target"], target);
        assert!(report["loss"]["specular"]["max"].is_number());
        for file in report["files"].as_array().unwrap() {
            assert!(out.join(file["file"].as_str().unwrap()).is_file());
        }
        let plain = run(&["export", text(&truth), "--to", target, "-o", text(&out)]);
        assert!(plain.status.success());
        assert!(String::from_utf8(plain.stdout).unwrap().contains("off at normal incidence"));
    }
    assert!(at("materialx/Card.mtlx").is_file() && at("unreal/T_Card_ORM.png").is_file());
    let directx = run(&["export", text(&truth), "--to", "gltf", "--normals", "directx", "-o", text(&at("none"))]);
    assert_eq!(directx.status.code(), Some(2));
    assert!(stderr(&directx).contains("normals") && !at("none").exists());

    // The same view in both spaces, and the matrix between them.
    let view = ["--camera", "0,0,20", "--light", "-8,8,15", "--light-intensity", "900,800,700", "--size", "16"];
    let render =
        |out: &Path, more: &[&str]| run(&[&["render", text(&truth), "-o", text(out)], &view[..], more].concat());
    assert!(render(&at("rec709.exr"), &[]).status.success());
    assert!(render(&at("acescg.exr"), &["--color-space", "acescg"]).status.success());
    let read = |name: &str| svbrdf_gcn::io::read_image(at(name), svbrdf_gcn::Transfer::Linear).unwrap();
    let (mut rec709, acescg) = (read("rec709.exr"), read("acescg.exr"));
    assert_ne!(rec709, acescg);
    let states = |name: &str| std::fs::read(at(name)).unwrap().windows(14).any(|bytes| bytes == b"chromaticities");
    assert!(states("acescg.exr") && !states("rec709.exr"));
    let mut back = acescg.clone();
    svbrdf_gcn::ColorSpace::AcesCg.convert_image(svbrdf_gcn::ColorSpace::Rec709, &mut back);
    // Lights of (900, 800, 700) in either space are not the same light: compare with the light converted by hand.
    let light = svbrdf_gcn::ColorSpace::AcesCg.convert(svbrdf_gcn::ColorSpace::Rec709, [900.0, 800.0, 700.0]);
    for (value, channel) in rec709.data_mut().iter_mut().zip([0, 1, 2].into_iter().cycle()) {
        *value *= (light[channel] / [900.0, 800.0, 700.0][channel]) as f32;
    }
    for (a, b) in rec709.data().iter().zip(back.data()) {
        assert!((a - b).abs() < 1e-5 * a.abs().max(0.1), "{a} {b}");
    }
    let encoded = render(&at("no.png"), &["--color-space", "acescg"]);
    assert_eq!(encoded.status.code(), Some(2));
    assert!(stderr(&encoded).contains("color_space") && !at("no.png").exists());

    // Photos in sRGB stay what they are; the albedos come out in ACEScg.
    let out = at("fit");
    let capture = samples("tiles");
    let arguments = ["fit", text(&capture), "-o", text(&out), "--views", "0,1", "--size", "16", "--direct-steps", "5"];
    let fit = run(&[&arguments[..], &["--color-space", "acescg", "-q"]].concat());
    assert!(fit.status.success() && stderr(&fit).contains("rec709"), "{}", stderr(&fit));
    let description: Value = serde_json::from_slice(&std::fs::read(out.join("material.json")).unwrap()).unwrap();
    assert_eq!(description["maps"]["diffuse"]["color_space"], "acescg");
    assert!(description["maps"]["normal"].get("color_space").is_none());
}

#[test]
fn colour_profiles_count_unless_they_are_ignored() {
    let folder = tempfile::tempdir().unwrap();
    // Display P3.
    let codes: Vec<u16> = (0..8 * 8).flat_map(|i| [90, 120 + i, 60]).collect();
    let photo = files::png_with(8, 8, 2, 8, &codes, &[(b"cICP", vec![12, 13, 0, 1])]);
    std::fs::write(folder.path().join("photo.png"), photo).unwrap();
    let capture = r#"{"format": "svbrdf-gcn capture", "version": 1, "patch_size": 10, "transfer": "srgb", "light_intensity": [700, 700, 700],
        "photos": [{"file": "photo.png", "camera": [0, 0, 15]}]}"#;
    std::fs::write(folder.path().join("capture.json"), capture).unwrap();
    let fit = |more: &[&str]| {
        let out = folder.path().join("out");
        let arguments = [
            "fit",
            text(folder.path()),
            "-o",
            text(&out),
            "--preset",
            "draft",
            "--method",
            "direct",
            "--direct-steps",
            "1",
            "--json",
        ];
        let report = json(&run(&[&arguments[..], more].concat()));
        report["report"]["warnings"].to_string()
    };
    let converted = fit(&[]);
    assert!(converted.contains("photo.png") && converted.contains("cICP 12, 13"), "{converted}");
    let ignored = fit(&["--ignore-profiles"]);
    assert!(!ignored.contains("cICP"), "{ignored}");
}

#[test]
fn outputs_spare_what_is_not_theirs() {
    let folder = tempfile::tempdir().unwrap();
    let capture = folder.path().join("capture");
    std::fs::create_dir(&capture).unwrap();
    let described = std::fs::read_to_string(samples("lambert/capture.json")).unwrap();
    let mut described: Value = serde_json::from_str(&described).unwrap();
    // Photos of such names, in a folder that the maps are to come to.
    for (photo, name) in described["photos"].as_array_mut().unwrap().iter_mut().zip(["preview.png", "diffuse.png"]) {
        std::fs::copy(samples("lambert").join(photo["file"].as_str().unwrap()), capture.join(name)).unwrap();
        photo["file"] = name.into();
    }
    let write = |name: &str| std::fs::write(capture.join(name), described.to_string()).unwrap();
    let bytes = |name: &str| std::fs::read(capture.join(name)).unwrap();
    let before = [bytes("preview.png"), bytes("diffuse.png")];
    let fit = |description: &Path, more: &[&str]| {
        let arguments = ["fit", text(description), "-o", text(&capture), "--views", "0,1", "--size", "8", "-q"];
        run(&[&arguments[..], more].concat())
    };
    write("capture.json");
    write("other.json");
    // Before a fit, which would need more memory than this.
    let refused = fit(&capture, &["--format", "png16", "--max-memory", "1000"]);
    assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("diffuse.png: this is a photo that this command reads"), "{}", stderr(&refused));
    std::fs::remove_file(capture.join("capture.json")).unwrap();
    let refused = fit(&capture.join("other.json"), &["--max-memory", "1000"]);
    assert!(stderr(&refused).contains("preview.png: this is a photo that this command reads"), "{}", stderr(&refused));
    let refused = fit(&samples("lambert"), &["--max-memory", "1000"]);
    assert!(stderr(&refused).contains("preview.png: svbrdf-gcn did not write this file"), "{}", stderr(&refused));
    assert_eq!([bytes("preview.png"), bytes("diffuse.png")], before);

    // A picture replaces what its user names, but no photo and no map.
    let maps = folder.path().join("maps");
    svbrdf_gcn::Material::load(samples("lambert/truth"))
        .unwrap()
        .save(&maps, &svbrdf_gcn::io::material::SaveOptions::default())
        .unwrap();
    let render = |out: &Path| {
        run(&["render", text(&maps), "--camera", "0,0,9", "--light", "0,0,9", "--size", "8", "-o", text(out)])
    };
    write("capture.json");
    for (out, said) in [
        (capture.join("preview.png"), "a photo of the capture beside it"),
        (maps.join("normal.exr"), "a map that this command reads"),
    ] {
        let before = std::fs::read(&out).unwrap();
        let refused = render(&out);
        assert_eq!(refused.status.code(), Some(2));
        assert!(stderr(&refused).contains(said), "{}", stderr(&refused));
        assert_eq!(std::fs::read(&out).unwrap(), before);
    }
    let mine = folder.path().join("mine.png");
    std::fs::write(&mine, "mine").unwrap();
    assert!(render(&mine).status.success());
    assert!(std::fs::read(&mine).unwrap().starts_with(b"\x89PNG"));

    // A changed map is read, and said to be.
    std::fs::copy(maps.join("specular.exr"), maps.join("diffuse.exr")).unwrap();
    let warned = render(&mine);
    assert!(warned.status.success() && stderr(&warned).contains("diffuse.exr: changed since"), "{}", stderr(&warned));
    let info = json(&run(&["info", text(&maps), "--json"]));
    assert!(info["warnings"][0].as_str().unwrap().contains("diffuse.exr"), "{info}");
}

/// One photo needs no capture: what is assumed is said, and the light is such that the diffuse albedo ends at 0.9.
#[test]
fn one_photo_alone_is_fitted() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let photo = samples("tiles/04.png");
    let fit = |more: &[&str]| {
        let fixed = ["fit", text(&photo), "-o", text(&out), "--size", "48", "--preset", "draft", "--json"];
        run(&[&fixed[..], more].concat())
    };
    let output = fit(&[]);
    let said = stderr(&output);
    assert!(said.contains("04.png: one photo without a capture") && said.contains("50.0 degrees"), "{said}");
    let report = &json(&output)["report"];
    let assumed = &report["assumed"];
    assert_eq!((&assumed["light_is_chosen"], &assumed["field_of_view_is_from_exif"]), (&true.into(), &false.into()));
    let reasons = report["reasons"].as_array().unwrap();
    let reason = reasons.iter().find(|reason| reason["code"] == "assumed").unwrap();
    assert!(reason["text"].as_str().unwrap().contains("straight above at 2.145"), "{reason}");
    let material = svbrdf_gcn::Material::load(&out).unwrap();
    let mut brightest: Vec<f32> =
        material.diffuse_albedo.data().chunks_exact(3).map(|rgb| rgb.iter().copied().fold(0.0, f32::max)).collect();
    brightest.sort_by(f32::total_cmp);
    let percentile = brightest[brightest.len() * 99 / 100];
    assert!((0.8..1.0).contains(&percentile), "{percentile}");

    let output = fit(&["--light-intensity", "30,20,10"]);
    assert!(!stderr(&output).contains("the light is assumed"), "{}", stderr(&output));
    let assumed = &json(&output)["report"]["assumed"];
    assert_eq!(assumed["light_intensity"], serde_json::json!([30.0, 20.0, 10.0]));
    assert_eq!(assumed["light_is_chosen"], false);

    let refused = fit(&["--light-intensity", "1,2"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("one number or three r,g,b"), "{}", stderr(&refused));
}

/// What is given in place of what is wanted is called what it is, with what to do and where that is described.
#[test]
fn what_was_given_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let photos = at("photos");
    std::fs::create_dir(&photos).unwrap();
    for name in ["a.jpg", "b.jpg"] {
        let image = svbrdf_gcn::Image::new(4, 3, 3, vec![0.5; 36]).unwrap();
        svbrdf_gcn::io::write_image(photos.join(name), &image, svbrdf_gcn::Transfer::Srgb).unwrap();
    }
    let (a, b, out) = (photos.join("a.jpg"), photos.join("b.jpg"), at("out"));
    let (a, b, photos, out) = (text(&a), text(&b), text(&photos), text(&out));
    let capture = samples("lambert");
    let (capture, truth) = (text(&capture), samples("lambert/truth"));
    let truth = text(&truth);
    let weights = Path::new(env!("CARGO_MANIFEST_DIR")).join("weights/default.safetensors");
    let view = ["--camera", "0,0,9", "--light", "0,0,9", "-o", out];
    let cases: [(Vec<&str>, i32, &[&str]); 12] = [
        (vec!["info", a], 3, &["a.jpg", "a JPEG image of 4 x 3 pixels", "weights file", "docs/captures.md"]),
        (vec!["info", photos], 3, &["a folder with 2 images", "docs/materials.md"]),
        (vec!["info", capture], 3, &["the folder of a capture", "fit"]),
        (vec!["fit", photos, "-o", out], 3, &["a folder with 2 images and no capture.json", "docs/captures.md"]),
        (vec!["fit", truth, "-o", out], 3, &["the folder of a material", "docs/captures.md"]),
        (vec!["fit", text(&weights), "-o", out], 3, &["a weights file", "docs/captures.md"]),
        (
            vec!["fit", a, b, "-o", out],
            2,
            &[
                "photos: none can be used",
                "a.jpg: 0 of the sheet's 16 tags",
                "b.jpg",
                "svbrdf-gcn sheet",
                "docs/capturing.md",
            ],
        ),
        (vec!["evaluate", truth, a, b], 2, &["capture: expected one", "got 2", "docs/captures.md"]),
        ([&["render", a], &view[..]].concat(), 3, &["a JPEG image", "material.json", "docs/materials.md"]),
        (
            [&["render", truth], &view[..], &["--light-intensity", "-1,1,1"]].concat(),
            2,
            &["light_intensity", "0 or more", "-1"],
        ),
        (vec!["render", truth, "--camera", "0,0,-9", "--light", "0,0,9", "-o", out], 2, &["camera", "-9", "above 0"]),
        (vec!["render", truth, "--camera", "0,0,9", "--light", "1,1,0", "-o", out], 2, &["light", "above 0, got 0"]),
    ];
    for (arguments, code, parts) in cases {
        let output = run(&arguments);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
        assert!(message.starts_with("error: ") && message.trim_end().lines().count() == 1, "{message}");
        for part in parts {
            assert!(message.contains(part), "{arguments:?}: no {part:?} in {message}");
        }
        assert!(!Path::new(out).exists(), "{arguments:?}");
    }
    let picture = at("picture.png");
    let larger =
        run(&["render", truth, "--camera", "0,0,9", "--light", "0,0,9", "--size", "4096", "-o", text(&picture)]);
    assert!(larger.status.success() && stderr(&larger).contains("4096") && stderr(&larger).contains("not enlarged"));
}

/// Names that would steer a terminal are shown escaped, on either stream.
#[cfg(unix)]
#[test]
fn names_do_not_steer_the_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let evil = "evil\u{1b}]0;owned\u{7}\n\u{202e}";
    let capture = folder.path().join("capture");
    std::fs::create_dir(&capture).unwrap();
    for file in std::fs::read_dir(samples("lambert")).unwrap().flatten().filter(|file| file.path().is_file()) {
        std::fs::copy(file.path(), capture.join(file.file_name())).unwrap();
    }
    let json_file = capture.join("capture.json");
    let description: Value = serde_json::from_slice(&std::fs::read(&json_file).unwrap()).unwrap();
    let name = description["photos"][0]["file"].as_str().unwrap();
    std::fs::rename(capture.join(name), capture.join(format!("{evil}{name}"))).unwrap();
    let mut renamed = description.clone();
    renamed["photos"][0]["file"] = format!("{evil}{name}").into();
    std::fs::write(&json_file, renamed.to_string()).unwrap();
    let truth = samples("lambert/truth");
    let out = folder.path().join(evil);
    let evaluate = run(&["evaluate", text(&truth), text(&capture)]);
    assert!(evaluate.status.success(), "{}", stderr(&evaluate));
    let missing = run(&["evaluate", text(&out), text(&capture)]);
    let misused = run(&["evaluate", text(&out), text(&capture), &format!("--{evil}")]);
    let fit = run(&["fit", text(&capture), "-o", text(&out), "--size", "8", "--preset", "draft"]);
    assert!(fit.status.success(), "{}", stderr(&fit));
    assert_eq!((missing.status.code(), misused.status.code()), (Some(3), Some(2)));
    for output in [evaluate, missing, misused, fit] {
        let said = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
        assert!(said.contains("evil\\u{1b}]0;owned\\u{7}\\n\\u{202e}"), "{said:?}");
        assert!(!said.chars().any(|c| c.is_control() && c != '\n' || c == '\u{202e}'), "{said:?}");
    }
}

/// Starts the command line with `arguments`, sends it SIGINT after `milliseconds` if it still runs, and returns its exit code and the seconds it then took.
#[cfg(unix)]
fn interrupted(arguments: &[&str], milliseconds: u64) -> (Option<i32>, f64) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_svbrdf-gcn"))
        .args(arguments)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let started = std::time::Instant::now();
    while started.elapsed().as_millis() < u128::from(milliseconds) && child.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let sent = std::time::Instant::now();
    if child.try_wait().unwrap().is_none() {
        assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    }
    (child.wait().unwrap().code(), sent.elapsed().as_secs_f64())
}

/// Control-C ends the reading of photos while they are decoded, in every command that reads them.
#[cfg(unix)]
#[test]
fn an_interrupt_ends_the_reading_of_photos() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // Many seconds of decoding, a second and a half each, in few bytes.
    let large = svbrdf_gcn::Image::new(6000, 6000, 1, vec![0.5; 36_000_000]).unwrap();
    svbrdf_gcn::io::write_image(at("large.png"), &large, svbrdf_gcn::Transfer::Srgb).unwrap();
    let photo = r#"{"file": "large.png", "camera": [0, 0, 9]}"#;
    let photos = vec![photo; 60].join(", ");
    let capture = format!(
        r#"{{"format": "svbrdf-gcn capture", "version": 1, "patch_size": 1, "transfer": "srgb", "light_intensity": 9, "photos": [{photos}]}}"#
    );
    std::fs::write(at("capture.json"), capture).unwrap();
    let (capture, out, truth) = (at("capture.json"), at("out"), samples("lambert/truth"));
    let (capture, out, truth) = (text(&capture), text(&out), text(&truth));
    for arguments in [vec!["fit", capture, "-o", out, "--size", "16"], vec!["evaluate", truth, capture]] {
        let (code, seconds) = interrupted(&arguments, 500);
        assert_eq!(code, Some(130), "{arguments:?}");
        assert!(seconds < 5.0, "{arguments:?}: {seconds} s");
    }
    assert!(!Path::new(out).exists());
}

/// Control-C during an export leaves nothing, or comes too late and the export is there.
#[cfg(unix)]
#[test]
fn an_interrupt_ends_an_export_or_comes_too_late() {
    const SIDE: usize = 1024;
    let folder = tempfile::tempdir().unwrap();
    let maps = folder.path().join("maps");
    let material = material::noise(SIDE);
    material.save(&maps, &svbrdf_gcn::io::material::SaveOptions::default()).unwrap();
    let mut codes = Vec::new();
    for milliseconds in [100, 200, 400, 800, 600_000] {
        let out = folder.path().join(format!("{milliseconds}/made"));
        let (code, _) = interrupted(&["export", text(&maps), "--to", "gltf", "-o", text(&out)], milliseconds);
        match code {
            // None: ended by the signal, before the program listened to it.
            Some(130) | None => assert!(!out.exists() && !out.parent().unwrap().exists(), "after {milliseconds} ms"),
            Some(0) => assert!(out.join("export.json").is_file() && out.join("material.gltf").is_file()),
            other => panic!("{other:?} after {milliseconds} ms"),
        }
        codes.push(code);
    }
    assert!(codes.contains(&Some(130)) && codes.last() == Some(&Some(0)), "{codes:?}");
}
