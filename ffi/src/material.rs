//! Fitting, and what comes of it.

use std::ffi::{CString, c_char};

use serde_json::Value;
use svbrdf_gcn::capture::render_photo;
use svbrdf_gcn::io::material::{read_deviations, read_report};
use svbrdf_gcn::metrics::photo_rmse;
use svbrdf_gcn::nn::Model;
use svbrdf_gcn::render::render;
use svbrdf_gcn::{Deviations, Fit, Image, Material, fit_material};

use crate::capture::svbrdf_gcn_capture;
use crate::guard::{borrow, guard, guard_value, path, text};
use crate::handle::{Handle, destroy, expect_out, give, string_at};
use crate::image::{HostBuffer, svbrdf_gcn_image_buffer, svbrdf_gcn_image_view, view_of};
use crate::model::svbrdf_gcn_model;
use crate::options::{
    choose, read, read_or_defaults, svbrdf_gcn_export_options, svbrdf_gcn_options, svbrdf_gcn_save_options,
    svbrdf_gcn_shot,
};
use crate::progress::{Callback, token_or_new};
use crate::status::{Failure, c_string, svbrdf_gcn_status};
use svbrdf_gcn_map_kind::*;

/// The maps of a material. Immutable: any number of threads may use it at once.
pub struct svbrdf_gcn_material {
    material: Material,
    deviations: Option<Deviations>,
    unit: Option<CString>,
    report: Option<Value>,
    report_json: CString,
    warnings: Vec<CString>,
}

impl Handle for svbrdf_gcn_material {}

impl svbrdf_gcn_material {
    fn new(material: Material, deviations: Option<Deviations>, report: Option<Value>) -> Self {
        let unit = material.unit.as_ref().map(|unit| c_string(unit.name()));
        let report_json = c_string(&report.as_ref().unwrap_or(&Value::Null).to_string());
        let of_fit = report.as_ref().and_then(|report| report.get("warnings")?.as_array()).into_iter().flatten();
        let warnings = material.warnings.iter().map(String::as_str).chain(of_fit.filter_map(Value::as_str));
        let warnings = warnings.map(c_string).collect();
        Self { material, deviations, unit, report, report_json, warnings }
    }
}

/// What may be expected of fitted maps.
#[repr(i32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum svbrdf_gcn_verdict {
    /// Not known: the material was not fitted.
    SVBRDF_GCN_VERDICT_NONE = 0,
    /// A new photo would hardly be told from its rendering, and nothing contradicts.
    SVBRDF_GCN_VERDICT_GOOD = 1,
    /// Right in the whole, with errors that can be seen.
    SVBRDF_GCN_VERDICT_USABLE = 2,
    /// Not what the photos show.
    SVBRDF_GCN_VERDICT_POOR = 3,
}

/// The maps of a material.
#[repr(i32)]
pub enum svbrdf_gcn_map_kind {
    /// Diffuse albedo, 3 channels, linear RGB, 0 to 1.
    SVBRDF_GCN_MAP_DIFFUSE_ALBEDO = 0,
    /// Specular albedo: reflectance at normal incidence (F0), 3 channels, linear RGB, 0 to 1.
    SVBRDF_GCN_MAP_SPECULAR_ALBEDO = 1,
    /// Perceptual roughness, 1 channel, or 2 (x, y) of an anisotropic material, 0 to 1.
    SVBRDF_GCN_MAP_ROUGHNESS = 2,
    /// Unit normal, 3 channels, +x right, +y up, +z out of the surface, -1 to 1.
    SVBRDF_GCN_MAP_NORMAL = 3,
    /// Unit tangent of an anisotropic material, 3 channels, -1 to 1.
    SVBRDF_GCN_MAP_TANGENT = 4,
    /// Standard deviation of the diffuse albedo (root mean square over colours), 1 channel; of materials that a fit with the default network made.
    SVBRDF_GCN_MAP_DIFFUSE_ALBEDO_DEVIATION = 5,
    /// Likewise of the specular albedo.
    SVBRDF_GCN_MAP_SPECULAR_ALBEDO_DEVIATION = 6,
    /// Likewise of the roughness.
    SVBRDF_GCN_MAP_ROUGHNESS_DEVIATION = 7,
    /// Likewise of the normal: about an angle in radians.
    SVBRDF_GCN_MAP_NORMAL_DEVIATION = 8,
}

/// Recovers the material that the photos of `capture` show.
///
/// `model` may be NULL: then the default network, which is part of the library. `options` may be NULL for the defaults. The call returns when the
/// fit is done or stopped; the progress callback runs on the calling thread. Any number of fits may run at once, of the same model and capture too.
/// Destroy the material with `svbrdf_gcn_material_destroy`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_fit_material(
    model: *const svbrdf_gcn_model,
    capture: *const svbrdf_gcn_capture,
    options: *const svbrdf_gcn_options,
    out: *mut *mut svbrdf_gcn_material,
) -> svbrdf_gcn_status {
    guard(|| {
        expect_out(out)?;
        // SAFETY: NULL or living handles, options and strings, says the caller.
        let (model, capture, options, weights, cancel) = unsafe {
            let options = read_or_defaults("options", options)?;
            let weights = text("weights", options.weights)?;
            (model.as_ref(), borrow("capture", capture)?.capture()?, options, weights, token_or_new(options.cancel))
        };
        let fit_options = options.fit_options(cancel)?;
        let loaded = match (model, weights) {
            (Some(_), Some(path)) => {
                return Err(Failure::invalid("weights", format!("expected NULL beside a model, got {path:?}")));
            }
            (None, Some(path)) => Some(Model::load_for(path, capture.len())?),
            (_, None) => None,
        };
        let model = model.map(|handle| &*handle.model).or(loaded.as_ref());
        let mut callback = Callback::new(options.progress, options.progress_user_data);
        let fit = fit_material(capture, model, &fit_options, &mut |progress| callback.call(progress));
        callback.check()?;
        let Fit { material, deviations, report } = fit?;
        let json = serde_json::to_value(&report).map_err(|error| Failure::invalid("report", error))?;
        // SAFETY: not NULL.
        unsafe { give(out, svbrdf_gcn_material::new(material, deviations, Some(json))) };
        Ok(())
    })
}

/// Destroys a material, and with it its maps; no-op for NULL. Nobody else may use it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_material_destroy(material: *mut svbrdf_gcn_material) {
    // SAFETY: NULL or a material that is not used any more, says the caller.
    unsafe { destroy(material) }
}

/// A view of a map (`map_kind` is a `svbrdf_gcn_map_kind`): packed floats that live as long as the material. Set `out->struct_size` first
/// (`svbrdf_gcn_image_view_init`). An isotropic material has no tangent; asking for it is `SVBRDF_GCN_ERR_INVALID_ARGUMENT`, as it
/// is for a deviation that is not known.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_material_map(
    material: *const svbrdf_gcn_material,
    map_kind: i32,
    out: *mut svbrdf_gcn_image_view,
) -> svbrdf_gcn_status {
    guard(|| {
        // SAFETY: NULL or a living material, says the caller.
        let svbrdf_gcn_material { material: maps, deviations, .. } = unsafe { borrow("material", material) }?;
        let deviation = |image: fn(&Deviations) -> &Image| deviations.as_ref().map(image);
        let image: Option<&Image> = choose(
            "map_kind",
            map_kind,
            &[
                (SVBRDF_GCN_MAP_DIFFUSE_ALBEDO as i32, Some(&maps.diffuse_albedo)),
                (SVBRDF_GCN_MAP_SPECULAR_ALBEDO as i32, Some(&maps.specular_albedo)),
                (SVBRDF_GCN_MAP_ROUGHNESS as i32, Some(&maps.roughness)),
                (SVBRDF_GCN_MAP_NORMAL as i32, Some(&maps.normal)),
                (SVBRDF_GCN_MAP_TANGENT as i32, maps.tangent.as_ref()),
                (SVBRDF_GCN_MAP_DIFFUSE_ALBEDO_DEVIATION as i32, deviation(|all| &all.diffuse_albedo)),
                (SVBRDF_GCN_MAP_SPECULAR_ALBEDO_DEVIATION as i32, deviation(|all| &all.specular_albedo)),
                (SVBRDF_GCN_MAP_ROUGHNESS_DEVIATION as i32, deviation(|all| &all.roughness)),
                (SVBRDF_GCN_MAP_NORMAL_DEVIATION as i32, deviation(|all| &all.normal)),
            ],
        )?;
        let image = image.ok_or_else(|| {
            let missing = match map_kind {
                kind if kind == SVBRDF_GCN_MAP_TANGENT as i32 => "an isotropic material has no tangent",
                _ => "the material's deviations are not known",
            };
            Failure::invalid("map_kind", missing)
        })?;
        // SAFETY: NULL or a view, says the caller.
        unsafe { view_of(image, out) }
    })
}

/// Width of the patch in the capture's length unit; 0 if `material` is NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_material_patch_size(material: *const svbrdf_gcn_material) -> f64 {
    guard_value(0.0, || {
        // SAFETY: NULL or a living material, says the caller.
        Ok(unsafe { borrow("material", material) }?.material.patch_size)
    })
}

/// Name of the unit of the patch's width, in UTF-8: that of the capture, or of the folder it was loaded from. NULL if it is not known or `material` is NULL.
/// Valid as long as the material.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_material_unit(material: *const svbrdf_gcn_material) -> *const c_char {
    guard_value(std::ptr::null(), || {
        // SAFETY: NULL or a living material, says the caller.
        let unit = &unsafe { borrow("material", material) }?.unit;
        Ok(unit.as_ref().map_or(std::ptr::null(), |unit| unit.as_ptr()))
    })
}

/// What the fit did, as the JSON object that `material.json` holds under `report`: settings, stages, losses, errors of the photos, warnings; `null` if the
/// material was loaded from files that have none. NULL if `material` is. Valid as long as the material.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_material_report_json(material: *const svbrdf_gcn_material) -> *const c_char {
    guard_value(std::ptr::null(), || {
        // SAFETY: NULL or a living material, says the caller.
        Ok(unsafe { borrow("material", material) }?.report_json.as_ptr())
    })
}

/// What may be expected of the maps, as the fit found; kept when a material is saved and loaded. The reasons and what to do stand in
/// `svbrdf_gcn_material_report_json`. `SVBRDF_GCN_VERDICT_NONE` if there was no fit or `material` is NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_material_verdict(material: *const svbrdf_gcn_material) -> svbrdf_gcn_verdict {
    guard_value(svbrdf_gcn_verdict::SVBRDF_GCN_VERDICT_NONE, || {
        // SAFETY: NULL or a living material, says the caller.
        let report = &unsafe { borrow("material", material) }?.report;
        let verdict = report.as_ref().and_then(|report| report.get("verdict")?.as_str());
        Ok(match verdict {
            Some("good") => svbrdf_gcn_verdict::SVBRDF_GCN_VERDICT_GOOD,
            Some("usable") => svbrdf_gcn_verdict::SVBRDF_GCN_VERDICT_USABLE,
            Some("poor") => svbrdf_gcn_verdict::SVBRDF_GCN_VERDICT_POOR,
            _ => svbrdf_gcn_verdict::SVBRDF_GCN_VERDICT_NONE,
        })
    })
}

/// What a user should know, of loaded maps those that have changed since they were saved, then of the fit: warning `index`, from 0, in UTF-8; NULL past the last. Valid as long as the material.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_material_warning(
    material: *const svbrdf_gcn_material,
    index: usize,
) -> *const c_char {
    guard_value(std::ptr::null(), || {
        // SAFETY: NULL or a living material, says the caller.
        Ok(string_at(&unsafe { borrow("material", material) }?.warnings, index))
    })
}

/// Writes the maps and `material.json` to a folder (UTF-8 path), which is made if it is not there: the files that the command line writes. A material that is
/// there is replaced as a whole, or, if the call fails, left as it was. A file of one of these names that svbrdf-gcn did not write is
/// `SVBRDF_GCN_ERR_INVALID_ARGUMENT`. `options` may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_material_save(
    material: *const svbrdf_gcn_material,
    folder_utf8: *const c_char,
    options: *const svbrdf_gcn_save_options,
) -> svbrdf_gcn_status {
    guard(|| {
        // SAFETY: NULL or a living material, a string and options, says the caller.
        let (handle, folder, options) = unsafe {
            (borrow("material", material)?, path("folder_utf8", folder_utf8)?, read_or_defaults("options", options)?)
        };
        let mut options = options.save_options()?;
        options.report.clone_from(&handle.report);
        options.deviations.clone_from(&handle.deviations);
        Ok(handle.material.save(folder, &options)?)
    })
}

/// Reads a folder with a `material.json` (UTF-8 path). Destroy the material with `svbrdf_gcn_material_destroy`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_material_load(
    folder_utf8: *const c_char,
    out: *mut *mut svbrdf_gcn_material,
) -> svbrdf_gcn_status {
    guard(|| {
        expect_out(out)?;
        // SAFETY: NULL or a string, says the caller.
        let folder = unsafe { path("folder_utf8", folder_utf8) }?;
        let (material, deviations, report) = (Material::load(folder)?, read_deviations(folder)?, read_report(folder)?);
        // SAFETY: not NULL.
        unsafe { give(out, svbrdf_gcn_material::new(material, deviations, report)) };
        Ok(())
    })
}

/// Writes the material for another program to a folder (UTF-8 path), which is made if it is not there. `export.json` in it says what every file holds, and
/// what the program cannot hold of this material.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_material_export(
    material: *const svbrdf_gcn_material,
    folder_utf8: *const c_char,
    options: *const svbrdf_gcn_export_options,
) -> svbrdf_gcn_status {
    guard(|| {
        // SAFETY: NULL or a living material, strings and options, says the caller.
        let (handle, folder, options) = unsafe {
            let options = read("options", options)?.export_options()?;
            (borrow("material", material)?, path("folder_utf8", folder_utf8)?, options)
        };
        handle.material.export(folder, &options)?;
        Ok(())
    })
}

/// Renders the material from the camera and under the light of `shot`, with the model the fit uses: linear RGB, written to `out`, which has the size of
/// the maps and 3 channels of float or half. Nothing is written if the call fails.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_material_render(
    material: *const svbrdf_gcn_material,
    shot: *const svbrdf_gcn_shot,
    out: *mut svbrdf_gcn_image_buffer,
) -> svbrdf_gcn_status {
    guard(|| {
        // SAFETY: NULL or a living material, a shot and a buffer, says the caller.
        let (material, shot, buffer) = unsafe {
            let material = &borrow("material", material)?.material;
            let size = (material.width(), material.height(), 3);
            (material, read("shot", shot)?.shot(), HostBuffer::new("out", out, size)?)
        };
        let image = render(material, &shot)?;
        // SAFETY: the pixels of the buffer may be written, says the caller.
        unsafe { buffer.write(&image) };
        Ok(())
    })
}

/// How far the material, rendered as photo `index` (from 0) of `capture` was taken, is from the photo: root mean square error of values encoded with gamma
/// 2.2 and clamped to 0 to 1. The maps must have the size of the photos and show the same patch: widths in known units (mm, cm, m, in) are converted; where a unit is not
/// stated the numbers must agree. Else it is `SVBRDF_GCN_ERR_INVALID_ARGUMENT`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_photo_rmse(
    material: *const svbrdf_gcn_material,
    capture: *const svbrdf_gcn_capture,
    index: usize,
    out: *mut f64,
) -> svbrdf_gcn_status {
    guard(|| {
        if out.is_null() {
            return Err(Failure::null("out"));
        }
        // SAFETY: NULL or living handles, says the caller.
        let (material, capture) = unsafe { (&borrow("material", material)?.material, borrow("capture", capture)?) };
        let photo = capture.photo(index)?;
        let rmse = photo_rmse(&render_photo(material, capture.capture()?, index)?, &photo.image)?;
        // SAFETY: not NULL.
        unsafe { out.write(rmse) };
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use std::ffi::{CStr, c_void};
    use std::ptr::{self, null, null_mut};

    use svbrdf_gcn::Lobe;
    use svbrdf_gcn::nn::{Gcn, NetworkConfig};

    use super::*;
    use crate::capture::*;
    use crate::image::svbrdf_gcn_pixel_type::*;
    use crate::model::*;
    use crate::options::*;
    use crate::progress::*;
    use crate::status::svbrdf_gcn_last_error_message;
    use crate::status::svbrdf_gcn_status::*;

    fn last_error() -> &'static str {
        // SAFETY: NUL-terminated; the tests look at it before the next call.
        unsafe { CStr::from_ptr(svbrdf_gcn_last_error_message()) }.to_str().unwrap()
    }

    /// A capture of two photos of 8 x 8 pixels.
    fn capture() -> *mut svbrdf_gcn_capture {
        let options = svbrdf_gcn_capture_options {
            transfer: svbrdf_gcn_transfer::SVBRDF_GCN_TRANSFER_LINEAR as i32,
            ..svbrdf_gcn_capture_options::defaults()
        };
        let pixels: Vec<f32> = (0..8 * 8 * 3).map(|i| (i % 17) as f32 / 40.0).collect();
        let mut capture = null_mut();
        // SAFETY: the pixels are there.
        unsafe {
            assert_eq!(svbrdf_gcn_capture_create(2.0, &raw const options, &raw mut capture), SVBRDF_GCN_OK);
            for x in [0.5, -0.5] {
                let view = svbrdf_gcn_image_view {
                    data: pixels.as_ptr().cast(),
                    pixel_type: SVBRDF_GCN_PIXEL_FLOAT as i32,
                    channels: 3,
                    width: 8,
                    height: 8,
                    ..svbrdf_gcn_image_view::defaults()
                };
                let shot = svbrdf_gcn_shot {
                    camera: [x, 0.0, 4.0],
                    light: [x, 0.5, 4.0],
                    light_intensity: [30.0; 3],
                    ..svbrdf_gcn_shot::defaults()
                };
                let status = svbrdf_gcn_capture_add_photo(capture, &raw const view, &raw const shot);
                assert_eq!(status, SVBRDF_GCN_OK, "{}", last_error());
            }
        }
        capture
    }

    unsafe extern "C" fn note_stage(stages: *mut c_void, progress: *const svbrdf_gcn_progress) -> i32 {
        // SAFETY: the test hands over a list, the library a report.
        let (stages, progress) = unsafe { (&mut *stages.cast::<Vec<i32>>(), &*progress) };
        stages.push(progress.stage);
        svbrdf_gcn_step::SVBRDF_GCN_CONTINUE as i32
    }

    /// The fit of a network with random weights: from a model and from a path come the same bits, of an anisotropic material.
    #[test]
    fn fit_with_a_network() {
        let config = NetworkConfig {
            width: 8,
            encoder_blocks: vec![1, 1],
            middle_blocks: 1,
            decoder_blocks: vec![1, 1],
            ..NetworkConfig::paper(2, Gcn::Full, Lobe::Anisotropic)
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.safetensors");
        Model::random(&[config], 3).unwrap().save(&path).unwrap();
        let path = c_string(path.to_str().unwrap());
        let capture = capture();
        let mut stages: Vec<i32> = Vec::new();
        let mut options = svbrdf_gcn_options {
            latent_steps: 2,
            adapter_steps: 3,
            progress: Some(note_stage),
            progress_user_data: ptr::from_mut(&mut stages).cast(),
            ..svbrdf_gcn_options::defaults()
        };
        let (mut model, mut materials) = (null_mut(), [null_mut(), null_mut()]);
        // SAFETY: handles are used as the header says.
        unsafe {
            assert_eq!(svbrdf_gcn_model_load(path.as_ptr(), &raw mut model), SVBRDF_GCN_OK, "{}", last_error());
            assert!(!CStr::from_ptr(svbrdf_gcn_model_license(model)).is_empty());
            let status = svbrdf_gcn_fit_material(model, capture, &raw const options, &raw mut materials[0]);
            assert_eq!(status, SVBRDF_GCN_OK, "{}", last_error());
            let (encode, latent, adapters) = (
                svbrdf_gcn_stage::SVBRDF_GCN_STAGE_ENCODE as i32,
                svbrdf_gcn_stage::SVBRDF_GCN_STAGE_LATENT as i32,
                svbrdf_gcn_stage::SVBRDF_GCN_STAGE_ADAPTERS as i32,
            );
            stages.dedup();
            assert_eq!(stages, [encode, latent, adapters]);
            assert!(
                CStr::from_ptr(svbrdf_gcn_material_report_json(materials[0])).to_str().unwrap().contains("network")
            );
            assert!(svbrdf_gcn_material_warning(materials[0], 0).is_null());
            // Nothing was left out: no expectation, no good verdict.
            assert_eq!(svbrdf_gcn_material_verdict(materials[0]), svbrdf_gcn_verdict::SVBRDF_GCN_VERDICT_USABLE);
            assert_eq!(svbrdf_gcn_material_verdict(null()), svbrdf_gcn_verdict::SVBRDF_GCN_VERDICT_NONE);

            options.weights = path.as_ptr();
            let status = svbrdf_gcn_fit_material(null(), capture, &raw const options, &raw mut materials[1]);
            assert_eq!(status, SVBRDF_GCN_OK, "{}", last_error());
            let status = svbrdf_gcn_fit_material(model, capture, &raw const options, &raw mut materials[1]);
            assert_eq!(status, SVBRDF_GCN_ERR_INVALID_ARGUMENT);
            assert!(last_error().starts_with("weights: expected NULL beside a model"), "{}", last_error());

            for (kind, channels) in [3, 3, 2, 3, 3].into_iter().enumerate() {
                let mut views = [svbrdf_gcn_image_view::defaults(); 2];
                for (view, material) in views.iter_mut().zip(materials) {
                    assert_eq!(svbrdf_gcn_material_map(material, kind as i32, view), SVBRDF_GCN_OK, "{}", last_error());
                    assert_eq!((view.width, view.height, view.channels), (8, 8, channels));
                }
                let [a, b] =
                    views.map(|view| std::slice::from_raw_parts(view.data.cast::<f32>(), 64 * channels as usize));
                assert_eq!(a, b);
            }
            for material in materials {
                svbrdf_gcn_material_destroy(material);
            }
            svbrdf_gcn_capture_destroy(capture);
            svbrdf_gcn_model_destroy(model);
        }
    }
}
