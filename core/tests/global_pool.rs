//! Rayon's global pool belongs to the host.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::ops::ControlFlow;
use std::path::Path;

use svbrdf_gcn::io::material::SaveOptions;
use svbrdf_gcn::metrics::photo_rmse;
use svbrdf_gcn::preview::material_png;
use svbrdf_gcn::render::{photo_loss, render};
use svbrdf_gcn::{
    Capture, CaptureOptions, ExportOptions, ExportTarget, FitOptions, Material, Method, Preset, fit_material,
};

/// Alone in its process: the global pool can be set up once, and only where nothing has used it.
#[test]
fn nothing_touches_it() {
    let samples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../samples");
    let folder = tempfile::tempdir().unwrap();
    let capture = Capture::open_with(samples.join("lambert"), &CaptureOptions::new().size(16)).unwrap();
    let options = FitOptions::preset(Preset::Draft).direct_steps(3).threads(2);
    for method in [Method::Network, Method::Direct] {
        let options = options.clone().method(method);
        let fit = fit_material(&capture, None, &options, &mut |_| ControlFlow::Continue(())).unwrap();
        fit.material.save(folder.path().join("out"), &SaveOptions::default()).unwrap();
    }
    let material = Material::load(folder.path().join("out")).unwrap().resized(8).unwrap();
    material_png(&material).unwrap();
    for target in ExportTarget::ALL {
        material.export(folder.path().join(target.name()), &ExportOptions::new(target)).unwrap();
    }
    let photo =
        &Capture::open_with(samples.join("lambert"), &CaptureOptions::new().size(8)).unwrap().photos()[0].clone();
    photo_rmse(&render(&material, &photo.shot).unwrap(), &photo.image).unwrap();
    photo_loss(&material.to_maps().unwrap(), 1.0, &[photo.target().unwrap()], None).unwrap();
    assert!(rayon::ThreadPoolBuilder::new().num_threads(1).build_global().is_ok());
}
