//! A network as data.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::params::{AdapterParams, block_tensors};
use super::weights::broken;
use crate::error::Result;
use crate::maps::Lobe;

/// How the features of several photos are fused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Gcn {
    /// The graph convolution as the paper writes it (eq. 2).
    Full,
    /// The graph convolution with the edges from each node to itself alone, which the released weights were trained with.
    Diagonal,
    /// None: one 3x3 convolution of the photos' channels.
    None,
}

/// Sizes and form of a network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Photos the encoder takes.
    pub photos: usize,
    /// Channels at the finest level; twice as many at each next.
    pub width: usize,
    /// NAFNet blocks of the encoder at each level, finest first.
    pub encoder_blocks: Vec<usize>,
    /// NAFNet blocks of the decoder at the resolution of the latent code.
    pub middle_blocks: usize,
    /// NAFNet blocks of the decoder at each level, coarsest first; as many levels as in the encoder.
    pub decoder_blocks: Vec<usize>,
    /// How the photos' features are fused.
    pub gcn: Gcn,
    /// The maps that come out.
    pub lobe: Lobe,
    /// Raw roughness below this decodes as this; -1 where there is no floor, -0.3 in the released form.
    pub roughness_floor: f32,
}

/// The adapters of isotropic maps in the order of their outputs: name in a weights file, planes.
pub(crate) const ISOTROPIC_ADAPTERS: [(&str, usize); 4] =
    [("diff_conv", 3), ("normal_conv", 2), ("rough_conv", 1), ("spec_conv", 3)];

/// Fails unless a network's size is in a sane range.
pub(crate) fn within(name: &str, value: usize, low: usize, high: usize) -> Result<()> {
    if (low..=high).contains(&value) {
        Ok(())
    } else {
        Err(broken(format!("{name}: expected {low} to {high}, got {value}")))
    }
}

/// Fails unless raw roughness can have this floor.
pub(crate) fn check_roughness_floor(floor: f32) -> Result<()> {
    if (-1.0..1.0).contains(&floor) {
        Ok(())
    } else {
        Err(broken(format!("roughness_floor: expected -1 to 1, got {floor}")))
    }
}

/// Name and shape of a tensor.
pub(crate) type TensorSpec = (String, Vec<usize>);

impl NetworkConfig {
    /// The sizes of the paper's released network for `photos` photos: one, without graph convolution, or several with `gcn`.
    pub fn paper(photos: usize, gcn: Gcn, lobe: Lobe) -> Self {
        Self {
            photos,
            width: 64,
            encoder_blocks: vec![2, 2, 4, 8],
            middle_blocks: 12,
            decoder_blocks: vec![2, 2, 2, 2],
            gcn,
            lobe,
            roughness_floor: -0.3,
        }
    }

    /// Levels, each of half the resolution of the one before.
    pub fn levels(&self) -> usize {
        self.encoder_blocks.len()
    }

    /// Channels of the latent code.
    pub fn latent_channels(&self) -> usize {
        self.width << self.levels()
    }

    /// Channels of the material feature, the decoder's output.
    pub fn feature_channels(&self) -> usize {
        match self.lobe {
            Lobe::Isotropic => 9,
            Lobe::Anisotropic => 14,
        }
    }

    /// The adapters in the order of their outputs: name in a weights file, planes.
    pub fn adapters(&self) -> &'static [(&'static str, usize)] {
        match self.lobe {
            Lobe::Isotropic => &ISOTROPIC_ADAPTERS,
            Lobe::Anisotropic => {
                &[("diff_conv", 3), ("normal_conv", 3), ("ax_ay_conv", 2), ("spec_conv", 3), ("tang_conv", 3)]
            }
        }
    }

    /// Fails unless the sizes make a network of sane size.
    pub(crate) fn validate(&self) -> Result<()> {
        let fail = |reason: String| Err(broken(reason));
        within("photos", self.photos, 1, 64)?;
        within("width", self.width, 1, 1024)?;
        within("levels", self.levels(), 1, 6)?;
        within("middle_blocks", self.middle_blocks, 0, 64)?;
        if self.decoder_blocks.len() != self.levels() {
            return fail(format!(
                "decoder_blocks: expected {} levels, got {}",
                self.levels(),
                self.decoder_blocks.len()
            ));
        }
        for &blocks in self.encoder_blocks.iter().chain(&self.decoder_blocks) {
            within("blocks of a level", blocks, 0, 64)?;
        }
        if self.gcn != Gcn::None && !self.width.is_multiple_of(self.photos) {
            return fail(format!("width: expected a multiple of {} photos, got {}", self.photos, self.width));
        }
        check_roughness_floor(self.roughness_floor)
    }

    /// Channels at level `level`.
    pub(crate) fn channels(&self, level: usize) -> usize {
        self.width << level
    }

    /// The encoder's and the decoder's tensors, as named in a weights file, and their shapes.
    pub(crate) fn tensors(&self) -> Vec<TensorSpec> {
        let mut list: Vec<TensorSpec> = Vec::new();
        let layer = |list: &mut Vec<TensorSpec>, name: &str, shape: [usize; 4]| {
            list.push((format!("{name}.weight"), shape.to_vec()));
            list.push((format!("{name}.bias"), vec![shape[0]]));
        };
        let blocks = |list: &mut Vec<TensorSpec>, name: &str, count: usize, channels: usize| {
            for block in 0..count {
                list.extend(
                    block_tensors(channels).map(|(tensor, shape)| (format!("{name}.{block}.{tensor}"), shape.to_vec())),
                );
            }
        };
        let width = self.width;
        if self.gcn == Gcn::None {
            layer(&mut list, "encoder.intro", [width, 3 * self.photos, 3, 3]);
        } else {
            layer(&mut list, "encoder.conv0", [width / self.photos, 3, 3, 3]);
            for name in ["encoder.conv_q1", "encoder.conv_k1", "encoder.conv1"] {
                layer(&mut list, name, [width, width, 3, 3]);
            }
            list.push(("encoder.adj1".into(), vec![width, width]));
            list.push(("encoder.lamda".into(), vec![]));
        }
        for (level, &count) in self.encoder_blocks.iter().enumerate() {
            let channels = self.channels(level);
            blocks(&mut list, &format!("encoder.encoders.{level}"), count, channels);
            layer(&mut list, &format!("encoder.downs.{level}"), [2 * channels, channels, 2, 2]);
        }
        blocks(&mut list, "decoder.middle_blks", self.middle_blocks, self.latent_channels());
        for (step, &count) in self.decoder_blocks.iter().enumerate() {
            let channels = self.channels(self.levels() - 1 - step);
            list.push((format!("decoder.ups.{step}.0.weight"), vec![4 * channels, 2 * channels, 1, 1]));
            blocks(&mut list, &format!("decoder.decoders.{step}"), count, channels);
        }
        layer(&mut list, "decoder.ending", [self.feature_channels(), width, 3, 3]);
        list
    }

    /// The names of all tensors.
    pub(crate) fn all_tensors(&self) -> impl Iterator<Item = String> {
        let adapters = self.adapters().iter().flat_map(|&(name, outputs)| self.adapter_tensors(name, outputs));
        self.tensors().into_iter().map(|tensor| tensor.0).chain(adapters.map(|tensor| tensor.0))
    }

    /// The tensors of adapter `name`, as named in a weights file: name, shape, place among the adapter's values.
    pub(crate) fn adapter_tensors(
        &self,
        name: &'static str,
        outputs: usize,
    ) -> impl Iterator<Item = (String, Vec<usize>, Range<usize>)> + use<> {
        AdapterParams::tensors(self.feature_channels(), outputs).map(move |(tensor, shape, range)| {
            let part = if tensor.starts_with("end.") { "" } else { "conv." };
            (format!("decoder.{name}.{part}{tensor}"), shape.to_vec(), range)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::{Gcn, NetworkConfig};
    use crate::maps::Lobe;
    use crate::nn::AdapterParams;

    #[test]
    fn the_released_network_has_116_million_parameters() {
        let config = NetworkConfig::paper(4, Gcn::Diagonal, Lobe::Isotropic);
        let tensors = config.tensors();
        let count: usize = tensors.iter().map(|(_, shape)| shape.iter().product::<usize>()).sum();
        let adapters: usize = config.adapters().iter().map(|&(_, k)| AdapterParams::len_for(9, k)).sum();
        assert_eq!(adapters, 4194);
        assert_eq!((count + adapters) / 1_000_000, 116);
        let middle = tensors.iter().filter(|(name, _)| name.starts_with("decoder.middle_blks"));
        assert_eq!(middle.map(|(_, shape)| shape.iter().product::<usize>()).sum::<usize>() / 1_000_000, 88);
    }

    #[test]
    fn sizes_out_of_range_are_errors() {
        let good = NetworkConfig::paper(4, Gcn::Full, Lobe::Anisotropic);
        good.validate().unwrap();
        for broken in [
            NetworkConfig { photos: 0, ..good.clone() },
            NetworkConfig { photos: 3, ..good.clone() },
            NetworkConfig { width: 1 << 40, ..good.clone() },
            NetworkConfig { encoder_blocks: vec![], decoder_blocks: vec![], ..good.clone() },
            NetworkConfig { decoder_blocks: vec![2, 2, 2], ..good.clone() },
            NetworkConfig { middle_blocks: usize::MAX, ..good.clone() },
            NetworkConfig { roughness_floor: f32::NAN, ..good.clone() },
        ] {
            assert!(broken.validate().is_err(), "{broken:?}");
        }
    }
}
