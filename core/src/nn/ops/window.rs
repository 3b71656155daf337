//! Means over windows, for channel attention in pictures larger than those of the training.

use rayon::prelude::*;

use crate::nn::kernels::{add_wide, exchange_wide, running_means};
use crate::nn::layout::Layout;
use crate::nn::scalar::Scalar;
use crate::nn::tape::{Buffer, Pool};

/// Means of every channel of `x` over `window` x `window` pixels around each pixel, in the layout of `x`.
///
/// The window of pixel i begins at i - window / 2; at the edges it is moved inwards, and a window longer than a side is cut to it. Summed in `f64`,
/// row sums gliding down the picture and prefix sums along each row: the cost does not depend on `window`.
pub(crate) fn window_means<E: Scalar>(x: &[E], layout: Layout, window: usize, pool: &Pool<E>) -> Buffer<E> {
    let Layout { channels, height, width } = layout;
    let (rows, columns) = (window.clamp(1, height), window.clamp(1, width));
    let start = |row: usize| row.saturating_sub(rows / 2).min(height - rows);
    let share = 1.0 / (rows * columns) as f64;
    // Every task sums the rows of its first window anew, so that tasks are not much lower than a window.
    let bands = (rows / 2).div_ceil(layout.band_rows(0).len()).max(1);
    let mut out = pool.take(layout.len());
    out.par_chunks_mut(bands * layout.band_len()).enumerate().for_each(|(task, out)| {
        let begin = task * bands * layout.band_len();
        let first = layout.band_rows(task * bands).start;
        let last = first + out.len() / (channels * width);
        let (mut sums, mut prefix) = (vec![0.0; width], vec![0.0; width + 1]);
        for channel in 0..channels {
            let line = |row: usize| &x[layout.row(channel, row)];
            sums.fill(0.0);
            let mut top = start(first);
            (top..top + rows).for_each(|row| add_wide(&mut sums, line(row)));
            for row in first..last {
                if start(row) > top {
                    exchange_wide(&mut sums, line(top + rows), line(top));
                    top += 1;
                }
                let place = layout.row(channel, row).start - begin;
                running_means(&mut out[place..place + width], &sums, &mut prefix, columns, share);
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::window_means;
    use crate::nn::layout::Layout;
    use crate::nn::ops::testing::{compare, numbers};
    use crate::nn::tape::Pool;

    #[test]
    fn means_of_the_definition() {
        for (height, width) in [(20, 40), (1, 7), (7, 1), (3, 300), (300, 3), (64, 64)] {
            let layout = Layout { channels: 3, height, width };
            let x = numbers(layout.len(), 1);
            let packed = layout.pack(&x, height, width);
            for window in [1, 2, 5, 16, 31, 64, 1000] {
                let (rows, columns) = (window.min(height), window.min(width));
                let mut expected = vec![0.0; layout.len()];
                for (at, expected) in expected.iter_mut().enumerate() {
                    let (channel, row, column) = (at / (height * width), at / width % height, at % width);
                    let top = row.saturating_sub(rows / 2).min(height - rows);
                    let left = column.saturating_sub(columns / 2).min(width - columns);
                    for row in top..top + rows {
                        let line = (channel * height + row) * width;
                        *expected += x[line + left..line + left + columns].iter().sum::<f64>();
                    }
                    *expected /= (rows * columns) as f64;
                }
                let means = window_means(&packed, layout, window, &Pool::default());
                compare(&layout.unpack(&means, height, width), &expected, 1e-12, "means");
            }
        }
    }

    #[test]
    fn single_precision_does_not_drift() {
        let layout = Layout { channels: 1, height: 2000, width: 5 };
        let x: Vec<f32> = numbers(layout.len(), 2).iter().map(|&value| 1e4 + value as f32).collect();
        let means = window_means(&layout.pack(&x, 2000, 5), layout, 3, &Pool::default());
        let means = layout.unpack(&means, 2000, 5);
        for row in 1..1999 {
            let expected: f64 =
                (row - 1..row + 2).flat_map(|r| &x[5 * r..5 * r + 3]).map(|&v| f64::from(v)).sum::<f64>() / 9.0;
            assert!((f64::from(means[5 * row + 1]) - expected).abs() < 1e-3, "{row}");
        }
    }
}
