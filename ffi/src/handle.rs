//! Handles: values that live behind a pointer until C destroys them.

use std::ffi::{CString, c_char};
use std::ptr;

use crate::guard::guard;
use crate::status::{Failure, Result};

/// A value that the library made and C only points to: the one kind of value behind a pointer from C that references are made of.
///
/// Structs that C allocates are [`SizeFirst`](crate::options::SizeFirst) and no handles: one may be shorter than ours, and a reference to more
/// memory than there is would be undefined behaviour. They are copied.
pub(crate) trait Handle {}

/// Checks the place for a new handle before anything is computed.
pub(crate) fn expect_out<T: Handle>(out: *mut *mut T) -> Result<()> {
    if out.is_null() { Err(Failure::null("out")) } else { Ok(()) }
}

/// Gives a new handle to C.
///
/// # Safety
/// `out` is not NULL and may be written.
pub(crate) unsafe fn give<T: Handle>(out: *mut *mut T, value: T) {
    // SAFETY: the caller's word.
    unsafe { out.write(Box::into_raw(Box::new(value))) }
}

/// Ends a handle; NULL is none.
///
/// # Safety
/// `handle` is NULL or came from [`give`] and is not used any more.
pub(crate) unsafe fn destroy<T: Handle>(handle: *mut T) {
    if !handle.is_null() {
        guard(|| {
            // SAFETY: made by `Box::into_raw` in `give`, and given back once.
            drop(unsafe { Box::from_raw(handle) });
            Ok(())
        });
    }
}

/// The string at `index`, or NULL.
pub(crate) fn string_at(strings: &[CString], index: usize) -> *const c_char {
    strings.get(index).map_or(ptr::null(), |text| text.as_ptr())
}
