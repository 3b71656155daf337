//! From photos to maps.

pub mod adam;
pub mod descent;
pub mod progress;
