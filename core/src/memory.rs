//! Memory whose size comes from outside: asked for, never taken for granted.

use crate::error::{Error, Result};

/// Bytes a run may use: what the caller allows, or three quarters of what is free.
pub(crate) fn allowed(max_memory: Option<u64>) -> u64 {
    max_memory.unwrap_or_else(|| {
        let mut system = sysinfo::System::new();
        system.refresh_memory();
        let free = match system.available_memory() {
            // A machine that does not tell sets no limit.
            0 => return u64::MAX,
            free => free.min(group_free(&system)),
        };
        free / 4 * 3
    })
}

/// What the limit of a container leaves.
fn group_free(system: &sysinfo::System) -> u64 {
    system.cgroup_limits().map_or(u64::MAX, |limits| limits.total_memory.saturating_sub(limits.rss))
}

/// # Errors
/// [`Error::OutOfMemory`] with both values if `needed` bytes for `what` are more than `allowed`.
pub(crate) fn check(what: &str, needed: u64, allowed: u64) -> Result<()> {
    if needed <= allowed {
        return Ok(());
    }
    Err(Error::OutOfMemory { what: what.to_owned(), needed, allowed: Some(allowed) })
}

/// An empty vector with room for `len` values.
///
/// # Errors
/// [`Error::OutOfMemory`] if the system refuses it.
pub(crate) fn reserved<T>(len: usize) -> Result<Vec<T>> {
    let mut values = Vec::new();
    values.try_reserve_exact(len).map_err(|_| Error::OutOfMemory {
        what: format!("{len} values"),
        needed: (len as u64).saturating_mul(size_of::<T>() as u64),
        allowed: None,
    })?;
    Ok(values)
}

/// `len` values that are all `value`.
///
/// # Errors
/// As [`reserved`].
pub(crate) fn filled<T: Clone>(value: T, len: usize) -> Result<Vec<T>> {
    let mut values = reserved(len)?;
    values.resize(len, value);
    Ok(values)
}

/// The values of an iterator that has about `len` of them.
///
/// # Errors
/// As [`reserved`].
pub(crate) fn collected<T>(len: usize, values: impl IntoIterator<Item = T>) -> Result<Vec<T>> {
    let mut collected = reserved(len)?;
    collected.extend(values);
    Ok(collected)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_machine_has_is_an_error() {
        for len in [usize::MAX, usize::MAX / 4, usize::MAX >> 4] {
            let error = filled(0.0f32, len).unwrap_err();
            assert!(matches!(error, Error::OutOfMemory { allowed: None, .. }), "{error}");
            assert!(error.to_string().contains(&len.to_string()), "{error}");
        }
        assert_eq!(filled(7u8, 3).unwrap(), [7; 3]);
    }

    #[test]
    fn the_limit_and_the_need_are_named() {
        assert!(check("a run", 10, 10).is_ok());
        let message = check("a run", 11, 10).unwrap_err().to_string();
        assert_eq!(message, "max_memory: a run needs about 11 bytes, allowed are 10");
        assert_eq!(allowed(Some(5)), 5);
        assert!(allowed(None) > 0);
    }
}
