//! From photos to maps.

pub mod progress;
