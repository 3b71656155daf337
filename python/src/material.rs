//! Materials.

use std::path::PathBuf;
use std::sync::Arc;

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use serde_json::Value;
use svbrdf_gcn::export::principled::Principled;
use svbrdf_gcn::fit::Fit;
use svbrdf_gcn::image::Image;
use svbrdf_gcn::io::material::{
    LoadOptions, MATERIAL_JSON, MaterialEncoding, MaterialFormat, SaveOptions, read_deviations, read_report,
};
use svbrdf_gcn::metrics::MapErrors;
use svbrdf_gcn::preview::material_png;
use svbrdf_gcn::{
    Deviations, ExportOptions, ExportTarget, Material, NormalConvention, Photo, Shot, Unit, metrics, render,
};

use crate::arrays::{ImageArray, image, intensities, triple};
use crate::capture::{self, PyCapture};
use crate::errors::detached;
use crate::options::{Given, choice, maybe, maybe_count};
use crate::types::{ArrayLike, Json, json_error};

/// The maps of a material.
///
/// ``fit_material`` and ``Material.load`` make materials; the constructor takes maps of your own, which are copied.
///
/// Parameters
/// ----------
/// diffuse_albedo : ndarray of float, shape (H, W, 3), linear, 0 to 1
/// specular_albedo : ndarray of float, shape (H, W, 3), linear, 0 to 1
///     Reflectance at normal incidence (F0).
/// roughness : ndarray of float, shape (H, W, 1) or (H, W), 0 to 1
///     Perceptual roughness; shape (H, W, 2) along tangent and bitangent of an anisotropic material.
/// normal : ndarray of float, shape (H, W, 3), -1 to 1
///     Unit vectors, +x right, +y up, +z out of the surface.
/// tangent : ndarray of float, shape (H, W, 3), -1 to 1, optional
///     Unit vectors; for anisotropic materials only.
/// patch_size : float
///     Width of the maps in the unit of the positions given to `render`.
/// unit : str, optional
///     Name of that unit: mm, cm, m, in, or one of your own.
///
/// Raises
/// ------
/// ShapeError
///     If the maps differ in size.
/// FormatError
///     If they are not floats.
/// ArgumentError
///     If a value is not finite, an albedo or roughness outside 0 to 1 by more than 0.001 (values of 0 to 255), a normal's or tangent's length off by
///     more than a tenth (a map that is still encoded), or `patch_size` not above 0.
///
/// Examples
/// --------
/// >>> import numpy as np
/// >>> grey, flat = np.full((4, 6, 3), 0.5), np.zeros((4, 6, 3)) + [0, 0, 1]
/// >>> svbrdf_gcn.Material(grey, 0.08 * grey, grey[:, :, :1], flat, patch_size=10)
/// <svbrdf_gcn.Material: 6 x 4 pixels, isotropic, patch 10 wide>
#[pyclass(frozen, name = "Material", module = "svbrdf_gcn")]
pub struct PyMaterial {
    material: Arc<Material>,
    deviations: Option<Arc<Deviations>>,
    report: Value,
}

impl PyMaterial {
    fn deviation<'py>(&self, py: Python<'py>, image: fn(&Deviations) -> &Image) -> PyResult<Option<ImageArray<'py>>> {
        self.deviations.as_ref().map(|deviations| ImageArray::view(py, deviations, image)).transpose()
    }

    pub fn fitted(fit: Fit) -> PyResult<Self> {
        let report = serde_json::to_value(&fit.report).map_err(json_error)?;
        Ok(Self { material: Arc::new(fit.material), deviations: fit.deviations.map(Arc::new), report })
    }
}

#[pymethods]
impl PyMaterial {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    #[pyo3(signature = (diffuse_albedo, specular_albedo, roughness, normal, tangent = None, *, patch_size, unit = None))]
    fn new(
        py: Python<'_>,
        diffuse_albedo: ArrayLike<'_>,
        specular_albedo: ArrayLike<'_>,
        roughness: ArrayLike<'_>,
        normal: ArrayLike<'_>,
        tangent: Option<ArrayLike<'_>>,
        patch_size: Given<'_, f64>,
        unit: Option<Given<'_, String>>,
    ) -> PyResult<Self> {
        let (patch_size, unit) = (patch_size.take("patch_size")?, maybe("unit", unit)?.map(Unit::new));
        let material = Material {
            diffuse_albedo: image("diffuse_albedo", &diffuse_albedo)?,
            specular_albedo: image("specular_albedo", &specular_albedo)?,
            roughness: image("roughness", &roughness)?,
            normal: image("normal", &normal)?,
            tangent: tangent.map(|tangent| image("tangent", &tangent)).transpose()?,
            patch_size,
            unit,
            warnings: Vec::new(),
        };
        // What cannot be computed with is refused here, what is out of range limited.
        let material = detached(py, || material.limited())?;
        Ok(Self { material: Arc::new(material), deviations: None, report: Value::Null })
    }

    /// Read a material: a folder with a ``material.json``, or maps of another program.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    ///     Folder, or, with an `encoding` that has them, image of several maps side by side.
    /// encoding : {"deschaintre2018", "deep-inverse-rendering", "materialgan", "svbrdf-diff-renderer"}, optional
    ///     How maps without a ``material.json`` are stored; ``docs/materials.md`` describes these.
    /// patch_size : float, optional
    ///     Width of maps without a ``material.json``; 1 if not given.
    /// unit : str, optional
    ///     Unit of that width.
    ///
    /// Returns
    /// -------
    /// Material
    ///
    /// Raises
    /// ------
    /// OSError
    ///     For files that are missing or broken.
    /// FormatError
    ///     For maps whose encoding is not stated.
    /// ArgumentError, ShapeError
    ///     For values out of range, and maps that differ in size.
    ///
    /// Examples
    /// --------
    /// >>> svbrdf_gcn.Material.load("samples/tiles/truth")
    /// <svbrdf_gcn.Material: 256 x 256 pixels, isotropic, patch 10 wide>
    #[staticmethod]
    #[pyo3(signature = (path, *, encoding = None, patch_size = None, unit = None))]
    fn load(
        py: Python<'_>,
        path: Given<'_, PathBuf>,
        encoding: Option<Given<'_, String>>,
        patch_size: Option<Given<'_, f64>>,
        unit: Option<Given<'_, String>>,
    ) -> PyResult<Self> {
        let (path, encoding) = (path.take("path")?, maybe("encoding", encoding)?);
        let mut options = LoadOptions::default();
        options.patch_size = maybe("patch_size", patch_size)?;
        options.unit = maybe("unit", unit)?.map(Unit::new);
        options.encoding = encoding
            .as_deref()
            .map(|name| choice("encoding", name, &MaterialEncoding::ALL, MaterialEncoding::name))
            .transpose()?;
        detached(py, || {
            let material = Arc::new(Material::load_with(&path, &options)?);
            let described = path.join(MATERIAL_JSON).exists();
            let (report, deviations) =
                if described { (read_report(&path)?, read_deviations(&path)?) } else { (None, None) };
            let deviations = deviations.map(Arc::new);
            Ok(Self { material, deviations, report: report.unwrap_or_default() })
        })
    }

    /// Write the maps and ``material.json`` to a folder, which is made if it is not there.
    ///
    /// The files are those of the command line; ``docs/materials.md`` describes them. A material that is there is replaced as a whole, or, if the
    /// call fails, left as it was.
    ///
    /// Parameters
    /// ----------
    /// folder : str or os.PathLike
    /// format : {"exr", "png16", "tiff"}, default "exr"
    ///     OpenEXR with half floats, PNG with 16 bits, or TIFF with single floats.
    /// color_space : {"rec709", "acescg"}, default "rec709"
    ///     Colour space of the albedos written.
    ///
    /// Raises
    /// ------
    /// ArgumentError
    ///     If a file of one of these names is there that svbrdf-gcn did not write.
    /// OSError
    ///     If a file cannot be written.
    ///
    /// Examples
    /// --------
    /// >>> import tempfile
    /// >>> material = svbrdf_gcn.Material.load("samples/tiles/truth")
    /// >>> with tempfile.TemporaryDirectory() as folder:
    /// ...     material.save(folder, format="tiff")
    /// ...     svbrdf_gcn.Material.load(folder)
    /// <svbrdf_gcn.Material: 256 x 256 pixels, isotropic, patch 10 wide>
    #[pyo3(signature = (folder, *, format = Given::Default("exr".into()), color_space = Given::Default("rec709".into())))]
    fn save(
        &self,
        py: Python<'_>,
        folder: Given<'_, PathBuf>,
        format: Given<'_, String>,
        color_space: Given<'_, String>,
    ) -> PyResult<()> {
        let folder = folder.take("folder")?;
        let formats = [MaterialFormat::Exr, MaterialFormat::Png16, MaterialFormat::Tiff];
        let mut options = SaveOptions::new(choice("format", &format.take("format")?, &formats, format_name)?);
        options.color_space = capture::color_space(&color_space.take("color_space")?)?;
        options.deviations = self.deviations.as_deref().cloned();
        options.report = (!self.report.is_null()).then(|| self.report.clone());
        detached(py, || self.material.save(folder, &options))
    }

    /// How the surface leans as a whole: the mean slopes of its normals towards +x and +y.
    #[getter]
    fn tilt(&self) -> (f64, f64) {
        self.material.tilt().into()
    }

    /// The material lying flat.
    ///
    /// A sample that did not lie flat in its capture leans. Without its `tilt`, tiles of the material make a plane.
    ///
    /// Returns
    /// -------
    /// Material
    ///     With the report and the deviations of this one.
    ///
    /// Examples
    /// --------
    /// >>> level = svbrdf_gcn.Material.load("samples/tiles/truth").leveled()
    /// >>> max(abs(slope) for slope in level.tilt) < 1e-6
    /// True
    fn leveled(&self, py: Python<'_>) -> PyResult<Self> {
        let material = Arc::new(detached(py, || self.material.leveled())?);
        Ok(Self { material, deviations: self.deviations.clone(), report: self.report.clone() })
    }

    /// Write the material for another program.
    ///
    /// ``docs/exports.md`` describes the files.
    ///
    /// Parameters
    /// ----------
    /// folder : str or os.PathLike
    ///     Made if it is not there.
    /// to : {"materialx", "gltf", "principled", "unreal"}
    ///     MaterialX with an OpenPBR surface, glTF with KHR_materials_specular, maps for Blender's Principled BSDF, or
    ///     maps for Unreal.
    /// name : str, default "material"
    ///     What the material is called: letters, digits and underscores, a letter first.
    /// normals : {"opengl", "directx"}, optional
    ///     Whether green points up or down; what the program expects if not given.
    /// level : bool, default True
    ///     Take the tilt of the whole surface out of its normals, so that tiles of it make a plane.
    ///
    /// Returns
    /// -------
    /// dict
    ///     The files written, and what the program cannot hold of the material; also in ``export.json``.
    ///
    /// Raises
    /// ------
    /// ArgumentError
    ///     For another program or name, normals that the program does not take, and a file in the folder that no export wrote or that another
    ///     export uses.
    /// OSError
    ///     If a file cannot be written.
    ///
    /// Examples
    /// --------
    /// >>> import tempfile
    /// >>> material = svbrdf_gcn.Material.load("samples/lambert/truth")
    /// >>> with tempfile.TemporaryDirectory() as folder:
    /// ...     report = material.export(folder, to="unreal", name="Wall")
    /// >>> report["target"], report["normals"]
    /// ('unreal', 'directx')
    #[pyo3(signature = (folder, *, to, name = Given::Default("material".into()), normals = None, level = Given::Default(true)))]
    fn export<'py>(
        &self,
        py: Python<'py>,
        folder: Given<'py, PathBuf>,
        to: Given<'py, String>,
        name: Given<'py, String>,
        normals: Option<Given<'py, String>>,
        level: Given<'py, bool>,
    ) -> PyResult<Json<'py>> {
        let (folder, normals) = (folder.take("folder")?, maybe("normals", normals)?);
        let mut options = ExportOptions::new(choice("to", &to.take("to")?, &ExportTarget::ALL, ExportTarget::name)?)
            .name(name.take("name")?)
            .level(level.take("level")?);
        let conventions = [NormalConvention::OpenGl, NormalConvention::DirectX];
        options.normals =
            normals.as_deref().map(|name| choice("normals", name, &conventions, NormalConvention::name)).transpose()?;
        let report = detached(py, || self.material.export(folder, &options))?;
        Json::of(py, &report)
    }

    /// The material as Blender's Principled BSDF has it.
    ///
    /// Returns
    /// -------
    /// Principled
    ///
    /// Examples
    /// --------
    /// >>> principled = svbrdf_gcn.Material.load("samples/lambert/truth").principled()
    /// >>> principled.base_color.shape, principled.metallic.shape
    /// ((64, 64, 3), (64, 64, 1))
    fn principled(&self, py: Python<'_>) -> PyResult<PyPrincipled> {
        detached(py, || Principled::from_material(&self.material)).map(|principled| PyPrincipled(Arc::new(principled)))
    }

    /// Photo of the material under one camera and one light.
    ///
    /// The same forward model the fit uses.
    ///
    /// Parameters
    /// ----------
    /// camera : array_like of shape (3,)
    ///     Position of the camera, in the unit of `patch_size`.
    /// light : array_like of shape (3,)
    ///     Position of the light.
    /// light_intensity : float or array_like of shape (3,), optional
    ///     A white matt patch at distance r has the radiance ``light_intensity / (pi * r**2)``. If not given, such a patch is
    ///     white (1) at the centre.
    /// size : int, optional
    ///     Longer side in pixels; maps are resampled by area, never enlarged.
    ///
    /// Returns
    /// -------
    /// ndarray of float32, shape (H, W, 3), linear RGB
    ///
    /// Raises
    /// ------
    /// ArgumentError
    ///     For values that are not finite, camera or light not in front of the surface (z above 0), and a negative intensity.
    /// ShapeError
    ///     For positions of another shape.
    ///
    /// Examples
    /// --------
    /// >>> material = svbrdf_gcn.Material.load("samples/tiles/truth")
    /// >>> photo = material.render([0, 0, 20], [-5, 5, 18], size=64)
    /// >>> photo.shape, photo.dtype.name
    /// ((64, 64, 3), 'float32')
    #[pyo3(signature = (camera, light, light_intensity = None, *, size = None))]
    fn render<'py>(
        &self,
        py: Python<'py>,
        camera: ArrayLike<'py>,
        light: ArrayLike<'py>,
        light_intensity: Option<ArrayLike<'py>>,
        size: Option<Given<'py, i128>>,
    ) -> PyResult<ImageArray<'py>> {
        let (camera, light) = (triple("camera", &camera)?, triple("light", &light)?);
        let light_intensity = match light_intensity {
            Some(light_intensity) => intensities("light_intensity", &light_intensity, 1)?[0],
            None => [std::f64::consts::PI * light.iter().map(|x| x * x).sum::<f64>(); 3],
        };
        let shot = Shot { camera, light, light_intensity };
        let size = maybe_count("size", size)?;
        let photo = detached(py, || match size {
            Some(size) => render::render(&self.material.resized(size)?, &shot),
            None => render::render(&self.material, &shot),
        })?;
        ImageArray::owned(py, &photo)
    }

    /// Diffuse albedo: linear RGB from 0 to 1, a read-only array of shape (H, W, 3).
    #[getter]
    fn diffuse_albedo<'py>(&self, py: Python<'py>) -> PyResult<ImageArray<'py>> {
        ImageArray::view(py, &self.material, |material| &material.diffuse_albedo)
    }

    /// Specular albedo (reflectance at normal incidence, F0): linear RGB from 0 to 1, a read-only array of shape (H, W, 3).
    #[getter]
    fn specular_albedo<'py>(&self, py: Python<'py>) -> PyResult<ImageArray<'py>> {
        ImageArray::view(py, &self.material, |material| &material.specular_albedo)
    }

    /// Perceptual roughness from 0 to 1: a read-only array of shape (H, W, 1), or (H, W, 2) if anisotropic.
    #[getter]
    fn roughness<'py>(&self, py: Python<'py>) -> PyResult<ImageArray<'py>> {
        ImageArray::view(py, &self.material, |material| &material.roughness)
    }

    /// Unit normals, +x right, +y up, +z out of the surface: a read-only array of shape (H, W, 3).
    #[getter]
    fn normal<'py>(&self, py: Python<'py>) -> PyResult<ImageArray<'py>> {
        ImageArray::view(py, &self.material, |material| &material.normal)
    }

    /// Unit tangents of an anisotropic material, a read-only array of shape (H, W, 3); else None.
    #[getter]
    fn tangent<'py>(&self, py: Python<'py>) -> PyResult<Option<ImageArray<'py>>> {
        ImageArray::view_of_some(py, &self.material, |material| material.tangent.as_ref())
    }

    /// Standard deviation of the diffuse albedo (linear, root mean square over colours), a read-only array of shape (H, W, 1); None if not known.
    ///
    /// How often the truth lies within one such deviation is measured in ``docs/accuracy.md``.
    #[getter]
    fn diffuse_albedo_deviation<'py>(&self, py: Python<'py>) -> PyResult<Option<ImageArray<'py>>> {
        self.deviation(py, |deviations| &deviations.diffuse_albedo)
    }

    /// Standard deviation of the specular albedo (linear, root mean square over colours), a read-only array of shape (H, W, 1); None if not known.
    #[getter]
    fn specular_albedo_deviation<'py>(&self, py: Python<'py>) -> PyResult<Option<ImageArray<'py>>> {
        self.deviation(py, |deviations| &deviations.specular_albedo)
    }

    /// Standard deviation of the roughness, a read-only array of shape (H, W, 1); None if not known.
    #[getter]
    fn roughness_deviation<'py>(&self, py: Python<'py>) -> PyResult<Option<ImageArray<'py>>> {
        self.deviation(py, |deviations| &deviations.roughness)
    }

    /// Standard deviation of the normal, about an angle in radians: a read-only array of shape (H, W, 1); None if not known.
    #[getter]
    fn normal_deviation<'py>(&self, py: Python<'py>) -> PyResult<Option<ImageArray<'py>>> {
        self.deviation(py, |deviations| &deviations.normal)
    }

    /// Width of the maps in the unit of the capture.
    #[getter]
    fn patch_size(&self) -> f64 {
        self.material.patch_size
    }

    /// Name of the unit of `patch_size`; None if it is not known.
    #[getter]
    fn unit(&self) -> Option<&str> {
        self.material.unit.as_ref().map(Unit::name)
    }

    /// Columns of the maps.
    #[getter]
    fn width(&self) -> usize {
        self.material.width()
    }

    /// Rows of the maps.
    #[getter]
    fn height(&self) -> usize {
        self.material.height()
    }

    /// What the fit did (settings, stages, losses, errors of the photos, seconds); empty if there was none.
    #[getter]
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Json<'py>> {
        Json::new(py, &self.report)
    }

    /// What may be expected of the maps: "good", "usable" or "poor"; None if there was no fit. ``report["reasons"]`` says why it is not better and what
    /// to do, ``report["expected_error"]`` by how much a new photo would be missed.
    #[getter]
    fn verdict(&self) -> Option<&str> {
        self.report.get("verdict").and_then(Value::as_str)
    }

    /// What a user should know: of loaded maps those that have changed since they were saved; of capture and fit.
    #[getter]
    fn warnings(&self) -> Vec<&str> {
        let of_fit = self.report.get("warnings").and_then(Value::as_array).into_iter().flatten();
        self.material.warnings.iter().map(String::as_str).chain(of_fit.filter_map(Value::as_str)).collect()
    }

    /// The maps side by side and a view under a light at the upper left, for notebooks.
    fn _repr_png_<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        detached(py, || material_png(&self.material)).map(|bytes| PyBytes::new(py, &bytes))
    }

    fn __repr__(&self) -> String {
        let Self { material, .. } = self;
        let lobe = if material.tangent.is_some() { "anisotropic" } else { "isotropic" };
        let (width, height) = (material.width(), material.height());
        format!("<svbrdf_gcn.Material: {width} x {height} pixels, {lobe}, patch {} wide>", material.patch_size)
    }
}

/// The maps of a metallic surface under a dielectric coat that reflects, at normal incidence, what a material does.
///
/// The sockets of Blender's Principled BSDF; ``Material.principled`` makes it. Arrays are read-only views, as those of ``Material``.
///
/// Examples
/// --------
/// >>> principled = svbrdf_gcn.Material.load("samples/tiles/truth").principled()
/// >>> sorted(principled.loss)
/// ['diffuse', 'specular']
#[pyclass(frozen, name = "Principled", module = "svbrdf_gcn")]
pub struct PyPrincipled(Arc<Principled>);

#[pymethods]
impl PyPrincipled {
    /// Base Color: linear RGB from 0 to 1, shape (H, W, 3).
    #[getter]
    fn base_color<'py>(&self, py: Python<'py>) -> PyResult<ImageArray<'py>> {
        ImageArray::view(py, &self.0, |maps| &maps.base_color)
    }

    /// Metallic, from 0 to 1, shape (H, W, 1).
    #[getter]
    fn metallic<'py>(&self, py: Python<'py>) -> PyResult<ImageArray<'py>> {
        ImageArray::view(py, &self.0, |maps| &maps.metallic)
    }

    /// Roughness, from 0 to 1, shape (H, W, 1).
    #[getter]
    fn roughness<'py>(&self, py: Python<'py>) -> PyResult<ImageArray<'py>> {
        ImageArray::view(py, &self.0, |maps| &maps.roughness)
    }

    /// Specular IOR Level, from 0 to 1, shape (H, W, 1).
    #[getter]
    fn specular_level<'py>(&self, py: Python<'py>) -> PyResult<ImageArray<'py>> {
        ImageArray::view(py, &self.0, |maps| &maps.specular_level)
    }

    /// Specular Tint: linear RGB from 0 to 1, shape (H, W, 3).
    #[getter]
    fn specular_tint<'py>(&self, py: Python<'py>) -> PyResult<ImageArray<'py>> {
        ImageArray::view(py, &self.0, |maps| &maps.specular_tint)
    }

    /// Anisotropic, from 0 to 1, shape (H, W, 1); None for an isotropic material.
    #[getter]
    fn anisotropic<'py>(&self, py: Python<'py>) -> PyResult<Option<ImageArray<'py>>> {
        ImageArray::view_of_some(py, &self.0, |maps| maps.anisotropy.as_ref().map(|anisotropy| &anisotropy.amount))
    }

    /// Anisotropic Rotation: turns of the direction of the greater roughness, counter-clockwise from +x, shape (H, W, 1).
    #[getter]
    fn anisotropic_rotation<'py>(&self, py: Python<'py>) -> PyResult<Option<ImageArray<'py>>> {
        ImageArray::view_of_some(py, &self.0, |maps| maps.anisotropy.as_ref().map(|anisotropy| &anisotropy.rotation))
    }

    /// Unit normals, +x right, +y up, +z out of the surface, shape (H, W, 3).
    #[getter]
    fn normal<'py>(&self, py: Python<'py>) -> PyResult<ImageArray<'py>> {
        ImageArray::view(py, &self.0, |maps| &maps.normal)
    }

    /// IOR of the whole material.
    #[getter]
    fn ior(&self) -> f64 {
        self.0.ior
    }

    /// How far diffuse and specular reflectance at normal incidence are from the material's: mean and max of each.
    #[getter]
    fn loss<'py>(&self, py: Python<'py>) -> PyResult<Json<'py>> {
        Json::of(py, &self.0.loss)
    }
}

fn format_name(format: MaterialFormat) -> &'static str {
    match format {
        MaterialFormat::Png16 => "png16",
        MaterialFormat::Tiff => "tiff",
        _ => "exr",
    }
}

/// Error of a re-rendered photo, as the literature has it.
///
/// Root mean square over all values, encoded with gamma 2.2 and clamped to the range from 0 to 1.
///
/// Parameters
/// ----------
/// rendering, photo : ndarray of float, shape (H, W, 3), linear RGB
///
/// Returns
/// -------
/// float
///
/// Raises
/// ------
/// ShapeError
///     If the shapes differ.
/// FormatError
///     If the arrays are not floats.
///
/// Examples
/// --------
/// >>> import numpy as np
/// >>> round(svbrdf_gcn.metrics.photo_rmse(np.full((4, 4, 3), 0.25), np.zeros((4, 4, 3))), 4)
/// 0.5325
#[pyfunction]
pub fn photo_rmse(py: Python<'_>, rendering: ArrayLike<'_>, photo: ArrayLike<'_>) -> PyResult<f64> {
    let (rendering, photo) = (image("rendering", &rendering)?, image("photo", &photo)?);
    detached(py, || metrics::photo_rmse(&rendering, &photo))
}

/// Errors of a material against the photos of a capture, as the literature has them.
///
/// The material is rendered as each photo was taken; then ``photo_rmse``.
///
/// Parameters
/// ----------
/// material : Material
///     Of the size of the photos. It must show the same patch: widths in known units (mm, cm, m, in) are converted; where a unit is not
///     stated the numbers must agree.
/// capture : Capture
///
/// Returns
/// -------
/// list of float
///     One for each photo.
///
/// Raises
/// ------
/// ArgumentError
///     If the patches differ in width, or their units cannot be converted.
/// ShapeError
///     If the sizes differ.
///
/// Examples
/// --------
/// >>> capture = svbrdf_gcn.Capture.open("samples/lambert", views=[0, 1])
/// >>> truth = svbrdf_gcn.Material.load("samples/lambert/truth")
/// >>> [error < 0.02 for error in svbrdf_gcn.metrics.photo_errors(truth, capture)]
/// [True, True]
#[pyfunction]
pub fn photo_errors<'py>(
    py: Python<'py>,
    material: Given<'py, Bound<'py, PyMaterial>>,
    capture: Given<'py, Bound<'py, PyCapture>>,
) -> PyResult<Vec<f64>> {
    let (material, capture) = (material.take("material")?, capture.take("capture")?);
    let (material, capture) = (&material.get().material, &capture.get().0);
    let error = |(index, photo): (usize, &Photo)| {
        metrics::photo_rmse(&svbrdf_gcn::capture::render_photo(material, capture, index)?, &photo.image)
    };
    detached(py, || capture.photos().iter().enumerate().map(error).collect())
}

/// Errors of a material's maps against the true ones.
///
/// Parameters
/// ----------
/// material, truth : Material
///
/// Returns
/// -------
/// dict
///     ``diffuse``, ``specular`` and ``roughness``: RMSE of the ``linear`` and of the ``gamma22`` encoded values; ``normal``: RMSE
///     of (n + 1) / 2; ``normal_angle_deg``: mean angle between the normals.
///
/// Raises
/// ------
/// ShapeError
///     If the maps differ in size.
///
/// Examples
/// --------
/// >>> truth = svbrdf_gcn.Material.load("samples/tiles/truth")
/// >>> svbrdf_gcn.metrics.map_errors(truth, truth)["diffuse"]
/// {'gamma22': 0.0, 'linear': 0.0}
#[pyfunction]
pub fn map_errors<'py>(
    py: Python<'py>,
    material: Given<'py, Bound<'py, PyMaterial>>,
    truth: Given<'py, Bound<'py, PyMaterial>>,
) -> PyResult<Json<'py>> {
    let (material, truth) = (material.take("material")?, truth.take("truth")?);
    let (material, truth) = (material.get(), truth.get());
    let errors = detached(py, || MapErrors::between(&material.material, &truth.material))?;
    Json::of(py, &errors)
}
