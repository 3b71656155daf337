//! The command line; everything it does is in [`svbrdf_gcn::cli`].

fn main() {
    std::process::exit(svbrdf_gcn::cli::main(std::env::args_os()));
}
