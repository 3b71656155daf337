//! What the photos of a pixel tell without learning: where the surface leans, and how dark and bright it gets.

use rayon::prelude::*;

use super::config::{HINT_RIDGE, HINTS, INPUTS};
use crate::error::Result;
use crate::nn::layout::Layout;
use crate::nn::scalar::Scalar;
use crate::nn::tape::{Buffer, Planes, Pool};

/// First plane of a photo's ratio to a white diffuse surface, 3, and of its half vector, of which x and y are used.
const FIRST_RATIO: usize = 3;
const FIRST_HALF: usize = 10;
/// Least mean ratio that slopes are divided by, least sum of weights, and largest slope.
const CODE_MIN: f64 = 0.02;
const WEIGHT_MIN: f64 = 1e-6;
const SLOPE_MAX: f64 = 4.0;

/// Values held per pixel, and where they begin: mean and smallest ratio, 3 each; mean of the half vector, 2; sums of the products of deviations: xx, yy, xy,
/// then of the mean over colours c of the ratio with x and y; sum of the weights c^4, and of them times x and y.
pub(super) const SUMS: usize = 16;
const MEAN: usize = 0;
const LEAST: usize = 3;
const HALF: usize = 6;
const SQUARES: usize = 8;
const WITH_CODE: usize = 11;
const WEIGHT: usize = 13;
const BRIGHT: usize = 14;

/// The hints of photos that are taken in one after the other (`python/svbrdf_gcn/training/model.py`, `hints`); their order does not matter.
///
/// With c the mean over colours of the ratio and h the x and y of the half vector: the slope of c in h (ridge regression) over the mean of c, within [-4, 4], 2; the mean
/// of h with weights c^4 less its mean without, 2; the smallest ratio, 3; the mean ratio, 3.
pub(super) struct Hints<E: Scalar> {
    /// The layout of what is held.
    layout: Layout,
    sums: Buffer<E>,
    photos: usize,
}

impl<E: Scalar> Hints<E> {
    /// Of no photos yet, with as many pixels as `layout`.
    pub fn new(layout: Layout, pool: &Pool<E>) -> Self {
        let layout = layout.with_channels(SUMS);
        Self { layout, sums: pool.zeros(layout.len()), photos: 0 }
    }

    /// Takes in the [`INPUTS`] planes of one more photo.
    pub fn add(&mut self, photo: &[E]) {
        let first = self.photos == 0;
        self.photos += 1;
        let share = E::splat(1.0 / self.photos as f64);
        let bands = self.sums.par_chunks_mut(self.layout.band_len());
        let inputs = photo.par_chunks(self.layout.with_channels(INPUTS).band_len());
        bands.zip(inputs).for_each(|(band, photo)| {
            let pixels = band.len() / SUMS;
            for pixel in 0..pixels {
                let mut sums = gather(band, pixels, pixel);
                let input = |plane: usize| photo[plane * pixels + pixel];
                let ratio = [0, 1, 2].map(|channel| input(FIRST_RATIO + channel));
                take_in(&mut sums, ratio, [input(FIRST_HALF), input(FIRST_HALF + 1)], share, first);
                for (plane, value) in sums.into_iter().enumerate() {
                    band[plane * pixels + pixel] = value;
                }
            }
        });
    }

    /// What the photos amount to: ([`HINTS`], H, W).
    pub fn finish(self, pool: &Pool<E>) -> Result<Planes<E>> {
        let to = self.layout.with_channels(HINTS);
        let share = E::splat(1.0 / self.photos as f64);
        let mut out = pool.take(to.len());
        out.par_chunks_mut(to.band_len()).zip(self.sums.par_chunks(self.layout.band_len())).for_each(|(out, band)| {
            let pixels = band.len() / SUMS;
            for pixel in 0..pixels {
                for (plane, value) in hints(&gather(band, pixels, pixel), share).into_iter().enumerate() {
                    out[plane * pixels + pixel] = value;
                }
            }
        });
        Planes::of(out, to)
    }
}

/// What `band` of `pixels` pixels holds for one of them.
#[inline(always)]
fn gather<E: Scalar>(band: &[E], pixels: usize, pixel: usize) -> [E; SUMS] {
    std::array::from_fn(|plane| band[plane * pixels + pixel])
}

/// The mean over colours.
#[inline(always)]
fn grey<E: Scalar>(color: [E; 3]) -> E {
    (color[0] + color[1] + color[2]) * E::splat(1.0 / 3.0)
}

#[inline(always)]
fn mean_ratio<E: Scalar>(sums: &[E; SUMS]) -> [E; 3] {
    [sums[MEAN], sums[MEAN + 1], sums[MEAN + 2]]
}

#[inline(always)]
fn at_least<E: Scalar>(value: E, least: f64) -> E {
    let least = E::splat(least);
    if value < least { least } else { value }
}

/// Takes one more photo into the sums of a pixel, by deviations from the mean so far as Welford does, because moments about zero cancel; `share` is the
/// reciprocal of how many photos there are with it.
#[inline(always)]
fn take_in<E: Scalar>(sums: &mut [E; SUMS], ratio: [E; 3], half: [E; 2], share: E, first: bool) {
    let code = grey(ratio);
    let off_code = code - grey(mean_ratio(sums));
    for channel in 0..3 {
        sums[MEAN + channel] += (ratio[channel] - sums[MEAN + channel]) * share;
        if first || ratio[channel] < sums[LEAST + channel] {
            sums[LEAST + channel] = ratio[channel];
        }
    }
    let off = [half[0] - sums[HALF], half[1] - sums[HALF + 1]];
    for axis in 0..2 {
        sums[HALF + axis] += off[axis] * share;
    }
    let rest = [half[0] - sums[HALF], half[1] - sums[HALF + 1]];
    sums[SQUARES] += off[0] * rest[0];
    sums[SQUARES + 1] += off[1] * rest[1];
    sums[SQUARES + 2] += off[0] * rest[1];
    let weight = (code * code) * (code * code);
    sums[WEIGHT] += weight;
    for axis in 0..2 {
        sums[WITH_CODE + axis] += off_code * rest[axis];
        sums[BRIGHT + axis] += weight * half[axis];
    }
}

/// The hints of a pixel; `share` is the reciprocal of the number of photos.
#[inline(always)]
fn hints<E: Scalar>(sums: &[E; SUMS], share: E) -> [E; HINTS] {
    let ridge = E::splat(HINT_RIDGE);
    let mean = |at: usize| sums[at] * share;
    let (xx, yy, xy) = (mean(SQUARES) + ridge, mean(SQUARES + 1) + ridge, mean(SQUARES + 2));
    let with_code = [mean(WITH_CODE), mean(WITH_CODE + 1)];
    let ratio = mean_ratio(sums);
    let scale = E::splat(1.0) / ((xx * yy - xy * xy) * at_least(grey(ratio), CODE_MIN));
    let slope = [yy * with_code[0] - xy * with_code[1], xx * with_code[1] - xy * with_code[0]].map(|slope| {
        let (slope, most) = (at_least(slope * scale, -SLOPE_MAX), E::splat(SLOPE_MAX));
        if slope > most { most } else { slope }
    });
    let weight = at_least(sums[WEIGHT], WEIGHT_MIN);
    let bright = [0, 1].map(|axis| (sums[BRIGHT + axis] - sums[HALF + axis] * sums[WEIGHT]) / weight);
    let least = [sums[LEAST], sums[LEAST + 1], sums[LEAST + 2]];
    [slope[0], slope[1], bright[0], bright[1], least[0], least[1], least[2], ratio[0], ratio[1], ratio[2]]
}

#[cfg(test)]
mod tests {
    use super::Hints;
    use crate::nn::layout::Layout;
    use crate::nn::ops::testing::{compare, numbers};
    use crate::nn::photo_graph::config::{HINTS, INPUTS};
    use crate::nn::scalar::Scalar;
    use crate::nn::tape::Pool;

    const SIZE: (usize, usize) = (20, 40);

    /// The hints by their definition, from moments about the means.
    fn defined(photos: &[Vec<f64>]) -> Vec<f64> {
        let (pixels, n) = (SIZE.0 * SIZE.1, photos.len() as f64);
        let mut out = vec![0.0; HINTS * pixels];
        for pixel in 0..pixels {
            let plane = |index: usize| photos.iter().map(|x| x[index * pixels + pixel]).collect::<Vec<f64>>();
            let mean = |x: &[f64]| x.iter().sum::<f64>() / n;
            let centred = |x: &[f64]| x.iter().map(|value| value - mean(x)).collect::<Vec<f64>>();
            let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / n;
            let ratio = [plane(3), plane(4), plane(5)];
            let code: Vec<f64> = (0..photos.len()).map(|i| (ratio[0][i] + ratio[1][i] + ratio[2][i]) / 3.0).collect();
            let (c, x, y) = (centred(&code), centred(&plane(10)), centred(&plane(11)));
            let (xx, yy, xy) = (product(&x, &x) + 1e-2, product(&y, &y) + 1e-2, product(&x, &y));
            let (cx, cy) = (product(&c, &x), product(&c, &y));
            let scale = 1.0 / (xx * yy - xy * xy) / mean(&code).max(0.02);
            let weight: Vec<f64> = code.iter().map(|c| c.powi(4)).collect();
            let bright = |off: &[f64]| product(&weight, off) * n / weight.iter().sum::<f64>().max(1e-6);
            let least = |x: &Vec<f64>| x.iter().copied().fold(f64::INFINITY, f64::min);
            let slope = [(yy * cx - xy * cy) * scale, (xx * cy - xy * cx) * scale].map(|v| v.clamp(-4.0, 4.0));
            let all = [&slope[..], &[bright(&x), bright(&y)], &ratio.each_ref().map(least), &ratio.map(|x| mean(&x))];
            for (index, value) in all.concat().into_iter().enumerate() {
                out[index * pixels + pixel] = value;
            }
        }
        out
    }

    fn hints<E: Scalar>(photos: &[Vec<f64>]) -> Vec<f64> {
        let layout = Layout { channels: INPUTS, height: SIZE.0, width: SIZE.1 };
        let pool = Pool::default();
        let mut hints = Hints::<E>::new(layout, &pool);
        for photo in photos {
            let planes: Vec<E> = photo.iter().map(|&value| E::splat(value)).collect();
            hints.add(&layout.pack(&planes, SIZE.0, SIZE.1));
        }
        let planes = hints.finish(&pool).unwrap();
        planes.layout.unpack(planes.values(), SIZE.0, SIZE.1).into_iter().map(Scalar::wide).collect()
    }

    #[test]
    fn hints_are_what_the_definition_says() {
        let pixels = SIZE.0 * SIZE.1;
        for count in [1, 2, 7] {
            let mut photos: Vec<Vec<f64>> = (0..count).map(|photo| numbers(INPUTS * pixels, photo as u64)).collect();
            for (index, photo) in photos.iter_mut().enumerate() {
                photo[3 * pixels..6 * pixels].iter_mut().for_each(|value| *value = value.max(0.0));
                // Black in all photos up to pixel 9, in all but the first up to 18, which leans out of the ordinary there.
                let black = if index == 0 { 9 } else { 18 };
                (3..6).for_each(|plane| photo[plane * pixels..plane * pixels + black].fill(0.0));
                let lean = if index == 0 { 0.2 } else { 0.0 };
                photo[10 * pixels + 9..10 * pixels + 14].fill(lean);
                photo[11 * pixels + 9..11 * pixels + 14].fill(0.0);
                photo[10 * pixels + 14..10 * pixels + 18].fill(0.0);
                photo[11 * pixels + 14..11 * pixels + 18].fill(-lean);
            }
            let expected = defined(&photos);
            let limited = |limit: f64| expected[..2 * pixels].contains(&limit);
            assert_eq!((limited(4.0), limited(-4.0)), (count > 1, count > 1));
            compare(&hints::<f64>(&photos), &expected, 1e-12, "hints");
            compare(&hints::<f32>(&photos), &expected, 1e-5, "hints in f32");
        }
    }

    #[test]
    fn many_photos_with_nearly_the_same_half_vector() {
        let pixels = SIZE.0 * SIZE.1;
        let mut photos: Vec<Vec<f64>> = (0..60).map(|photo| numbers(INPUTS * pixels, photo)).collect();
        for photo in &mut photos {
            photo[3 * pixels..6 * pixels].iter_mut().for_each(|value| *value = value.abs() + 0.5);
            photo[10 * pixels..12 * pixels].iter_mut().for_each(|value| *value = 0.9 + 1e-3 * *value);
        }
        compare(&hints::<f32>(&photos), &defined(&photos), 1e-5, "hints in f32");
    }
}
