//! The Python module `svbrdf_gcn._svbrdf_gcn`: translates between Python and the core, which computes.

mod acquire;
mod arrays;
mod capture;
mod errors;
mod fit;
mod material;
mod options;
mod training;
mod types;

/// The compiled part of ``svbrdf_gcn``.
#[pyo3::pymodule]
mod _svbrdf_gcn {
    use std::ffi::OsString;

    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::acquire::{PyAcquisition, py_acquire};
    #[pymodule_export]
    use crate::capture::PyCapture;
    #[pymodule_export]
    use crate::fit::{PyCancelToken, PyModel, PyProgress, py_fit_material};
    #[pymodule_export]
    use crate::material::{PyMaterial, PyPrincipled, map_errors, photo_errors, photo_rmse};

    #[pymodule_export]
    use crate::training::PyTrainingData;

    #[pymodule_export]
    #[expect(non_upper_case_globals, reason = "Python's name for it")]
    const __version__: &str = env!("CARGO_PKG_VERSION");

    /// Run the command line with `arguments`, the program's name first, and return its exit code.
    ///
    /// It takes over SIGINT: meant for a process of its own.
    #[pyfunction]
    fn command_line(py: Python<'_>, arguments: Vec<OsString>) -> i32 {
        py.detach(|| svbrdf_gcn::cli::main(arguments))
    }
}
