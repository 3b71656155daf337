//! Exports: files, their documents, and what they say was lost.

use std::fs;
use std::path::Path;

use serde_json::Value;
use svbrdf_gcn::export::principled::Principled;
use svbrdf_gcn::io::material::{MaterialFormat, SaveOptions};
use svbrdf_gcn::io::read_image;
use svbrdf_gcn::{Error, ExportOptions, ExportTarget, Image, Lobe, Maps, Material, NormalConvention, Transfer};
use tempfile::TempDir;

const SIZE: (usize, usize) = (5, 4);

/// A material with different values everywhere; plain dielectrics in the upper half, metals in the lower.
fn material(lobe: Lobe) -> Material {
    let pixels = SIZE.0 * SIZE.1;
    let value = |plane: usize, p: usize| 0.1 + 0.8 * ((plane * 31 + p * 17) % 97) as f32 / 97.0;
    let data = (0..lobe.planes()).flat_map(|plane| (0..pixels).map(move |p| value(plane, p))).collect();
    let mut maps = Maps::new(lobe, SIZE.0, SIZE.1, data).unwrap();
    maps.plane_mut(5).fill(2.0);
    for channel in 0..3 {
        maps.plane_mut(channel)[pixels / 2..].fill(0.0);
        maps.plane_mut(lobe.specular_plane() + channel)[..pixels / 2].fill(0.05);
    }
    Material::from_maps(&maps, 12.5).unwrap()
}

fn export(lobe: Lobe, options: &ExportOptions) -> (TempDir, Value) {
    let dir = TempDir::new().unwrap();
    let report = material(lobe).export(dir.path().join("out"), options).unwrap();
    let sidecar: Value = json(&dir.path().join("out/export.json"));
    // As text and back: the parser may round the last bit of a number.
    let expected: Value = serde_json::from_str(&serde_json::to_string(&report).unwrap()).unwrap();
    for (key, value) in expected.as_object().unwrap() {
        assert_eq!(&sidecar[key], value, "{key}");
    }
    let mut listed: Vec<String> = report.files.iter().map(|file| file.file.clone()).collect();
    listed.push("export.json".to_owned());
    listed.sort();
    let mut found: Vec<String> = fs::read_dir(dir.path().join("out"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    found.sort();
    assert_eq!(found, listed);
    (dir, sidecar)
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

/// The PNG header's bit depth and the pixels as they are stored.
fn stored(dir: &TempDir, file: &str) -> (u8, Image) {
    let path = dir.path().join("out").join(file);
    (fs::read(&path).unwrap()[24], read_image(&path, Transfer::Linear).unwrap())
}

fn assert_close(got: &[f32], expected: impl Iterator<Item = f32>, tolerance: f32) {
    let expected: Vec<f32> = expected.collect();
    assert_eq!(got.len(), expected.len());
    for (got, expected) in got.iter().zip(expected) {
        assert!((got - expected).abs() <= tolerance, "{got} {expected}");
    }
}

#[test]
fn every_file_is_described_as_it_is() {
    for target in ExportTarget::ALL {
        for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
            let (dir, sidecar) = export(lobe, &ExportOptions::new(target));
            assert_eq!(sidecar["format"], "svbrdf-gcn export");
            assert_eq!(sidecar["target"], target.name());
            assert_eq!(sidecar["patch_size"], 12.5);
            for file in sidecar["files"].as_array().unwrap() {
                let name = file["file"].as_str().unwrap();
                assert_eq!(name.ends_with(".png"), file["bits"].is_u64(), "{name}");
                if name.ends_with(".png") {
                    let (bits, image) = stored(&dir, name);
                    assert_eq!(u64::from(bits), file["bits"].as_u64().unwrap(), "{name}");
                    assert_eq!((image.width(), image.height()), SIZE, "{name}");
                    assert!(["srgb", "data"].contains(&file["color_space"].as_str().unwrap()));
                }
            }
        }
    }
}

#[test]
fn principled_files_hold_the_maps() {
    let (dir, sidecar) = export(Lobe::Isotropic, &ExportOptions::new(ExportTarget::Principled).level(false));
    let maps = Principled::from_material(&material(Lobe::Isotropic)).unwrap();
    assert!((sidecar["ior"].as_f64().unwrap() - maps.ior).abs() < 1e-12);
    let step = 0.51 / 65535.0;
    let encoded = |image: &Image| image.data().iter().map(|&v| Transfer::Srgb.encode(v)).collect::<Vec<_>>();
    for (file, image) in [("base_color.png", &maps.base_color), ("specular_tint.png", &maps.specular_tint)] {
        assert_close(stored(&dir, file).1.data(), encoded(image).into_iter(), step);
    }
    for (file, image) in [
        ("metallic.png", &maps.metallic),
        ("roughness.png", &maps.roughness),
        ("specular_level.png", &maps.specular_level),
    ] {
        assert_close(stored(&dir, file).1.data(), image.data().iter().copied(), step);
    }
    assert_close(stored(&dir, "normal.png").1.data(), maps.normal.data().iter().map(|v| (v + 1.0) / 2.0), step);
}

#[test]
fn the_tilt_of_the_surface_is_taken_out() {
    let material = material(Lobe::Isotropic);
    let tilt = material.tilt();
    assert!(tilt.iter().all(|slope| *slope > 0.1), "{tilt:?}");
    let options = ExportOptions::new(ExportTarget::Principled);
    let (dir, sidecar) = export(Lobe::Isotropic, &options);
    let level = material.leveled().unwrap();
    assert_close(
        stored(&dir, "normal.png").1.data(),
        level.normal.data().iter().map(|v| (v + 1.0) / 2.0),
        0.51 / 65535.0,
    );
    for (axis, slope) in tilt.iter().enumerate() {
        assert!((sidecar["tilt_removed"][axis].as_f64().unwrap() - slope).abs() < 1e-12);
    }
    assert!(export(Lobe::Isotropic, &options.level(false)).1["tilt_removed"].is_null());
}

#[test]
fn unreal_packs_channels_and_turns_green_down() {
    let material = material(Lobe::Isotropic);
    let (dir, sidecar) = export(Lobe::Isotropic, &ExportOptions::new(ExportTarget::Unreal).name("Wood_2").level(false));
    assert_eq!(sidecar["normals"], "directx");
    let (bits, orm) = stored(&dir, "T_Wood_2_ORM.png");
    assert_eq!(bits, 8);
    for (p, pixel) in orm.data().chunks(3).enumerate() {
        assert_eq!(pixel[0], 1.0);
        assert!((pixel[1] - material.roughness.data()[p]).abs() < 0.51 / 255.0);
        // The upper half is dielectric, the lower metal.
        assert_eq!(pixel[2], if p < SIZE.0 * SIZE.1 / 2 { 0.0 } else { 1.0 });
    }
    let specular = stored(&dir, "T_Wood_2_Specular.png").1;
    assert!((specular.data()[0] - 0.05 / 0.08).abs() < 0.51 / 255.0);
    let flipped = |up: f32| {
        let normals = material.normal.data().chunks(3);
        normals.flat_map(|n| [n[0], up * n[1], n[2]].map(|v| (v + 1.0) / 2.0)).collect::<Vec<_>>().into_iter()
    };
    assert_close(stored(&dir, "T_Wood_2_Normal.png").1.data(), flipped(-1.0), 0.51 / 65535.0);
    let options =
        ExportOptions::new(ExportTarget::Unreal).name("Wood_2").normals(NormalConvention::OpenGl).level(false);
    let (dir, _) = export(Lobe::Isotropic, &options);
    assert_close(stored(&dir, "T_Wood_2_Normal.png").1.data(), flipped(1.0), 0.51 / 65535.0);
}

/// The rules of the glTF 2.0 schema that a document like ours can break.
#[test]
fn gltf_refers_to_what_is_there() {
    for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
        let (dir, sidecar) = export(lobe, &ExportOptions::new(ExportTarget::Gltf));
        let folder = dir.path().join("out");
        let gltf = json(&folder.join("material.gltf"));
        assert_eq!(gltf["asset"]["version"], "2.0");
        let count = |key: &str| gltf[key].as_array().unwrap().len() as u64;
        let bin = fs::read(folder.join(gltf["buffers"][0]["uri"].as_str().unwrap())).unwrap();
        assert_eq!(gltf["buffers"][0]["byteLength"], bin.len());
        for image in gltf["images"].as_array().unwrap() {
            assert!(folder.join(image["uri"].as_str().unwrap()).is_file());
        }
        for texture in gltf["textures"].as_array().unwrap() {
            assert!(texture["source"].as_u64().unwrap() < count("images"));
        }
        for accessor in gltf["accessors"].as_array().unwrap() {
            let view = &gltf["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
            let components = match accessor["type"].as_str().unwrap() {
                "SCALAR" => 1,
                "VEC2" => 2,
                "VEC3" => 3,
                _ => 4,
            };
            let bytes = if accessor["componentType"] == 5126 { 4 } else { 2 };
            let offset = view["byteOffset"].as_u64().unwrap();
            let length = components * bytes * accessor["count"].as_u64().unwrap();
            assert_eq!(view["byteLength"], length);
            assert!(offset.is_multiple_of(4) && offset + length <= bin.len() as u64);
        }
        let extensions = gltf["materials"][0]["extensions"].as_object().unwrap();
        let used: Vec<&str> = gltf["extensionsUsed"].as_array().unwrap().iter().map(|e| e.as_str().unwrap()).collect();
        assert_eq!(extensions.keys().collect::<Vec<_>>(), used);
        assert_eq!(extensions.contains_key("KHR_materials_anisotropy"), lobe == Lobe::Anisotropic);
        let mut slots = vec![
            &gltf["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"],
            &gltf["materials"][0]["pbrMetallicRoughness"]["metallicRoughnessTexture"],
            &gltf["materials"][0]["normalTexture"],
            &extensions["KHR_materials_specular"]["specularColorTexture"],
        ];
        slots.extend(extensions.get("KHR_materials_anisotropy").map(|e| &e["anisotropyTexture"]));
        let mut indices: Vec<u64> = slots.iter().map(|slot| slot["index"].as_u64().unwrap()).collect();
        indices.sort_unstable();
        assert_eq!(indices, (0..count("textures")).collect::<Vec<_>>());
        // The normal of the first texture row is the plane's upper edge: position +y has texture v = 0.
        let float = |at: usize| f32::from_le_bytes(bin[4 * at..4 * at + 4].try_into().unwrap());
        assert!(float(1) > 0.0 && float(12 + 12 + 16 + 1) == 0.0);
        // Plain dielectrics and metals are exact with the extension; without it the dielectrics reflect 0.04 instead of 0.05.
        assert!(sidecar["loss"]["specular"]["max"].as_f64().unwrap() < 1e-6);
        let without = sidecar["loss_without_extensions"]["specular"]["max"].as_f64().unwrap();
        assert!((without - 0.01).abs() < 1e-6, "{without}");
    }
}

#[test]
fn anisotropic_roughness_comes_back_from_every_target() {
    let material = material(Lobe::Anisotropic);
    let alphas: Vec<(f32, f32)> =
        material.roughness.data().chunks(2).map(|r| (r[0].max(r[1]).powi(2), r[0].min(r[1]).powi(2))).collect();
    let check = |got: Vec<(f32, f32)>, tolerance: f32| {
        assert_eq!(got.len(), alphas.len());
        for (got, expected) in got.iter().zip(&alphas) {
            assert!(
                (got.0 - expected.0).abs() < tolerance && (got.1 - expected.1).abs() < tolerance,
                "{got:?} {expected:?}"
            );
        }
    };
    let scalars = |image: &Image, channel: usize| -> Vec<f32> {
        image.data().chunks(image.channels()).map(|pixel| pixel[channel]).collect()
    };
    let pair = |a: Vec<f32>, b: Vec<f32>, alphas: &dyn Fn(f32, f32) -> (f32, f32)| {
        a.into_iter().zip(b).map(|(a, b)| alphas(a, b)).collect::<Vec<_>>()
    };

    let (dir, _) = export(Lobe::Anisotropic, &ExportOptions::new(ExportTarget::MaterialX));
    let roughness = scalars(&stored(&dir, "roughness.png").1, 0);
    let amount = scalars(&stored(&dir, "anisotropy.png").1, 0);
    // OpenPBR 1.1, section "Microfacet model".
    let open_pbr = |r: f32, a: f32| {
        let along = r * r * (2.0 / (1.0 + (1.0 - a).powi(2))).sqrt();
        (along, (1.0 - a) * along)
    };
    check(pair(roughness, amount, &open_pbr), 1e-4);

    let (dir, _) = export(Lobe::Anisotropic, &ExportOptions::new(ExportTarget::Gltf));
    let roughness = scalars(&stored(&dir, "metallic_roughness.png").1, 1);
    let strength = scalars(&stored(&dir, "anisotropy.png").1, 2);
    // KHR_materials_anisotropy: alpha along = mix(alpha, 1, strength^2), across = alpha.
    check(pair(roughness, strength, &|r, s| (r * r + (1.0 - r * r) * s * s, r * r)), 0.008);

    let (dir, _) = export(Lobe::Anisotropic, &ExportOptions::new(ExportTarget::Unreal));
    let roughness = scalars(&stored(&dir, "T_material_ORM.png").1, 1);
    let amount = scalars(&stored(&dir, "T_material_Anisotropy.png").1, 0);
    check(pair(roughness, amount, &|r, a| (r * r * (1.0 + a), r * r * (1.0 - a))), 0.01);
}

#[test]
fn what_cannot_be_exported_leaves_nothing() {
    let dir = TempDir::new().unwrap();
    let out = dir.path().join("out");
    let good = material(Lobe::Isotropic);
    let name = |result: svbrdf_gcn::Result<_>| match result.map(|_: svbrdf_gcn::ExportReport| ()) {
        Err(Error::InvalidArgument { name, .. }) => name,
        other => panic!("{other:?}"),
    };
    for bad in ["", "2wood", "a/b", "../x", "Holz\u{e4}", "a b"] {
        assert_eq!(name(good.export(&out, &ExportOptions::new(ExportTarget::Gltf).name(bad))), "name", "{bad:?}");
    }
    for target in [ExportTarget::MaterialX, ExportTarget::Gltf] {
        let options = ExportOptions::new(target).normals(NormalConvention::DirectX);
        assert_eq!(name(good.export(&out, &options)), "normals");
    }
    let mut bad = good.clone();
    bad.normal.data_mut()[2] = f32::NAN;
    assert_eq!(name(bad.export(&out, &ExportOptions::new(ExportTarget::Unreal))), "normal");
    assert!(!out.exists());
    for target in ExportTarget::ALL {
        assert_eq!(ExportTarget::from_name(target.name()), Some(target));
    }
}

#[test]
fn an_export_replaces_itself_and_nothing_else() {
    let dir = TempDir::new().unwrap();
    let folder = dir.path();
    let options = |target| ExportOptions::new(target).name("Wood");
    let names = || {
        let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        entries.collect::<std::collections::BTreeSet<_>>()
    };
    let isotropic = material(Lobe::Isotropic);
    material(Lobe::Anisotropic).export(folder, &options(ExportTarget::Gltf)).unwrap();
    assert!(names().contains("anisotropy.png"));
    isotropic.export(folder, &options(ExportTarget::Gltf)).unwrap();
    assert!(!names().contains("anisotropy.png"), "{:?}", names());
    let before = names();
    // Another export stays what it is, and may lie beside this one as long as none of its files would change.
    let message = isotropic.export(folder, &options(ExportTarget::MaterialX)).unwrap_err().to_string();
    assert!(message.contains(".png: another export"), "{message}");
    assert_eq!(names(), before);
    isotropic.export(folder, &options(ExportTarget::Gltf).name("Copy")).unwrap();
    isotropic.export(folder, &options(ExportTarget::Unreal)).unwrap();
    isotropic.export(folder, &options(ExportTarget::Gltf)).unwrap();
    for kept in before.iter().map(String::as_str).chain(["Copy.gltf", "Copy.bin", "T_Wood_ORM.png"]) {
        assert!(names().contains(kept), "{kept}");
    }
    let brighter = Material { diffuse_albedo: Image::new(5, 4, 3, vec![0.9; 60]).unwrap(), ..isotropic.clone() };
    let message = brighter.export(folder, &options(ExportTarget::Gltf)).unwrap_err().to_string();
    assert!(message.contains(".png: another export"), "{message}");
    assert_eq!(names().len(), before.len() + 6, "{:?}", names());

    // A material's own folder, and somebody else's files.
    let own = dir.path().join("own");
    isotropic.save(&own, &SaveOptions::new(MaterialFormat::Png16)).unwrap();
    let before = fs::read(own.join("normal.png")).unwrap();
    let message = isotropic.export(&own, &options(ExportTarget::Principled)).unwrap_err().to_string();
    assert!(message.contains("roughness.png") && message.contains("material.json"), "{message}");
    assert_eq!(fs::read(own.join("normal.png")).unwrap(), before);
    let mine = dir.path().join("mine");
    fs::create_dir(&mine).unwrap();
    fs::write(mine.join("Wood.gltf"), "mine").unwrap();
    let message = isotropic.export(&mine, &options(ExportTarget::Gltf)).unwrap_err().to_string();
    assert!(message.contains("Wood.gltf") && message.contains("did not write"), "{message}");
    // And a material does not replace an export's.
    let exported = dir.path().join("exported");
    isotropic.export(&exported, &options(ExportTarget::Principled)).unwrap();
    let message = isotropic.save(&exported, &SaveOptions::new(MaterialFormat::Png16)).unwrap_err().to_string();
    assert!(message.contains(".png") && message.contains("export.json"), "{message}");
}
