//! The one way from C into Rust: pointers are checked, panics caught, messages kept.

use std::any::Any;
use std::ffi::{CStr, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::handle::Handle;
use crate::status::svbrdf_gcn_status::*;
use crate::status::{Failure, Result, set_last_error, svbrdf_gcn_status};

/// Runs the body of an exported function.
pub(crate) fn guard(body: impl FnOnce() -> Result<()>) -> svbrdf_gcn_status {
    // A body that panics leaves at worst a handle half changed, and the header allows no more than to destroy it then.
    let failure = match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => return SVBRDF_GCN_OK,
        Ok(Err(failure)) => failure,
        Err(panic) => Failure {
            status: SVBRDF_GCN_ERR_INTERNAL,
            message: format!("internal error, please report: {}", panic_message(panic.as_ref())),
        },
    };
    set_last_error(&failure.message);
    failure.status
}

/// [`guard`] for functions that return a value, `fallback` if there is none.
pub(crate) fn guard_value<T>(fallback: T, body: impl FnOnce() -> Result<T>) -> T {
    let mut value = fallback;
    guard(|| {
        value = body()?;
        Ok(())
    });
    value
}

fn panic_message(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("panic")
}

/// The value behind a handle from C.
///
/// # Safety
/// `pointer` is NULL or points to a `T` that lives and stays as it is for `'a`.
pub(crate) unsafe fn borrow<'a, T: Handle>(name: &str, pointer: *const T) -> Result<&'a T> {
    // SAFETY: the caller's word.
    unsafe { pointer.as_ref() }.ok_or_else(|| Failure::null(name))
}

/// The value behind a handle from C, to be changed.
///
/// # Safety
/// As [`borrow`], and nobody else uses the value during `'a`.
pub(crate) unsafe fn borrow_mut<'a, T: Handle>(name: &str, pointer: *mut T) -> Result<&'a mut T> {
    // SAFETY: the caller's word.
    unsafe { pointer.as_mut() }.ok_or_else(|| Failure::null(name))
}

/// The UTF-8 text behind a pointer from C, or `None` for NULL.
///
/// # Safety
/// `pointer` is NULL or points to a NUL-terminated string that lives and stays as it is for `'a`.
pub(crate) unsafe fn text<'a>(name: &str, pointer: *const c_char) -> Result<Option<&'a str>> {
    if pointer.is_null() {
        return Ok(None);
    }
    // SAFETY: not NULL; the rest is the caller's word.
    let text = unsafe { CStr::from_ptr(pointer) }.to_str();
    text.map(Some).map_err(|error| Failure::invalid(name, format!("expected UTF-8, got {error}")))
}

/// The path behind a pointer from C.
///
/// # Safety
/// As [`text`].
pub(crate) unsafe fn path<'a>(name: &str, pointer: *const c_char) -> Result<&'a str> {
    // SAFETY: the caller's word.
    unsafe { text(name, pointer) }?.ok_or_else(|| Failure::null(name))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::status::svbrdf_gcn_last_error_message;

    fn last_error() -> String {
        // SAFETY: the message is NUL-terminated and copied before the next call.
        unsafe { CStr::from_ptr(svbrdf_gcn_last_error_message()) }.to_str().unwrap().to_owned()
    }

    #[test]
    fn panics_become_a_status() {
        assert_eq!(guard(|| panic!("index {} of {}", 4, 3)), SVBRDF_GCN_ERR_INTERNAL);
        assert!(last_error().contains("index 4 of 3"), "{}", last_error());
        assert_eq!(guard(|| std::panic::panic_any(7)), SVBRDF_GCN_ERR_INTERNAL);
        assert_eq!(guard_value(5, || panic!("no value")), 5);
    }

    #[test]
    fn messages_are_per_thread_and_outlive_success() {
        assert_eq!(guard(|| Err(Failure::invalid("seed", "a\0b"))), SVBRDF_GCN_ERR_INVALID_ARGUMENT);
        std::thread::spawn(|| assert_eq!(last_error(), "")).join().unwrap();
        assert_eq!(guard(|| Ok(())), SVBRDF_GCN_OK);
        assert_eq!(last_error(), "seed: a b");
    }
}
