//! Memory whose size comes from outside: asked for, never taken for granted; and the budget of a run.

use crate::error::{Error, Result};

/// Bytes that a text states: `4000000000`, or `4G`, `500M`, `1.5G`; K, M, G and T are powers of 1024.
///
/// # Errors
/// [`Error::InvalidArgument`] for anything else.
///
/// # Example
/// ```
/// assert_eq!(svbrdf_gcn::memory::parse_bytes("1.5G")?, 3 << 29);
/// # Ok::<(), svbrdf_gcn::Error>(())
/// ```
pub fn parse_bytes(text: &str) -> Result<u64> {
    let wrong = || {
        let expected = "expected bytes such as 4000000000, 500M, 2G or 1.5G (K, M, G and T are powers of 1024)";
        Error::invalid("max_memory", format!("{expected}, got {text:?}"))
    };
    let factor = match text.chars().last().map(|letter| letter.to_ascii_uppercase()) {
        Some('K') => 1u64 << 10,
        Some('M') => 1 << 20,
        Some('G') => 1 << 30,
        Some('T') => 1 << 40,
        _ => return text.parse().map_err(|_| wrong()),
    };
    let number: f64 = text[..text.len() - 1].parse().map_err(|_| wrong())?;
    let bytes = number * factor as f64;
    // Beyond 2^63 no machine has any: what is not a number is not below it either.
    if (0.0..9e18).contains(&bytes) { Ok(bytes as u64) } else { Err(wrong()) }
}

/// What work on images takes beside them: tables, buffers of files, lists.
pub(crate) const SMALL: u64 = 1 << 20;

/// Bytes a run may use: what the caller allows, or three quarters of what is free beside `in_use`, which are the run's already.
pub(crate) fn allowed(max_memory: Option<u64>, in_use: u64) -> u64 {
    max_memory.unwrap_or_else(|| {
        let mut system = sysinfo::System::new();
        system.refresh_memory();
        let free = match system.available_memory() {
            // A machine that does not tell sets no limit.
            0 => return u64::MAX,
            free => free.min(group_free(&system)),
        };
        (free / 4 * 3).saturating_add(in_use)
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
    fn bytes_in_words() {
        for (text, bytes) in [
            ("0", 0),
            ("4000000000", 4_000_000_000),
            ("2G", 2 << 30),
            ("2g", 2 << 30),
            ("500M", 500 << 20),
            ("1.5G", 3 << 29),
            ("64k", 64 << 10),
            ("1T", 1 << 40),
            ("18446744073709551615", u64::MAX),
        ] {
            assert_eq!(parse_bytes(text).unwrap(), bytes, "{text}");
        }
        for text in
            ["", "G", "-1", "-1G", "2GB", "2 G", "1.5", "nanG", "infG", "1e30T", "18446744073709551616", "2\u{212a}"]
        {
            let message = parse_bytes(text).unwrap_err().to_string();
            assert!(message.starts_with("max_memory: expected bytes") && message.contains("1.5G"), "{message}");
        }
    }

    #[test]
    fn the_limit_and_the_need_are_named() {
        assert!(check("a run", 10, 10).is_ok());
        let message = check("a run", 11, 10).unwrap_err().to_string();
        assert!(message.starts_with("max_memory: a run needs about 11 bytes, allowed are 10: "), "{message}");
        assert_eq!((allowed(Some(5), 3), allowed(None, u64::MAX)), (5, u64::MAX));
        assert!(allowed(None, 0) > 0);
    }
}
