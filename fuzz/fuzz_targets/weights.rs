//! Any bytes as a weights file: an error or a model, never a panic or a huge allocation.
#![no_main]

use libfuzzer_sys::fuzz_target;
use svbrdf_gcn::nn::Model;

fuzz_target!(|bytes: &[u8]| {
    drop(Model::from_bytes(bytes));
});
