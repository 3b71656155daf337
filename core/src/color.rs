//! Transfer functions between stored pixel values and linear radiance.

use serde::{Deserialize, Serialize};

/// How the pixel values of a photo file relate to linear radiance.
///
/// The function is always stated, never guessed: captures of the literature use gamma 2.2, cameras give sRGB or raw linear files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Transfer {
    /// `stored = linear^(1/2.2)`.
    #[serde(rename = "gamma2.2")]
    Gamma22,
    /// The piecewise curve of IEC 61966-2-1.
    Srgb,
    /// `stored = linear`.
    Linear,
}

impl Transfer {
    /// The name used on the command line and in every file: `gamma2.2`, `srgb` or `linear`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gamma22 => "gamma2.2",
            Self::Srgb => "srgb",
            Self::Linear => "linear",
        }
    }

    /// The inverse of [`Transfer::name`].
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Gamma22, Self::Srgb, Self::Linear].into_iter().find(|transfer| transfer.name() == name)
    }

    /// Linear value of a stored one. Negative values are kept for `Linear` and read as 0 otherwise.
    pub fn decode(self, stored: f32) -> f32 {
        match self {
            Self::Gamma22 => stored.max(0.0).powf(2.2),
            Self::Srgb if stored <= 0.04045 => stored.max(0.0) / 12.92,
            Self::Srgb => ((stored + 0.055) / 1.055).powf(2.4),
            Self::Linear => stored,
        }
    }

    /// Stored value of a linear one; the inverse of [`Transfer::decode`].
    pub fn encode(self, linear: f32) -> f32 {
        match self {
            Self::Gamma22 => linear.max(0.0).powf(1.0 / 2.2),
            Self::Srgb if linear <= 0.003_130_8 => linear.max(0.0) * 12.92,
            Self::Srgb => 1.055 * linear.powf(1.0 / 2.4) - 0.055,
            Self::Linear => linear,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Transfer;

    #[test]
    fn known_values() {
        // IEC 61966-2-1: 18 % grey is stored as 0.4614; gamma 2.2 stores 0.5 for 0.5^2.2 = 0.21764.
        assert!((Transfer::Srgb.encode(0.18) - 0.461_356).abs() < 1e-5);
        assert!((Transfer::Gamma22.decode(0.5) - 0.217_637_64).abs() < 1e-6);
    }

    #[test]
    fn decode_inverts_encode() {
        for transfer in [Transfer::Gamma22, Transfer::Srgb, Transfer::Linear] {
            for i in 0..=1000 {
                let linear = i as f32 / 500.0;
                let back = transfer.decode(transfer.encode(linear));
                assert!((back - linear).abs() < 1e-5 * linear.max(0.1), "{transfer:?} {linear} {back}");
            }
            assert_eq!(Transfer::from_name(transfer.name()), Some(transfer));
        }
    }
}
