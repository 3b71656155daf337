//! Pixel shuffle and its inverse.

use dfdx::tensor::{Cpu, Tape};
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::nn::layout::Layout;
use crate::nn::scalar::Scalar;
use crate::nn::tape::{Planes, Slot, record};

/// Pixel shuffle by two: (4C, H, W) -> (C, 2H, 2W), channel 4c + 2i + j to row offset i, column offset j; plus `skip`, if there is one.
///
/// # Source
/// Shi et al., "Real-Time Single Image and Video Super-Resolution Using an Efficient Sub-Pixel CNN", CVPR 2016, eq. 4.
pub(crate) fn pixel_shuffle<E: Scalar, T: Tape<E, Cpu>>(
    x: Planes<E, T>,
    skip: Option<Planes<E, T>>,
) -> Result<Planes<E, T>> {
    let from = x.layout;
    if !from.channels.is_multiple_of(4) {
        return Err(Error::shape("pixel shuffle", "a multiple of 4 channels", from.channels.to_string()));
    }
    let to = Layout { channels: from.channels / 4, height: 2 * from.height, width: 2 * from.width };
    let mut out = match &skip {
        Some(skip) if skip.layout != to => {
            return Err(Error::shape("skip", format!("{to:?}"), format!("{:?}", skip.layout)));
        }
        Some(skip) => x.pool().copy(skip.values()),
        None => x.pool().zeros(to.len()),
    };
    add_shuffled(&mut out, to, x.values(), from);

    let pool = x.pool().clone();
    let (x, tape) = x.split();
    let x = x.slot();
    let (skip, tape) = match skip.map(Planes::split) {
        Some((skip, other)) => (Some(skip.slot()), tape.merge(other)),
        None => (None, tape),
    };
    let wanted = T::OWNS_TAPE && (x.is_wanted() || skip.as_ref().is_some_and(Slot::is_wanted));
    record(out, to, tape, wanted, move |dy, grads| {
        x.add(grads, || {
            let mut dx = pool.take(from.len());
            unshuffle(&mut dx, from, &dy, to);
            dx
        })?;
        skip.map_or(Ok(()), |skip| skip.add(grads, || dy))
    })
}

/// The inverse of [`pixel_shuffle`]: (C, 2H, 2W) -> (4C, H, W).
pub(crate) fn pixel_unshuffle<E: Scalar, T: Tape<E, Cpu>>(x: Planes<E, T>) -> Result<Planes<E, T>> {
    let from = x.layout;
    if !from.height.is_multiple_of(2) || !from.width.is_multiple_of(2) {
        return Err(Error::shape("pixel unshuffle", "even sides", format!("{} x {}", from.height, from.width)));
    }
    let to = Layout { channels: 4 * from.channels, height: from.height / 2, width: from.width / 2 };
    let mut out = x.pool().take(to.len());
    unshuffle(&mut out, to, x.values(), from);
    let pool = x.pool().clone();
    let (x, tape) = x.split();
    let x = x.slot();
    let wanted = T::OWNS_TAPE && x.is_wanted();
    record(out, to, tape, wanted, move |dy, grads| {
        x.add(grads, || {
            let mut dx = pool.zeros(from.len());
            add_shuffled(&mut dx, from, &dy, to);
            dx
        })
    })
}

/// Adds (4C, h, w) to (C, 2h, 2w).
fn add_shuffled<E: Scalar>(wide: &mut [E], wide_layout: Layout, deep: &[E], deep_layout: Layout) {
    wide.par_chunks_mut(wide_layout.band_len()).enumerate().for_each(|(band, wide)| {
        let rows = wide_layout.band_rows(band);
        for (line, to) in wide.chunks_exact_mut(wide_layout.width).enumerate() {
            let (channel, row) = (line / rows.len(), rows.start + line % rows.len());
            let deep_channel = 4 * channel + 2 * (row % 2);
            let even = &deep[deep_layout.row(deep_channel, row / 2)];
            let odd = &deep[deep_layout.row(deep_channel + 1, row / 2)];
            for (to, (&even, &odd)) in to.chunks_exact_mut(2).zip(even.iter().zip(odd)) {
                to[0] += even;
                to[1] += odd;
            }
        }
    });
}

/// (C, 2h, 2w) to (4C, h, w).
fn unshuffle<E: Scalar>(deep: &mut [E], deep_layout: Layout, wide: &[E], wide_layout: Layout) {
    deep.par_chunks_mut(deep_layout.band_len()).enumerate().for_each(|(band, deep)| {
        let rows = deep_layout.band_rows(band);
        for (line, to) in deep.chunks_exact_mut(deep_layout.width).enumerate() {
            let (channel, row) = (line / rows.len(), rows.start + line % rows.len());
            let from = &wide[wide_layout.row(channel / 4, 2 * row + channel % 4 / 2)];
            for (to, from) in to.iter_mut().zip(from.chunks_exact(2)) {
                *to = from[channel % 2];
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::{pixel_shuffle, pixel_unshuffle};
    use crate::nn::layout::Layout;
    use crate::nn::ops::testing::{check, compare, numbers};
    use crate::nn::tape::Planes;

    #[test]
    fn places() {
        let layout = Layout { channels: 4, height: 1, width: 2 };
        let x = Planes::constant(vec![0.0f32, 1.0, 10.0, 11.0, 20.0, 21.0, 30.0, 31.0], layout).unwrap();
        let out = pixel_shuffle(x, None).unwrap();
        assert_eq!(out.layout.unpack(out.values(), 2, 4), [0.0, 10.0, 1.0, 11.0, 20.0, 30.0, 21.0, 31.0]);
    }

    #[test]
    fn inverses() {
        let layout = Layout { channels: 3, height: 22, width: 600 };
        let x = Planes::constant(numbers(layout.len(), 1), layout).unwrap();
        let back = pixel_shuffle(pixel_unshuffle(x.branch()).unwrap(), None).unwrap();
        compare(back.values(), x.values(), 0.0, "shuffle of unshuffle");
    }

    #[test]
    fn gradients() {
        check(Layout { channels: 8, height: 11, width: 20 }, &[], |x, _| pixel_shuffle(x, None));
        check(Layout { channels: 2, height: 22, width: 20 }, &[], |x, _| pixel_unshuffle(x));
        check(Layout { channels: 2, height: 22, width: 20 }, &[], |x, _| {
            let skip = x.branch();
            pixel_shuffle(pixel_unshuffle(x)?, Some(skip))
        });
    }

    #[test]
    fn wrong_sizes_are_errors() {
        let planes = |channels, height, width| {
            let layout = Layout { channels, height, width };
            Planes::constant(vec![0.0f32; layout.len()], layout).unwrap()
        };
        assert!(pixel_shuffle(planes(3, 2, 2), None).is_err());
        assert!(pixel_shuffle(planes(4, 2, 2), Some(planes(1, 4, 2))).is_err());
        assert!(pixel_unshuffle(planes(1, 3, 2)).is_err());
    }
}
