//! How the channels of an image lie in memory inside the network.

use std::ops::Range;

use rayon::prelude::*;

use super::scalar::Scalar;

/// Pixels of a band, roughly: enough for full speed of the matrix products, few enough for the caches.
const BAND_PIXELS: usize = 256;

/// Images are cut into bands of full rows; within a band all of channel 0 comes first, then all of channel 1, and so on.
///
/// A band is one contiguous piece, so that bands can be worked on in parallel, and a matrix (channels x pixels) for a 1x1 convolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Layout {
    /// Channels.
    pub channels: usize,
    /// Rows of the image.
    pub height: usize,
    /// Columns of the image.
    pub width: usize,
}

impl Layout {
    /// The same image with another number of channels.
    pub fn with_channels(self, channels: usize) -> Self {
        Self { channels, ..self }
    }

    /// Pixels of the image.
    pub fn pixels(self) -> usize {
        self.height * self.width
    }

    /// Values of the image.
    pub fn len(self) -> usize {
        self.channels * self.pixels()
    }

    /// Rows of every band but the last, which may have fewer.
    fn rows(self) -> usize {
        // At least two bands where that leaves them 128 pixels.
        let pixels = BAND_PIXELS.min((self.pixels() / 2).max(128));
        (pixels / self.width).clamp(1, self.height)
    }

    /// Number of bands.
    pub fn bands(self) -> usize {
        self.height.div_ceil(self.rows())
    }

    /// The rows of band `band`.
    pub fn band_rows(self, band: usize) -> Range<usize> {
        band * self.rows()..((band + 1) * self.rows()).min(self.height)
    }

    /// Values of every band but the last: the chunk size that cuts an image into its bands.
    pub fn band_len(self) -> usize {
        self.channels * self.rows() * self.width
    }

    /// Where channels `channels` of band `band` lie.
    pub fn part(self, band: usize, channels: Range<usize>) -> Range<usize> {
        let pixels = self.band_rows(band).len() * self.width;
        let start = band * self.band_len();
        start + channels.start * pixels..start + channels.end * pixels
    }

    /// Where band `band` lies.
    pub fn band(self, band: usize) -> Range<usize> {
        self.part(band, 0..self.channels)
    }

    /// Where row `row` of channel `channel` lies.
    pub fn row(self, channel: usize, row: usize) -> Range<usize> {
        let band = row / self.rows();
        let rows = self.band_rows(band);
        let start = band * self.band_len() + (channel * rows.len() + row - rows.start) * self.width;
        start..start + self.width
    }

    /// An image in this layout from planes of `height` x `width` values, zero to the right and below of them.
    pub fn pack<E: Scalar>(self, planar: &[E], height: usize, width: usize) -> Vec<E> {
        let mut out = vec![E::default(); self.len()];
        out.par_chunks_mut(self.band_len()).enumerate().for_each(|(band, chunk)| {
            let rows = self.band_rows(band);
            for (line, target) in chunk.chunks_exact_mut(self.width).enumerate() {
                let (channel, row) = (line / rows.len(), rows.start + line % rows.len());
                if row < height {
                    target[..width].copy_from_slice(&planar[(channel * height + row) * width..][..width]);
                }
            }
        });
        out
    }

    /// The upper left `height` x `width` pixels of an image in this layout, plane after plane.
    pub fn unpack<E: Scalar>(self, data: &[E], height: usize, width: usize) -> Vec<E> {
        let mut out = vec![E::default(); self.channels * height * width];
        out.par_chunks_mut(height * width).enumerate().for_each(|(channel, plane)| {
            for (row, target) in plane.chunks_exact_mut(width).enumerate() {
                target.copy_from_slice(&data[self.row(channel, row)][..width]);
            }
        });
        out
    }
}

#[cfg(test)]
mod tests {
    use super::Layout;

    #[test]
    fn bands_cover_every_row_once_and_rows_lie_where_chunks_say() {
        for (height, width) in [(16, 16), (256, 256), (33, 40), (1, 1), (1, 3000), (3000, 1), (7, 128)] {
            let layout = Layout { channels: 3, height, width };
            let mut next = 0;
            let mut seen = vec![false; layout.len()];
            for band in 0..layout.bands() {
                assert_eq!(layout.band_rows(band).start, next);
                next = layout.band_rows(band).end;
                let chunk = band * layout.band_len()..((band + 1) * layout.band_len()).min(layout.len());
                for row in layout.band_rows(band) {
                    for channel in 0..3 {
                        let place = layout.row(channel, row);
                        assert!(chunk.start <= place.start && place.end <= chunk.end);
                        seen[place].fill(true);
                    }
                }
            }
            assert_eq!(next, height);
            assert!(seen.iter().all(|&seen| seen));
        }
    }

    #[test]
    fn padding_and_cropping() {
        let layout = Layout { channels: 2, height: 36, width: 44 };
        let planar: Vec<f32> = (0..2 * 33 * 41).map(|i| i as f32 + 1.0).collect();
        let padded = layout.pack(&planar, 33, 41);
        assert_eq!(layout.unpack(&padded, 33, 41), planar);
        assert_eq!(padded.iter().filter(|&&v| v != 0.0).count(), planar.len());
    }
}
