//! Trained networks.

use std::ffi::{CString, c_char};
use std::sync::Arc;

use svbrdf_gcn::nn::Model;

use crate::guard::{borrow, guard, guard_value, text};
use crate::handle::{Handle, destroy, expect_out, give};
use crate::status::{c_string, svbrdf_gcn_status};

/// The networks of a weights file. Immutable: any number of fits may use it at once.
pub struct svbrdf_gcn_model {
    pub(crate) model: Arc<Model>,
    license: CString,
}

impl Handle for svbrdf_gcn_model {}

/// Loads the networks of a weights file (UTF-8 path). NULL means the default network, which is part of the library and which a fit without
/// a model takes. Destroy the model with `svbrdf_gcn_model_destroy`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_model_load(
    weights_path_utf8: *const c_char,
    out: *mut *mut svbrdf_gcn_model,
) -> svbrdf_gcn_status {
    guard(|| {
        expect_out(out)?;
        // SAFETY: NULL or a string, says the caller.
        let model = match unsafe { text("weights_path_utf8", weights_path_utf8) }? {
            Some(path) => Arc::new(Model::load(path)?),
            None => Model::embedded()?,
        };
        let license = c_string(model.license());
        // SAFETY: not NULL.
        unsafe { give(out, svbrdf_gcn_model { model, license }) };
        Ok(())
    })
}

/// The licence the weights come under, as their file states it; NULL if `model` is. Valid as long as the model.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_model_license(model: *const svbrdf_gcn_model) -> *const c_char {
    guard_value(std::ptr::null(), || {
        // SAFETY: NULL or a living model, says the caller.
        Ok(unsafe { borrow("model", model) }?.license.as_ptr())
    })
}

/// Destroys a model; no-op for NULL. Fits that use it must have returned.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_model_destroy(model: *mut svbrdf_gcn_model) {
    // SAFETY: NULL or a model that is not used any more, says the caller.
    unsafe { destroy(model) }
}
