//! The C interface: translates, and leaves all computing to the core.
//!
//! Types and functions bear the names they have in `include/svbrdf_gcn/svbrdf_gcn.h`, which is made of them; their comments are
//! written for its readers.

#![allow(unsafe_code, reason = "pointers come from C; each use has a SAFETY comment")]
#![allow(non_camel_case_types, reason = "the names are those of the C header")]
#![allow(clippy::missing_safety_doc, reason = "the header says at its top what every function asks of its arguments")]

#[cfg(not(panic = "unwind"))]
compile_error!("the guard at the boundary catches panics, so they have to unwind");

pub mod acquire;
pub mod capture;
pub mod guard;
pub mod handle;
pub mod image;
pub mod material;
pub mod model;
pub mod options;
pub mod progress;
pub mod status;

use std::ffi::c_char;

/// The version of this interface. It grows when a function or struct changes so that programs have to be compiled again.
pub const SVBRDF_GCN_ABI_VERSION: u32 = 1;

/// The interface version of the library that is loaded; compare it with `SVBRDF_GCN_ABI_VERSION`.
#[unsafe(no_mangle)]
pub extern "C" fn svbrdf_gcn_abi_version() -> u32 {
    SVBRDF_GCN_ABI_VERSION
}

/// The version of the library that is loaded, as `SVBRDF_GCN_VERSION` spells it. Never NULL, valid for ever.
#[unsafe(no_mangle)]
pub extern "C" fn svbrdf_gcn_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}
