//! The parameters of one adapter, as they lie in memory, in a weights file and under the optimiser.

use std::ops::Range;

use crate::error::{Error, Result};

/// Shape of a tensor of a block, given the block's channels.
type ShapeOf = fn(usize) -> [usize; 4];

/// Tensors of a NAFNet block on `m` channels, in the order of [`AdapterParams::values`]: name, shape.
const BLOCK: [(&str, ShapeOf); 18] = [
    ("norm1.weight", |m| [m, 1, 1, 1]),
    ("norm1.bias", |m| [m, 1, 1, 1]),
    ("conv1.weight", |m| [2 * m, m, 1, 1]),
    ("conv1.bias", |m| [2 * m, 1, 1, 1]),
    ("conv2.weight", |m| [2 * m, 1, 3, 3]),
    ("conv2.bias", |m| [2 * m, 1, 1, 1]),
    ("sca.1.weight", |m| [m, m, 1, 1]),
    ("sca.1.bias", |m| [m, 1, 1, 1]),
    ("conv3.weight", |m| [m, m, 1, 1]),
    ("conv3.bias", |m| [m, 1, 1, 1]),
    ("beta", |m| [m, 1, 1, 1]),
    ("norm2.weight", |m| [m, 1, 1, 1]),
    ("norm2.bias", |m| [m, 1, 1, 1]),
    ("conv4.weight", |m| [2 * m, m, 1, 1]),
    ("conv4.bias", |m| [2 * m, 1, 1, 1]),
    ("conv5.weight", |m| [m, m, 1, 1]),
    ("conv5.bias", |m| [m, 1, 1, 1]),
    ("gamma", |m| [m, 1, 1, 1]),
];

/// Name and shape of the tensors of a NAFNet block on `channels` channels, in order.
pub(crate) fn block_tensors(channels: usize) -> impl Iterator<Item = (&'static str, [usize; 4])> {
    BLOCK.into_iter().map(move |(name, shape)| (name, shape(channels)))
}

/// The parameters of one adapter: a NAFNet block on the `channels` of the material feature, then a 3x3 convolution to `outputs` planes.
#[derive(Clone, Debug, PartialEq)]
pub struct AdapterParams {
    channels: usize,
    outputs: usize,
    /// All values, tensor after tensor in the order of [`AdapterParams::tensors`], each row-major.
    pub values: Vec<f32>,
}

impl AdapterParams {
    /// Parameters from their values.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if `values` is not as long as [`AdapterParams::len_for`] says.
    pub fn new(channels: usize, outputs: usize, values: Vec<f32>) -> Result<Self> {
        let expected = Self::len_for(channels, outputs);
        if values.len() != expected {
            return Err(Error::shape("adapter", format!("{expected} values"), format!("{} values", values.len())));
        }
        Ok(Self { channels, outputs, values })
    }

    /// Channels of the material feature (9, anisotropic 14).
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Planes of the adapter's raw output.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// Number of values of an adapter.
    pub fn len_for(channels: usize, outputs: usize) -> usize {
        7 * channels * channels + 33 * channels + outputs * (9 * channels + 1)
    }

    /// The tensors of an adapter in order: name below the adapter's own (`norm1.weight`, ..., `gamma`, `end.weight`, `end.bias`),
    /// shape (out, in, height, width; trailing ones where a tensor has fewer dimensions), and place in [`AdapterParams::values`].
    pub fn tensors(channels: usize, outputs: usize) -> impl Iterator<Item = (&'static str, [usize; 4], Range<usize>)> {
        let end = [("end.weight", [outputs, channels, 3, 3]), ("end.bias", [outputs, 1, 1, 1])];
        let mut start = 0;
        block_tensors(channels).chain(end).map(move |(name, shape)| {
            let range = start..start + shape.iter().product::<usize>();
            start = range.end;
            (name, shape, range)
        })
    }

    /// Where the tensor `name` lies in [`AdapterParams::values`], if there is one of this name.
    pub fn range(&self, name: &str) -> Option<Range<usize>> {
        Self::tensors(self.channels, self.outputs).find(|tensor| tensor.0 == name).map(|tensor| tensor.2)
    }
}

#[cfg(test)]
mod tests {
    use super::AdapterParams;

    #[test]
    fn the_four_isotropic_adapters_have_4194_parameters() {
        assert_eq!([3, 2, 1, 3].map(|outputs| AdapterParams::len_for(9, outputs)).iter().sum::<usize>(), 4194);
    }

    #[test]
    fn tensors_cover_the_values_without_gaps() {
        for (channels, outputs) in [(9, 3), (14, 2), (1, 1)] {
            let mut end = 0;
            for (_, shape, range) in AdapterParams::tensors(channels, outputs) {
                assert_eq!(range, end..end + shape.iter().product::<usize>());
                end = range.end;
            }
            assert_eq!(end, AdapterParams::len_for(channels, outputs));
        }
    }

    #[test]
    fn wrong_lengths_are_errors() {
        let mut values = vec![0.0; AdapterParams::len_for(9, 1)];
        let params = AdapterParams::new(9, 1, values.clone()).unwrap();
        assert_eq!(params.range("beta").unwrap().len(), 9);
        assert!(params.range("alpha").is_none());
        values.pop();
        assert!(AdapterParams::new(9, 1, values).is_err());
    }
}
