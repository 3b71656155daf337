//! Names the shared library as programs will look for it.

fn main() {
    let major = std::env::var("CARGO_PKG_VERSION_MAJOR").unwrap_or_default();
    if std::env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "linux") {
        println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libsvbrdf_gcn.so.{major}");
    }
    println!("cargo::rerun-if-changed=build.rs");
}
