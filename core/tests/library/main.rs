//! Tests of the library's public interface, in one program: each of their own would be compiled and linked alone.
//!
//! Beside it stand those that need a process of their own: the command line, the global pool of threads, peak memory.
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

mod common;
#[allow(dead_code, reason = "shared with other programs")]
#[path = "common/files.rs"]
mod files;

mod adapters_gradients;
mod brdf_fixtures;
mod capture_layouts;
mod export;
mod fit_direct;
mod io_colors;
mod io_formats;
mod io_material;
mod official_network;
mod render_gradients;
mod render_properties;
mod sample;
