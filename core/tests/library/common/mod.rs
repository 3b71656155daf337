//! Where the tests find their data.

use std::io::Write;
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
        // Past the capture of test output: a skip must be seen.
        drop(writeln!(std::io::stderr(), "SKIPPED: shared/{path} is not there"));
    }
    found
}

/// A file under `tests/fixtures` of this repository.
pub fn fixture(path: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures").join(path)
}

/// A safetensors file of expected values.
pub struct Expected(Vec<u8>);

impl Expected {
    /// Reads the file.
    pub fn open(path: &std::path::Path) -> Self {
        Self(std::fs::read(path).expect("a readable file"))
    }

    /// The values of tensor `name`.
    pub fn f64(&self, name: &str) -> Vec<f64> {
        let file = safetensors::SafeTensors::deserialize(&self.0).expect("a safetensors file");
        let tensor = file.tensor(name).unwrap_or_else(|error| panic!("{name}: {error}"));
        match tensor.dtype() {
            safetensors::Dtype::F64 => tensor.data().as_chunks().0.iter().map(|&v| f64::from_le_bytes(v)).collect(),
            safetensors::Dtype::F32 => {
                tensor.data().as_chunks().0.iter().map(|&v| f32::from_le_bytes(v).into()).collect()
            }
            other => panic!("{name}: {other}"),
        }
    }

    /// Likewise, rounded.
    pub fn f32(&self, name: &str) -> Vec<f32> {
        self.f64(name).into_iter().map(|value| value as f32).collect()
    }
}

/// Length of the difference over length of `expected`.
pub fn relative_l2(got: &[f32], expected: &[f64]) -> f64 {
    assert_eq!(got.len(), expected.len());
    let off: f64 = got.iter().zip(expected).map(|(&got, expected)| (f64::from(got) - expected).powi(2)).sum();
    (off / expected.iter().map(|value| value * value).sum::<f64>()).sqrt()
}
