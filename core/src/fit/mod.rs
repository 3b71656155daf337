//! From photos to maps.

pub mod adam;
mod cluster;
pub mod descent;
pub mod options;
pub mod progress;
