//! The loss of a rendering against photos, in gamma 2.2, and its gradient with respect to every map.

use rayon::prelude::*;

use super::{Grid, TILE, Tile, View, padded, planes, split_planes};
use crate::brdf::{Frame, FrameGradient};
use crate::color::GAMMA;
use crate::error::{Error, Result};
use crate::maps::{Lobe, Maps};
use crate::real::{Arithmetic, Kernel, Lanes, Real, Wide};
use crate::shot::Shot;
use crate::{memory, pool};

/// Radiance below which [`encode_radiance`] leaves the power law: less than half of what the first code of an 8-bit file stands for.
pub const TOE: f64 = 1e-6;

/// Factor of the mean squared error, as in the released optimisation.
const LOSS_SCALE: f64 = 1000.0;

/// Gamma 2.2 encoding `radiance^(1/2.2)` with a finite slope at 0.
///
/// From [`TOE`] on it is the power law, unchanged. Below, where the power law's slope grows without limit, it is the parabola through
/// 0 that continues value and slope, so black stays black; its slope at 0 is 2896. Below 0 it goes on as a line with that slope.
pub fn encode_radiance<T: Real>(radiance: T) -> T {
    encode(radiance).0
}

/// [`encode_radiance`] of all `values`, many at a time.
pub(crate) fn encode_all(values: &mut [f32]) {
    f32::run(Encode(values));
}

struct Encode<'a>(&'a mut [f32]);

impl Kernel<f32> for Encode<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes<Scalar = f32>>(self) {
        for values in self.0.chunks_mut(L::LANES) {
            encode(L::load(values)).0.store(values);
        }
    }
}

/// [`encode_radiance`] and its slope.
#[inline(always)]
pub(crate) fn encode<L: Lanes>(radiance: L) -> (L, L) {
    let toe = L::splat(TOE);
    let top = TOE.powf(1.0 / GAMMA);
    // a x + b x^2 with value `top` and slope `top / (2.2 TOE)` at TOE.
    let linear = L::splat((2.0 - 1.0 / GAMMA) * top / TOE);
    let square = L::splat((1.0 / GAMMA - 1.0) * top / (TOE * TOE));
    let low = radiance.max(L::splat(0.0)).min(toe);
    let high = radiance.max(toe);
    let power = high.pow_normal(1.0 / GAMMA);
    let above = radiance.gt(toe);
    let value = L::select(above, power, low.mul_add(square, linear) * radiance);
    let slope = L::select(above, power * (L::splat(1.0 / GAMMA) / high), (low + low).mul_add(square, linear));
    (value, slope)
}

/// A photo as the loss compares with it.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    width: usize,
    height: usize,
    shot: Shot,
    /// (height, 3, padded width): the channels of a row follow each other, for the reason that [`Tile`] states.
    encoded: Vec<f32>,
    /// (height, padded width).
    saturated: Vec<u8>,
}

impl Target {
    /// A target from three planes (R, G, B) of `height * width` values, encoded by [`encode_radiance`], rows from the top, and one byte
    /// per pixel of which bit c says that channel c is saturated: "at least this bright".
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if the lengths do not fit; [`Error::InvalidArgument`] if a value is not finite.
    pub fn new(width: usize, height: usize, shot: Shot, encoded: &[f32], saturated: &[u8]) -> Result<Self> {
        let pixels = width.saturating_mul(height);
        if encoded.is_empty() || pixels.checked_mul(3) != Some(encoded.len()) || saturated.len() != pixels {
            return Err(Error::shape(
                "target",
                format!("3 planes of {height} x {width} values and as many bytes"),
                format!("{} values and {} bytes", encoded.len(), saturated.len()),
            ));
        }
        if let Some(value) = encoded.iter().find(|value| !value.is_finite()) {
            return Err(Error::invalid("target", format!("expected finite values, got {value}")));
        }
        let stride = padded(width);
        let mut rows = memory::filled(0.0, 3 * height * stride)?;
        for (i, row) in rows.chunks_exact_mut(stride).enumerate() {
            row[..width].copy_from_slice(&encoded[((i % 3) * height + i / 3) * width..][..width]);
        }
        let mut flags = memory::filled(0, height * stride)?;
        for (row, source) in flags.chunks_exact_mut(stride).zip(saturated.chunks_exact(width)) {
            row[..width].copy_from_slice(source);
        }
        Ok(Self { width, height, shot, encoded: rows, saturated: flags })
    }

    /// Bytes of a target of this size.
    pub(crate) fn memory(width: usize, height: usize) -> u64 {
        (3 * size_of::<f32>() as u64 + 1) * (padded(width) * height) as u64
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Positions and light.
    pub fn shot(&self) -> &Shot {
        &self.shot
    }

    /// Takes other positions and light for those of the photo.
    pub fn set_shot(&mut self, shot: Shot) {
        self.shot = shot;
    }
}

/// What renderings are compared with.
pub(super) trait Comparison<T>: Sync {
    /// Sum over channels of the errors of the pixels from `column` on, and half its derivatives by the radiance.
    fn compare<L: Lanes<Scalar = T>>(&self, row: usize, column: usize, radiance: [L; 3]) -> (L, [L; 3]);
}

impl<T> Comparison<T> for Target {
    /// Squared errors.
    #[inline(always)]
    fn compare<L: Lanes<Scalar = T>>(&self, row: usize, column: usize, radiance: [L; 3]) -> (L, [L; 3]) {
        let zero = L::splat(0.0);
        let stride = padded(self.width);
        let flags = &self.saturated[row * stride + column..][..L::LANES];
        let (mut squares, mut slopes) = (zero, [zero; 3]);
        for c in 0..3 {
            let (encoded, slope) = encode(radiance[c]);
            let photo = L::load_f32(&self.encoded[(row * 3 + c) * stride + column..][..L::LANES]);
            let error = encoded - photo;
            let error = L::select(L::bits_set(flags, c as u32), error.min(zero), error);
            squares = error.mul_add(error, squares);
            slopes[c] = error * slope;
        }
        (squares, slopes)
    }
}

/// 1000 times the mean, over photos, channels and pixels, of `(encode(radiance) - photo)^2`, with [`encode_radiance`].
///
/// Where the photo is saturated a rendering that is at least as bright has no error. `gradient`, where given, is overwritten with the
/// derivatives of the loss by every value of `maps`. `patch_size` is the width of the patch in the unit of the targets' positions.
///
/// The result may be NaN or infinite where `maps` are.
///
/// # Errors
/// [`Error::InvalidArgument`] if `patch_size` is not positive, there are no targets, or a position or light is not finite;
/// [`Error::ShapeMismatch`] if a target or `gradient` has another size than `maps`.
pub fn photo_loss<T: Real>(
    maps: &Maps<T>,
    patch_size: f64,
    targets: &[Target],
    gradient: Option<&mut Maps<T>>,
) -> Result<f64> {
    let grid = Grid::new(maps, patch_size)?;
    let pixels = maps.width() * maps.height();
    if targets.is_empty() {
        return Err(Error::invalid("targets", "expected at least one photo, got none"));
    }
    let size = |width: usize, height: usize| format!("{height} x {width}");
    let mut views = Vec::with_capacity(targets.len());
    for target in targets {
        if (target.width, target.height) != (maps.width(), maps.height()) {
            return Err(Error::shape("target", size(maps.width(), maps.height()), size(target.width, target.height)));
        }
        views.push((View::new(&target.shot, patch_size)?, target));
    }
    let weight = LOSS_SCALE / (3.0 * pixels as f64 * targets.len() as f64);
    pool::inside(|| compared(&Job { grid: &grid, views: &views, maps, weight }, gradient))
}

/// The weighted sum of the errors that `job` states, with its gradient as [`photo_loss`] gives it.
pub(super) fn compared<T: Real, C: Comparison<T>>(job: &Job<'_, T, C>, gradient: Option<&mut Maps<T>>) -> Result<f64> {
    let Job { grid, maps, weight, .. } = *job;
    let pixels = maps.width() * maps.height();
    let partial: Vec<f64> = match gradient {
        Some(gradient) => {
            if (gradient.lobe(), gradient.width(), gradient.height()) != (maps.lobe(), maps.width(), maps.height()) {
                let shape =
                    |maps: &Maps<T>| format!("{} planes of {} x {}", maps.lobe().planes(), maps.height(), maps.width());
                return Err(Error::shape("gradient", shape(maps), shape(gradient)));
            }
            let mut chunks = split_planes(gradient.data_mut(), pixels, grid.chunk_rows * grid.width);
            chunks
                .par_iter_mut()
                .enumerate()
                .map(|(index, out)| T::run(LossRows::<_, _, true> { job, rows: grid.rows(index), gradient: out }))
                .collect()
        }
        None => (0..maps.height().div_ceil(grid.chunk_rows))
            .into_par_iter()
            .map(|index| T::run(LossRows::<_, _, false> { job, rows: grid.rows(index), gradient: &mut [] }))
            .collect(),
    };
    Ok(weight * partial.iter().sum::<f64>())
}

/// What all chunks share.
pub(super) struct Job<'a, T, C> {
    pub grid: &'a Grid,
    pub views: &'a [(View, &'a C)],
    pub maps: &'a Maps<T>,
    /// Of every error.
    pub weight: f64,
}

/// Sum of errors and gradient of some rows.
struct LossRows<'a, T, C, const GRADIENT: bool> {
    job: &'a Job<'a, T, C>,
    rows: std::ops::Range<usize>,
    gradient: &'a mut [&'a mut [T]],
}

impl<T: Real, C: Comparison<T>, const GRADIENT: bool> LossRows<'_, T, C, GRADIENT> {
    #[inline(always)]
    fn rows<L: Lanes<Scalar = T>, const ANISOTROPIC: bool>(self) -> f64 {
        let Job { grid, views, maps, weight } = *self.job;
        let planes = planes(maps);
        let weight = L::splat(2.0 * weight);
        let (mut tile, mut out) = (Tile::new(), Tile::new());
        let mut sum = L::Wide::splat(0.0);
        for row in self.rows.clone() {
            for column in (0..grid.width).step_by(TILE) {
                let len = TILE.min(grid.width - column);
                tile.read::<L>(&planes, row * grid.width + column, len);
                for at in (0..len).step_by(L::LANES) {
                    let surface = tile.load_surface::<L, ANISOTROPIC>(at);
                    let frame = Frame::<L, ANISOTROPIC>::new(&surface);
                    let (x, y) = grid.position::<L>(row, column + at);
                    let mut gradient = FrameGradient::zero();
                    for (view, target) in views {
                        let response = view.response(&frame, x, y);
                        let intensity = view.intensity::<L>();
                        let radiance = response.radiance(&surface, intensity);
                        let (errors, slopes) = target.compare(row, column + at, radiance);
                        sum = sum + errors.widen();
                        if GRADIENT {
                            let mut by_response = slopes;
                            for c in 0..3 {
                                by_response[c] = slopes[c] * (intensity[c] * weight);
                            }
                            gradient.add(&surface, &response, by_response);
                        }
                    }
                    if GRADIENT {
                        out.store_surface::<L, ANISOTROPIC>(at, &gradient.finish(&frame));
                    }
                }
                if GRADIENT {
                    out.write(self.gradient, (row - self.rows.start) * grid.width + column, len);
                }
            }
        }
        sum.sum()
    }
}

impl<T: Real, C: Comparison<T>, const GRADIENT: bool> Kernel<T> for LossRows<'_, T, C, GRADIENT> {
    type Output = f64;

    #[inline(always)]
    fn run<L: Lanes<Scalar = T>>(self) -> f64 {
        match self.job.maps.lobe() {
            Lobe::Isotropic => self.rows::<L, false>(),
            Lobe::Anisotropic => self.rows::<L, true>(),
        }
    }
}
