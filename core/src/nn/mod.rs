//! The network: NAFNet encoder and decoder with a graph convolution over the photos' features, and the per-map adapters.
#![allow(dead_code)]
mod kernels;
mod layout;
mod matrix;
mod nafnet;
mod ops;
mod params;
mod scalar;
mod tape;

pub use params::AdapterParams;
