//! Progress of long work, and stopping it.

use std::ffi::c_void;
use std::ops::ControlFlow;

use svbrdf_gcn::progress::Stage;
use svbrdf_gcn::{CancelToken, Progress};

use crate::guard::{borrow, guard, guard_value};
use crate::handle::{Handle, destroy, expect_out, give};
use crate::status::{Failure, Result, svbrdf_gcn_status};
use svbrdf_gcn_stage::*;
use svbrdf_gcn_step::*;

/// The parts of a fit, and of `svbrdf_gcn_acquire`. Later releases may add some.
#[repr(i32)]
pub enum svbrdf_gcn_stage {
    /// The photos pass through the network once.
    SVBRDF_GCN_STAGE_ENCODE = 0,
    /// The latent code is optimised.
    SVBRDF_GCN_STAGE_LATENT = 1,
    /// The adapters are optimised.
    SVBRDF_GCN_STAGE_ADAPTERS = 2,
    /// The maps themselves are optimised.
    SVBRDF_GCN_STAGE_DIRECT = 3,
    /// The predicted maps are fitted to the photos pixel by pixel.
    SVBRDF_GCN_STAGE_FINISH = 4,
    /// Photos of a printed sheet become a capture.
    SVBRDF_GCN_STAGE_ACQUIRE = 5,
    /// A part this release has no number for.
    SVBRDF_GCN_STAGE_OTHER = -1,
}

/// What a progress callback returns. Anything else stops the work with `SVBRDF_GCN_ERR_INVALID_ARGUMENT`.
#[repr(i32)]
pub enum svbrdf_gcn_step {
    /// Go on.
    SVBRDF_GCN_CONTINUE = 0,
    /// Stop; the call then returns `SVBRDF_GCN_CANCELLED`.
    SVBRDF_GCN_STOP = 1,
}

/// Where a fit, or `svbrdf_gcn_acquire`, stands. The library makes it; fields may be added at its end.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct svbrdf_gcn_progress {
    /// The size of the library's struct.
    pub struct_size: usize,
    /// A `svbrdf_gcn_stage`.
    pub stage: i32,
    /// 1 if `loss` means something.
    pub has_loss: i32,
    /// Steps of this stage that are done.
    pub step: usize,
    /// Steps this stage takes at most.
    pub steps: usize,
    /// The loss before the last step.
    pub loss: f64,
}

/// Called on the thread that called `svbrdf_gcn_fit_material`, at least after every step and some ten times a second in long ones, or `svbrdf_gcn_acquire`, some
/// twenty times a second and at the end; never after that returned. `progress` is valid during the call. Returns a `svbrdf_gcn_step`. It must not throw, jump out, or
/// destroy what the call uses.
pub type svbrdf_gcn_progress_fn =
    Option<unsafe extern "C" fn(user_data: *mut c_void, progress: *const svbrdf_gcn_progress) -> i32>;

/// The host's callback.
pub(crate) struct Callback {
    pub function: svbrdf_gcn_progress_fn,
    pub user_data: *mut c_void,
    /// What it returned that is no `svbrdf_gcn_step`.
    refused: Option<i32>,
}

impl Callback {
    pub fn new(function: svbrdf_gcn_progress_fn, user_data: *mut c_void) -> Self {
        Self { function, user_data, refused: None }
    }

    pub fn call(&mut self, progress: &Progress) -> ControlFlow<()> {
        const CONTINUE: i32 = SVBRDF_GCN_CONTINUE as i32;
        const STOP: i32 = SVBRDF_GCN_STOP as i32;
        let Some(function) = self.function else { return ControlFlow::Continue(()) };
        let stage = match progress.stage {
            Stage::Encode => SVBRDF_GCN_STAGE_ENCODE,
            Stage::Latent => SVBRDF_GCN_STAGE_LATENT,
            Stage::Adapters => SVBRDF_GCN_STAGE_ADAPTERS,
            Stage::Direct => SVBRDF_GCN_STAGE_DIRECT,
            Stage::Finish => SVBRDF_GCN_STAGE_FINISH,
            Stage::Acquire => SVBRDF_GCN_STAGE_ACQUIRE,
            _ => SVBRDF_GCN_STAGE_OTHER,
        };
        let report = svbrdf_gcn_progress {
            struct_size: size_of::<svbrdf_gcn_progress>(),
            stage: stage as i32,
            has_loss: progress.loss.is_some().into(),
            step: progress.step,
            steps: progress.steps,
            loss: progress.loss.unwrap_or(0.0),
        };
        // SAFETY: the host's function, called as the header says.
        match unsafe { function(self.user_data, &raw const report) } {
            CONTINUE => ControlFlow::Continue(()),
            STOP => ControlFlow::Break(()),
            other => {
                self.refused = Some(other);
                ControlFlow::Break(())
            }
        }
    }

    /// Whether all that was returned meant something.
    pub fn check(&self) -> Result<()> {
        match self.refused {
            Some(value) => Err(Failure::invalid(
                "progress",
                format!("expected SVBRDF_GCN_CONTINUE (0) or SVBRDF_GCN_STOP (1) to be returned, got {value}"),
            )),
            None => Ok(()),
        }
    }
}

/// A flag that stops fits, `svbrdf_gcn_acquire` and the reading of photos. It may be used from any thread, at any time while it lives. Once cancelled it stays cancelled:
/// what is started with it returns `SVBRDF_GCN_CANCELLED` at once; take a new one for the next run.
pub struct svbrdf_gcn_cancel_token(CancelToken);

impl Handle for svbrdf_gcn_cancel_token {}

/// The token behind a pointer from C, one that nobody cancels for NULL.
///
/// # Safety
/// `token` is NULL or a living token.
pub(crate) unsafe fn token_or_new(token: *const svbrdf_gcn_cancel_token) -> CancelToken {
    // SAFETY: the caller's word.
    unsafe { token.as_ref() }.map_or_else(CancelToken::new, |token| token.0.clone())
}

/// Makes a token that is not cancelled. Destroy it with `svbrdf_gcn_cancel_token_destroy`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_cancel_token_create(out: *mut *mut svbrdf_gcn_cancel_token) -> svbrdf_gcn_status {
    guard(|| {
        expect_out(out)?;
        // SAFETY: not NULL.
        unsafe { give(out, svbrdf_gcn_cancel_token(CancelToken::new())) };
        Ok(())
    })
}

/// Asks every fit that was started with the token to stop, and those that will be. Returns at once, from any thread.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_cancel_token_cancel(token: *const svbrdf_gcn_cancel_token) -> svbrdf_gcn_status {
    guard(|| {
        // SAFETY: NULL or a living token, says the caller.
        unsafe { borrow("token", token) }?.0.cancel();
        Ok(())
    })
}

/// 1 if the token was cancelled, 0 if not or if it is NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_cancel_token_is_cancelled(token: *const svbrdf_gcn_cancel_token) -> i32 {
    guard_value(0, || {
        // SAFETY: NULL or a living token, says the caller.
        Ok(unsafe { borrow("token", token) }?.0.is_cancelled().into())
    })
}

/// Destroys a token; no-op for NULL. Fits that use it must have returned.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn svbrdf_gcn_cancel_token_destroy(token: *mut svbrdf_gcn_cancel_token) {
    // SAFETY: NULL or a token that is not used any more, says the caller.
    unsafe { destroy(token) }
}
