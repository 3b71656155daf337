//! The forward model: maps, one camera and one light give the radiance of every pixel; and the loss against photos with its gradient.
//!
//! Frame and pixel positions are those of [`crate::capture`], the shading is [`crate::brdf`]. Work is cut into chunks of rows of a
//! fixed number of pixels and runs on rayon's current pool; sums are formed in a fixed order, so that the same processor gives
//! the same bits on any number of threads.

mod loss;

use rayon::prelude::*;

use crate::brdf::real::{Arithmetic, Kernel, Lanes, Real, Wide};
use crate::brdf::{Directions, Frame, Response, Surface};
use crate::capture::Shot;
use crate::error::{Error, Result};
use crate::image::Image;
use crate::maps::{DIFFUSE_PLANE, Lobe, Maps, NORMAL_PLANE, ROUGHNESS_PLANE};
use crate::material::Material;

pub use loss::{TOE, Target, encode_radiance, photo_loss};

/// Pixels of a chunk of work, rounded to whole rows.
const CHUNK_PIXELS: usize = 4096;

/// Photo of a material under one camera and one light: linear RGB, (H, W, 3).
///
/// # Errors
/// [`Error::ShapeMismatch`] or [`Error::InvalidArgument`] if maps differ in size, hold NaN or infinity, or `shot` is not finite.
///
/// # Example
/// ```
/// use svbrdf_gcn::{Image, Material, Shot, render};
/// let constant = |values: &[f32]| Image::new(1, 1, values.len(), values.to_vec());
/// let white = Material {
///     diffuse_albedo: constant(&[1.0; 3])?,
///     specular_albedo: constant(&[0.0; 3])?,
///     roughness: constant(&[1.0])?,
///     normal: constant(&[0.0, 0.0, 1.0])?,
///     tangent: None,
///     patch_size: 1.0,
/// };
/// let shot = Shot { camera: [0.0, 0.0, 2.0], light: [0.0, 0.0, 2.0], light_intensity: [4.0 * std::f64::consts::PI; 3] };
/// let photo = render::render(&white, &shot)?;
/// assert!((photo.data()[0] - 1.0).abs() < 1e-4);
/// # Ok::<(), svbrdf_gcn::Error>(())
/// ```
pub fn render(material: &Material, shot: &Shot) -> Result<Image> {
    let maps = material.to_maps()?;
    let planes = render_maps(&maps, material.patch_size, shot)?;
    Image::from_planar(maps.width(), maps.height(), 3, &planes)
}

/// Radiance of every pixel of `maps`: three planes (R, G, B) of `height * width` values, rows from the top, linear.
///
/// `patch_size` is the width of the patch in the unit of `shot`. Values outside the ranges of [`Maps`] are computed with as they are,
/// but for the smallest roughness, [`crate::brdf::ROUGHNESS_MIN`].
///
/// # Errors
/// [`Error::InvalidArgument`] if `patch_size` is not positive and finite, or `shot` is not finite.
pub fn render_maps<T: Real>(maps: &Maps<T>, patch_size: f64, shot: &Shot) -> Result<Vec<T>> {
    let grid = Grid::new(maps, patch_size)?;
    let view = View::new(shot, patch_size)?;
    let pixels = maps.width() * maps.height();
    let mut radiance = vec![T::default(); 3 * pixels];
    let mut chunks = split_planes(&mut radiance, pixels, grid.chunk_rows * grid.width);
    chunks.par_iter_mut().enumerate().for_each(|(index, out)| {
        T::run(RenderRows { grid: &grid, view: &view, maps, rows: grid.rows(index), out });
    });
    Ok(radiance)
}

/// The chunks of all planes of `data`: `[chunk][plane]`.
fn split_planes<T>(data: &mut [T], plane_len: usize, chunk_len: usize) -> Vec<Vec<&mut [T]>> {
    let mut chunks: Vec<Vec<&mut [T]>> = (0..plane_len.div_ceil(chunk_len)).map(|_| Vec::new()).collect();
    for plane in data.chunks_mut(plane_len) {
        for (chunk, part) in chunks.iter_mut().zip(plane.chunks_mut(chunk_len)) {
            chunk.push(part);
        }
    }
    chunks
}

/// Positions of the pixels in units of the patch's width, and how they are cut into chunks.
struct Grid {
    x: Vec<f64>,
    y: Vec<f64>,
    width: usize,
    chunk_rows: usize,
}

impl Grid {
    fn new<T>(maps: &Maps<T>, patch_size: f64) -> Result<Self> {
        if !(patch_size.is_finite() && patch_size > 0.0) {
            return Err(Error::invalid("patch_size", format!("expected a positive length, got {patch_size}")));
        }
        let (width, height) = (maps.width(), maps.height());
        let columns = width as f64;
        Ok(Self {
            x: (0..width).map(|column| (column as f64 + 0.5) / columns - 0.5).collect(),
            y: (0..height).map(|row| (0.5 * height as f64 - (row as f64 + 0.5)) / columns).collect(),
            width,
            chunk_rows: (CHUNK_PIXELS / width).max(1),
        })
    }

    fn rows(&self, chunk: usize) -> std::ops::Range<usize> {
        let first = chunk * self.chunk_rows;
        first..(first + self.chunk_rows).min(self.y.len())
    }
}

/// One photo's positions in units of the patch's width.
pub(crate) struct View {
    camera: [f64; 3],
    light: [f64; 3],
    intensity: [f64; 3],
    collocated: bool,
}

impl View {
    /// # Errors
    /// [`Error::InvalidArgument`] if a value is not finite, or an intensity negative.
    pub(crate) fn new(shot: &Shot, patch_size: f64) -> Result<Self> {
        for (name, values) in [("camera", shot.camera), ("light", shot.light)] {
            if !values.iter().all(|value| value.is_finite()) {
                return Err(Error::invalid(name, format!("expected a finite position, got {values:?}")));
            }
        }
        if !shot.light_intensity.iter().all(|value| value.is_finite() && *value >= 0.0) {
            let got = shot.light_intensity;
            return Err(Error::invalid("light_intensity", format!("expected finite values of 0 or more, got {got:?}")));
        }
        Ok(Self {
            camera: shot.camera.map(|c| c / patch_size),
            light: shot.light.map(|c| c / patch_size),
            intensity: shot.light_intensity.map(|i| i / (patch_size * patch_size)),
            collocated: shot.camera == shot.light,
        })
    }

    #[inline(always)]
    fn intensity<L: Lanes>(&self) -> [L; 3] {
        self.intensity.map(L::splat)
    }

    /// How the points (x, y, 0) answer to this photo.
    ///
    /// The two cases are separate code: with camera and light at one place most of the work is done once instead of twice.
    #[inline(always)]
    fn response<L: Lanes, const ANISOTROPIC: bool>(
        &self,
        frame: &Frame<L, ANISOTROPIC>,
        x: L::Wide,
        y: L::Wide,
    ) -> Response<L> {
        let to = |target: [f64; 3]| {
            [L::Wide::splat(target[0]) - x, L::Wide::splat(target[1]) - y, L::Wide::splat(target[2])]
        };
        if self.collocated {
            Response::new(frame, &Directions::collocated(to(self.camera)))
        } else {
            Response::new(frame, &Directions::separate(to(self.camera), to(self.light)))
        }
    }
}

/// The pixels `range` of all planes, as the shading reads them.
#[inline(always)]
fn load_surface<L: Lanes, const ANISOTROPIC: bool>(
    planes: &[&[L::Scalar]],
    range: std::ops::Range<usize>,
) -> Surface<L> {
    let plane = |index: usize| L::load(&planes[index][range.clone()]);
    let three = |first: usize| [plane(first), plane(first + 1), plane(first + 2)];
    let zero = L::splat(0.0);
    if ANISOTROPIC {
        Surface {
            diffuse: three(DIFFUSE_PLANE),
            normal: three(NORMAL_PLANE),
            roughness: [plane(ROUGHNESS_PLANE), plane(ROUGHNESS_PLANE + 1)],
            specular: three(Lobe::Anisotropic.specular_plane()),
            tangent: three(Lobe::Anisotropic.tangent_plane()),
        }
    } else {
        Surface {
            diffuse: three(DIFFUSE_PLANE),
            normal: three(NORMAL_PLANE),
            roughness: [plane(ROUGHNESS_PLANE), zero],
            specular: three(Lobe::Isotropic.specular_plane()),
            tangent: [zero; 3],
        }
    }
}

/// The inverse of [`load_surface`].
#[inline(always)]
fn store_surface<L: Lanes, const ANISOTROPIC: bool>(
    surface: &Surface<L>,
    planes: &mut [&mut [L::Scalar]],
    range: std::ops::Range<usize>,
) {
    let mut store = |first: usize, values: &[L]| {
        for (i, value) in values.iter().enumerate() {
            value.store(&mut planes[first + i][range.clone()]);
        }
    };
    let lobe = if ANISOTROPIC { Lobe::Anisotropic } else { Lobe::Isotropic };
    store(DIFFUSE_PLANE, &surface.diffuse);
    store(NORMAL_PLANE, &surface.normal);
    store(ROUGHNESS_PLANE, &surface.roughness[..lobe.roughness_planes()]);
    store(lobe.specular_plane(), &surface.specular);
    if ANISOTROPIC {
        store(lobe.tangent_plane(), &surface.tangent);
    }
}

/// All planes of `maps`, for indexing without arithmetic.
fn planes<T>(maps: &Maps<T>) -> Vec<&[T]> {
    maps.data().chunks(maps.width() * maps.height()).collect()
}

/// Renders some rows.
struct RenderRows<'a, T> {
    grid: &'a Grid,
    view: &'a View,
    maps: &'a Maps<T>,
    rows: std::ops::Range<usize>,
    out: &'a mut [&'a mut [T]],
}

impl<T: Real> RenderRows<'_, T> {
    #[inline(always)]
    fn rows<L: Lanes<Scalar = T>, const ANISOTROPIC: bool>(self) {
        let planes = planes(self.maps);
        let intensity = self.view.intensity::<L>();
        let start = self.rows.start * self.grid.width;
        for row in self.rows {
            let y = L::Wide::splat(self.grid.y[row]);
            for column in (0..self.grid.width).step_by(L::LANES) {
                let end = (column + L::LANES).min(self.grid.width);
                let first = row * self.grid.width;
                let surface = load_surface::<L, ANISOTROPIC>(&planes, first + column..first + end);
                let frame = Frame::<L, ANISOTROPIC>::new(&surface);
                let response = self.view.response(&frame, L::Wide::load(&self.grid.x[column..end]), y);
                for (out, radiance) in self.out.iter_mut().zip(response.radiance(&surface, intensity)) {
                    radiance.store(&mut out[first - start + column..first - start + end]);
                }
            }
        }
    }
}

impl<T: Real> Kernel<T> for RenderRows<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes<Scalar = T>>(self) {
        match self.maps.lobe() {
            Lobe::Isotropic => self.rows::<L, false>(),
            Lobe::Anisotropic => self.rows::<L, true>(),
        }
    }
}
