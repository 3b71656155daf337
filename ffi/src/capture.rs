//! Photos and where camera and light stood.

use std::ffi::{CStr, CString, c_char};

use svbrdf_gcn::acquire::Acquisition;
use svbrdf_gcn::{Capture, CaptureOptions, Photo, PhotoPixels, Transfer};

use crate::guard::{borrow, borrow_mut, guard, guard_value, path};
use crate::handle::{Handle, destroy, expect_out, give, string_at};
use crate::image::{HostImage, svbrdf_gcn_image_view, view_of};
use crate::options::{read, read_or_defaults, svbrdf_gcn_capture_options, svbrdf_gcn_shot, write};
use crate::status::{Failure, Result, c_string, svbrdf_gcn_status};

/// Photos of one sample, all of the same size, and where camera and light stood for each.
pub struct svbrdf_gcn_capture {
    source: Source,
    warnings: Vec<CString>,
    report_json: CString,
}

impl Handle for svbrdf_gcn_capture {}

/// Where photos come from.
enum Source {
    Disk(Capture),
    Host(Host),
    Acquired(Acquisition),
}

/// Photos of the host.
struct Host {
    patch_size: f64,
    transfer: Transfer,
    white_level: Option<f32>,
    options: CaptureOptions,
    /// `None` until the first photo is there.
    capture: Option<Capture>,
}

impl svbrdf_gcn_capture {
    fn new(source: Source) -> Self {
        let mut made = Self { source, warnings: Vec::new(), report_json: c_string("null") };
        made.warnings = warnings(made.any());
        made
    }

    pub(crate) fn acquired(acquisition: Acquisition) -> Result<Self> {
        let report = serde_json::to_string(&acquisition.report).map_err(|error| Failure::invalid("report", error))?;
        let warnings = acquisition.report.warnings.iter().map(|warning| c_string(warning)).collect();
        Ok(Self { source: Source::Acquired(acquisition), warnings, report_json: c_string(&report) })
    }

    pub(crate) fn acquisition(&self) -> Result<&Acquisition> {
        match &self.source {
            Source::Acquired(acquisition) => Ok(acquisition),
            _ => Err(Failure::invalid("capture", "expected one that svbrdf_gcn_acquire made, got another")),
        }
    }

    pub(crate) fn report_json(&self) -> &CStr {
        &self.report_json
    }

    /// The capture, if there is a photo.
    fn any(&self) -> Option<&Capture> {
        match &self.source {
            Source::Disk(capture) => Some(capture),
            Source::Host(host) => host.capture.as_ref(),
            Source::Acquired(acquisition) => Some(&acquisition.capture),
        }
    }

    pub(crate) fn capture(&self) -> Result<&Capture> {
        self.any().ok_or_else(|| Failure::invalid("capture", "expected at least one photo, got 0"))
    }

    pub(crate) fn photo(&self, index: usize) -> Result<&Photo> {
        let photos = self.any().map_or(&[][..], Capture::photos);
        photos
            .get(index)
            .ok_or_else(|| Failure::invalid("index", format!("photo {index} of a capture of {} photos", photos.len())))
    }
}

fn warnings(capture: Option<&Capture>) -> Vec<CString> {
    capture.map_or(&[][..], Capture::warnings).iter().map(|warning| c_string(warning)).collect()
}

/// Reads a capture from disk: a folder, or a JSON file, as the command line does. `path_utf8` is UTF-8; `options` may be NULL. Destroy the
/// capture with `svbrdf_gcn_capture_destroy`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_capture_open(
    path_utf8: *const c_char,
    options: *const svbrdf_gcn_capture_options,
    out: *mut *mut svbrdf_gcn_capture,
) -> svbrdf_gcn_status {
    guard(|| {
        expect_out(out)?;
        // SAFETY: NULL or a string, and NULL or options, says the caller.
        let (path, options) = unsafe { (path("path_utf8", path_utf8)?, read_or_defaults("options", options)?) };
        if options.white_level != 0.0 {
            return Err(Failure::invalid(
                "white_level",
                format!("a capture on disk states its own: expected 0, got {}", options.white_level),
            ));
        }
        // SAFETY: NULL or as many views as the caller said, NULL or a living token.
        let capture = Capture::open_with(path, &unsafe { options.capture_options() }?)?;
        // SAFETY: not NULL.
        unsafe { give(out, svbrdf_gcn_capture::new(Source::Disk(capture))) };
        Ok(())
    })
}

/// Makes a capture without photos, for pixels of the host; add them with `svbrdf_gcn_capture_add_photo`.
///
/// `patch_size` is the width of the patch that the photos show, in the unit of the positions. `options` state the `transfer` function of the
/// pixels, and may state `size` and `white_level`; `views` are for captures on disk. Values out of range are found when the first photo is added. Destroy the capture with `svbrdf_gcn_capture_destroy`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_capture_create(
    patch_size: f64,
    options: *const svbrdf_gcn_capture_options,
    out: *mut *mut svbrdf_gcn_capture,
) -> svbrdf_gcn_status {
    guard(|| {
        expect_out(out)?;
        // SAFETY: NULL or options, says the caller.
        let theirs = unsafe { read("options", options) }?;
        // SAFETY: NULL or as many views as the caller said, NULL or a living token.
        let options = unsafe { theirs.capture_options() }?;
        let Some(transfer) = options.transfer else {
            return Err(Failure::invalid(
                "transfer",
                "pixels of the host need one, got SVBRDF_GCN_TRANSFER_FROM_CAPTURE",
            ));
        };
        if options.views.is_some() {
            return Err(Failure::invalid("views", "only captures on disk have them: add the photos to be used"));
        }
        let white_level = (theirs.white_level != 0.0).then_some(theirs.white_level);
        if let Some(light_intensity) = options.light_intensity {
            return Err(Failure::invalid(
                "light_intensity",
                format!("photos of the host have theirs in their shots: expected zeros, got {light_intensity:?}"),
            ));
        }
        let host = Host { patch_size, transfer, white_level, options, capture: None };
        // SAFETY: not NULL.
        unsafe { give(out, svbrdf_gcn_capture::new(Source::Host(host))) };
        Ok(())
    })
}

/// Adds a photo to a capture made by `svbrdf_gcn_capture_create`. Pixels are copied, converted to linear light and resampled to the capture's `size` before the
/// call returns. All photos have to have the same size. If the call fails the capture stays as it was. Nobody else may use the capture meanwhile.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_capture_add_photo(
    capture: *mut svbrdf_gcn_capture,
    pixels: *const svbrdf_gcn_image_view,
    shot: *const svbrdf_gcn_shot,
) -> svbrdf_gcn_status {
    guard(|| {
        // SAFETY: NULL or a living capture that nobody else uses, says the caller.
        let handle = unsafe { borrow_mut("capture", capture) }?;
        let Source::Host(host) = &mut handle.source else {
            return Err(Failure::invalid("capture", "it was read from files and takes no more photos"));
        };
        // SAFETY: NULL or a shot, whose name is NULL or a string, says the caller.
        let (name, shot) = unsafe {
            let shot = read("shot", shot)?;
            (shot.name(host.capture.as_ref().map_or(0, Capture::len))?, shot.shot())
        };
        // SAFETY: NULL or a view of pixels that are there, says the caller.
        let image = unsafe { HostImage::read("pixels", pixels) }?;
        let HostImage { width, height, channels, .. } = image;
        let photo = PhotoPixels { name: &name, shot, width, height, channels, samples: image.samples() };
        let options = host.options.clone().in_use(host.capture.as_ref().map_or(0, Capture::memory));
        let added = Capture::from_photos(&[photo], host.patch_size, host.transfer, host.white_level, &options)?;
        match &mut host.capture {
            Some(capture) => capture.append(added)?,
            none => *none = Some(added),
        }
        handle.warnings = warnings(handle.any());
        Ok(())
    })
}

/// Destroys a capture; no-op for NULL. Nobody else may use it; materials fitted to it live on.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_capture_destroy(capture: *mut svbrdf_gcn_capture) {
    // SAFETY: NULL or a capture that is not used any more, says the caller.
    unsafe { destroy(capture) }
}

/// How many photos there are; 0 if `capture` is NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_capture_photo_count(capture: *const svbrdf_gcn_capture) -> usize {
    guard_value(0, || {
        // SAFETY: NULL or a living capture, says the caller.
        Ok(unsafe { borrow("capture", capture) }?.any().map_or(0, Capture::len))
    })
}

/// Columns of every photo after reading; 0 if there is none.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_capture_width(capture: *const svbrdf_gcn_capture) -> usize {
    guard_value(0, || {
        // SAFETY: NULL or a living capture, says the caller.
        Ok(unsafe { borrow("capture", capture) }?.any().map_or(0, Capture::width))
    })
}

/// Rows of every photo after reading; 0 if there is none.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_capture_height(capture: *const svbrdf_gcn_capture) -> usize {
    guard_value(0, || {
        // SAFETY: NULL or a living capture, says the caller.
        Ok(unsafe { borrow("capture", capture) }?.any().map_or(0, Capture::height))
    })
}

/// The pixels of photo `index` (from 0) as the fit sees them: linear RGB floats. The view is valid as long as the capture and until the next photo is added.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_capture_photo(
    capture: *const svbrdf_gcn_capture,
    index: usize,
    out: *mut svbrdf_gcn_image_view,
) -> svbrdf_gcn_status {
    guard(|| {
        // SAFETY: NULL or a living capture, and NULL or a view, says the caller.
        unsafe { view_of(&borrow("capture", capture)?.photo(index)?.image, out) }
    })
}

/// Where camera and light stood for photo `index` (from 0). `name` in it is NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_capture_shot(
    capture: *const svbrdf_gcn_capture,
    index: usize,
    out: *mut svbrdf_gcn_shot,
) -> svbrdf_gcn_status {
    guard(|| {
        // SAFETY: NULL or a living capture, and NULL or a shot, says the caller.
        unsafe {
            let shot = svbrdf_gcn_shot::from_shot(&borrow("capture", capture)?.photo(index)?.shot);
            write("out", shot, out)
        }
    })
}

/// What a user should know about how the photos were read: warning `index`, from 0, in UTF-8; NULL past the last. Valid as long as the capture and until
/// the next photo is added.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_capture_warning(capture: *const svbrdf_gcn_capture, index: usize) -> *const c_char {
    guard_value(std::ptr::null(), || {
        // SAFETY: NULL or a living capture, says the caller.
        Ok(string_at(&unsafe { borrow("capture", capture) }?.warnings, index))
    })
}
