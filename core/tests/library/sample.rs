//! The sample captures, path-traced by another renderer, against this crate's reader and renderer: units, axes, encodings.

use std::path::PathBuf;

use svbrdf_gcn::capture::render_photo;
use svbrdf_gcn::metrics::photo_rmse;
use svbrdf_gcn::render::render;
use svbrdf_gcn::{Capture, CaptureOptions, Material, Unit};

fn sample(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../samples").join(name)
}

#[test]
fn photos_of_the_tiles_match_renderings_of_the_true_maps() {
    let capture = Capture::open(sample("tiles")).unwrap();
    let truth = Material::load(sample("tiles/truth")).unwrap();
    assert_eq!((capture.len(), capture.width(), capture.height()), (9, 256, 256));
    assert_eq!(capture.patch_size(), truth.patch_size);
    assert!(capture.warnings().is_empty(), "{:?}", capture.warnings());
    for photo in capture.photos() {
        let rendering = render(&truth, &photo.shot).unwrap();
        // Measured: 0.0060 to 0.0085, most of it blur at edges. The light moved into the camera gives 0.04, a flipped normal 0.06.
        let error = photo_rmse(&rendering, &photo.image).unwrap();
        assert!(error < 0.01, "{}: {error}", photo.name);
        let top_codes = photo.saturated.iter().filter(|&&channels| channels != 0).count();
        assert!((100..3000).contains(&top_codes), "{}: {top_codes} saturated pixels", photo.name);
    }
}

#[test]
fn lambertian_radiance_has_the_stated_unit() {
    let capture = Capture::open(sample("lambert")).unwrap();
    let truth = Material::load(sample("lambert/truth")).unwrap();
    for photo in capture.photos() {
        let rendering = render(&truth, &photo.shot).unwrap();
        for (&got, &expected) in photo.image.data().iter().zip(rendering.data()) {
            // Measured: at most 0.7 %.
            assert!((got / expected - 1.0).abs() < 0.01, "{}: {got} instead of {expected}", photo.name);
        }
    }
}

/// A material that states another unit is as good as the one in the capture's; one of another patch is not silently judged by it.
#[test]
fn errors_of_photos_in_other_units() {
    let capture = Capture::open_with(sample("tiles"), &CaptureOptions::new().size(64).views([0])).unwrap();
    let truth = Material::load(sample("tiles/truth")).unwrap().resized(64).unwrap();
    let with =
        |patch_size: f64, unit: Option<&str>| Material { patch_size, unit: unit.map(Unit::new), ..truth.clone() };
    let rendered = |material: &Material| render_photo(material, &capture, 0);
    assert_eq!(capture.unit(), Some(&Unit::new("cm")));
    assert_eq!(capture.patch_size(), 10.0);
    let expected = render(&with(10.0, None), &capture.photos()[0].shot).unwrap();
    for (patch_size, unit) in [
        (10.0, Some("cm")),
        (100.0, Some("mm")),
        (0.1, Some("m")),
        (3.937, Some("in")),
        (10.0, None),
        (10.009, Some("cm")),
    ] {
        assert_eq!(rendered(&with(patch_size, unit)).unwrap(), expected, "{patch_size} {unit:?}");
    }
    for (patch_size, unit, told) in [
        (10.0, Some("mm"), "10 mm"),
        (9.7, Some("cm"), "9.7 cm"),
        (1.0, None, "1 (no unit stated)"),
        (10.0, Some("halves"), "10 halves"),
    ] {
        let message = rendered(&with(patch_size, unit)).unwrap_err().to_string();
        let expected = format!("patch_size: the capture's patch is 10 cm wide, the material's {told}");
        assert!(message.starts_with(&expected), "{message}");
    }
    assert!(render_photo(&truth, &capture, 1).unwrap_err().to_string().contains("photo 1 of a capture of 1"));
}
