//! How much memory a run may use.

use crate::error::{Error, Result};

/// Bytes a run may use: what the caller allows, or three quarters of what is free.
pub(crate) fn allowed(max_memory: Option<u64>) -> u64 {
    max_memory.unwrap_or_else(|| {
        let mut system = sysinfo::System::new();
        system.refresh_memory();
        // A machine that does not tell sets no limit.
        match system.available_memory() {
            0 => u64::MAX,
            free => free / 4 * 3,
        }
    })
}

/// # Errors
/// [`Error::OutOfMemory`] with both values if `needed` is over what [`allowed`] says.
pub(crate) fn check(needed: u64, max_memory: Option<u64>) -> Result<()> {
    let allowed = allowed(max_memory);
    if needed > allowed { Err(Error::OutOfMemory { needed, allowed }) } else { Ok(()) }
}
