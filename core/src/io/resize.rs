//! Area resampling: every output pixel is the mean of the input over its footprint.

use rayon::prelude::*;

use crate::error::Result;
use crate::{memory, pool};

/// Shrinks an image, row by row, to `out_width` x `out_height`, none larger than the input's.
///
/// The footprint of output pixel j along an axis of n input and m output pixels is [j n/m, (j+1) n/m]; an input pixel counts by
/// the part of it that lies inside, computed from whole numbers, so constant images stay constant and the mean is kept. Bits of the input's mask
/// are set in the output wherever an input pixel of the footprint, however little of it lies inside, has them.
///
/// `read(y, row, mask)` gives input row `y`: `channels` values per pixel and one byte of bits per pixel.
///
/// # Errors
/// [`Error::OutOfMemory`](crate::Error::OutOfMemory) if the system refuses memory for the output; what `read` returns.
pub(crate) fn shrink(
    (width, height): (usize, usize),
    (out_width, out_height): (usize, usize),
    channels: usize,
    read: impl Fn(usize, &mut [f32], &mut [u8]) -> Result<()> + Sync,
) -> Result<(Vec<f32>, Vec<u8>)> {
    debug_assert!(out_width <= width && out_height <= height);
    let columns: Vec<Footprint> = (0..out_width).map(|j| Footprint::new(width, out_width, j)).collect();
    let mut values = memory::filled(0.0f32, out_width * out_height * channels)?;
    let mut masks = memory::filled(0u8, out_width * out_height)?;
    let rows = values.par_chunks_exact_mut(out_width * channels).zip(masks.par_chunks_exact_mut(out_width));
    let shrink_row = |(i, (out_row, out_mask)): (usize, (&mut [f32], &mut [u8]))| {
        if (out_width, out_height) == (width, height) {
            return read(i, out_row, out_mask);
        }
        let mut row = vec![0.0f32; width * channels];
        let mut mask = vec![0u8; width];
        let mut sums = vec![0.0f64; out_width * channels];
        let footprint = Footprint::new(height, out_height, i);
        for (k, &row_weight) in footprint.weights.iter().enumerate() {
            read(footprint.start + k, &mut row, &mut mask)?;
            for (j, column) in columns.iter().enumerate() {
                let pixels = row[column.start * channels..].chunks_exact(channels);
                let bits = &mask[column.start..column.start + column.weights.len()];
                for ((&weight, pixel), &bits) in column.weights.iter().zip(pixels).zip(bits) {
                    for (sum, &value) in sums[j * channels..(j + 1) * channels].iter_mut().zip(pixel) {
                        *sum += row_weight * weight * f64::from(value);
                    }
                    out_mask[j] |= bits;
                }
            }
        }
        for (out, sum) in out_row.iter_mut().zip(sums) {
            *out = sum as f32;
        }
        Ok(())
    };
    pool::inside(|| rows.enumerate().try_for_each(shrink_row))?;
    Ok((values, masks))
}

/// The input pixels under one output pixel along one axis, and their shares of it.
struct Footprint {
    start: usize,
    weights: Vec<f64>,
}

impl Footprint {
    /// Output pixel `j` of `m`, over `n` input pixels. In units of 1/m input pixels it covers [j n, (j + 1) n], input pixel s
    /// covers [s m, (s + 1) m].
    fn new(n: usize, m: usize, j: usize) -> Self {
        let (from, to) = (j * n, (j + 1) * n);
        let start = from / m;
        let weights =
            (start..to.div_ceil(m)).map(|s| (((s + 1) * m).min(to) - (s * m).max(from)) as f64 / n as f64).collect();
        Self { start, weights }
    }
}

/// The size of an image whose longer side shall be at most `longer`: never larger than it is, the aspect kept to the pixel.
pub(crate) fn fit_size(width: usize, height: usize, longer: Option<usize>) -> (usize, usize) {
    let side = width.max(height);
    let Some(longer) = longer.filter(|&longer| longer < side) else { return (width, height) };
    let scale = |n: usize| (((n as f64) * (longer as f64) / (side as f64)).round() as usize).max(1);
    (scale(width), scale(height))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{fit_size, shrink};

    fn shrink_grey(values: &[f32], mask: &[u8], size: (usize, usize), out: (usize, usize)) -> (Vec<f32>, Vec<u8>) {
        shrink(size, out, 1, |y, row, bits| {
            row.copy_from_slice(&values[y * size.0..(y + 1) * size.0]);
            bits.copy_from_slice(&mask[y * size.0..(y + 1) * size.0]);
            Ok(())
        })
        .unwrap()
    }

    #[test]
    fn three_to_two_by_hand() {
        let (values, mask) = shrink_grey(&[3.0, 6.0, 12.0], &[0, 1, 2], (3, 1), (2, 1));
        assert_eq!(values, [4.0, 10.0]);
        assert_eq!(mask, [1, 3]);
    }

    #[test]
    fn sizes() {
        assert_eq!(fit_size(1024, 512, Some(256)), (256, 128));
        assert_eq!(fit_size(100, 300, Some(200)), (67, 200));
        assert_eq!(fit_size(100, 300, Some(400)), (100, 300));
        assert_eq!(fit_size(1, 300, Some(10)), (1, 10));
        assert_eq!(fit_size(9, 8, None), (9, 8));
    }

    proptest! {
        #[test]
        fn mean_and_constants_are_kept(
            (width, height) in (1usize..24, 1usize..24),
            (x, y) in (0.0f64..1.0, 0.0f64..1.0),
            seed in any::<u64>(),
        ) {
            let out = (1 + (x * width as f64) as usize, 1 + (y * height as f64) as usize);
            let noise = |i: usize| ((i as u64 + 1).wrapping_mul(seed | 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f32 / 16_777_216.0;
            let image: Vec<f32> = (0..width * height).map(noise).collect();
            let clear = vec![0; image.len()];
            let (small, _) = shrink_grey(&image, &clear, (width, height), out);
            let mean = |values: &[f32]| values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len() as f64;
            prop_assert!((mean(&image) - mean(&small)).abs() < 1e-6);
            let (constant, _) = shrink_grey(&vec![0.3; image.len()], &clear, (width, height), out);
            prop_assert!(constant.iter().all(|v| (v - 0.3).abs() < 1e-7));
            let (same, _) = shrink_grey(&image, &clear, (width, height), (width, height));
            prop_assert_eq!(same, image);
        }

        #[test]
        fn one_saturated_pixel_marks_every_footprint_it_touches(
            (width, height) in (1usize..24, 1usize..24),
            (x, y) in (0.0f64..1.0, 0.0f64..1.0),
            (px, py) in (0.0f64..1.0, 0.0f64..1.0),
        ) {
            let (m, n) = (1 + (x * width as f64) as usize, 1 + (y * height as f64) as usize);
            let (px, py) = ((px * width as f64) as usize, (py * height as f64) as usize);
            let mut mask = vec![0; width * height];
            mask[py * width + px] = 4;
            let (_, marked) = shrink_grey(&vec![0.0; width * height], &mask, (width, height), (m, n));
            // Open intervals (s, s + 1) and (j w/m, (j + 1) w/m) overlap, compared as fractions.
            let touches = |s: usize, j: usize, from: usize, to: usize| s * to < (j + 1) * from && (s + 1) * to > j * from;
            for i in 0..n {
                for j in 0..m {
                    let expected = if touches(px, j, width, m) && touches(py, i, height, n) { 4 } else { 0 };
                    prop_assert_eq!(marked[i * m + j], expected);
                }
            }
        }
    }
}
