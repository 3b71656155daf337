//! The network: NAFNet encoder and decoder with a graph convolution over the photos' features, and the per-map adapters.

mod adapters;
mod config;
mod decode;
mod kernels;
mod layout;
mod matrix;
mod model;
mod nafnet;
mod network;
mod ops;
mod params;
mod scalar;
mod tape;
mod weights;

pub use adapters::Adapters;
pub use config::{Gcn, NetworkConfig};
pub use decode::Decoding;
pub use model::{Code, DecoderTrace, Model, Network};
pub use params::AdapterParams;
