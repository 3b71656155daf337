//! From the parameters of [`direct`](super) to maps, and the gradient back.
//!
//! With the sigmoid `S`, per pixel: diffuse albedo `S(d)`; specular albedo and roughness `S(base + own + groups)`, where `groups` mixes the offsets of
//! the pixel's two colour groups by its membership; normal proportional to `(slope + relief + tilt, 1)`. Simpler reflectances hold some of it: a diffuse
//! surface has no specular albedo, a dielectric one for all channels of a group. An anisotropic one has [`anisotropy`](crate::fit::anisotropy) beside the mean roughness.

use rayon::prelude::*;

use super::groups::Membership;
use crate::fit::anisotropy;
use crate::fit::options::Reflectance;
use crate::maps::{DIFFUSE_PLANE, Maps, NORMAL_PLANE, ROUGHNESS_PLANE};
use crate::real::{Kernel, Lanes, Real};

/// Roughness is held above this; sharper lobes cannot be told apart at the resolution of photos.
const ROUGHNESS_MIN: f32 = 0.02;
/// Pixels that one thread takes at a time.
const PART: usize = 1 << 14;
/// Steps of group values are longer by this factor, and those of the common tilt shorter.
pub(super) const GROUP_STEP: f32 = 2.0;
pub(super) const TILT_STEP: f32 = 1.0 / 3.0;

/// Where each kind of parameter lies in the flat vector that Adam moves.
#[derive(Clone, Copy)]
pub(super) struct Layout {
    pub pixels: usize,
    pub groups: usize,
    /// Whether lobes have an anisotropy.
    pub anisotropic: bool,
}

impl Layout {
    pub(super) const fn slope(self) -> usize {
        3 * self.pixels
    }
    pub(super) const fn specular_own(self) -> usize {
        5 * self.pixels
    }
    pub(super) const fn roughness_own(self) -> usize {
        6 * self.pixels
    }
    pub(super) const fn specular_group(self) -> usize {
        7 * self.pixels
    }
    pub(super) const fn roughness_group(self) -> usize {
        self.specular_group() + 3 * self.groups
    }
    pub(super) const fn tilt(self) -> usize {
        self.roughness_group() + self.groups
    }
    pub(super) const fn anisotropy_group(self) -> usize {
        self.tilt() + 2
    }
    pub(super) const fn anisotropy_field(self) -> usize {
        self.anisotropy_group() + if self.anisotropic { 2 * self.groups } else { 0 }
    }
    pub(super) const fn len(self) -> usize {
        self.anisotropy_field() + if self.anisotropic { 2 * anisotropy::NODES * anisotropy::NODES } else { 0 }
    }
}

/// What turns parameters into maps.
pub(super) struct Parameters {
    pub reflectance: Reflectance,
    /// Columns and rows.
    pub size: [usize; 2],
    pub layout: Layout,
    pub memberships: Vec<Membership>,
    /// Logits of specular albedo and roughness to which the offsets of groups and pixels are added, four planes.
    pub base: Vec<f32>,
    /// Slopes to which those of the pixels are added, two planes.
    pub relief: Option<Vec<f32>>,
}

impl Parameters {
    /// Plane `i` of the base, plus the offset of its group at every pixel, plus the pixel's own deviation.
    fn mixed_logits<'s>(&'s self, i: usize, values: &'s [f32], own: &'s [f32]) -> impl Iterator<Item = f32> + 's {
        let base = &self.base[i * self.layout.pixels..];
        self.memberships.iter().zip(own).zip(base).map(move |((&[(a, of_a), (b, of_b)], own), base)| {
            base + own + (of_a * values[a as usize] + of_b * values[b as usize]) * GROUP_STEP
        })
    }

    /// The transpose of [`Parameters::mixed_logits`] with respect to the groups' values, of four planes at once: a pixel's sums do not wait for each other.
    fn gather(&self, slopes: [&[f32]; 4]) -> Vec<[f64; 4]> {
        let of_part = |(part, memberships): (usize, &[Membership])| {
            let mut sums = vec![[0.0f64; 4]; self.layout.groups];
            for (p, membership) in (part * PART..).zip(memberships) {
                for &(group, weight) in membership {
                    let sum = &mut sums[group as usize];
                    for i in 0..4 {
                        sum[i] += f64::from(weight * slopes[i][p]);
                    }
                }
            }
            sums
        };
        let parts: Vec<Vec<[f64; 4]>> = self.memberships.par_chunks(PART).enumerate().map(of_part).collect();
        // Summed in order: the same bits on any number of threads.
        (0..self.layout.groups)
            .map(|group| [0, 1, 2, 3].map(|i| parts.iter().map(|sums| sums[group][i]).sum::<f64>()))
            .collect()
    }

    /// Parameters to maps. Normals are left as (slope x, slope y, 1).
    pub(super) fn decode(&self, params: &[f32], maps: &mut Maps<f32>) {
        let layout = self.layout;
        let n = layout.pixels;
        let tilt = [params[layout.tilt()] * TILT_STEP, params[layout.tilt() + 1] * TILT_STEP];
        let specular_plane = maps.lobe().specular_plane();
        maps.data_mut().par_chunks_mut(n).enumerate().for_each(|(plane, out)| {
            if plane < NORMAL_PLANE {
                let logits = &params[(plane - DIFFUSE_PLANE) * n..][..n];
                out.copy_from_slice(logits);
                f32::run(Sigmoid { values: out, least: 0.0 });
            } else if plane < NORMAL_PLANE + 2 {
                let c = plane - NORMAL_PLANE;
                let slopes = &params[layout.slope() + c * n..][..n];
                out.iter_mut().zip(slopes).for_each(|(out, slope)| *out = slope + tilt[c]);
                if let Some(relief) = &self.relief {
                    out.iter_mut().zip(&relief[c * n..]).for_each(|(out, slope)| *out += slope);
                }
            } else if plane < ROUGHNESS_PLANE {
                out.fill(1.0);
            } else if self.reflectance == Reflectance::Diffuse {
                out.fill(if plane < specular_plane { 1.0 } else { 0.0 });
            } else if plane < specular_plane {
                let groups = &params[layout.roughness_group()..layout.tilt()];
                let own = &params[layout.roughness_own()..layout.specular_group()];
                let logits = self.mixed_logits(3, groups, own);
                out.iter_mut().zip(logits).for_each(|(out, x)| *out = x);
                f32::run(Sigmoid { values: out, least: ROUGHNESS_MIN });
            } else if plane < specular_plane + 3 {
                let c = plane - specular_plane;
                let groups = &params[layout.specular_group() + c * layout.groups..][..layout.groups];
                let own = &params[layout.specular_own()..layout.roughness_own()];
                let logits = self.mixed_logits(c, groups, own);
                out.iter_mut().zip(logits).for_each(|(out, x)| *out = x);
                f32::run(Sigmoid { values: out, least: 0.0 });
            }
        });
        if layout.anisotropic {
            anisotropy::stretch(maps, &self.anisotropy(params));
        }
    }

    /// The anisotropy of every pixel.
    fn anisotropy(&self, params: &[f32]) -> Vec<[f32; 2]> {
        let layout = self.layout;
        let (groups, field) = (&params[layout.anisotropy_group()..], &params[layout.anisotropy_field()..layout.len()]);
        let of_pixel = |(pixel, membership): (usize, &Membership)| {
            let nodes = anisotropy::nodes(self.size, pixel);
            [0, 1].map(|i| {
                let of_groups: f32 =
                    membership.iter().map(|&(group, share)| share * groups[2 * group as usize + i]).sum();
                of_groups + nodes.iter().map(|&(node, share)| share * field[2 * node + i]).sum::<f32>()
            })
        };
        self.memberships.par_iter().enumerate().map(of_pixel).collect()
    }

    /// From the gradient with respect to the maps to that with respect to the parameters, which it overwrites. `map_gradient` is left with respect to logits.
    pub(super) fn chain(&self, params: &[f32], maps: &Maps<f32>, map_gradient: &mut Maps<f32>, gradient: &mut [f32]) {
        let layout = self.layout;
        let n = layout.pixels;
        let first = maps.lobe().specular_plane();
        let roughness = layout.anisotropic.then(|| self.chain_anisotropy(params, maps, map_gradient, gradient));
        let planes = map_gradient.data_mut().par_chunks_mut(n).zip(maps.data().par_chunks(n)).enumerate();
        planes.for_each(|(plane, (slopes, values))| {
            if plane < NORMAL_PLANE || plane == ROUGHNESS_PLANE || (first..first + 3).contains(&plane) {
                slopes.iter_mut().zip(values).for_each(|(slope, value)| *slope *= value * (1.0 - value));
            }
        });
        if let Some(roughness) = roughness {
            map_gradient.plane_mut(ROUGHNESS_PLANE).copy_from_slice(&roughness);
        }
        let plane = |plane: usize| map_gradient.plane(plane);
        let [red, green, blue, roughness] = [first, first + 1, first + 2, ROUGHNESS_PLANE].map(plane);

        let (own, shared) = gradient.split_at_mut(layout.specular_group());
        own.par_chunks_mut(n).enumerate().for_each(|(i, own)| match i {
            ..3 => own.copy_from_slice(plane(DIFFUSE_PLANE + i)),
            3 | 4 => own.copy_from_slice(plane(NORMAL_PLANE + i - 3)),
            5 => own.iter_mut().enumerate().for_each(|(p, own)| *own = red[p] + green[p] + blue[p]),
            _ => own.copy_from_slice(roughness),
        });
        for (group, sums) in self.gather([red, green, blue, roughness]).into_iter().enumerate() {
            for (i, sum) in sums.into_iter().enumerate() {
                shared[i * layout.groups + group] = sum as f32 * GROUP_STEP;
            }
        }
        for c in 0..2 {
            let sums =
                plane(NORMAL_PLANE + c).par_chunks(PART).map(|slopes| slopes.iter().copied().map(f64::from).sum());
            let sums: Vec<f64> = sums.collect();
            shared[layout.tilt() - layout.specular_group() + c] = sums.iter().sum::<f64>() as f32 * TILT_STEP;
        }
        if self.reflectance == Reflectance::Dielectric {
            // One specular albedo for the three channels and for all pixels of a group.
            gradient[layout.specular_own()..layout.roughness_own()].fill(0.0);
            for group in layout.specular_group()..layout.specular_group() + layout.groups {
                let channels = [0, 1, 2].map(|c| group + c * layout.groups);
                let mean = channels.iter().map(|&i| gradient[i]).sum::<f32>() / 3.0;
                channels.into_iter().for_each(|i| gradient[i] = mean);
            }
        }
    }

    /// The part of [`Parameters::chain`] that leads to the anisotropy. Gives the gradient by the logits of the mean roughness.
    fn chain_anisotropy(
        &self,
        params: &[f32],
        maps: &Maps<f32>,
        map_gradient: &Maps<f32>,
        gradient: &mut [f32],
    ) -> Vec<f32> {
        let layout = self.layout;
        let vectors = self.anisotropy(params);
        let of_pixel = |(pixel, &vector): (usize, &[f32; 2])| {
            let (by_log, by_vector) = anisotropy::pull_back(maps, map_gradient, vector, pixel);
            let [along, s] = [maps.plane(ROUGHNESS_PLANE)[pixel], vector[0].hypot(vector[1])];
            (by_log * (1.0 - along * (0.5 * s).exp()), by_vector)
        };
        let (logits, by_vectors): (Vec<f32>, Vec<[f32; 2]>) = vectors.par_iter().enumerate().map(of_pixel).unzip();
        let mut sums = vec![0.0f64; layout.len() - layout.anisotropy_group()];
        let (groups, field) = sums.split_at_mut(2 * layout.groups);
        for (pixel, (membership, by_vector)) in self.memberships.iter().zip(by_vectors).enumerate() {
            for i in 0..2 {
                for &(group, share) in membership {
                    groups[2 * group as usize + i] += f64::from(share * by_vector[i]);
                }
                for (node, share) in anisotropy::nodes(self.size, pixel) {
                    field[2 * node + i] += f64::from(share * by_vector[i]);
                }
            }
        }
        for (slope, sum) in gradient[layout.anisotropy_group()..].iter_mut().zip(sums) {
            *slope = sum as f32;
        }
        logits
    }
}

pub(super) fn logits(values: &[f32]) -> impl Iterator<Item = f32> + '_ {
    values.iter().map(|&value| logit(inside(value)))
}

/// Makes values of logits, `1 / (1 + exp(-x))`, none below `least`.
struct Sigmoid<'a> {
    values: &'a mut [f32],
    least: f32,
}

impl Kernel<f32> for Sigmoid<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes<Scalar = f32>>(self) {
        let one = L::splat(1.0);
        for values in self.values.chunks_mut(L::LANES) {
            let power = (L::load(values) * L::splat(-std::f64::consts::LOG2_E)).exp2();
            (one / (one + power)).max(L::splat(self.least.into())).store(values);
        }
    }
}

/// A value between 0 and 1 whose logit is finite.
pub(super) fn inside(x: f32) -> f32 {
    x.clamp(1e-4, 1.0 - 1e-4)
}

pub(super) fn logit(x: f32) -> f32 {
    (x / (1.0 - x)).ln()
}
