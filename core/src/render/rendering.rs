//! The loss of renderings of maps against renderings of the true maps, as training uses it.

use std::f64::consts::LN_2;

use super::loss::{Comparison, Job, compared};
use super::{Grid, TOE, View, padded, render_maps};
use crate::brdf::real::{Kernel, Lanes, Real};
use crate::error::{Error, Result};
use crate::maps::Maps;
use crate::shot::Shot;

const GAMMA: f64 = 2.2;

/// Radiance for comparisons, and its slope: gamma 2.2 up to 1, above it the logarithm that continues it with the same slope, below
/// [`TOE`] a line (`python/training/render.py`, `compress_radiance`).
#[inline(always)]
fn compress<L: Lanes>(radiance: L) -> (L, L) {
    let (one, toe, share) = (L::splat(1.0), L::splat(TOE), L::splat(1.0 / GAMMA));
    let line = L::splat(TOE.powf(1.0 / GAMMA) / TOE);
    let high = radiance.max(toe);
    let power = high.min(one).pow_normal(1.0 / GAMMA);
    let (above, bright) = (radiance.gt(toe), radiance.gt(one));
    let logarithm = high.max(one).log2() * L::splat(LN_2 / GAMMA);
    let value = L::select(above, power + logarithm, radiance * line);
    let slope = L::select(above, L::select(bright, one, power) * share / high, line);
    (value, slope)
}

/// One rendering of the true maps, compressed: (height, 3, padded width).
struct Rendered<T> {
    stride: usize,
    rows: Vec<T>,
}

impl<T: Real> Rendered<T> {
    fn new(maps: &Maps<T>, patch_size: f64, shot: &Shot) -> Result<Self> {
        let mut planes = render_maps(maps, patch_size, shot)?;
        T::run(Compress { values: &mut planes });
        let (width, height) = (maps.width(), maps.height());
        let stride = padded(width);
        let mut rows = vec![T::default(); 3 * height * stride];
        for (i, row) in rows.chunks_exact_mut(stride).enumerate() {
            row[..width].copy_from_slice(&planes[((i % 3) * height + i / 3) * width..][..width]);
        }
        Ok(Self { stride, rows })
    }
}

impl<T: Real> Comparison<T> for Rendered<T> {
    /// Absolute errors.
    #[inline(always)]
    fn compare<L: Lanes<Scalar = T>>(&self, row: usize, column: usize, radiance: [L; 3]) -> (L, [L; 3]) {
        let zero = L::splat(0.0);
        let (mut sum, mut slopes) = (zero, [zero; 3]);
        for c in 0..3 {
            let (value, slope) = compress(radiance[c]);
            let error = value - L::load(&self.rows[(row * 3 + c) * self.stride + column..][..L::LANES]);
            sum = sum + error.abs();
            let half = slope * L::splat(0.5);
            slopes[c] = L::select(error.gt(zero), half, L::select(zero.gt(error), -half, zero));
        }
        (sum, slopes)
    }
}

/// Compresses radiance in place.
struct Compress<'a, T> {
    values: &'a mut [T],
}

impl<T: Real> Kernel<T> for Compress<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes<Scalar = T>>(self) {
        for values in self.values.chunks_mut(L::LANES) {
            compress(L::load(values)).0.store(values);
        }
    }
}

/// Mean over `shots`, channels and pixels of the absolute difference of compressed renderings of `maps` and of `truth`; `gradient` is overwritten with
/// its derivatives by every value of `maps`.
///
/// # Errors
/// As [`super::photo_loss`], for `shots`, `truth` and `gradient`.
pub(crate) fn rendering_loss<T: Real>(
    maps: &Maps<T>,
    truth: &Maps<T>,
    patch_size: f64,
    shots: &[Shot],
    gradient: &mut Maps<T>,
) -> Result<f64> {
    let grid = Grid::new(maps, patch_size)?;
    if shots.is_empty() {
        return Err(Error::invalid("views", "expected at least one, got none"));
    }
    if (truth.width(), truth.height()) != (maps.width(), maps.height()) {
        let size = |maps: &Maps<T>| format!("{} x {}", maps.height(), maps.width());
        return Err(Error::shape("truth", size(maps), size(truth)));
    }
    let rendered = shots.iter().map(|shot| Rendered::new(truth, patch_size, shot)).collect::<Result<Vec<_>>>()?;
    let views = shots.iter().zip(&rendered).map(|(shot, rendered)| Ok((View::new(shot, patch_size)?, rendered)));
    let views = views.collect::<Result<Vec<_>>>()?;
    let weight = 1.0 / (3 * maps.width() * maps.height() * shots.len()) as f64;
    compared(&Job { grid: &grid, views: &views, maps, weight }, Some(gradient))
}
