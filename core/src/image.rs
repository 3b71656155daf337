//! Pixels in memory: interleaved rows for everything that crosses the API.

use crate::error::{Error, Result};
use crate::memory;

/// An image of `f32`, rows from the top, channels interleaved: the value of channel `c` at row `i`, column `j` is
/// `data[(i * width + j) * channels + c]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    width: usize,
    height: usize,
    channels: usize,
    data: Vec<f32>,
}

impl Image {
    /// An image from its pixels.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if `data` does not hold `width * height * channels` values, or a size is zero.
    pub fn new(width: usize, height: usize, channels: usize, data: Vec<f32>) -> Result<Self> {
        let expected = width.checked_mul(height).and_then(|n| n.checked_mul(channels));
        if expected != Some(data.len()) || data.is_empty() {
            return Err(Error::shape(
                "image",
                format!("{height} x {width} x {channels} values"),
                format!("{} values", data.len()),
            ));
        }
        Ok(Self { width, height, channels, data })
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Values per pixel.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// All values, rows from the top, channels interleaved.
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// All values, to be changed in place.
    pub fn data_mut(&mut self) -> &mut [f32] {
        &mut self.data
    }

    /// The values, channel by channel: all of channel 0, then all of channel 1, ...
    ///
    /// # Errors
    /// [`Error::OutOfMemory`] if the system refuses memory for them.
    pub fn to_planar(&self) -> Result<Vec<f32>> {
        let pixels = self.width * self.height;
        let mut planar = memory::filled(0.0, self.data.len())?;
        for (p, pixel) in self.data.chunks_exact(self.channels).enumerate() {
            for (c, &value) in pixel.iter().enumerate() {
                planar[c * pixels + p] = value;
            }
        }
        Ok(planar)
    }

    /// The inverse of [`Image::to_planar`].
    ///
    /// # Errors
    /// As [`Image::new`] and [`Image::to_planar`].
    pub fn from_planar(width: usize, height: usize, channels: usize, planar: &[f32]) -> Result<Self> {
        let mut image = Self::new(width, height, channels, memory::filled(0.0, planar.len())?)?;
        let pixels = width * height;
        for (p, pixel) in image.data.chunks_exact_mut(channels).enumerate() {
            for (c, value) in pixel.iter_mut().enumerate() {
                *value = planar[c * pixels + p];
            }
        }
        Ok(image)
    }
}

#[cfg(test)]
mod tests {
    use super::Image;

    #[test]
    fn planar_and_back() {
        let image = Image::new(2, 1, 3, vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]).unwrap();
        assert_eq!(image.to_planar().unwrap(), [1.0, 4.0, 2.0, 5.0, 3.0, 6.0]);
        assert_eq!(Image::from_planar(2, 1, 3, &image.to_planar().unwrap()).unwrap(), image);
    }

    #[test]
    fn wrong_sizes_are_errors() {
        assert!(Image::new(2, 2, 3, vec![0.0; 11]).is_err());
        assert!(Image::new(0, 2, 3, vec![]).is_err());
        assert!(Image::new(usize::MAX, 2, 3, vec![0.0]).is_err());
    }
}
