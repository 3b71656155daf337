//! Where camera and light of each photo stood, as far as maps tell: measured positions are off by some per cent.
//!
//! Not from the paper.

use rayon::prelude::*;

use crate::capture::{Capture, Photo};
use crate::cholesky::Cholesky;
use crate::error::Result;
use crate::fit::optim::holdout::{thinned, thinned_planes};
use crate::maps::Maps;
use crate::render::{encode_all, encode_radiance, render_maps};
use crate::shot::Shot;

/// Standard deviation of a stated position, in each direction, as a share of the camera's distance.
const DEVIATION: f64 = 0.03;
/// Likewise of the light, as a logarithm: it is found elsewhere, and must not be taken for a distance here.
const LIGHT_DEVIATION: f64 = 0.3;
/// Standard deviation of codes, and how many of them all pixels count for: neighbours are missed alike.
const CODE_DEVIATION: f64 = 0.03;
const EVIDENCE: f64 = 200.0;
/// Differences of codes beyond this count less and less (Cauchy).
const OUTLIER: f64 = 0.08;
/// Pixels along the longer side that are compared.
const SIDE: usize = 40;
/// Gauss-Newton steps, the difference (a share of the distance) of their derivatives, and the farthest that a position moves in a direction.
const STEPS: usize = 6;
const DIFFERENCE: f64 = 1e-3;
const FARTHEST: f64 = 0.1;

/// The shots of `capture`, camera and light of each moved together to where `maps` explain its photo better.
pub(super) fn placed(capture: &Capture, maps: &Maps<f32>) -> Result<Vec<Shot>> {
    let (thin, pixels) = thinned(capture, SIDE)?;
    let planes = thinned_planes(maps.data(), maps.lobe().planes(), &pixels);
    let maps = Maps::new(maps.lobe(), thin.width(), thin.height(), planes)?;
    thin.photos().par_iter().map(|photo| place(photo, &maps, thin.patch_size())).collect()
}

fn place(photo: &Photo, maps: &Maps<f32>, patch_size: f64) -> Result<Shot> {
    let pixels = photo.saturated.len();
    let used: Vec<usize> = (0..pixels).filter(|&p| photo.saturated[p] == 0).collect();
    let distance = photo.shot.camera.iter().map(|x| x * x).sum::<f64>().sqrt();
    let shot = |[_, offset @ ..]: &[f64; 4]| moved(&photo.shot, offset.map(|x| x * distance));
    // Codes of the rendering, three of each pixel.
    let codes = |at: &[f64; 4]| -> Result<Vec<f64>> {
        let mut planes = render_maps(maps, patch_size, &shot(at))?;
        let light = at[0].exp() as f32;
        planes.iter_mut().for_each(|value| *value *= light);
        encode_all(&mut planes);
        let code = |(p, c): (&usize, usize)| f64::from(planes[c * pixels + p]);
        Ok(used.iter().flat_map(|p| (0..3).map(move |c| (p, c))).map(code).collect())
    };
    let seen = |p: &usize| photo.image.data()[3 * p..3 * p + 3].iter().map(|&x| f64::from(encode_radiance(x)));
    let seen: Vec<f64> = used.iter().flat_map(seen).collect();
    let evidence = EVIDENCE / seen.len().max(1) as f64 / CODE_DEVIATION.powi(2);
    let prior = [LIGHT_DEVIATION, DEVIATION, DEVIATION, DEVIATION].map(|deviation: f64| deviation.powi(-2));
    let mut at = [0.0; 4];
    for _ in 0..STEPS {
        let here = codes(&at)?;
        let mut slopes: [Vec<f64>; 4] = Default::default();
        for (i, slope) in slopes.iter_mut().enumerate() {
            let mut beside = at;
            beside[i] += DIFFERENCE;
            *slope = codes(&beside)?.iter().zip(&here).map(|(there, here)| (there - here) / DIFFERENCE).collect();
        }
        let mut matrix: [[f64; 4]; 4] =
            std::array::from_fn(|i| std::array::from_fn(|j| if i == j { prior[i] } else { 0.0 }));
        let mut right: [f64; 4] = std::array::from_fn(|i| -prior[i] * at[i]);
        for (k, (seen, here)) in seen.iter().zip(&here).enumerate() {
            let missed = seen - here;
            let weight = evidence / (1.0 + (missed / OUTLIER).powi(2));
            for i in 0..4 {
                right[i] += weight * slopes[i][k] * missed;
                for j in 0..=i {
                    matrix[i][j] += weight * slopes[i][k] * slopes[j][k];
                }
            }
        }
        // Not a number where maps are none: the stated position stays.
        let Some(cholesky) = Cholesky::of(&matrix) else { return Ok(photo.shot) };
        let step = cholesky.solve(right);
        at = std::array::from_fn(
            |i| if i == 0 { at[0] + step[0] } else { (at[i] + step[i]).clamp(-FARTHEST, FARTHEST) },
        );
    }
    let found = shot(&at);
    Ok(if found.misplaced().is_none() { found } else { photo.shot })
}

/// `shot` with camera and light moved together.
fn moved(shot: &Shot, offset: [f64; 3]) -> Shot {
    let add = |place: [f64; 3]| std::array::from_fn(|i| place[i] + offset[i]);
    Shot { camera: add(shot.camera), light: add(shot.light), ..*shot }
}

#[cfg(test)]
mod tests {
    use super::{moved, placed};
    use crate::capture::{Capture, Photo};
    use crate::color::Transfer;
    use crate::fit::direct::light::stated;
    use crate::fit::testing::photo;
    use crate::maps::{Lobe, Maps};
    use crate::shot::Shot;

    const SIDE: usize = 24;
    const PIXELS: usize = SIDE * SIDE;

    fn maps(specular: f32) -> Maps<f32> {
        let mut random = fastrand::Rng::with_seed(3);
        let mut maps = Maps::new(Lobe::Isotropic, SIDE, SIDE, vec![0.0; 10 * PIXELS]).unwrap();
        for (i, value) in maps.data_mut().iter_mut().enumerate() {
            *value = match i / PIXELS {
                ..3 => 0.2 + 0.1 * random.f32(),
                3 | 4 => 0.0,
                5 => 1.0,
                6 => 0.4,
                _ => specular,
            };
        }
        maps
    }

    fn capture(maps: &Maps<f32>, offsets: &[[f64; 3]]) -> Capture {
        let photos = offsets.iter().enumerate().map(|(i, &offset)| {
            let place = [0.5 * i as f64 - 0.7, 0.3, 2.2];
            let shot = Shot { camera: place, light: place, light_intensity: [9.0; 3] };
            Photo { shot, ..photo(maps, moved(&shot, offset)) }
        });
        Capture::new(photos.collect(), 2.0, Transfer::Linear).unwrap()
    }

    #[test]
    fn positions_are_found_as_far_as_a_highlight_tells() {
        let maps = maps(0.1);
        // Beside the sample: height looks like other light.
        let offsets = [[0.05, 0.0, 0.0], [0.0; 3], [-0.03, 0.06, 0.0], [0.0, 0.04, 0.0]];
        let capture = capture(&maps, &offsets);
        let found = placed(&capture, &maps).unwrap();
        for ((photo, found), offset) in capture.photos().iter().zip(found).zip(offsets) {
            for (c, offset) in offset.into_iter().enumerate() {
                let missed = found.camera[c] - photo.shot.camera[c] - offset;
                assert!(missed.abs() < 0.01 + 0.3 * offset.abs(), "{c}: {missed} of {offset}");
            }
            assert_eq!(found.light, found.camera);
            assert_eq!(found.light_intensity, photo.shot.light_intensity);
        }
    }

    #[test]
    fn right_positions_and_photos_that_show_nothing_stay() {
        let maps = maps(0.1);
        let mut capture = capture(&maps, &[[0.0; 3]; 4]);
        for (found, stated) in placed(&capture, &maps).unwrap().iter().zip(stated(&capture)) {
            assert!((0..3).all(|c| (found.camera[c] - stated.camera[c]).abs() < 1e-4));
        }
        let photo = |photo: &Photo| Photo { saturated: vec![7; PIXELS], ..photo.clone() };
        let saturated = capture.photos().iter().map(photo).collect();
        capture = Capture::new(saturated, 2.0, Transfer::Linear).unwrap();
        assert_eq!(placed(&capture, &maps).unwrap(), stated(&capture));
    }
}
