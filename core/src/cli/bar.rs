//! The progress bar.

use indicatif::{ProgressBar, ProgressStyle};

use crate::progress::Progress;

/// Stage, steps, loss, time left.
pub struct Bar {
    bar: ProgressBar,
    stage: &'static str,
}

impl Bar {
    pub fn new(hidden: bool) -> Self {
        let bar = if hidden { ProgressBar::hidden() } else { ProgressBar::new(1) };
        if let Ok(style) = ProgressStyle::with_template("{prefix:<9}{bar:40} {pos:>5}/{len} {msg}  {eta} left") {
            bar.set_style(style);
        }
        Self { bar, stage: "" }
    }

    pub fn show(&mut self, progress: &Progress) {
        let stage = progress.stage.name();
        if stage != self.stage {
            self.stage = stage;
            self.bar.reset();
            self.bar.set_prefix(stage);
        }
        self.bar.set_length(progress.steps as u64);
        if let Some(loss) = progress.loss {
            self.bar.set_message(format!("loss {loss:.4}"));
        }
        self.bar.set_position(progress.step as u64);
    }

    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}
