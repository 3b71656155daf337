//! Photos that are left out judge a fit: which ones, and on which pixels.

use crate::capture::{Capture, Photo};
use crate::error::Result;
use crate::image::Image;

/// Pixels along the longer side on which photos that are left out judge a fit.
pub(crate) const REHEARSAL_SIDE: usize = 64;
/// How many of them are left out at most, one at a time.
pub(crate) const LEFT_OUT: usize = 4;

/// The photos of `count` that are left out, one at a time: `most` of them at most, evenly spread.
pub(crate) fn left_out(count: usize, most: usize) -> impl Iterator<Item = usize> + Clone {
    let folds = count.min(most);
    (0..folds).map(move |fold| fold * count / folds)
}

/// `capture` on a regular grid of its pixels, `side` along the longer side at most; and which pixels these are.
pub(crate) fn thinned(capture: &Capture, side: usize) -> Result<(Capture, Vec<usize>)> {
    let ([across, down], pixels) = grid(capture.width(), capture.height(), side);
    let part = |photo: &Photo| -> Result<Photo> {
        let data = pixels.iter().flat_map(|&p| photo.image.data()[3 * p..3 * p + 3].iter().copied()).collect();
        Ok(Photo {
            name: photo.name.clone(),
            shot: photo.shot,
            image: Image::new(across, down, 3, data)?,
            saturated: pixels.iter().map(|&p| photo.saturated[p]).collect(),
        })
    };
    let photos = capture.photos().iter().map(part).collect::<Result<_>>()?;
    Ok((Capture::new(photos, capture.patch_size(), capture.transfer())?, pixels))
}

/// `count` planes at some pixels only.
pub(crate) fn thinned_planes(planes: &[f32], count: usize, pixels: &[usize]) -> Vec<f32> {
    let length = planes.len() / count;
    planes.chunks_exact(length).flat_map(|plane| pixels.iter().map(|&p| plane[p])).collect()
}

/// A regular grid on an image, `side` pixels along the longer side at most: its columns and rows, and its pixels.
pub(crate) fn grid(width: usize, height: usize, side: usize) -> ([usize; 2], Vec<usize>) {
    let pitch = (width.max(height) as f64 / side as f64).max(1.0);
    let size = |len: usize| ((len as f64 / pitch).round() as usize).max(1);
    let (across, down) = (size(width), size(height));
    let ticks = |len: usize, count: usize| (0..count).map(move |i| (2 * i + 1) * len / (2 * count));
    let pixels = ticks(height, down).flat_map(|y| ticks(width, across).map(move |x| y * width + x)).collect();
    ([across, down], pixels)
}

#[cfg(test)]
mod tests {
    use super::{grid, left_out};

    #[test]
    fn photos_left_out_are_spread_and_each_is_left_out_once() {
        assert_eq!(left_out(9, 4).collect::<Vec<_>>(), [0, 2, 4, 6]);
        assert_eq!(left_out(3, 4).collect::<Vec<_>>(), [0, 1, 2]);
        assert_eq!(left_out(0, 4).count(), 0);
    }

    #[test]
    fn a_grid_covers_the_image_evenly() {
        let ([across, down], pixels) = grid(8, 4, 4);
        assert_eq!(([across, down], pixels), ([4, 2], vec![9, 11, 13, 15, 25, 27, 29, 31]));
        assert_eq!(grid(3, 2, 64), ([3, 2], (0..6).collect()));
        assert_eq!(grid(1000, 1, 10).0, [10, 1]);
    }
}
