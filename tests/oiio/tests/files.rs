//! The same file through our readers and OpenImageIO's, written by either.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::path::Path;

use svbrdf_gcn::io::material::{MaterialFormat, SaveOptions};
use svbrdf_gcn::io::{read_image, write_image};
use svbrdf_gcn::{ColorSpace, Image, Material, Transfer};
use svbrdf_gcn_oiio_tests::{Encoding, Picture, convert, read, write};
use tempfile::TempDir;

const SIZE: (i32, i32) = (37, 21);

/// Values between 0 and 1, different in every channel, smooth enough for JPEG.
fn picture(channels: &str) -> Picture {
    let count = channels.split(',').count();
    let value = |x: i32, y: i32, c: usize| {
        let phase = x as f32 * 0.11 + y as f32 * 0.07 * (c as f32 + 1.0) + c as f32;
        0.5 + 0.45 * phase.sin()
    };
    let pixels = (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y)));
    let values = pixels.flat_map(|(x, y)| (0..count).map(move |c| value(x, y, c))).collect();
    Picture { width: SIZE.0, height: SIZE.1, channels: channels.to_owned(), values, ..Picture::default() }
}

fn encoding(format: &str) -> Encoding {
    Encoding { format: format.to_owned(), ..Encoding::default() }
}

fn path_in(dir: &TempDir, name: &str) -> (String, std::path::PathBuf) {
    let path = dir.path().join(name);
    (path.to_str().unwrap().to_owned(), path)
}

/// The channels of `picture` that ours returns: R, G, B by name, or the first one of a grey picture.
fn colors(picture: &Picture) -> Vec<f32> {
    let names: Vec<&str> = picture.channels.split(',').collect();
    let wanted: Vec<usize> = match ["R", "G", "B"].map(|name| names.iter().position(|other| *other == name)) {
        [Some(r), Some(g), Some(b)] => vec![r, g, b],
        _ => vec![0],
    };
    picture.values.chunks(names.len()).flat_map(|pixel| wanted.iter().map(|&c| pixel[c])).collect()
}

fn worst(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

/// Ours and OpenImageIO's view of one file whose display window is its data window.
fn both(text: &str, path: &Path) -> (Vec<f32>, Vec<f32>) {
    let theirs = read(text).unwrap();
    let ours = read_image(path, Transfer::Linear).unwrap();
    assert_eq!((ours.width() as i32, ours.height() as i32), (theirs.width, theirs.height), "{text}");
    (ours.data().to_vec(), colors(&theirs))
}

#[test]
fn png_from_openimageio() {
    let dir = TempDir::new().unwrap();
    for (format, step) in [("uint8", 0.5 / 255.0), ("uint16", 0.5 / 65535.0)] {
        for channels in ["Y", "Y,A", "R,G,B", "R,G,B,A"] {
            let (text, path) = path_in(&dir, "a.png");
            let source = picture(channels);
            write(&text, &source, &encoding(format)).unwrap();
            let (ours, theirs) = both(&text, &path);
            assert!(worst(&ours, &theirs) < 1e-7, "{format} {channels}: the same codes");
            // With alpha OpenImageIO premultiplies on the way and divides again in 8 bits, unless told not to: the source itself comes back.
            assert!(worst(&ours, &colors(&source)) < 1.001 * step, "{format} {channels}");
        }
    }
}

#[test]
fn tiff_from_openimageio() {
    let dir = TempDir::new().unwrap();
    for (format, step) in [("uint8", 0.5 / 255.0), ("uint16", 0.5 / 65535.0), ("half", 1.0 / 4096.0), ("float", 0.0)] {
        for channels in ["Y", "Y,extra", "R,G,B", "R,G,B,A", "R,G,B,extra", "R,G,B,A,extra"] {
            for (compression, tile, separate) in [
                ("none", 0, false),
                ("none", 16, true),
                ("zip", 0, false),
                ("zip", 0, true),
                ("lzw", 0, false),
                ("lzw", 16, false),
                ("lzw", 16, true),
                ("packbits", 0, false),
            ] {
                let case = format!("{format} {channels} {compression} tile {tile} separate {separate}");
                let (text, path) = path_in(&dir, "a.tif");
                let source = picture(channels);
                let encoding = Encoding { compression: compression.to_owned(), tile, separate, ..encoding(format) };
                write(&text, &source, &encoding).unwrap();
                let (ours, theirs) = both(&text, &path);
                // Code / 255 is one float for us and another, a bit off, for OpenImageIO.
                assert!(
                    worst(&ours, &theirs) < if format.starts_with("uint") { 1e-7 } else { f32::MIN_POSITIVE },
                    "{case}"
                );
                assert!(worst(&ours, &colors(&source)) <= 1.001 * step, "{case}");
            }
        }
    }
}

#[test]
fn exr_from_openimageio() {
    let dir = TempDir::new().unwrap();
    let lossless = ["none", "rle", "zips", "zip", "piz"];
    for (format, step) in [("half", 1.0 / 4096.0), ("float", 0.0)] {
        for channels in ["Y", "R,G,B", "R,G,B,A", "B,G,R", "A,B,G,R"] {
            for compression in lossless.iter().chain(&["pxr24", "b44", "b44a"]) {
                for tile in [0, 16] {
                    let case = format!("{format} {channels} {compression} tile {tile}");
                    let (text, path) = path_in(&dir, "a.exr");
                    let source = picture(channels);
                    let compression = (*compression).to_owned();
                    let lossy = !lossless.contains(&compression.as_str());
                    write(&text, &source, &Encoding { compression, tile, ..encoding(format) }).unwrap();
                    let (ours, theirs) = both(&text, &path);
                    assert_eq!(worst(&ours, &theirs), 0.0, "{case}");
                    assert!(lossy || worst(&ours, &colors(&source)) <= 1.001 * step, "{case}");
                }
            }
        }
    }
}

#[test]
fn the_first_part_of_several_is_read() {
    let dir = TempDir::new().unwrap();
    for name in ["a.exr", "a.tif"] {
        let (text, path) = path_in(&dir, name);
        write(&text, &picture("R,G,B"), &Encoding { parts: 2, ..encoding("float") }).unwrap();
        let (ours, theirs) = both(&text, &path);
        assert_eq!(worst(&ours, &theirs), 0.0, "{name}");
    }
}

#[test]
fn a_display_window_is_cut_out_or_filled_with_black() {
    let dir = TempDir::new().unwrap();
    // Data within the display window, around it, beside its corner, and displaced from the origin.
    for (x, y, display) in [
        (3, 2, [0, 0, 50, 30]),
        (-5, -4, [0, 0, 20, 10]),
        (-5, 6, [0, 0, 30, 12]),
        (100, 200, [90, 190, 60, 50]),
        (7, 9, [10, 12, 20, 15]),
    ] {
        for channels in ["R,G,B", "R,G,B,A", "Y"] {
            let (text, path) = path_in(&dir, "a.exr");
            let [full_x, full_y, full_width, full_height] = display;
            let source = Picture { x, y, full_x, full_y, full_width, full_height, ..picture(channels) };
            write(&text, &source, &encoding("float")).unwrap();
            let theirs = read(&text).unwrap();
            assert_eq!([theirs.full_x, theirs.full_y, theirs.full_width, theirs.full_height], display);
            let ours = read_image(&path, Transfer::Linear).unwrap();
            assert_eq!((ours.width() as i32, ours.height() as i32), (full_width, full_height));
            let values = colors(&theirs);
            let count = ours.channels();
            for row in 0..full_height {
                for column in 0..full_width {
                    let (data_x, data_y) = (column + full_x - theirs.x, row + full_y - theirs.y);
                    let inside = (0..theirs.width).contains(&data_x) && (0..theirs.height).contains(&data_y);
                    let at = |x: i32, y: i32, width: i32| (y * width + x) as usize * count;
                    let got = &ours.data()[at(column, row, full_width)..][..count];
                    let zero = vec![0.0; count];
                    let expected = if inside { &values[at(data_x, data_y, theirs.width)..][..count] } else { &zero };
                    assert_eq!(got, expected, "{display:?} row {row} column {column}");
                }
            }
        }
    }
}

/// Decoders round the inverse cosine transform differently, by one code; where chroma is subsampled they also upsample it differently.
#[test]
fn jpeg_both_ways() {
    let dir = TempDir::new().unwrap();
    for (channels, compression, tolerance) in [("Y", "jpeg:95", 1.01), ("R,G,B", "jpeg:95", 4.01)] {
        let (text, path) = path_in(&dir, "a.jpg");
        write(&text, &picture(channels), &Encoding { compression: compression.to_owned(), ..encoding("uint8") })
            .unwrap();
        let (ours, theirs) = both(&text, &path);
        assert!(255.0 * worst(&ours, &theirs) < tolerance, "{channels}: {} codes", 255.0 * worst(&ours, &theirs));
        let source = picture(channels);
        let image = Image::new(SIZE.0 as usize, SIZE.1 as usize, channels.split(',').count(), source.values).unwrap();
        write_image(&path, &image, Transfer::Linear).unwrap();
        let (ours, theirs) = both(&text, &path);
        assert!(255.0 * worst(&ours, &theirs) < tolerance, "{channels}: {} codes", 255.0 * worst(&ours, &theirs));
        let off = 255.0 * worst(&theirs, image.data());
        // What quality 95 loses of this picture.
        assert!(off < 8.0, "{channels}: {off} codes");
    }
}

#[test]
fn our_files_in_openimageio() {
    let dir = TempDir::new().unwrap();
    for channels in ["Y", "R,G,B"] {
        let values = picture(channels).values;
        let image = Image::new(SIZE.0 as usize, SIZE.1 as usize, channels.split(',').count(), values).unwrap();
        for (name, step) in [("a.png", 0.5 / 255.0), ("a.exr", 0.0), ("a.tif", 0.0)] {
            let (text, path) = path_in(&dir, name);
            write_image(&path, &image, Transfer::Linear).unwrap();
            let (ours, theirs) = both(&text, &path);
            assert!(worst(&ours, &theirs) < 1e-7, "{name} {channels}");
            assert!(worst(&theirs, image.data()) <= 1.001 * step, "{name} {channels}");
        }
    }
}

fn material() -> Material {
    let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
    let image = |channels: &str, scale: f32| {
        let values = picture(channels).values.into_iter().map(|v| scale * v).collect();
        Image::new(width, height, channels.split(',').count(), values).unwrap()
    };
    let flat = (0..width * height).flat_map(|_| [0.0, 0.6, 0.8]).collect();
    Material {
        diffuse_albedo: image("R,G,B", 1.0),
        specular_albedo: image("R,G,B", 0.3),
        roughness: image("Y", 1.0),
        normal: Image::new(width, height, 3, flat).unwrap(),
        tangent: None,
        patch_size: 10.0,
        unit: None,
        warnings: Vec::new(),
    }
}

/// sRGB's curve and the primaries, both OpenColorIO's own: nothing in here was computed by us.
const CONFIG: &str = "\
ocio_profile_version: 2
roles:
  default: lin_rec709
  scene_linear: lin_rec709
file_rules:
  - !<Rule> {name: Default, colorspace: default}
displays:
  screen:
    - !<View> {name: plain, colorspace: srgb}
colorspaces:
  - !<ColorSpace>
    name: lin_rec709
  - !<ColorSpace>
    name: srgb
    to_scene_reference: !<ExponentWithLinearTransform> {gamma: 2.4, offset: 0.055, direction: forward}
  - !<ColorSpace>
    name: gamma22
    to_scene_reference: !<ExponentTransform> {value: 2.2}
  - !<ColorSpace>
    name: acescg
    to_scene_reference: !<BuiltinTransform> {style: UTILITY - ACES-AP1_to_LINEAR-REC709_BFD}
";

fn config(dir: &TempDir) -> String {
    let path = dir.path().join("config.ocio");
    std::fs::write(&path, CONFIG).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn transfer_functions_are_those_of_opencolorio() {
    let dir = TempDir::new().unwrap();
    let config = config(&dir);
    for bits in [8, 16] {
        let codes = 1u32 << bits;
        let step = codes / 256;
        let stored: Vec<f32> = (0..codes).step_by(step as usize).map(|code| code as f32 / (codes - 1) as f32).collect();
        let values: Vec<f32> = stored.iter().flat_map(|&v| [v; 3]).collect();
        let source = Picture {
            width: stored.len() as i32,
            height: 1,
            channels: "R,G,B".to_owned(),
            values,
            ..Picture::default()
        };
        for (space, transfer) in [("srgb", Transfer::Srgb), ("gamma22", Transfer::Gamma22)] {
            let linear = convert(&config, space, "lin_rec709", &source).unwrap();
            for (stored, linear) in source.values.iter().zip(&linear.values) {
                let ours = transfer.decode(*stored);
                // OpenColorIO computes powers with a fast approximation, good to about 1e-5 of the value, and joins the pieces of the
                // curve where they touch, at 0.0393; IEC 61966-2-1 rounds its constants and joins them at 0.04045.
                assert!((ours - linear).abs() <= 4e-5 * ours + 2e-6, "{space} {stored}: {ours} {linear}");
            }
        }
    }
}

#[test]
fn acescg_is_that_of_opencolorio() {
    let dir = TempDir::new().unwrap();
    let config = config(&dir);
    let source = picture("R,G,B");
    for (from, to) in [(ColorSpace::AcesCg, ColorSpace::Rec709), (ColorSpace::Rec709, ColorSpace::AcesCg)] {
        let name = |space: ColorSpace| if space == ColorSpace::AcesCg { "acescg" } else { "lin_rec709" };
        let theirs = convert(&config, name(from), name(to), &source).unwrap();
        let mut ours = Image::new(SIZE.0 as usize, SIZE.1 as usize, 3, source.values.clone()).unwrap();
        from.convert_image(to, &mut ours);
        assert!(worst(ours.data(), &theirs.values) < 2e-6, "{}", worst(ours.data(), &theirs.values));
    }
}

#[test]
fn albedos_written_in_acescg_are_the_same_colours() {
    let material = material();
    for (format, extension, step) in [
        (MaterialFormat::Exr, "exr", 1.0 / 4096.0),
        (MaterialFormat::Png16, "png", 0.5 / 65535.0),
        (MaterialFormat::Tiff, "tif", 0.0),
    ] {
        for (color_space, name) in [(ColorSpace::AcesCg, "acescg"), (ColorSpace::Rec709, "lin_rec709")] {
            let dir = TempDir::new().unwrap();
            let config = config(&dir);
            let options = SaveOptions::new(format).color_space(color_space);
            material.save(dir.path().join("out"), &options).unwrap();
            // An albedo in sRGB's curve, in a PNG of Rec. 709.
            let stored = if extension == "png" && color_space == ColorSpace::Rec709 { "srgb" } else { name };
            // The matrix has rows of up to 2.41 in absolute sum; the curve is steep to 2.3 at 1.
            let tolerance = 2.5 * step + 5e-5;
            for (file, albedo) in [("diffuse", &material.diffuse_albedo), ("specular", &material.specular_albedo)] {
                let (text, _) = path_in(&dir, &format!("out/{file}.{extension}"));
                let theirs = convert(&config, stored, "lin_rec709", &read(&text).unwrap()).unwrap();
                let off = worst(&theirs.values, albedo.data());
                assert!(off <= tolerance, "{file}.{extension} {name}: {off}");
            }
            let back = Material::load(dir.path().join("out")).unwrap();
            let off = worst(back.diffuse_albedo.data(), material.diffuse_albedo.data());
            assert!(off <= tolerance, "{extension} {name}: {off}");
        }
    }
}
