//! From raw photos to a capture.

use std::ffi::c_char;
use std::path::PathBuf;

use svbrdf_gcn::acquire::acquire;
use svbrdf_gcn::capture::MAX_PHOTOS;

use crate::capture::svbrdf_gcn_capture;
use crate::guard::{borrow, guard, guard_value, path};
use crate::handle::{expect_out, give};
use crate::options::{read_or_defaults, svbrdf_gcn_acquire_options};
use crate::progress::{Callback, token_or_new};
use crate::status::{Failure, svbrdf_gcn_status};

/// Makes a capture of photos that show the sample in the window of a printed sheet (`svbrdf-gcn sheet`, docs/capturing.md), or of which the patch's corners are known.
///
/// `photo_paths_utf8` are the paths of `photo_count` files; `options` may be NULL for the defaults. Photos that cannot be used are left out, and named in the report
/// (`svbrdf_gcn_capture_report_json`) and among the warnings. Positions are in millimetres. Destroy the capture with `svbrdf_gcn_capture_destroy`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_acquire(
    photo_paths_utf8: *const *const c_char,
    photo_count: usize,
    options: *const svbrdf_gcn_acquire_options,
    out: *mut *mut svbrdf_gcn_capture,
) -> svbrdf_gcn_status {
    guard(|| {
        expect_out(out)?;
        // SAFETY: NULL or options whose token is NULL or lives, says the caller.
        let (options, cancel) = unsafe {
            let options = read_or_defaults("options", options)?;
            (options, token_or_new(options.cancel))
        };
        if photo_count > MAX_PHOTOS {
            return Err(Failure::invalid("photo_count", format!("expected 1 to {MAX_PHOTOS}, got {photo_count}")));
        }
        if photo_paths_utf8.is_null() && photo_count > 0 {
            return Err(Failure::null("photo_paths_utf8"));
        }
        // SAFETY: as many pointers as the caller said, each NULL or a string.
        let photo = |i: usize| unsafe { path("photo_paths_utf8", photo_paths_utf8.add(i).read_unaligned()) };
        let photos = (0..photo_count).map(|i| photo(i).map(PathBuf::from)).collect::<Result<Vec<_>, _>>()?;
        // SAFETY: NULL or a string, and NULL or eight numbers for each photo, says the caller.
        let acquire_options = unsafe { options.acquire_options(photo_count, cancel) }?;
        let mut callback = Callback::new(options.progress, options.progress_user_data);
        let acquisition = acquire(&photos, &acquire_options, &mut |progress| callback.call(progress));
        callback.check()?;
        let capture = svbrdf_gcn_capture::acquired(acquisition?)?;
        // SAFETY: not NULL.
        unsafe { give(out, capture) };
        Ok(())
    })
}

/// What `svbrdf_gcn_acquire` found, as JSON: `photos`, those `left_out` with the reason, `lenses`, `warnings`; `assumptions` where there was no sheet. "null" for captures that came about otherwise; NULL if
/// `capture` is. Valid as long as the capture.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_capture_report_json(capture: *const svbrdf_gcn_capture) -> *const c_char {
    guard_value(std::ptr::null(), || {
        // SAFETY: NULL or a living capture, says the caller.
        Ok(unsafe { borrow("capture", capture) }?.report_json().as_ptr())
    })
}

/// Writes a capture that `svbrdf_gcn_acquire` made to a folder: `capture.json`, the rectified photos as OpenEXR, for each with saturated pixels a PNG that says which, and `contact-sheet.png`.
/// Others are `SVBRDF_GCN_ERR_INVALID_ARGUMENT`, and so is a folder whose files are not ours.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_capture_save(
    capture: *const svbrdf_gcn_capture,
    folder_utf8: *const c_char,
) -> svbrdf_gcn_status {
    guard(|| {
        // SAFETY: NULL or a living capture, and NULL or a string, says the caller.
        let (capture, folder) = unsafe { (borrow("capture", capture)?, path("folder_utf8", folder_utf8)?) };
        Ok(capture.acquisition()?.save(folder)?)
    })
}
