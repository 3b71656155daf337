//! Compiles the bridge to OpenImageIO.

use std::process::Command;

fn main() {
    let flags = Command::new("pkg-config").args(["--cflags", "--libs", "OpenImageIO"]).output();
    let flags =
        flags.ok().filter(|output| output.status.success()).and_then(|output| String::from_utf8(output.stdout).ok());
    let Some(flags) = flags else {
        panic!("OpenImageIO is not there: tools/setup.sh installs libopenimageio-dev and pkg-config");
    };
    let mut build = cxx_build::bridge("src/lib.rs");
    build.file("src/bridge.cpp").std("c++17").warnings(false);
    for flag in flags.split_whitespace() {
        if let Some(library) = flag.strip_prefix("-l") {
            println!("cargo:rustc-link-lib={library}");
        } else if let Some(folder) = flag.strip_prefix("-L") {
            println!("cargo:rustc-link-search={folder}");
        } else {
            build.flag(flag);
        }
    }
    build.compile("svbrdf_gcn_oiio_bridge");
    println!("cargo:rerun-if-changed=src/bridge.cpp");
    println!("cargo:rerun-if-changed=src/bridge.h");
}
