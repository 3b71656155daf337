//! Where the tests find their data.

use std::path::PathBuf;

/// A file or folder of the measuring data that lies beside the repository in `shared/`, or `None` (with a message) where there is none.
///
/// Set `SVBRDF_GCN_REQUIRE_SHARED=1` to turn its absence into a failure.
pub fn shared(path: &str) -> Option<PathBuf> {
    let manifest = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let found =
        manifest.ancestors().map(|folder| folder.join("shared").join(path)).find(|candidate| candidate.exists());
    if found.is_none() {
        let required = std::env::var_os("SVBRDF_GCN_REQUIRE_SHARED").is_some_and(|value| value == "1");
        assert!(!required, "shared/{path} is required and absent");
        eprintln!("SKIPPED: shared/{path} is not there");
    }
    found
}

/// A file under `tests/fixtures` of this repository.
pub fn fixture(path: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures").join(path)
}
