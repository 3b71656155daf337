//! Materials (SVBRDF maps) from flash photos.
#![cfg_attr(not(feature = "acquire"), allow(dead_code, unused_imports, reason = "what raw photos alone need"))]

pub mod acquire;
pub mod brdf;
mod cancel;
pub mod capture;
mod cholesky;
#[cfg(feature = "cli")]
pub mod cli;
pub mod color;
mod deviations;
pub mod error;
pub mod export;
pub mod fit;
mod font;
pub mod image;
pub mod io;
pub mod maps;
pub mod material;
pub mod memory;
pub mod metrics;
pub mod nn;
mod picture;
mod pool;
pub mod preview;
pub mod progress;
mod raw;
pub mod real;
pub mod render;
mod shot;
#[cfg(feature = "train")]
pub mod train;
pub mod unit;

pub use cancel::CancelToken;
pub use capture::{Capture, CaptureOptions, Photo, PhotoPixels};
pub use color::{ColorSpace, Transfer};
pub use deviations::Deviations;
pub use error::{Error, Result};
pub use export::{ExportOptions, ExportReport, ExportTarget, NormalConvention};
pub use fit::options::{FitOptions, Method, Preset, Refine, Reflectance};

pub use fit::{Fit, fit_material};
pub use image::Image;
pub use maps::{Lobe, Maps};
pub use material::Material;
pub use progress::Progress;
pub use shot::Shot;
pub use unit::Unit;
