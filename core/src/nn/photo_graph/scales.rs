//! A capture much larger than the crops that a network was trained on is shown to it smaller, too: what spreads over many pixels is taken rather from
//! there, details from where they are seen.

use rayon::prelude::*;

/// Pixels of the finer prediction, in each direction, whose mean is corrected at once; half as many of the coarser one.
const BLOCK: usize = 8;

/// How many pixels of a photo, in each direction, make one that the network sees: from 1 on, doubled as long as the longer side keeps half of the `window` that the
/// network was trained on.
pub(super) fn steps(longer: usize, window: Option<usize>) -> Vec<usize> {
    let Some(window) = window else { return vec![1] };
    let kept = |step: &usize| *step == 1 || longer.div_ceil(*step) >= window.div_ceil(2);
    std::iter::successors(Some(1usize), |step| step.checked_mul(2)).take_while(kept).collect()
}

/// Corrects planes of raw values (`size`: rows, columns) by those of a prediction at half the resolution. The larger the picture is beside the `window`, the less
/// the network is believed about what spreads over it.
pub(super) fn correct(fine: &mut [f32], coarse: &[f32], size: (usize, usize), window: usize) {
    let (height, width) = size;
    let half = (height.div_ceil(2), width.div_ceil(2));
    let longer = height.max(width);
    let share = longer as f32 / (longer + window) as f32;
    let across = width.div_ceil(BLOCK);
    let columns: Vec<_> = (0..width).map(|column| between(column, across)).collect();
    let planes = fine.par_chunks_exact_mut(height * width).zip(coarse.par_chunks_exact(half.0 * half.1));
    planes.for_each(|(fine, coarse)| {
        let [there, here] = [means(coarse, half, BLOCK / 2), means(fine, size, BLOCK)];
        let off: Vec<f32> = there.iter().zip(&here).map(|(there, here)| share * (there - here)).collect();
        for (row, fine) in fine.chunks_exact_mut(width).enumerate() {
            let (above, below, down) = between(row, height.div_ceil(BLOCK));
            let [above, below] = [above, below].map(|line| &off[line * across..][..across]);
            for (value, &(left, right, along)) in fine.iter_mut().zip(&columns) {
                let [above, below] = [above, below].map(|line| line[left] + along * (line[right] - line[left]));
                *value += above + down * (below - above);
            }
        }
    });
}

/// The blocks of `count` whose middles a row or column lies between, and how far it is on the way.
fn between(at: usize, count: usize) -> (usize, usize, f32) {
    let place = ((at as f32 + 0.5) / BLOCK as f32 - 0.5).clamp(0.0, (count - 1) as f32);
    let first = place as usize;
    (first, (first + 1).min(count - 1), place - first as f32)
}

/// Means of a plane over blocks of `side` x `side` pixels, smaller ones at the right and bottom.
fn means(plane: &[f32], (height, width): (usize, usize), side: usize) -> Vec<f32> {
    let mut out = Vec::with_capacity(height.div_ceil(side) * width.div_ceil(side));
    for lines in plane.chunks(side * width) {
        let rows = lines.len() / width;
        for first in (0..width).step_by(side) {
            let columns = first..width.min(first + side);
            let sum: f32 = lines.chunks_exact(width).flat_map(|line| &line[columns.clone()]).sum();
            out.push(sum / (rows * columns.len()) as f32);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::{correct, steps};

    #[test]
    fn small_pictures_are_seen_once_and_large_ones_down_to_half_a_window() {
        assert_eq!(steps(1, Some(96)), [1]);
        assert_eq!(steps(94, Some(96)), [1]);
        assert_eq!(steps(128, Some(96)), [1, 2]);
        assert_eq!(steps(256, Some(96)), [1, 2, 4]);
        assert_eq!(steps(1025, Some(96)), [1, 2, 4, 8, 16]);
        assert_eq!(steps(1025, None), [1]);
        assert_eq!(steps(usize::MAX, Some(1)).len(), 64);
    }

    #[test]
    fn what_spreads_comes_from_afar_and_details_stay() {
        for size in [(1usize, 1usize), (7, 3), (16, 16), (33, 50)] {
            let (height, width) = size;
            let half = height.div_ceil(2) * width.div_ceil(2);
            let window = height.max(width);
            // The finer picture alternates about .4, the coarser one is even: half of what is between them is taken over.
            let checker = |p: usize| if (p / width + p % width).is_multiple_of(2) { 0.1 } else { -0.1 };
            let mut fine: Vec<f32> = (0..2 * height * width).map(|p| 0.4 + checker(p % (height * width))).collect();
            let coarse: Vec<f32> = (0..2 * half).map(|p| if p < half { 0.8 } else { 0.4 }).collect();
            correct(&mut fine, &coarse, size, window);
            let (first, second) = fine.split_at(height * width);
            let mean = |plane: &[f32]| plane.iter().sum::<f32>() / plane.len() as f32;
            // Blocks of an odd number of pixels have a mean of their own.
            assert!((mean(first) - 0.6).abs() < 0.06, "{size:?}: {}", mean(first));
            assert!((mean(second) - 0.4).abs() < 0.06, "{size:?}: {}", mean(second));
            if height.is_multiple_of(2) && width.is_multiple_of(2) {
                for (p, (first, second)) in first.iter().zip(second).enumerate() {
                    let (row, column) = (p / width, p % width);
                    let inside = row + 8 < height && column + 8 < width;
                    assert!(!inside || (first - 0.6 - checker(p)).abs() < 1e-5, "{size:?} {p}: {first}");
                    assert!(!inside || (second - 0.4 - checker(p)).abs() < 1e-5, "{size:?} {p}: {second}");
                }
            }
        }
    }

    #[test]
    fn a_slope_that_both_see_stays_a_slope() {
        let (height, width) = (40, 64);
        let ramp = |column: f32| column / width as f32;
        let mut fine: Vec<f32> = (0..height * width).map(|p| ramp((p % width) as f32 + 0.5)).collect();
        let before = fine.clone();
        let coarse: Vec<f32> = (0..height * width / 4).map(|p| ramp(2.0 * (p % (width / 2)) as f32 + 1.0)).collect();
        correct(&mut fine, &coarse, (height, width), 96);
        for (after, before) in fine.iter().zip(&before) {
            assert!((after - before).abs() < 1e-6, "{after} {before}");
        }
    }
}
