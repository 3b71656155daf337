//! The network: NAFNet encoder and decoder with a graph convolution over the photos' features, and the per-map adapters.

mod params;

pub use params::AdapterParams;
