//! Threads of our own. Rayon's global pool belongs to the host: a child process made by `fork` has the pool but not its threads, and waits
//! for them without end.

use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::{Error, Result};

/// The most threads that are started: more than any machine has, few enough for every system to give.
pub const MAX_THREADS: usize = 1024;

/// A pool of `threads` threads, of as many as the machine offers if `None`.
///
/// # Errors
/// [`Error::InvalidArgument`] for 0 or too many threads, or if the system does not start them.
pub(crate) fn pool(threads: Option<usize>) -> Result<ThreadPool> {
    if let Some(threads) = threads
        && !(1..=MAX_THREADS).contains(&threads)
    {
        return Err(Error::invalid("threads", format!("expected 1 to {MAX_THREADS}, got {threads}")));
    }
    ThreadPoolBuilder::new()
        .num_threads(threads.unwrap_or(0))
        .build()
        .map_err(|error| Error::invalid("threads", format!("{threads:?} threads cannot be started: {error}")))
}

/// Runs `work` on the pool whose thread calls, else on a pool made for it.
///
/// # Errors
/// As [`pool`]; what `work` returns.
pub(crate) fn inside<T: Send>(work: impl FnOnce() -> Result<T> + Send) -> Result<T> {
    if rayon::current_thread_index().is_some() { work() } else { pool(None)?.install(work) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_runs_on_threads_of_our_own_and_stays_on_those_it_is_on() {
        let threads = || Ok((rayon::current_thread_index().is_some(), rayon::current_num_threads()));
        assert!(inside(threads).unwrap().0);
        assert_eq!(pool(Some(3)).unwrap().install(|| inside(threads)).unwrap(), (true, 3));
    }
}
