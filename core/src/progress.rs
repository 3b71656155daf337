//! Progress, cancellation, and the handle through which long work reports both.

use std::ops::ControlFlow;

use rayon::prelude::*;

pub use crate::cancel::CancelToken;
use crate::error::{Error, Result};

/// The parts of a fit, in the order they run, after that of making a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Stage {
    /// Photos of a printed sheet become a capture.
    Acquire,
    /// The photos pass through the network once.
    Encode,
    /// Adam on the latent code (paper, Eq. 6).
    Latent,
    /// Adam on the parameters of the per-map adapters (paper, Eq. 7).
    Adapters,
    /// Optimisation of the maps themselves.
    Direct,
    /// The predicted maps are fitted to the photos pixel by pixel.
    Finish,
}

impl Stage {
    /// The name used in files and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Acquire => "acquire",
            Self::Encode => "encode",
            Self::Latent => "latent",
            Self::Adapters => "adapters",
            Self::Direct => "direct",
            Self::Finish => "finish",
        }
    }
}

/// Where a fit stands.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Progress {
    /// The stage that is running.
    pub stage: Stage,
    /// Steps of this stage that are done.
    pub step: usize,
    /// Steps this stage will take at most.
    pub steps: usize,
    /// The loss before the last step, where the stage has one.
    pub loss: Option<f64>,
}

/// The callback of a fit: called at least after every step and, during long steps, some ten times a second with unchanged values.
pub type ProgressFn<'a> = dyn FnMut(&Progress) -> ControlFlow<()> + 'a;

/// What long work holds in order to report progress and to notice that it should stop.
pub struct Control<'a> {
    callback: &'a mut ProgressFn<'a>,
    token: CancelToken,
    last: Progress,
}

impl<'a> Control<'a> {
    /// A control that reports to `callback` and stops when it breaks or `token` is cancelled.
    pub fn new(callback: &'a mut ProgressFn<'a>, token: CancelToken) -> Self {
        let last = Progress { stage: Stage::Encode, step: 0, steps: 1, loss: None };
        Self { callback, token, last }
    }

    /// What `work` does under a control that reports to nobody and stops when `token` is cancelled.
    pub(crate) fn silently<T>(token: CancelToken, work: impl FnOnce(&mut Control<'_>) -> T) -> T {
        let mut callback = |_: &Progress| ControlFlow::Continue(());
        work(&mut Control::new(&mut callback, token))
    }

    /// Reports that `step` of `steps` steps of `stage` are done.
    ///
    /// # Errors
    /// [`Error::Cancelled`] if the caller wants to stop.
    pub fn report(&mut self, stage: Stage, step: usize, steps: usize, loss: Option<f64>) -> Result<()> {
        self.last = Progress { stage, step, steps, loss };
        self.poll()
    }

    /// What `work` makes of each of `items`, in their order: as many at a time as the pool has threads. It is polled between them.
    ///
    /// # Errors
    /// As [`Control::report`], and those of `work`.
    pub(crate) fn each<T: Sync, U: Send>(
        &mut self,
        items: &[T],
        work: impl Fn(&T, &mut Control<'_>) -> Result<U> + Sync,
    ) -> Result<Vec<U>> {
        let mut done = Vec::with_capacity(items.len());
        for items in items.chunks(rayon::current_num_threads()) {
            self.poll()?;
            let token = &self.token;
            let one = |item: &T| Control::silently(token.clone(), |control| work(item, control));
            done.extend(items.par_iter().map(one).collect::<Result<Vec<U>>>()?);
        }
        Ok(done)
    }

    /// To be called between the parts of a step that takes longer than some 100 ms.
    ///
    /// # Errors
    /// As [`Control::report`].
    pub fn poll(&mut self) -> Result<()> {
        if self.token.is_cancelled() || (self.callback)(&self.last).is_break() {
            return Err(Error::Cancelled);
        }
        Ok(())
    }
}
