//! Training of the default network, a [`PhotoGraph`](crate::nn::PhotoGraph), on the CPU, as `python/training` does it with PyTorch: the same
//! configuration, materials, captures, losses and checkpoints.
//!
//! The paper (Luo et al. 2024, section 3.4) trains on the L1 distance of maps and of renderings with Adam, on renderings of synthetic materials under
//! random lights. Here `data` draws crops of photographed and procedural materials and has a camera with all its defects photograph them,
//! `losses` states what is compared, `optimiser` how parameters move, and `trainer` has both take a step on a `batch`. `run` is the loop around
//! them, and `validate` judges the network on materials that were held out. What a step sees follows from the seed and its number alone, so that a
//! training may be stopped at any step and continued by either trainer.

mod batch;
mod config;
mod data;
mod losses;
mod optimiser;
mod run;
mod start;
mod trainer;
mod validate;

#[cfg(test)]
mod tests;

pub use config::{Configuration, DataSettings, LossSettings, OptimiserSettings, Phase, ValidationSettings};
pub use data::library::Library;
pub use run::{Event, RunOptions, Summary, run};
pub use validate::{Scores, Validation};
