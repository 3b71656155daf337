//! Stopping long work from another thread.

use std::io::{self, BufRead, Read, Seek, SeekFrom};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::error::{Error, Result};

/// A flag that stops running work from any thread; clones share it.
#[derive(Clone, Debug, Default)]
pub struct CancelToken(Arc<Flag>);

#[derive(Debug, Default)]
struct Flag {
    cancelled: AtomicBool,
    parent: Option<CancelToken>,
    #[cfg(test)]
    looks: countdown::Countdown,
}

impl CancelToken {
    /// A token that is not cancelled.
    pub fn new() -> Self {
        Self::default()
    }

    /// A token that is cancelled when this one is, and alone when it is itself.
    pub fn child(&self) -> Self {
        Self(Flag { parent: Some(self.clone()), ..Flag::default() }.into())
    }

    /// Asks every run that holds this token to stop.
    pub fn cancel(&self) {
        self.0.cancelled.store(true, Ordering::Relaxed);
    }

    /// Whether [`CancelToken::cancel`] was called, of this token or of one that it is a child of.
    pub fn is_cancelled(&self) -> bool {
        #[cfg(test)]
        if self.0.looks.is_over() {
            self.cancel();
        }
        self.0.cancelled.load(Ordering::Relaxed) || self.0.parent.as_ref().is_some_and(Self::is_cancelled)
    }

    /// # Errors
    /// [`Error::Cancelled`] if [`CancelToken::is_cancelled`].
    pub(crate) fn check(&self) -> Result<()> {
        if self.is_cancelled() { Err(Error::Cancelled) } else { Ok(()) }
    }
}

/// A reader that fails once its token is cancelled. It gives little at a time, so that whoever decodes what it gives is soon stopped, however far
/// the bytes unfold.
pub(crate) struct Cancellable<'a, R> {
    inner: R,
    cancel: &'a CancelToken,
}

/// Bytes given at a time: at the 1032 : 1 of deflate, 16 MiB.
const STEP: usize = 1 << 14;

impl<'a, R> Cancellable<'a, R> {
    pub fn new(inner: R, cancel: &'a CancelToken) -> Self {
        Self { inner, cancel }
    }

    fn check(&self) -> io::Result<()> {
        // Not `Interrupted`, after which readers try again.
        if self.cancel.is_cancelled() { Err(io::Error::other("cancelled")) } else { Ok(()) }
    }
}

impl<R: Read> Read for Cancellable<'_, R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        self.check()?;
        let step = out.len().min(STEP);
        self.inner.read(&mut out[..step])
    }
}

impl<R: BufRead> BufRead for Cancellable<'_, R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.check()?;
        let bytes = self.inner.fill_buf()?;
        Ok(&bytes[..bytes.len().min(STEP)])
    }

    fn consume(&mut self, count: usize) {
        self.inner.consume(count);
    }
}

impl<R: Seek> Seek for Cancellable<'_, R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.inner.seek(to)
    }
}

/// Tokens that are cancelled at a certain look at them.
#[cfg(test)]
mod countdown {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::{CancelToken, Flag};

    /// Looks that were taken, and with which of them it is over; never for 0.
    #[derive(Debug, Default)]
    pub struct Countdown {
        taken: AtomicUsize,
        last: usize,
    }

    impl Countdown {
        pub fn is_over(&self) -> bool {
            let taken = self.taken.fetch_add(1, Ordering::Relaxed) + 1;
            self.last > 0 && taken >= self.last
        }
    }

    impl CancelToken {
        /// A token that is cancelled with the `last` look at it, counted from 1.
        pub(crate) fn at_look(last: usize) -> Self {
            let looks = Countdown { last, ..Countdown::default() };
            Self(Flag { looks, ..Flag::default() }.into())
        }

        /// How often it was looked at.
        pub(crate) fn looks(&self) -> usize {
            self.0.looks.taken.load(Ordering::Relaxed)
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    #[test]
    fn children_are_cancelled_with_their_parent_and_alone() {
        let parent = CancelToken::new();
        let (one, other) = (parent.child(), parent.child().child());
        one.cancel();
        assert_eq!([&parent, &one, &other].map(CancelToken::is_cancelled), [false, true, false]);
        parent.cancel();
        assert_eq!([&parent, &one, &other].map(CancelToken::is_cancelled), [true; 3]);
    }

    #[test]
    fn a_reader_ends_at_the_look_that_cancels() {
        let bytes: Vec<u8> = (0..3 * STEP + 1).map(|i| i as u8).collect();
        for (last, expected) in [(1, 0), (2, STEP), (3, 2 * STEP), (9, bytes.len())] {
            let cancel = CancelToken::at_look(last);
            let mut reader = Cancellable::new(&*bytes, &cancel);
            let (mut read, mut out) = (Vec::new(), vec![0; bytes.len()]);
            while let Ok(count @ 1..) = reader.read(&mut out) {
                read.extend_from_slice(&out[..count]);
            }
            assert_eq!(read, bytes[..expected]);
            assert_eq!(matches!(cancel.check(), Err(Error::Cancelled)), last < 9);
        }
        let cancel = CancelToken::at_look(3);
        let mut reader = Cancellable::new(Cursor::new(&bytes), &cancel);
        for start in [0, STEP] {
            assert_eq!(reader.fill_buf().unwrap(), &bytes[start..start + STEP]);
            reader.consume(STEP);
        }
        assert!(reader.fill_buf().is_err());
    }
}
