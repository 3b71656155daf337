//! What a set of photos does not show of the sample: where no highlight of the flash stands, and from which sides no photo was taken.
//!
//! A flat, glossy surface has its highlight where the direction halfway between camera and light is the normal: on the straight line between the camera's foot and the light's,
//! nearer to the lower of both.

use super::geometry::norm;
use super::median;
use super::report::Missing;
use crate::shot::Shot;

/// From this angle to the normal on, in degrees, a photo shows the sample from a side.
const LEAN_DEG: f64 = 12.0;
/// How far a suggested photo leans.
const SUGGESTED_LEAN_DEG: f64 = 25.0;

/// Where the highlight of a flat sample stands, in the sample's plane.
pub fn highlight(shot: &Shot) -> [f64; 2] {
    let (up, light_up) = (shot.camera[2], shot.light[2]);
    [0, 1].map(|i| (shot.camera[i] * light_up + shot.light[i] * up) / (up + light_up))
}

/// What `shots` of a patch of this width leave open.
pub fn missing(shots: &[Shot], patch: f64) -> Vec<Missing> {
    let Some(distance) = median(shots.iter().map(|shot| norm(shot.camera))) else { return Vec::new() };
    let highlights: Vec<[f64; 2]> =
        shots.iter().map(highlight).filter(|at| at.iter().all(|x| x.abs() <= patch / 2.0)).collect();
    let mut found = Vec::new();
    for (name, side) in [
        ("upper left", [-1.0, 1.0]),
        ("upper right", [1.0, 1.0]),
        ("lower right", [1.0, -1.0]),
        ("lower left", [-1.0, -1.0]),
    ] {
        if !highlights.iter().any(|at| at[0] * side[0] > 0.0 && at[1] * side[1] > 0.0) {
            let [x, y] = side.map(|side| side * patch / 4.0);
            let text = format!(
                "no photo has its highlight in the {name} of the sample: if it is glossy, take one with the flash straight above that part"
            );
            found.push(Missing { text, camera: [x, y, (distance * distance - x * x - y * y).max(0.0).sqrt()] });
        }
    }
    for (name, side) in [("right", [1.0, 0.0]), ("top", [0.0, 1.0]), ("left", [-1.0, 0.0]), ("bottom", [0.0, -1.0])] {
        let leans = |shot: &Shot| {
            let [x, y, z] = shot.camera;
            let toward = x * side[0] + y * side[1];
            // Within a quarter turn about that side.
            let is_there = toward > 0.0 && toward >= std::f64::consts::FRAC_1_SQRT_2 * x.hypot(y) - 1e-9;
            is_there && x.hypot(y).atan2(z) >= LEAN_DEG.to_radians()
        };
        if !shots.iter().any(leans) {
            let (sin, cos) = SUGGESTED_LEAN_DEG.to_radians().sin_cos();
            let text = format!("no photo was taken from the {name}: take one from there, leaning by 20 to 30 degrees");
            found.push(Missing { text, camera: [side[0] * distance * sin, side[1] * distance * sin, distance * cos] });
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shot(camera: [f64; 3], light: [f64; 3]) -> Shot {
        Shot { camera, light, light_intensity: [1.0; 3] }
    }

    #[test]
    fn the_highlight_is_where_light_is_mirrored() {
        let shot = shot([100.0, -20.0, 200.0], [-30.0, 50.0, 130.0]);
        let [x, y] = highlight(&shot);
        let direction = |from: [f64; 3]| {
            let to = [from[0] - x, from[1] - y, from[2]];
            to.map(|value| value / norm(to))
        };
        let (view, light) = (direction(shot.camera), direction(shot.light));
        assert!((view[0] + light[0]).abs() < 1e-12 && (view[1] + light[1]).abs() < 1e-12);
    }

    #[test]
    fn one_photo_from_above_leaves_the_sides_open() {
        let above = [0.0, 0.0, 250.0];
        let found = missing(&[shot(above, above)], 96.0);
        // In the middle it is in no quarter.
        assert_eq!(found.len(), 8);
        assert!(found[0].text.contains("upper left") && found[0].camera[0] == -24.0 && found[0].camera[1] == 24.0);
        assert!(found.iter().all(|missing| (norm(missing.camera) - 250.0).abs() < 1e-9));
        // What is suggested is what was missing.
        let taken: Vec<Shot> = found.iter().map(|missing| shot(missing.camera, missing.camera)).collect();
        assert_eq!(missing(&taken, 96.0), []);
        assert_eq!(missing(&[], 96.0), []);
    }
}
