//! The networks: that of the paper, a NAFNet encoder and decoder with a graph convolution over the photos' features and per-map adapters; and
//! the photo graph, which takes any number of photos.

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
mod photo_graph;
mod scalar;
pub(crate) mod tape;
mod weights;

pub use adapters::Adapters;
pub use config::{Gcn, NetworkConfig};
pub use decode::Decoding;
pub use model::{Code, DecoderTrace, Model, Network};
pub use params::AdapterParams;
#[cfg(feature = "train")]
pub(crate) use photo_graph::{INPUTS, PhotoView};
pub use photo_graph::{Mirror, PhotoGraph, PhotoGraphConfig, Prediction};
