//! The command line; everything it does is in [`svbrdf_gcn::cli`].
fn main() {}
