//! The committed C header is what cbindgen makes of this crate.
//!
//! `SVBRDF_GCN_WRITE_HEADER=1 cargo test -p svbrdf-gcn-ffi --test header` (`make header`) writes it.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::path::Path;

/// What the header says before its declarations.
const PREAMBLE: &str = "\
/* svbrdf-gcn: material maps from flash photos. Generated from ffi/src by `make header`; do not edit.
 *
 * Every function that can fail returns a status; svbrdf_gcn_last_error_message() has the words for it. Results come last in the arguments and are written
 * only where the status is SVBRDF_GCN_OK.
 *
 * Handles (svbrdf_gcn_capture, _material, _model, _cancel_token) are made by one function and ended by the _destroy of their type; what is lent of them
 * (views, strings) ends with them. Arguments are borrowed for the call. Strings and paths are UTF-8.
 *
 * Structs begin with their size: fill them by their _init function, which takes sizeof, and then change what you want. Fields are only ever added at the end, so that
 * a program and a library of different releases understand each other. Enums are passed as int32_t; unknown values are errors.
 *
 * Threads: a const handle may be used by any number of threads at once. Whoever changes or destroys a handle must be alone with it. Error messages are kept per
 * thread. No exception and no longjmp may pass through a callback.
 */";

#[test]
fn header_is_up_to_date() {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut config = cbindgen::Config::from_file(manifest.join("cbindgen.toml")).unwrap();
    config.header = Some(PREAMBLE.to_owned());
    let [major, minor, patch] =
        [env!("CARGO_PKG_VERSION_MAJOR"), env!("CARGO_PKG_VERSION_MINOR"), env!("CARGO_PKG_VERSION_PATCH")];
    config.after_includes = Some(format!(
        "\n/** The version this header belongs to. */\n#define SVBRDF_GCN_VERSION \"{}\"\n#define SVBRDF_GCN_VERSION_MAJOR {major}\n\
         #define SVBRDF_GCN_VERSION_MINOR {minor}\n#define SVBRDF_GCN_VERSION_PATCH {patch}",
        env!("CARGO_PKG_VERSION")
    ));
    let mut made = Vec::new();
    cbindgen::Builder::new().with_config(config).with_crate(manifest).generate().unwrap().write(&mut made);
    let made = String::from_utf8(made).unwrap();

    let path = manifest.join("../include/svbrdf_gcn/svbrdf_gcn.h");
    if std::env::var_os("SVBRDF_GCN_WRITE_HEADER").is_some() {
        std::fs::write(&path, &made).unwrap();
    }
    let committed = std::fs::read_to_string(&path).unwrap();
    let first = made.lines().zip(committed.lines()).find(|(made, committed)| made != committed);
    assert!(made == committed, "{} is out of date; run `make header`. First difference: {first:?}", path.display());
}
