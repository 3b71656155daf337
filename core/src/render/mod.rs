//! The forward model: maps, one camera and one light give the radiance of every pixel; and the loss against photos with its gradient.
//!
//! Frame and pixel positions are those of a [`Capture`](crate::Capture), the shading is [`crate::brdf`]. Work is cut into chunks of rows of a
//! fixed number of pixels and runs on rayon's current pool; sums are formed in a fixed order, so that the same processor gives
//! the same bits on any number of threads.

mod loss;
mod tape;

use rayon::prelude::*;

use crate::brdf::{Directions, Frame, Response, Surface};
use crate::real::{Arithmetic, Kernel, LANES_MAX, Lanes, Real, Wide};

use crate::error::{Error, Result};
use crate::image::Image;
use crate::maps::{DIFFUSE_PLANE, Lobe, Maps, NORMAL_PLANE, ROUGHNESS_PLANE};
use crate::material::Material;
use crate::shot::Shot;
use crate::{memory, pool};

#[doc(hidden)]
pub use tape::photo_loss_on_tape;

pub use loss::{TOE, Target, encode_radiance, photo_loss};
pub(crate) use loss::{encode, encode_all};

/// Pixels of a chunk of work, rounded to whole rows.
const CHUNK_PIXELS: usize = 4096;

/// Photo of a material under one camera and one light: linear RGB, (H, W, 3).
///
/// # Errors
/// [`Error::ShapeMismatch`] or [`Error::InvalidArgument`] if maps differ in size, hold NaN or infinity, if camera or light are not in front of the surface
/// (z above 0), or `light_intensity` is negative or not finite.
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
///     unit: None,
///     warnings: Vec::new(),
/// };
/// let shot = Shot { camera: [0.0, 0.0, 2.0], light: [0.0, 0.0, 2.0], light_intensity: [4.0 * std::f64::consts::PI; 3] };
/// let photo = render::render(&white, &shot)?;
/// assert!((photo.data()[0] - 1.0).abs() < 1e-4);
/// # Ok::<(), svbrdf_gcn::Error>(())
/// ```
pub fn render(material: &Material, shot: &Shot) -> Result<Image> {
    rendered(material, material.patch_size, shot)
}

/// [`render`] of a patch that is `patch_size` wide in the unit of `shot`.
pub(crate) fn rendered(material: &Material, patch_size: f64, shot: &Shot) -> Result<Image> {
    if let Some((field, reason)) = shot.misplaced() {
        return Err(Error::invalid(field, reason));
    }
    let maps = material.to_maps()?;
    let planes = render_maps(&maps, patch_size, shot)?;
    Image::from_planar(maps.width(), maps.height(), 3, &planes)
}

/// Estimated bytes that the rendering of `material` takes at its peak, those of its maps included: the maps a second time, as planes, and the picture, as
/// planes and as it is.
#[cfg(feature = "cli")]
pub(crate) fn rendering_memory(material: &Material) -> u64 {
    2 * material.memory() + 2 * 3 * 4 * (material.width() * material.height()) as u64 + memory::SMALL
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
    let mut radiance = memory::filled(T::default(), 3 * pixels)?;
    let mut chunks = split_planes(&mut radiance, pixels, grid.chunk_rows * grid.width);
    pool::inside(|| {
        chunks.par_iter_mut().enumerate().for_each(|(index, out)| {
            T::run(RenderRows { grid: &grid, view: &view, maps, rows: grid.rows(index), out });
        });
        Ok(())
    })?;
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

/// Length of a row with room for whole bundles.
fn padded(width: usize) -> usize {
    width.next_multiple_of(LANES_MAX)
}

/// Positions of the pixels in units of the patch's width, and how they are cut into chunks.
struct Grid {
    /// Of the columns, and on to [`padded`].
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
            x: (0..padded(width)).map(|column| (column as f64 + 0.5) / columns - 0.5).collect(),
            y: (0..height).map(|row| (0.5 * height as f64 - (row as f64 + 0.5)) / columns).collect(),
            width,
            chunk_rows: (CHUNK_PIXELS / width).max(1),
        })
    }

    /// Positions of the pixels from `column` on.
    #[inline(always)]
    fn position<L: Lanes>(&self, row: usize, column: usize) -> (L::Wide, L::Wide) {
        (L::Wide::load(&self.x[column..][..L::LANES]), L::Wide::splat(self.y[row]))
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
        [L::splat(self.intensity[0]), L::splat(self.intensity[1]), L::splat(self.intensity[2])]
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
        let camera = offset::<L>(self.camera, x, y);
        if self.collocated {
            Response::new(frame, &Directions::collocated(camera))
        } else {
            Response::new(frame, &Directions::separate(camera, offset::<L>(self.light, x, y)))
        }
    }
}

/// The way from (x, y, 0) to `target`.
#[inline(always)]
pub(crate) fn offset<L: Lanes>(target: [f64; 3], x: L::Wide, y: L::Wide) -> [L::Wide; 3] {
    [L::Wide::splat(target[0]) - x, L::Wide::splat(target[1]) - y, L::Wide::splat(target[2])]
}

/// Pixels of a tile.
const TILE: usize = 128;
/// Values of a line of the cache, in single precision.
const LINE: usize = 16;

/// A piece of a row of all planes, side by side.
///
/// Planes whose size is a power of two fall on the same lines of the cache: reading ten and writing ten in step evicts each line before
/// it is used up, and costs half as much again as the arithmetic. Pieces of some lines, copied, do not.
/// Behind the end of a row a tile is filled with zeros, which render black and have no gradient.
#[repr(align(64))]
struct Tile<T>([[T; TILE]; Lobe::Anisotropic.planes()]);

impl<T: Real> Tile<T> {
    fn new() -> Self {
        Self([[T::default(); TILE]; Lobe::Anisotropic.planes()])
    }

    /// Reads `len` pixels from `start` on, and has those after them fetched meanwhile.
    #[inline(always)]
    fn read<L: Lanes<Scalar = T>>(&mut self, planes: &[&[T]], start: usize, len: usize) {
        for (tile, plane) in self.0.iter_mut().zip(planes) {
            for line in plane[start + len..].chunks(LINE).take(TILE / LINE) {
                L::prefetch(line);
            }
            match plane[start..][..len].first_chunk::<TILE>() {
                Some(whole) => *tile = *whole,
                None => {
                    tile[..len].copy_from_slice(&plane[start..][..len]);
                    tile[len..].fill(T::default());
                }
            }
        }
    }

    /// Writes the first `len` pixels of the first planes to `start`.
    #[inline(always)]
    fn write(&self, planes: &mut [&mut [T]], start: usize, len: usize) {
        for (tile, plane) in self.0.iter().zip(planes) {
            match plane[start..][..len].first_chunk_mut::<TILE>() {
                Some(whole) => *whole = *tile,
                None => plane[start..][..len].copy_from_slice(&tile[..len]),
            }
        }
    }

    #[inline(always)]
    fn load<L: Lanes<Scalar = T>>(&self, plane: usize, at: usize) -> L {
        L::load(&self.0[plane][at..][..L::LANES])
    }

    #[inline(always)]
    fn load_three<L: Lanes<Scalar = T>>(&self, first: usize, at: usize) -> [L; 3] {
        [self.load(first, at), self.load(first + 1, at), self.load(first + 2, at)]
    }

    #[inline(always)]
    fn store<L: Lanes<Scalar = T>>(&mut self, plane: usize, at: usize, value: L) {
        value.store(&mut self.0[plane][at..][..L::LANES]);
    }

    /// The pixels from `at` on, as the shading reads them.
    #[inline(always)]
    fn load_surface<L: Lanes<Scalar = T>, const ANISOTROPIC: bool>(&self, at: usize) -> Surface<L> {
        let zero = L::splat(0.0);
        let (mut roughness, mut tangent) = ([self.load(ROUGHNESS_PLANE, at), zero], [zero; 3]);
        if ANISOTROPIC {
            roughness[1] = self.load(ROUGHNESS_PLANE + 1, at);
            tangent = self.load_three(Lobe::Anisotropic.tangent_plane(), at);
        }
        Surface {
            diffuse: self.load_three(DIFFUSE_PLANE, at),
            normal: self.load_three(NORMAL_PLANE, at),
            roughness,
            specular: self.load_three(lobe::<ANISOTROPIC>().specular_plane(), at),
            tangent,
        }
    }

    /// The inverse of [`Tile::load_surface`].
    #[inline(always)]
    fn store_surface<L: Lanes<Scalar = T>, const ANISOTROPIC: bool>(&mut self, at: usize, surface: &Surface<L>) {
        let lobe = lobe::<ANISOTROPIC>();
        for c in 0..3 {
            self.store(DIFFUSE_PLANE + c, at, surface.diffuse[c]);
            self.store(NORMAL_PLANE + c, at, surface.normal[c]);
            self.store(lobe.specular_plane() + c, at, surface.specular[c]);
            if ANISOTROPIC {
                self.store(lobe.tangent_plane() + c, at, surface.tangent[c]);
            }
        }
        self.store(ROUGHNESS_PLANE, at, surface.roughness[0]);
        if ANISOTROPIC {
            self.store(ROUGHNESS_PLANE + 1, at, surface.roughness[1]);
        }
    }
}

const fn lobe<const ANISOTROPIC: bool>() -> Lobe {
    if ANISOTROPIC { Lobe::Anisotropic } else { Lobe::Isotropic }
}

/// All planes of `maps`.
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
        let (mut tile, mut radiance) = (Tile::new(), Tile::new());
        for row in self.rows.clone() {
            for column in (0..self.grid.width).step_by(TILE) {
                let len = TILE.min(self.grid.width - column);
                tile.read::<L>(&planes, row * self.grid.width + column, len);
                for at in (0..len).step_by(L::LANES) {
                    let surface = tile.load_surface::<L, ANISOTROPIC>(at);
                    let frame = Frame::<L, ANISOTROPIC>::new(&surface);
                    let (x, y) = self.grid.position::<L>(row, column + at);
                    let response = self.view.response(&frame, x, y);
                    let values = response.radiance(&surface, intensity);
                    for (c, value) in values.into_iter().enumerate() {
                        radiance.store(c, at, value);
                    }
                }
                radiance.write(self.out, (row - self.rows.start) * self.grid.width + column, len);
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
