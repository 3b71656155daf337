//! The sample captures, path-traced by another renderer, against this crate's reader and renderer: units, axes, encodings.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::path::PathBuf;

use svbrdf_gcn::metrics::photo_rmse;
use svbrdf_gcn::render::render;
use svbrdf_gcn::{Capture, Material};

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
