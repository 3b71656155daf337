//! Material folders: written, read back, and read in the encodings of the field.

use std::fs;
use std::path::Path;

use crate::{common, files};
use serde_json::{Value, json};
use svbrdf_gcn::io::material::{
    LoadOptions, MATERIAL_JSON, MaterialEncoding, MaterialFormat, SaveOptions, check_folder, read_deviations,
    read_report,
};
use svbrdf_gcn::io::read_image;
use svbrdf_gcn::{Capture, ColorSpace, Deviations, Image, Lobe, Maps, Material, Transfer, Unit};
use tempfile::TempDir;

const SIZE: (usize, usize) = (5, 3);

/// A material with different values everywhere, the darkest albedos among them.
fn material(lobe: Lobe) -> Material {
    let pixels = SIZE.0 * SIZE.1;
    let value = |plane: usize, p: usize| (((plane * 31 + p * 17) % 97) as f32 / 97.0).powi(3);
    let data = (0..lobe.planes()).flat_map(|plane| (0..pixels).map(move |p| value(plane, p))).collect();
    let mut maps = Maps::new(lobe, SIZE.0, SIZE.1, data).unwrap();
    maps.plane_mut(5).fill(0.4);
    Material::from_maps(&maps, 12.5).unwrap()
}

fn images(material: &Material) -> Vec<(&'static str, &Image)> {
    let mut images = vec![
        ("diffuse", &material.diffuse_albedo),
        ("specular", &material.specular_albedo),
        ("roughness", &material.roughness),
        ("normal", &material.normal),
    ];
    images.extend(material.tangent.as_ref().map(|tangent| ("tangent", tangent)));
    images
}

/// The largest difference of two materials' maps, each as a multiple of what is allowed for its map and value.
fn worst(a: &Material, b: &Material, allowed: impl Fn(&str, f32) -> f32) -> f32 {
    let pairs = images(a).into_iter().zip(images(b));
    let ratios = pairs.flat_map(|((name, a), (_, b))| {
        assert_eq!((a.width(), a.height(), a.channels()), (b.width(), b.height(), b.channels()), "{name}");
        a.data().iter().zip(b.data()).map(|(a, b)| (a - b).abs() / allowed(name, *a)).collect::<Vec<_>>()
    });
    ratios.fold(0.0, f32::max)
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn every_format_comes_back() {
    for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
        let material = material(lobe);
        for format in [MaterialFormat::Exr, MaterialFormat::Png16, MaterialFormat::Tiff] {
            let dir = TempDir::new().unwrap();
            let folder = dir.path().join("deep/out");
            material.save(&folder, &SaveOptions::new(format)).unwrap();
            let back = Material::load(&folder).unwrap();
            assert_eq!(back.patch_size, 12.5);
            assert_eq!(back.lobe(), lobe);
            // One code, or half a unit in the last place of a half float; vectors are stored halved and brought to unit length after.
            let ratio = worst(&back, &material, |name, value| match (format, name) {
                (MaterialFormat::Exr, "normal" | "tangent") => 2.0 * 0.75 / 2048.0,
                (MaterialFormat::Exr, _) => value / 2048.0 + 1e-7,
                (MaterialFormat::Png16, "normal" | "tangent") => 3.0 / 65535.0,
                (MaterialFormat::Png16, _) => 1.2 / 65535.0,
                _ => 2e-7,
            });
            assert!(ratio <= 1.0, "{lobe:?} {format:?} {ratio}");
            let extension = match format {
                MaterialFormat::Exr => "exr",
                MaterialFormat::Png16 => "png",
                _ => "tif",
            };
            let mut expected: Vec<String> =
                images(&material).iter().map(|(name, _)| format!("{name}.{extension}")).collect();
            expected.push(MATERIAL_JSON.to_owned());
            expected.sort();
            assert_eq!(names(&folder), expected);
        }
    }
}

#[test]
fn exr_channels_are_named_and_half() {
    let dir = TempDir::new().unwrap();
    material(Lobe::Anisotropic).save(dir.path(), &SaveOptions::default()).unwrap();
    for (name, channels) in
        [("diffuse", "BGR"), ("specular", "BGR"), ("normal", "BGR"), ("tangent", "BGR"), ("roughness", "GR")]
    {
        assert_eq!(exr_channels(&dir.path().join(format!("{name}.exr"))), channels, "{name}");
    }
    material(Lobe::Isotropic).save(dir.path(), &SaveOptions::default()).unwrap();
    assert_eq!(exr_channels(&dir.path().join("roughness.exr")), "Y");
    // File values, not through our own loader: the normal of pixel 0 as (n + 1) / 2.
    let stored = read_image(dir.path().join("normal.exr"), Transfer::Linear).unwrap();
    let normal = &material(Lobe::Isotropic).normal;
    for (stored, n) in stored.data().iter().zip(normal.data()) {
        assert!((stored - (n + 1.0) / 2.0).abs() < 1.0 / 4096.0);
    }
}

/// The names in the channel list of an OpenEXR file, all of which must be half floats (type 1).
fn exr_channels(path: &Path) -> String {
    let bytes = fs::read(path).unwrap();
    let key = b"channels\0chlist\0";
    let start = bytes.windows(key.len()).position(|window| window == key).unwrap() + key.len() + 4;
    let mut names = String::new();
    for entry in bytes[start..].chunks(18).take_while(|entry| entry[0] != 0) {
        names.push(char::from(entry[0]));
        assert_eq!(entry[1..6], [0, 1, 0, 0, 0]);
    }
    names
}

#[test]
fn another_format_replaces_the_maps_and_nothing_else() {
    let dir = TempDir::new().unwrap();
    let anisotropic = material(Lobe::Anisotropic);
    anisotropic.save(dir.path(), &SaveOptions::new(MaterialFormat::Exr)).unwrap();
    for name in ["notes.exr", "preview.png", "specular.tif"] {
        fs::write(dir.path().join(name), b"mine").unwrap();
    }
    // A file of the user's own that the description names is his, too.
    let path = dir.path().join(MATERIAL_JSON);
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace("roughness.exr", "notes.exr")).unwrap();
    material(Lobe::Isotropic).save(dir.path(), &SaveOptions::new(MaterialFormat::Png16)).unwrap();
    let kept = ["notes.exr", "preview.png", "roughness.exr", "specular.tif"];
    let written = ["diffuse.png", "material.json", "normal.png", "roughness.png", "specular.png"];
    let mut expected = [&kept[..], &written[..]].concat();
    expected.sort_unstable();
    assert_eq!(names(dir.path()), expected);
}

#[test]
fn albedos_in_acescg_come_back() {
    let before = material(Lobe::Isotropic);
    for format in [MaterialFormat::Exr, MaterialFormat::Png16, MaterialFormat::Tiff] {
        let dir = TempDir::new().unwrap();
        before.save(dir.path(), &SaveOptions::new(format).color_space(ColorSpace::AcesCg)).unwrap();
        let value: Value = serde_json::from_slice(&fs::read(dir.path().join(MATERIAL_JSON)).unwrap()).unwrap();
        let extension = if format == MaterialFormat::Png16 {
            "png"
        } else if format == MaterialFormat::Exr {
            "exr"
        } else {
            "tif"
        };
        let expected = json!({"file": format!("diffuse.{extension}"), "transfer": "linear", "color_space": "acescg"});
        assert_eq!(value["maps"]["diffuse"], expected);
        // The file holds the converted values.
        let stored = read_image(dir.path().join(format!("diffuse.{extension}")), Transfer::Linear).unwrap();
        let pixel: [f64; 3] = std::array::from_fn(|c| before.diffuse_albedo.data()[c].into());
        for (stored, expected) in stored.data().iter().zip(ColorSpace::Rec709.convert(ColorSpace::AcesCg, pixel)) {
            assert!((f64::from(*stored) - expected).abs() < 3e-4, "{stored} {expected}");
        }
        // Rounding, times the largest absolute row sum of the matrix back, 2.41.
        let ratio = worst(&Material::load(dir.path()).unwrap(), &before, |name, _| match (format, name) {
            (MaterialFormat::Exr, _) => 2.5 / 2048.0,
            (MaterialFormat::Png16, "normal") => 3.0 / 65535.0,
            (MaterialFormat::Png16, _) => 2.5 * 0.6 / 65535.0,
            _ => 2e-6,
        });
        assert!(ratio <= 1.0, "{format:?} {ratio}");
    }
}

#[test]
fn json_says_what_is_there() {
    let dir = TempDir::new().unwrap();
    let report = json!({"stages": [{"stage": "direct", "best_loss": 1.25}], "warnings": ["none"]});
    let options = SaveOptions::new(MaterialFormat::Png16).report(report.clone());
    let material = Material { unit: Some(Unit::new("cm")), ..material(Lobe::Isotropic) };
    material.save(dir.path(), &options).unwrap();
    let text = fs::read_to_string(dir.path().join(MATERIAL_JSON)).unwrap();
    let value: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(value["format"], "svbrdf-gcn material");
    assert_eq!(value["version"], 1);
    assert_eq!(value["written_by"], concat!("svbrdf-gcn ", env!("CARGO_PKG_VERSION")));
    assert_eq!((value["width"].as_u64(), value["height"].as_u64()), (Some(5), Some(3)));
    assert_eq!(value["patch_size"], 12.5);
    assert_eq!(value["unit"], "cm");
    assert_eq!(value["lobe"], "isotropic");
    assert_eq!(value["maps"]["diffuse"], json!({"file": "diffuse.png", "transfer": "srgb", "color_space": "rec709"}));
    assert_eq!(value["maps"]["roughness"], json!({"file": "roughness.png", "transfer": "linear"}));
    assert!(value["maps"].get("tangent").is_none());
    assert!(value["conventions"]["normal"].as_str().unwrap().contains("(n + 1) / 2"));
    assert_eq!(value["report"], report);
    assert_eq!(read_report(dir.path()).unwrap(), Some(report));
    let back = Material::load(dir.path()).unwrap();
    assert_eq!((back.patch_size, &back.unit), (12.5, &material.unit));
    // What is made of a material has its unit, what is saved again keeps it.
    back.resized(2).unwrap().save(dir.path().join("small"), &SaveOptions::default()).unwrap();
    assert_eq!(Material::load(dir.path().join("small")).unwrap().unit, material.unit);
}

#[test]
fn deviations_lie_beside_the_maps() {
    let grey = |value: f32| Image::new(5, 3, 1, vec![value; 15]).unwrap();
    let deviations = Deviations {
        diffuse_albedo: grey(0.125),
        specular_albedo: grey(0.0625),
        roughness: grey(0.25),
        normal: grey(0.5),
    };
    let dir = TempDir::new().unwrap();
    let (path, material) = (dir.path(), material(Lobe::Isotropic));
    for format in [MaterialFormat::Tiff, MaterialFormat::Exr] {
        material.save(path, &SaveOptions::new(format).deviations(Some(deviations.clone()))).unwrap();
        assert_eq!(read_deviations(path).unwrap().as_ref(), Some(&deviations));
        assert_eq!(names(path).len(), 9, "those of the other format are gone: {:?}", names(path));
    }
    fs::rename(path.join("roughness.exr"), path.join("kept.exr")).unwrap();
    fs::copy(path.join("diffuse.exr"), path.join("roughness_deviation.exr")).unwrap();
    assert!(read_deviations(path).unwrap_err().to_string().contains("roughness_deviation.exr"));
    fs::remove_file(path.join("kept.exr")).unwrap();
    material.save(path, &SaveOptions::default()).unwrap();
    assert_eq!(read_deviations(path).unwrap(), None);
    assert_eq!(names(path).len(), 5, "{:?}", names(path));

    let small = Deviations { normal: Image::new(3, 3, 1, vec![0.5; 9]).unwrap(), ..deviations };
    let message = material.save(path, &SaveOptions::default().deviations(Some(small))).unwrap_err().to_string();
    assert!(message.contains("normal_deviation"), "{message}");
}

#[test]
fn a_failed_save_leaves_the_folder_as_it_was() {
    let dir = TempDir::new().unwrap();
    let good = material(Lobe::Isotropic);
    good.save(dir.path(), &SaveOptions::default()).unwrap();
    let before: Vec<_> = names(dir.path()).iter().map(|name| fs::read(dir.path().join(name)).unwrap()).collect();

    let mut bad = good.clone();
    bad.normal.data_mut()[4] = f32::NAN;
    assert!(bad.save(dir.path(), &SaveOptions::default()).unwrap_err().to_string().contains("normal"));
    let mut small = good.clone();
    small.roughness = Image::new(2, 2, 1, vec![0.5; 4]).unwrap();
    assert!(small.save(dir.path(), &SaveOptions::default()).unwrap_err().to_string().contains("roughness"));
    let after: Vec<_> = names(dir.path()).iter().map(|name| fs::read(dir.path().join(name)).unwrap()).collect();
    assert_eq!(before, after);

    let file = dir.path().join("file");
    fs::write(&file, b"").unwrap();
    assert!(good.save(&file, &SaveOptions::default()).unwrap_err().to_string().contains("file"));
}

#[test]
fn what_others_wrote_is_not_replaced() {
    let material = material(Lobe::Isotropic);
    let picture = Image::new(2, 2, 3, vec![0.5; 12]).unwrap();
    for (name, format) in [
        ("diffuse.png", MaterialFormat::Png16),
        ("normal.exr", MaterialFormat::Exr),
        ("preview.png", MaterialFormat::Exr),
        ("material.json", MaterialFormat::Tiff),
    ] {
        let options = SaveOptions::new(format).preview(picture.clone());
        let dir = TempDir::new().unwrap();
        let path = dir.path().join(name);
        fs::write(&path, b"mine").unwrap();
        for message in [
            material.save(dir.path(), &options).unwrap_err().to_string(),
            check_folder(dir.path(), format).unwrap_err().to_string(),
        ] {
            assert!(message.contains(name) && message.contains("did not write"), "{message}");
        }
        assert_eq!(fs::read(&path).unwrap(), b"mine");
        assert_eq!(names(dir.path()), [name]);
        fs::remove_file(&path).unwrap();
        // What it wrote itself is, also when nothing but the images is left.
        material.save(dir.path(), &options).unwrap();
        material.save(dir.path(), &options).unwrap();
        fs::remove_file(dir.path().join(MATERIAL_JSON)).unwrap();
        check_folder(dir.path(), format).unwrap();
        material.save(dir.path(), &options).unwrap();
        assert_eq!(names(dir.path()).len(), 6);
        // A picture of the old maps does not outlive them.
        material.save(dir.path(), &SaveOptions::new(format)).unwrap();
        assert_eq!(names(dir.path()).len(), 5);
    }
    // A photo that a capture names stays, whoever wrote it.
    let dir = TempDir::new().unwrap();
    material.save(dir.path(), &SaveOptions::new(MaterialFormat::Png16)).unwrap();
    fs::remove_file(dir.path().join(MATERIAL_JSON)).unwrap();
    let capture = json!({"format": "svbrdf-gcn capture", "version": 1, "photos": [{"file": "diffuse.png"}]});
    fs::write(dir.path().join("capture.json"), capture.to_string()).unwrap();
    let message = material.save(dir.path(), &SaveOptions::new(MaterialFormat::Png16)).unwrap_err().to_string();
    assert!(message.contains("diffuse.png") && message.contains("capture.json"), "{message}");
}

#[test]
fn a_map_that_was_changed_is_read_with_a_warning() {
    let dir = TempDir::new().unwrap();
    let before = material(Lobe::Isotropic);
    before.save(dir.path(), &SaveOptions::new(MaterialFormat::Tiff)).unwrap();
    assert!(Material::load(dir.path()).unwrap().warnings.is_empty());
    let other = Material { roughness: Image::new(5, 3, 1, vec![0.5; 15]).unwrap(), ..before };
    let elsewhere = dir.path().join("other");
    other.save(&elsewhere, &SaveOptions::new(MaterialFormat::Tiff)).unwrap();
    fs::copy(elsewhere.join("roughness.tif"), dir.path().join("roughness.tif")).unwrap();
    let loaded = Material::load(dir.path()).unwrap();
    assert_eq!(loaded.roughness, other.roughness);
    assert_eq!(loaded.warnings.len(), 1, "{:?}", loaded.warnings);
    assert!(loaded.warnings[0].contains("roughness.tif") && loaded.warnings[0].contains("changed since"));
    assert_eq!(loaded.resized(2).unwrap().warnings, loaded.warnings);
    // Saved again it is as its description says; a description without sizes and sums says nothing.
    loaded.save(dir.path(), &SaveOptions::new(MaterialFormat::Tiff)).unwrap();
    assert!(Material::load(dir.path()).unwrap().warnings.is_empty());
    let path = dir.path().join(MATERIAL_JSON);
    let mut value: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    let sum = &value["files"]["roughness.tif"];
    let bytes = fs::read(dir.path().join("roughness.tif")).unwrap();
    assert_eq!(sum["bytes"], bytes.len());
    assert_eq!(sum["crc32"], format!("{:08x}", crc32(&bytes)));
    value.as_object_mut().unwrap().remove("files");
    fs::write(&path, value.to_string()).unwrap();
    fs::copy(elsewhere.join("roughness.tif"), dir.path().join("specular.tif")).unwrap();
    assert!(Material::load(dir.path()).unwrap().warnings.is_empty());
}

/// CRC-32 bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 };
    !bytes.iter().fold(!0, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), |crc, _| step(crc)))
}

/// A folder that may not be written keeps what a save was killed over; a load reads the new files by the record.
#[cfg(unix)]
#[test]
fn a_load_that_may_not_write_reads_the_right_files() {
    use std::os::unix::fs::PermissionsExt;
    let dir = TempDir::new().unwrap();
    let (folder, other) = (dir.path().join("a"), dir.path().join("b"));
    let old = material(Lobe::Isotropic);
    let new =
        Material { roughness: Image::new(5, 3, 1, vec![0.5; 15]).unwrap(), unit: Some(Unit::new("m")), ..old.clone() };
    old.save(&folder, &SaveOptions::new(MaterialFormat::Tiff)).unwrap();
    new.save(&other, &SaveOptions::new(MaterialFormat::Tiff)).unwrap();
    let mut replace = serde_json::Map::new();
    for (i, name) in names(&other).into_iter().enumerate() {
        let temporary = format!(".svbrdf-gcn-{i}.tmp");
        fs::copy(other.join(&name), folder.join(if i < 2 { &name } else { &temporary })).unwrap();
        replace.insert(name, temporary.into());
    }
    let record = json!({"format": "svbrdf-gcn save", "version": 1, "replace": replace, "remove": []});
    fs::write(folder.join(".svbrdf-gcn-save.json"), record.to_string()).unwrap();
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o555)).unwrap();
    let expected = Material::load(&other).unwrap();
    assert_eq!(Material::load(&folder).unwrap(), expected);
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o755)).unwrap();
    assert_eq!(Material::load(&folder).unwrap(), expected);
    assert_eq!(names(&folder), names(&other));
}

#[test]
fn values_out_of_range_by_rounding_are_limited_when_written_and_others_refused() {
    let dir = TempDir::new().unwrap();
    let mut material = material(Lobe::Isotropic);
    material.diffuse_albedo.data_mut()[..2].copy_from_slice(&[1.5, -0.5]);
    let refused = material.save(dir.path(), &SaveOptions::default()).unwrap_err().to_string();
    assert!(refused.contains("diffuse_albedo") && names(dir.path()).is_empty(), "{refused}");
    material.diffuse_albedo.data_mut()[..2].copy_from_slice(&[1.0009, -0.0009]);
    for value in &mut material.normal.data_mut()[..3] {
        *value *= 1.09;
    }
    material.save(dir.path(), &SaveOptions::new(MaterialFormat::Tiff)).unwrap();
    let back = Material::load(dir.path()).unwrap();
    assert_eq!(back.diffuse_albedo.data()[..2], [1.0, 0.0]);
    let length2: f32 = back.normal.data()[..3].iter().map(|v| v * v).sum();
    assert!((length2 - 1.0).abs() < 1e-6);
}

#[test]
fn broken_folders() {
    let fails = |change: &dyn Fn(&Path), parts: &[&str]| {
        let dir = TempDir::new().unwrap();
        material(Lobe::Isotropic).save(dir.path(), &SaveOptions::default()).unwrap();
        change(dir.path());
        let message = Material::load(dir.path()).unwrap_err().to_string();
        for part in parts {
            assert!(message.contains(part), "{part:?} is missing in: {message}");
        }
    };
    let edit = |from: &'static str, to: &'static str| {
        move |dir: &Path| {
            let path = dir.join(MATERIAL_JSON);
            let text = fs::read_to_string(&path).unwrap();
            assert!(text.contains(from), "{text}");
            fs::write(path, text.replacen(from, to, 1)).unwrap();
        }
    };
    fails(&|dir| fs::remove_file(dir.join("normal.exr")).unwrap(), &["normal.exr", "No such file"]);
    fails(&|dir| fs::write(dir.join("normal.exr"), b"").unwrap(), &["normal.exr", "empty"]);
    fails(
        &|dir| fs::remove_file(dir.join(MATERIAL_JSON)).unwrap(),
        &["material.json", "deschaintre2018", "materialgan"],
    );
    fails(&|dir| fs::write(dir.join(MATERIAL_JSON), "{").unwrap(), &["material.json", "EOF"]);
    fails(&edit("\"version\": 1", "\"version\": 9"), &["material.json", "version 9", "version 1"]);
    fails(&edit("svbrdf-gcn material", "other"), &["material.json", "other"]);
    fails(&edit("12.5", "-1.0"), &["patch_size", "-1"]);
    fails(&edit("isotropic", "anisotropic"), &["material.json", "tangent"]);
    fails(&edit("isotropic", "layered"), &["material.json", "layered"]);
    fails(&edit("\"normal.exr\"", "\"roughness.exr\""), &["roughness.exr", "three channels"]);
    let bright = files::exr([0, 0, 5, 3], [0, 0, 5, 3], &[("Y", &[1.5; 15])]);
    fails(&|dir| fs::write(dir.join("specular.exr"), &bright).unwrap(), &["specular.exr", "0 to 1", "1.5"]);
    let other_size = files::exr([0, 0, 5, 2], [0, 0, 5, 2], &[("Y", &[0.5; 10])]);
    fails(&|dir| fs::write(dir.join("specular.exr"), &other_size).unwrap(), &["specular", "(3, 5, 3)", "(2, 5, 3)"]);
}

fn save_png(folder: &Path, name: &str, kind: u8, size: (u32, u32), samples: &[u16]) {
    fs::write(folder.join(name), files::png(size.0, size.1, kind, 8, samples)).unwrap();
}

#[test]
fn plain_folders_in_stated_encodings() {
    let dir = TempDir::new().unwrap();
    save_png(dir.path(), "dif.png", 2, (1, 1), &[128, 64, 32]);
    save_png(dir.path(), "Specular.PNG", 0, (1, 1), &[51]);
    save_png(dir.path(), "rgh.png", 2, (1, 1), &[100, 100, 100]);
    save_png(dir.path(), "nom.png", 2, (1, 1), &[128, 255, 200]);
    save_png(dir.path(), "tex.png", 2, (1, 1), &[0, 0, 0]);
    let code = |code: u8| f32::from(code) / 255.0;
    let gamma = |v: u8| code(v).powf(2.2);
    for encoding in MaterialEncoding::ALL {
        assert_eq!(MaterialEncoding::from_name(encoding.name()), Some(encoding));
        let options = LoadOptions::new().encoding(encoding).patch_size(2.0);
        let material = Material::load_with(dir.path(), &options).unwrap();
        let (linear_diffuse, linear_rest) = match encoding {
            MaterialEncoding::Deschaintre2018 => (true, true),
            MaterialEncoding::DeepInverseRendering => (false, true),
            _ => (false, false),
        };
        let expected = |value: u8, linear: bool| if linear { code(value) } else { gamma(value) };
        assert!((material.diffuse_albedo.data()[1] - expected(64, linear_diffuse)).abs() < 1e-6, "{encoding:?}");
        assert!((material.specular_albedo.data()[2] - expected(51, linear_rest)).abs() < 1e-6, "{encoding:?}");
        assert!((material.roughness.data()[0] - expected(100, linear_rest)).abs() < 1e-6, "{encoding:?}");
        let n = [128, 255, 200].map(|v| 2.0 * code(v) - 1.0);
        let length = n.iter().map(|v| v * v).sum::<f32>().sqrt();
        for (got, n) in material.normal.data().iter().zip(n) {
            assert!((got - n / length).abs() < 1e-6);
        }
        assert_eq!(material.patch_size, 2.0);
    }
    let options = LoadOptions::new().encoding(MaterialEncoding::MaterialGan);
    save_png(dir.path(), "roughness.png", 0, (1, 1), &[1]);
    let message = Material::load_with(dir.path(), &options).unwrap_err().to_string();
    assert!(message.contains("rgh.png") && message.contains("roughness.png"), "{message}");
    fs::remove_file(dir.path().join("roughness.png")).unwrap();
    save_png(dir.path(), "rgh.png", 0, (2, 1), &[1, 2]);
    let message = Material::load_with(dir.path(), &options).unwrap_err().to_string();
    assert!(message.contains("roughness") && message.contains('2'), "{message}");
    fs::remove_file(dir.path().join("rgh.png")).unwrap();
    let message = Material::load_with(dir.path(), &options).unwrap_err().to_string();
    assert!(message.contains("roughness or rgh"), "{message}");
}

#[test]
fn strips() {
    let dir = TempDir::new().unwrap();
    // Tiles of 1 x 1: photo, A, B, C, D.
    let tiles: Vec<u16> = [[9, 9, 9], [128, 128, 255], [40, 50, 60], [70, 70, 70], [10, 20, 30]].concat();
    save_png(dir.path(), "five.png", 2, (5, 1), &tiles);
    save_png(dir.path(), "four.png", 2, (4, 1), &tiles[3..]);
    let load =
        |name: &str, encoding| Material::load_with(dir.path().join(name), &LoadOptions::new().encoding(encoding));
    let code = |code: u8| f32::from(code) / 255.0;
    for name in ["five.png", "four.png"] {
        let material = load(name, MaterialEncoding::Deschaintre2018).unwrap();
        assert_eq!(material.diffuse_albedo.data(), [40, 50, 60].map(code));
        assert!((material.roughness.data()[0] - code(70)).abs() < 1e-7);
        assert_eq!(material.specular_albedo.data(), [10, 20, 30].map(code));
        assert!(material.normal.data()[2] > 0.999);
    }
    let material = load("four.png", MaterialEncoding::DeepInverseRendering).unwrap();
    assert!((material.diffuse_albedo.data()[0] - code(40).powf(2.2)).abs() < 1e-7);
    assert_eq!(material.specular_albedo.data(), [10, 20, 30].map(code));
    let swapped: Vec<u16> = [&tiles[6..9], &tiles[3..6], &tiles[9..]].concat();
    save_png(dir.path(), "gan.png", 2, (4, 1), &swapped);
    let gan = load("gan.png", MaterialEncoding::MaterialGan).unwrap();
    assert_eq!(gan.diffuse_albedo, material.diffuse_albedo);
    assert_eq!(gan.normal, material.normal);
    assert!((gan.specular_albedo.data()[1] - code(20).powf(2.2)).abs() < 1e-7);
    for (name, encoding, part) in [
        ("five.png", MaterialEncoding::MaterialGan, "4 x 1"),
        ("four.png", MaterialEncoding::DiffRenderer, "svbrdf-diff-renderer"),
        ("none.png", MaterialEncoding::MaterialGan, "none.png"),
    ] {
        let message = load(name, encoding).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn resized() {
    let material = material(Lobe::Anisotropic);
    assert_eq!(material.resized(5).unwrap(), material.resized(99).unwrap());
    let small = material.resized(2).unwrap();
    assert_eq!((small.width(), small.height()), (2, 1));
    let mean = |image: &Image| image.data().iter().sum::<f32>() / image.data().len() as f32;
    assert!((mean(&small.diffuse_albedo) - mean(&material.diffuse_albedo)).abs() < 1e-6);
    for n in small.normal.data().chunks(3) {
        assert!((n.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-6);
    }
    assert!(material.resized(0).is_err());
}

#[test]
fn ground_truth_maps_open() {
    let Some(folder) = common::shared("maps") else { return };
    let options = LoadOptions::new().encoding(MaterialEncoding::Deschaintre2018);
    let mut count = 0;
    for entry in fs::read_dir(folder).unwrap() {
        let material = Material::load_with(entry.unwrap().path(), &options).unwrap();
        assert_eq!((material.width(), material.height()), (256, 256));
        // Normals look out of the surface nearly everywhere, whatever the map: the encoding was read right.
        let up = material.normal.data().chunks(3).filter(|n| n[2] > 0.0).count();
        assert!(up > 65_000, "{up}");
        count += 1;
    }
    assert_eq!(count, 12);
}

/// What is written in ACEScg says so: as a photo it has the same colours.
#[test]
fn openexr_files_in_acescg_state_their_chromaticities() {
    let dir = TempDir::new().unwrap();
    let material = material(Lobe::Isotropic);
    for space in [ColorSpace::AcesCg, ColorSpace::Rec709] {
        let folder = dir.path().join(space.name());
        material.save(&folder, &SaveOptions::new(MaterialFormat::Exr).color_space(space)).unwrap();
        for (name, image) in images(&material) {
            let photos = json!([{"file": format!("{name}.exr"), "camera": [0, 0, 1]}]);
            let capture = json!({"format": "svbrdf-gcn capture", "version": 1, "patch_size": 1, "transfer": "linear",
                "light_intensity": [1, 1, 1], "photos": photos});
            fs::write(folder.join("capture.json"), capture.to_string()).unwrap();
            let photo = Capture::open(&folder).unwrap();
            // Numbers are no colours and state nothing.
            let is_color = ["diffuse", "specular"].contains(&name);
            let warnings = usize::from(is_color && space == ColorSpace::AcesCg);
            assert_eq!(photo.warnings().len(), warnings, "{name} {:?}", photo.warnings());
            if is_color {
                for (got, expected) in photo.photos()[0].image.data().iter().zip(image.data()) {
                    assert!((got - expected).abs() < 2e-3, "{name} in {}: {got} instead of {expected}", space.name());
                }
            }
        }
    }
}
