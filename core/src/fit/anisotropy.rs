//! Lobes that are wider across than along: the anisotropy of a pixel as a vector that is 0 where the lobe is round.
//!
//! With `s = ln(alpha_y / alpha_x) / 2 >= 0` and the angle `a` from +x to the tangent, along which the lobe is narrow, the vector is `s (cos 2a, sin 2a)`: a
//! tangent and its opposite are the same, and nothing jumps where a lobe becomes round. Its mean over pixels of one material is a mean of lobes.
//! A pixel's vector is that of its colour group plus a field that is linear between [`NODES`] x [`NODES`] nodes: brushing follows the shape of the
//! part. The mean roughness, the geometric one of both, is what isotropic maps have as roughness.

use std::borrow::Cow;

use rayon::prelude::*;

use crate::error::Result;
use crate::maps::{Lobe, Maps, ROUGHNESS_PLANE};

/// Nodes of the field along each side of the patch.
pub(crate) const NODES: usize = 8;
/// Standard deviation of a group's vector and of the field at a node, and of the difference of two neighbouring nodes.
pub(crate) const GROUP_DEVIATION: f64 = 1.0;
pub(crate) const FIELD_DEVIATION: f64 = 0.5;
pub(crate) const NEIGHBOUR_DEVIATION: f64 = 0.2;
/// Squared length below which a vector has no direction.
const ROUND: f32 = 1e-8;
/// Pixels that one thread takes at a time.
const PART: usize = 1 << 12;

/// The nodes around a pixel of a patch of this size, and the share of each.
pub(crate) fn nodes([width, height]: [usize; 2], pixel: usize) -> [(usize, f32); 4] {
    let along = |i: usize, count: usize| {
        let x = (i as f32 + 0.5) / count as f32 * (NODES - 1) as f32;
        let first = (x as usize).min(NODES - 2);
        (first, x - first as f32)
    };
    let ((column, right), (row, down)) = (along(pixel % width, width), along(pixel / width, height));
    let first = row * NODES + column;
    [
        (first, (1.0 - right) * (1.0 - down)),
        (first + 1, right * (1.0 - down)),
        (first + NODES, (1.0 - right) * down),
        (first + NODES + 1, right * down),
    ]
}

/// Pairs of neighbouring nodes.
pub(crate) fn neighbours() -> impl Iterator<Item = (usize, usize)> {
    let across = (0..NODES * NODES).filter(|node| node % NODES + 1 < NODES).map(|node| (node, node + 1));
    across.chain((0..NODES * (NODES - 1)).map(|node| (node, node + NODES)))
}

/// `s`, and the tangent, of a vector.
fn lobe([p, q]: [f32; 2]) -> (f32, [f32; 2]) {
    let length2 = p * p + q * q;
    if length2 < ROUND {
        return (0.0, [1.0, 0.0]);
    }
    let s = length2.sqrt();
    let cosine = (0.5 * (1.0 + p / s)).max(0.0).sqrt();
    let sine = (0.5 * (1.0 - p / s)).max(0.0).sqrt().copysign(q);
    (s, [cosine, sine])
}

/// Of maps whose two roughnesses are the mean one, those of pixels with these vectors; and their tangents, in the plane of the patch.
pub(crate) fn stretch(maps: &mut Maps<f32>, vectors: &[[f32; 2]]) {
    let pixels = vectors.len();
    let tangent = maps.lobe().tangent_plane() - ROUGHNESS_PLANE;
    let planes = &mut maps.data_mut()[ROUGHNESS_PLANE * pixels..];
    let (roughness, rest) = planes.split_at_mut(2 * pixels);
    let (along, across) = roughness.split_at_mut(pixels);
    let (x, rest) = rest[(tangent - 2) * pixels..].split_at_mut(pixels);
    let (y, z) = rest.split_at_mut(pixels);
    let roughness = along.par_chunks_mut(PART).zip(across.par_chunks_mut(PART));
    let tangent = x.par_chunks_mut(PART).zip(y.par_chunks_mut(PART)).zip(z.par_chunks_mut(PART));
    roughness.zip(tangent).zip(vectors.par_chunks(PART)).for_each(|(((along, across), ((x, y), z)), vectors)| {
        for (p, &vector) in vectors.iter().enumerate() {
            let (s, tangent) = lobe(vector);
            let root = (0.5 * s).exp();
            (along[p], across[p]) = (along[p] / root, (across[p] * root).min(1.0));
            (x[p], y[p], z[p]) = (tangent[0], tangent[1], 0.0);
        }
    });
}

/// The gradient by the logarithm of a pixel's mean roughness and by its vector, from that by `maps` as [`stretch`] made them.
pub(crate) fn pull_back(maps: &Maps<f32>, map_gradient: &Maps<f32>, [p, q]: [f32; 2], pixel: usize) -> (f32, [f32; 2]) {
    let tangent_plane = Lobe::Anisotropic.tangent_plane();
    let at = |maps: &Maps<f32>, plane: usize| maps.plane(plane)[pixel];
    let [along, across] = [0, 1].map(|i| at(maps, ROUGHNESS_PLANE + i));
    let by_along = at(map_gradient, ROUGHNESS_PLANE) * along;
    // At its limit it does not move.
    let by_across = if across < 1.0 { at(map_gradient, ROUGHNESS_PLANE + 1) * across } else { 0.0 };
    let [x, y] = [0, 1].map(|i| at(maps, tangent_plane + i));
    let by_turn = x * at(map_gradient, tangent_plane + 1) - y * at(map_gradient, tangent_plane);
    let by_length = 0.5 * (by_across - by_along);
    let length2 = p * p + q * q;
    let by_vector = if length2 < ROUND {
        [by_length, 0.0]
    } else {
        let s = length2.sqrt();
        let turn = 0.5 * by_turn / length2;
        [by_length * p / s - turn * q, by_length * q / s + turn * p]
    };
    (by_along + by_across, by_vector)
}

/// Maps with a round lobe of the mean roughness, and the vector of every pixel; none of isotropic maps, which stay as they are.
pub(crate) fn split(maps: &Maps<f32>) -> (Cow<'_, Maps<f32>>, Vec<[f32; 2]>) {
    if maps.lobe() == Lobe::Isotropic {
        return (Cow::Borrowed(maps), Vec::new());
    }
    let (roughness, vectors) = unstretch(maps);
    let pixels = vectors.len();
    let specular = &maps.data()[maps.lobe().specular_plane() * pixels..][..3 * pixels];
    let planes = [&maps.data()[..ROUGHNESS_PLANE * pixels], &roughness, specular].concat();
    let round = Maps::new(Lobe::Isotropic, maps.width(), maps.height(), planes);
    (round.map_or(Cow::Borrowed(maps), Cow::Owned), vectors)
}

/// The inverse of [`split`].
pub(crate) fn join(maps: Maps<f32>, vectors: &[[f32; 2]]) -> Result<Maps<f32>> {
    if vectors.is_empty() {
        return Ok(maps);
    }
    let pixels = vectors.len();
    let (before, specular) = maps.data().split_at(maps.lobe().specular_plane() * pixels);
    let planes = [before, maps.plane(ROUGHNESS_PLANE), specular, &vec![0.0; 3 * pixels]].concat();
    let mut joined = Maps::new(Lobe::Anisotropic, maps.width(), maps.height(), planes)?;
    stretch(&mut joined, vectors);
    Ok(joined)
}

/// The mean roughness and the vector of every pixel of anisotropic maps.
fn unstretch(maps: &Maps<f32>) -> (Vec<f32>, Vec<[f32; 2]>) {
    let tangent_plane = maps.lobe().tangent_plane();
    let pixels = maps.width() * maps.height();
    let of_pixel = |pixel: usize| {
        let at = |plane: usize| maps.plane(plane)[pixel];
        let [along, across] = [at(ROUGHNESS_PLANE), at(ROUGHNESS_PLANE + 1)];
        let s = (across / along.max(f32::MIN_POSITIVE)).ln();
        let [x, y] = [at(tangent_plane), at(tangent_plane + 1)];
        ((along * across).sqrt(), [s * (x * x - y * y), s * 2.0 * x * y])
    };
    (0..pixels).into_par_iter().map(of_pixel).unzip()
}

#[cfg(test)]
mod tests {
    use super::{NODES, lobe, neighbours, nodes, pull_back, stretch, unstretch};
    use crate::maps::{Lobe, Maps};

    fn maps(roughness: f32) -> Maps<f32> {
        let mut maps = Maps::new(Lobe::Anisotropic, 1, 1, vec![0.5; 14]).unwrap();
        maps.data_mut()[6..8].fill(roughness);
        maps
    }

    #[test]
    fn stretching_is_undone() {
        for vector in [[0.3f32, 0.4], [-0.7, 0.1], [0.2, -0.9], [-0.5, -0.5], [0.0, 0.6], [-0.6, 0.0]] {
            let mut maps = maps(0.3);
            stretch(&mut maps, &[vector]);
            let (roughness, vectors) = unstretch(&maps);
            assert!((roughness[0] - 0.3).abs() < 1e-6);
            assert!((0..2).all(|i| (vectors[0][i] - vector[i]).abs() < 1e-5), "{vector:?} {vectors:?}");
            assert!(maps.plane(6)[0] < maps.plane(7)[0], "the lobe is narrow along the tangent");
        }
        assert_eq!(lobe([0.0; 2]), (0.0, [1.0, 0.0]));
    }

    #[test]
    fn the_gradient_is_that_of_differences() {
        let weights: Vec<f32> = (0..14).map(|i| (1.0 + i as f32).sin()).collect();
        let value = |roughness: f32, vector: [f32; 2]| -> f64 {
            let mut maps = maps(roughness);
            stretch(&mut maps, &[vector]);
            maps.data().iter().zip(&weights).map(|(a, b)| f64::from(a * b)).sum()
        };
        let gradient = Maps::new(Lobe::Anisotropic, 1, 1, weights.clone()).unwrap();
        for vector in [[0.3f32, 0.4], [-0.7, 0.2], [0.2, -0.9], [1.5, -0.5]] {
            let mut at = maps(0.3);
            stretch(&mut at, &[vector]);
            let (by_log, by_vector) = pull_back(&at, &gradient, vector, 0);
            let step = 1e-2f32;
            let difference = |a: f64, b: f64| ((a - b) / (2.0 * f64::from(step))) as f32;
            let expected = difference(value(0.3 * step.exp(), vector), value(0.3 * (-step).exp(), vector));
            assert!((by_log - expected).abs() < 1e-3, "{by_log} {expected}");
            for i in 0..2 {
                let moved = |by: f32| {
                    let mut vector = vector;
                    vector[i] += by;
                    value(0.3, vector)
                };
                let expected = difference(moved(step), moved(-step));
                assert!((by_vector[i] - expected).abs() < 2e-3, "{vector:?} {i}: {} {expected}", by_vector[i]);
            }
        }
    }

    #[test]
    fn nodes_share_a_pixel() {
        for pixel in [0, 5, 11, 47, 59] {
            let around = nodes([12, 5], pixel);
            assert!(around.iter().all(|&(node, share)| node < NODES * NODES && (0.0..=1.0).contains(&share)));
            assert!((around.iter().map(|(_, share)| share).sum::<f32>() - 1.0).abs() < 1e-6);
        }
        assert_eq!(neighbours().count(), 2 * NODES * (NODES - 1));
    }
}
