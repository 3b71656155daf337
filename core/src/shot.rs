//! Where camera and light stood.

use crate::error::{Error, Result};

/// Where camera and light stood for one photo, and how bright the light was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shot {
    /// Camera position, in the capture's unit.
    pub camera: [f64; 3],
    /// Position of the point light; equal to `camera` for a flash beside the lens.
    pub light: [f64; 3],
    /// RGB intensity: photo units times length squared, so that a surface at distance r receives `light_intensity / r^2`.
    pub light_intensity: [f64; 3],
}

impl Shot {
    /// The irradiance of the sample's plane at (x, y) under a light of intensity 1: cosine over squared distance.
    pub(crate) fn fall_off(&self, [x, y]: [f64; 2]) -> f64 {
        let to_light = [self.light[0] - x, self.light[1] - y, self.light[2]];
        to_light[2] / to_light.iter().map(|x| x * x).sum::<f64>().powf(1.5)
    }

    /// What cannot be a position of camera or light in front of the sample: the field, and why.
    pub(crate) fn misplaced(&self) -> Option<(&'static str, String)> {
        [("camera", self.camera), ("light", self.light)].into_iter().find_map(|(field, position)| {
            if !position.iter().all(|v| v.is_finite()) {
                return Some((field, format!("{position:?} is not finite")));
            }
            let behind = format!("{position:?} lies behind the sample: z must be above 0, got {}", position[2]);
            (position[2] <= 0.0).then_some((field, behind))
        })
    }

    /// # Errors
    /// [`Error::InvalidArgument`] naming `photo` and the field, for a position that is not finite or not in front of the sample, or
    /// an intensity that is negative, zero in all channels, or not finite.
    pub(crate) fn check(&self, photo: &str) -> Result<()> {
        if let Some((field, reason)) = self.misplaced() {
            return Err(Error::invalid(photo, format!("{field} {reason}")));
        }
        let intensity = self.light_intensity;
        if !intensity.iter().all(|v| v.is_finite() && *v >= 0.0) || intensity == [0.0; 3] {
            return Err(Error::invalid(
                photo,
                format!("light_intensity must be finite, not negative and not all 0, got {intensity:?}"),
            ));
        }
        Ok(())
    }
}
