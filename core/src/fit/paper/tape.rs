//! The way from the material feature to the maps on dfdx's tape. The loss behind it is [`photo_loss_on_tape`](crate::render::photo_loss_on_tape), the decoder before it
//! ends on the same tape.

use std::sync::{Arc, Mutex};

use dfdx::prelude::*;

use super::adapters::lock;
use crate::error::{Error, Result};
use crate::maps::Maps;
use crate::nn::tape::{Image, image};
use crate::nn::{Adapters, Decoding};

/// The raw planes that `adapters` with `params` give for `feature`. Their gradient goes to the feature alone.
pub(super) fn adapters<T: Tape<f32, Cpu>>(
    adapters: &Arc<Mutex<Adapters>>,
    params: &[f32],
    feature: Image<f32, T>,
) -> Result<Image<f32, T>> {
    let (feature, tape) = feature.split_tape();
    let (_, channels, height, width) = *feature.shape();
    let mut held = lock(adapters);
    held.set_feature(&feature.as_vec())?;
    let mut raw = vec![0.0; held.raw_len()];
    held.forward(params, &mut raw)?;
    drop(held);
    let planes = raw.len() / (height * width);
    let (feature, adapters) = (feature.ghost(), adapters.clone());
    image(raw, [planes, height, width], tape, move |gradient, grads| {
        let mut back = vec![0.0; channels * height * width];
        let mut held = lock(&adapters);
        held.backward(gradient, None, Some(&mut back)).map_err(misfit)?;
        add(grads.get_or_alloc_mut(&feature)?, &back);
        Ok(())
    })
}

/// The maps that `decoding` makes of the planes `raw`.
pub(super) fn decode<T: Tape<f32, Cpu>>(decoding: Decoding, raw: Image<f32, T>) -> Result<Image<f32, T>> {
    let (raw, tape) = raw.split_tape();
    let (_, _, height, width) = *raw.shape();
    let (lobe, values) = (decoding.lobe(), raw.as_vec());
    let mut maps = Maps::new(lobe, width, height, vec![0.0; lobe.planes() * height * width])?;
    decoding.decode(&values, &mut maps)?;
    let raw = raw.ghost();
    image(maps.data().to_vec(), [lobe.planes(), height, width], tape, move |gradient, grads| {
        let slopes = Maps::new(lobe, width, height, gradient.to_vec()).map_err(misfit)?;
        let mut back = vec![0.0; values.len()];
        decoding.backward(&values, &slopes, &mut back).map_err(misfit)?;
        add(grads.get_or_alloc_mut(&raw)?, &back);
        Ok(())
    })
}

fn add(sums: &mut [f32], part: &[f32]) {
    sums.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
}

/// dfdx's error for ours: sizes that do not fit.
fn misfit(_: Error) -> CpuError {
    CpuError::WrongNumElements
}
