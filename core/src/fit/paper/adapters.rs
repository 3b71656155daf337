//! Second stage of the network fit: Adam on the parameters of the per-map adapters, the material feature held fixed.
//!
//! The paper (Section 3.3, Eq. 7) optimises the adapters alone once the latent code is found. The decoder before them is then a constant,
//! so the material feature is computed once and a step costs the adapters, the renderer and nothing else.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use dfdx::prelude::{Cpu, Tape};

use super::tape;
use crate::error::{Error, Result};
use crate::fit::optim::descent::{Descent, EarlyStop, Settings, descend};
use crate::maps::Maps;
use crate::nn::tape::{Image, Loss};
use crate::nn::{AdapterParams, Adapters, Decoding};
use crate::progress::{Control, Stage};
use crate::render::{Target, photo_loss, photo_loss_on_tape};

/// Learning rate for several photos, and for one (released optimisation).
const RATES: [f64; 2] = [1e-3, 1e-4];

/// From a material feature through adapters, decoding and renderer to the loss against photos, and back.
pub struct Readout<'a> {
    /// Shared with the tape that a pass was recorded on.
    adapters: Arc<Mutex<Adapters>>,
    decoding: Decoding,
    patch_size: f64,
    targets: &'a [Target],
    raw: Vec<f32>,
    d_raw: Vec<f32>,
    maps: Maps<f32>,
    d_maps: Maps<f32>,
}

impl<'a> Readout<'a> {
    /// The way from `feature`, `channels` planes of the size of the `targets`, through adapters with `outputs[i]` planes each.
    ///
    /// `patch_size` is the width of the patch in the unit of the targets' positions.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] if there are no targets; [`Error::ShapeMismatch`] if `feature` is not of their size or `outputs` are
    /// not as many planes as `decoding` reads; as [`Adapters::new`].
    pub fn new(
        feature: &[f32],
        channels: usize,
        outputs: &[usize],
        decoding: Decoding,
        patch_size: f64,
        targets: &'a [Target],
    ) -> Result<Self> {
        let [first, ..] = targets else {
            return Err(Error::invalid("targets", "expected at least one photo, got none"));
        };
        let planes = outputs.iter().sum::<usize>();
        if planes != decoding.raw_planes() {
            return Err(Error::shape(
                "outputs",
                format!("{} planes", decoding.raw_planes()),
                format!("{planes} planes"),
            ));
        }
        let (width, height, lobe) = (first.width(), first.height(), decoding.lobe());
        let adapters = Adapters::new(feature, channels, outputs, width, height)?;
        let maps = Maps::new(lobe, width, height, vec![0.0; lobe.planes() * height * width])?;
        let raw = vec![0.0; adapters.raw_len()];
        let adapters = Arc::new(Mutex::new(adapters));
        Ok(Self { adapters, decoding, patch_size, targets, d_raw: raw.clone(), raw, d_maps: maps.clone(), maps })
    }

    /// Puts another feature of the same size in place.
    ///
    /// # Errors
    /// As [`Adapters::set_feature`].
    pub fn set_feature(&mut self, feature: &[f32]) -> Result<()> {
        lock(&self.adapters).set_feature(feature)
    }

    /// [`Readout::loss`] of `feature`, a tensor (1, channels, height, width), on its tape.
    ///
    /// # Errors
    /// As [`Readout::set_feature`] and [`Readout::loss`].
    pub(crate) fn loss_on_tape<T: Tape<f32, Cpu>>(
        &self,
        params: &[f32],
        feature: Image<f32, T>,
    ) -> Result<Loss<f32, T>> {
        let raw = tape::adapters(&self.adapters, params, feature)?;
        let maps = tape::decode(self.decoding, raw)?;
        photo_loss_on_tape(maps, self.decoding.lobe(), self.patch_size, self.targets)
    }

    /// The [`photo_loss`] at the adapters' parameters `params` (of all adapters, one after the other) and, where asked for, its gradient
    /// with respect to them and to the feature.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if a length does not fit; [`Error::Cancelled`]; as [`photo_loss`].
    pub fn loss(
        &mut self,
        params: &[f32],
        d_params: Option<&mut [f32]>,
        d_feature: Option<&mut [f32]>,
        control: &mut Control<'_>,
    ) -> Result<f64> {
        lock(&self.adapters).forward(params, &mut self.raw)?;
        control.poll()?;
        self.decoding.decode(&self.raw, &mut self.maps)?;
        if d_params.is_none() && d_feature.is_none() {
            return photo_loss(&self.maps, self.patch_size, self.targets, None);
        }
        let loss = photo_loss(&self.maps, self.patch_size, self.targets, Some(&mut self.d_maps))?;
        control.poll()?;
        self.decoding.backward(&self.raw, &self.d_maps, &mut self.d_raw)?;
        lock(&self.adapters).backward(&self.d_raw, d_params, d_feature)?;
        Ok(loss)
    }

    /// Adam's learning rate for this number of photos.
    pub(crate) fn learning_rate(&self) -> f64 {
        RATES[usize::from(self.targets.len() == 1)]
    }

    /// The maps of the last [`Readout::loss`].
    pub fn maps(&self) -> &Maps<f32> {
        &self.maps
    }

    /// As [`Readout::maps`], when nothing more is to be computed.
    pub(crate) fn into_maps(self) -> Maps<f32> {
        self.maps
    }
}

pub(super) fn lock(adapters: &Mutex<Adapters>) -> MutexGuard<'_, Adapters> {
    adapters.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Optimises `adapters`, the network's in the order of their outputs, so that the rendering of the maps that `readout` has from its
/// feature matches its targets. `adapters` are left at the best state and [`Readout::maps`] are the maps it gives.
///
/// `steps` steps of Adam at a learning rate of 1e-3, with a single photo 1e-4, or fewer as `early_stop` has it.
///
/// # Errors
/// [`Error::ShapeMismatch`] if the adapters have not the sizes `readout` was made for;
/// [`Error::Cancelled`]; [`Error::NonFinite`] if the loss is not finite from the start.
pub fn fit_adapters(
    readout: &mut Readout<'_>,
    adapters: &mut [AdapterParams],
    steps: usize,
    early_stop: Option<EarlyStop>,
    control: &mut Control<'_>,
) -> Result<Descent> {
    let mut params: Vec<f32> = adapters.iter().flat_map(|adapter| &adapter.values).copied().collect();
    let settings = Settings {
        stage: Stage::Adapters,
        steps,
        learning_rate: readout.learning_rate(),
        final_rate: 1.0,
        early_stop,
        around: [0; 2],
    };
    let descent = descend(&mut params, &settings, control, |params, gradient, control| {
        readout.loss(params, gradient, None, control)
    })?;
    readout.loss(&params, None, None, control)?;
    let mut rest = &params[..];
    for adapter in adapters {
        let (values, others) = rest.split_at(adapter.values.len());
        adapter.values.copy_from_slice(values);
        rest = others;
    }
    Ok(descent)
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use dfdx::prelude::*;

    use super::{Readout, fit_adapters};
    use crate::maps::{Lobe, Maps};
    use crate::nn::{AdapterParams, Decoding};
    use crate::progress::{CancelToken, Control, Progress};
    use crate::render::{Target, encode_radiance, render_maps};
    use crate::shot::Shot;

    const WIDTH: usize = 13;
    const HEIGHT: usize = 10;

    /// Values in [-1, 1) without pattern.
    fn noise(len: usize) -> impl Iterator<Item = f32> {
        (0..len).map(|i| ((i as f64 * 0.618_033_988_75 + 0.3).fract() * 2.0 - 1.0) as f32)
    }

    /// Sizes of the adapters.
    fn outputs(lobe: Lobe) -> (usize, Vec<usize>) {
        match lobe {
            Lobe::Isotropic => (9, vec![3, 2, 1, 3]),
            Lobe::Anisotropic => (14, vec![3, 3, 2, 3, 3]),
        }
    }

    /// Adapters whose output lies around a plain material: nothing faces away from the lights or is black.
    fn adapters(lobe: Lobe) -> Vec<AdapterParams> {
        let (m, outputs) = outputs(lobe);
        let mut base = match lobe {
            Lobe::Isotropic => &[0.0, 0.1, 0.2, 0.05, -0.05, 0.1, -0.3, -0.3, -0.3][..],
            Lobe::Anisotropic => &[0.0, 0.1, 0.2, 0.05, -0.05, 1.0, 0.1, 0.3, -0.3, -0.3, -0.3, 1.0, 0.1, 0.0],
        }
        .iter();
        let mut adapter = |k: usize| {
            let values = noise(AdapterParams::len_for(m, k)).map(|x| 0.15 * x).collect();
            let mut params = AdapterParams::new(m, k, values).unwrap();
            let (weight, bias) = (params.range("end.weight").unwrap(), params.range("end.bias").unwrap());
            params.values[weight].iter_mut().for_each(|weight| *weight *= 0.2);
            params.values[bias].iter_mut().zip(&mut base).for_each(|(bias, base)| *bias = *base);
            params
        };
        outputs.into_iter().map(&mut adapter).collect()
    }

    fn feature(lobe: Lobe) -> Vec<f32> {
        noise(outputs(lobe).0 * WIDTH * HEIGHT).collect()
    }

    /// Photos of a surface that is not what the adapters start from.
    fn targets(lobe: Lobe) -> Vec<Target> {
        let pixels = WIDTH * HEIGHT;
        let mut data = Vec::new();
        for plane in 0..lobe.planes() {
            let value = if plane == 5 || plane == 11 { 1.0 } else { 0.15 + 0.03 * plane as f32 };
            data.extend(noise(pixels).map(|x| value + if plane < 3 { 0.1 * x } else { 0.0 }));
        }
        let maps = Maps::new(lobe, WIDTH, HEIGHT, data).unwrap();
        let shots = [[0.3, 0.2, 3.0], [-1.0, 0.8, 2.5], [1.0, -0.9, 2.6]];
        let target = |at: [f64; 3]| {
            let shot = Shot { camera: at, light: at, light_intensity: [20.0; 3] };
            let encoded: Vec<f32> = render_maps(&maps, 2.0, &shot).unwrap().into_iter().map(encode_radiance).collect();
            Target::new(WIDTH, HEIGHT, shot, &encoded, &vec![0; pixels]).unwrap()
        };
        shots.into_iter().map(target).collect()
    }

    fn go_on(_: &Progress) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    #[test]
    fn gradients_of_the_whole_way_match_differences() {
        for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
            let (m, outputs) = outputs(lobe);
            let (targets, decoding) = (targets(lobe), Decoding::new(lobe));
            let mut readout = Readout::new(&feature(lobe), m, &outputs, decoding, 2.0, &targets).unwrap();
            let mut callback = go_on;
            let mut control = Control::new(&mut callback, CancelToken::new());
            let mut params: Vec<f32> = adapters(lobe).iter().flat_map(|adapter| adapter.values.clone()).collect();
            let (mut d_params, mut d_feature) = (vec![0.0; params.len()], vec![0.0; m * WIDTH * HEIGHT]);
            readout.loss(&params, Some(&mut d_params), Some(&mut d_feature), &mut control).unwrap();
            // Along the gradient itself, where differences in f32 are largest.
            let slope = |gradient: &[f32]| gradient.iter().map(|&g| f64::from(g).powi(2)).sum::<f64>().sqrt();
            let along = |values: &[f32], gradient: &[f32], by: f64| -> Vec<f32> {
                let factor = by / slope(gradient);
                values.iter().zip(gradient).map(|(v, &g)| (f64::from(*v) + factor * f64::from(g)) as f32).collect()
            };
            let start = params.clone();
            let mut at = |by: f64| {
                params = along(&start, &d_params, by);
                readout.loss(&params, None, None, &mut control).unwrap()
            };
            let difference = (at(1e-3) - at(-1e-3)) / 2e-3;
            assert!((difference / slope(&d_params) - 1.0).abs() < 5e-3, "{difference} {}", slope(&d_params));

            let mut at = |by: f64| {
                readout.set_feature(&along(&feature(lobe), &d_feature, by)).unwrap();
                readout.loss(&start, None, None, &mut control).unwrap()
            };
            let difference = (at(1e-3) - at(-1e-3)) / 2e-3;
            assert!((difference / slope(&d_feature) - 1.0).abs() < 5e-3, "{difference} {}", slope(&d_feature));
        }
    }

    #[test]
    fn the_tape_gives_what_the_loop_gives() {
        for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
            let (m, outputs) = outputs(lobe);
            let (targets, decoding, feature) = (targets(lobe), Decoding::new(lobe), feature(lobe));
            let mut readout = Readout::new(&feature, m, &outputs, decoding, 2.0, &targets).unwrap();
            let mut callback = go_on;
            let mut control = Control::new(&mut callback, CancelToken::new());
            let params: Vec<f32> = adapters(lobe).iter().flat_map(|adapter| adapter.values.clone()).collect();
            let mut expected = vec![0.0; feature.len()];
            let loss = readout.loss(&params, None, Some(&mut expected), &mut control).unwrap();
            let tensor = Cpu::default().tensor_from_vec(feature, (1, m, HEIGHT, WIDTH));
            let taped = readout.loss_on_tape(&params, tensor.leaky_trace()).unwrap();
            assert_eq!(taped.array(), loss as f32);
            assert_eq!(taped.backward().get(&tensor).as_vec(), expected);
        }
    }

    #[test]
    fn fitting_lowers_the_loss_and_returns_the_maps_of_the_best_state() {
        for lobe in [Lobe::Isotropic, Lobe::Anisotropic] {
            let (m, outputs) = outputs(lobe);
            let (targets, decoding, feature) = (targets(lobe), Decoding::new(lobe), feature(lobe));
            let mut callback = go_on;
            let mut control = Control::new(&mut callback, CancelToken::new());
            let mut params = adapters(lobe);
            let mut readout = Readout::new(&feature, m, &outputs, decoding, 2.0, &targets).unwrap();
            let descent = fit_adapters(&mut readout, &mut params, 150, None, &mut control).unwrap();
            let maps = readout.maps().clone();
            assert_eq!((descent.steps, descent.rollbacks), (150, 0));
            assert!(descent.best_loss < 0.6 * descent.first_loss, "{} {}", descent.first_loss, descent.best_loss);
            let mut readout = Readout::new(&feature, m, &outputs, decoding, 2.0, &targets).unwrap();
            let values: Vec<f32> = params.iter().flat_map(|adapter| adapter.values.clone()).collect();
            assert_eq!(readout.loss(&values, None, None, &mut control).unwrap(), descent.best_loss);
            assert_eq!(readout.maps(), &maps);
        }
    }

    #[test]
    fn misfits_are_errors() {
        let (targets, decoding, feature) =
            (targets(Lobe::Isotropic), Decoding::new(Lobe::Isotropic), feature(Lobe::Isotropic));
        assert!(Readout::new(&feature, 9, &[3, 2, 1, 3], decoding, 2.0, &[]).is_err());
        assert!(Readout::new(&feature, 9, &[3, 2, 3], decoding, 2.0, &targets).is_err());
        assert!(Readout::new(&feature[1..], 9, &[3, 2, 1, 3], decoding, 2.0, &targets).is_err());
        let mut callback = go_on;
        let mut control = Control::new(&mut callback, CancelToken::new());
        let mut readout = Readout::new(&feature, 9, &[3, 2, 1, 3], decoding, 2.0, &targets).unwrap();
        assert!(fit_adapters(&mut readout, &mut adapters(Lobe::Isotropic)[1..], 1, None, &mut control).is_err());
    }
}
