//! Training of the default network, as `python/training` does it with PyTorch: the same configuration, materials, captures, losses and checkpoints.
//!
//! The paper (section 3.4) trains on renderings of synthetic materials under random lights, with the loss on maps and re-renderings. Here a step draws
//! crops of photographed and procedural materials ([`data`]), has a camera with all its defects photograph them (`data::camera`), and moves the
//! weights against the gradient of the losses. What a step sees follows from the seed and its number alone, so that a training may be stopped and
//! continued at any step, by either trainer.

mod batch;
mod config;
#[allow(dead_code)]
mod data;

pub use config::Configuration;
