//! What `acquire` says of a capture that it made.

use serde::Deserialize;

/// How near positions and light are, and what is assumed of both: the part of `acquisition` in a capture.json that a fit's verdict uses.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
#[non_exhaustive]
pub struct Acquired {
    /// What was measured of every photo.
    pub photos: Vec<AcquiredPhoto>,
    /// What was assumed of all of them.
    pub assumptions: Vec<String>,
}

/// How near position and light of a photo are.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
#[non_exhaustive]
pub struct AcquiredPhoto {
    /// Its file in the capture.
    pub file: String,
    /// Root mean squared distance of known points from where they should be, as a share of the patch's width.
    pub position_error: Option<f64>,
    /// How far white paper is from what position and light explain, as a share.
    pub paper_error: Option<f64>,
}
