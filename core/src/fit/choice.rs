//! What the scene requires: the simplest reflectance that predicts photos left out as well as richer ones, and whether their light is what is stated.
//!
//! Not from the paper.

use serde::Serialize;

use super::direct::{FoldRelief, PHOTO_DEVIATION, fit_folds};
use crate::capture::Capture;
use crate::error::Result;
use crate::fit::optim::holdout::{LEFT_OUT, thinned};
use crate::fit::options::{FitOptions, Refine, Reflectance};
use crate::maps::Lobe;
use crate::progress::{Control, Stage};

/// From the simplest to the richest.
const CANDIDATES: [Reflectance; 4] =
    [Reflectance::Diffuse, Reflectance::Dielectric, Reflectance::Isotropic, Reflectance::Anisotropic];
/// Photos below which nothing is chosen.
const PHOTOS_MIN: usize = 3;
/// Pixels along the longer side, photos left out, and steps, of the fits that compare.
const SIDE: usize = 40;
const FOLDS: usize = 3;
const STEPS: usize = 100;
/// Steps below which fits are too far from their end to be compared.
const STEPS_MIN: usize = 50;
/// A richer reflectance has to take away more than this share of the squared error of photos left out; two lobes more than that.
const GAIN: f64 = 0.01;
const ANISOTROPIC_GAIN: f64 = 0.15;
/// Fits of few steps may rank two reflectances wrongly where their squared errors are nearer than this factor.
const NEAR: f64 = 1.1;
/// Share of the squared error that the richer of two near ones has to take away with all steps: on textures of dielectrics it took or added 2 %.
const NEAR_GAIN: f64 = 0.03;
/// Two roughnesses that take away less than the first share with few steps have to take away the second with all: few steps leave bumps unfitted, which a
/// stretched lobe explains, too.
const ANISOTROPIC_SURE: f64 = 0.5;
const ANISOTROPIC_NEAR_GAIN: f64 = 0.25;
/// Share of the squared error that the stated light has to take away from the refined one, which costs next to nothing where the stated one is right.
const LIGHT_GAIN: f64 = 0.02;
/// Share of the squared error that refined positions have to take away.
const PLACE_GAIN: f64 = 0.02;
/// Share of pixels whose specular albedo is a metal's above which the simpler reflectances do not count.
const METALLIC_SHARE: f64 = 0.01;
/// Errors (gamma 2.2 codes) below which a round lobe is good enough.
const ROUND_ENOUGH: f64 = 0.004;

/// The error of photos left out under one reflectance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Comparison {
    /// The reflectance.
    pub reflectance: Reflectance,
    /// Root mean square of gamma 2.2 codes over the photos left out; after few steps, or all, where two were too near to be told apart by few.
    pub error: f64,
}

/// What a scene requires.
#[derive(Clone, Debug)]
pub(crate) struct Choice {
    pub reflectance: Reflectance,
    pub refine: Refine,
    /// The errors that decided about the reflectance, simplest first.
    pub comparisons: Vec<Comparison>,
}

impl Choice {
    /// That of a network of the paper's form.
    pub fn of_lobe(lobe: Lobe) -> Self {
        let reflectance = match lobe {
            Lobe::Isotropic => Reflectance::Isotropic,
            Lobe::Anisotropic => Reflectance::Anisotropic,
        };
        Self { reflectance, refine: Refine::None, comparisons: Vec::new() }
    }

    /// What the options ask for, and for the rest what suits the photos of `capture`.
    ///
    /// # Errors
    /// As [`fit_folds`].
    pub fn new(capture: &Capture, options: &FitOptions, control: &mut Control<'_>) -> Result<Self> {
        let FitOptions { mut reflectance, mut refine, .. } = *options;
        let mut comparisons = Vec::new();
        // No more steps than the fit itself takes.
        let steps = options.steps(Stage::Direct).min(STEPS);
        if capture.len() < PHOTOS_MIN || steps < STEPS_MIN {
            if reflectance == Reflectance::Auto {
                reflectance = Reflectance::Isotropic;
            }
            if refine == Refine::Auto {
                refine = if capture.len() < PHOTOS_MIN { Refine::None } else { Refine::Light };
            }
            return Ok(Self { reflectance, refine, comparisons });
        }
        let (thin, _) = thinned(capture, SIDE)?;
        let few = FitOptions { direct_steps: Some(steps), ..options.clone() };
        let mut folds = |most: usize, options: FitOptions| {
            fit_folds(&thin, FoldRelief::Flat, Some(PHOTO_DEVIATION), most, &options, control)
        };
        let mut refined = None;
        if reflectance == Reflectance::Auto {
            let mut metallic = false;
            for reflectance in CANDIDATES {
                let folds = folds(FOLDS, FitOptions { reflectance, refine, ..few.clone() })?;
                metallic |= reflectance == Reflectance::Isotropic && folds.metallic_share() > METALLIC_SHARE;
                comparisons.push(Comparison { reflectance, error: folds.error()? });
            }
            // Paint beside metal may be predicted well without the metal.
            let allows_metal = |one: &Comparison| one.reflectance == Reflectance::Isotropic;
            let first = if metallic { comparisons.iter().position(allows_metal).unwrap_or(0) } else { 0 };
            reflectance = simplest(&comparisons[first..]);
            let tried = comparisons.clone();
            let mut full = |reflectance: Reflectance| {
                folds(LEFT_OUT, FitOptions { reflectance, refine, ..options.clone() })?.error()
            };
            reflectance = verified(reflectance, &mut comparisons, &mut full)?;
            refined = tried.iter().find(|one| one.reflectance == reflectance).map(|one| one.error);
        }
        if refine == Refine::Auto {
            let mut error = |refine: Refine| folds(FOLDS, FitOptions { reflectance, refine, ..few.clone() })?.error();
            let refined = refined.map_or_else(|| error(Refine::Light), Ok)?;
            let [stated, placed] = [error(Refine::None)?, error(Refine::All)?];
            tracing::debug!(
                "photos left out, as stated, light and positions refined: {stated:.4}, {refined:.4}, {placed:.4}"
            );
            let better = |one: f64, share: f64, other: f64| one.powi(2) < (1.0 - share) * other.powi(2);
            // Light is seldom known exactly: as stated only where that is clearly better. Positions mostly are: moved only where that is.
            refine = if better(stated, LIGHT_GAIN, refined.min(placed)) {
                Refine::None
            } else if better(placed, PLACE_GAIN, refined) {
                Refine::All
            } else {
                Refine::Light
            };
        }
        tracing::debug!("reflectance {}, refine {}: {comparisons:?}", reflectance.name(), refine.name());
        Ok(Self { reflectance, refine, comparisons })
    }
}

/// The simplest of which no richer one is much better.
fn simplest(comparisons: &[Comparison]) -> Reflectance {
    let worse = |simple: &Comparison, rich: &Comparison| {
        let (gain, enough) = match rich.reflectance {
            Reflectance::Anisotropic => (ANISOTROPIC_GAIN, ROUND_ENOUGH),
            _ => (GAIN, 0.0),
        };
        rich.error.powi(2) < (1.0 - gain) * simple.error.powi(2) && simple.error > enough
    };
    let suits = |(i, simple): &(usize, &Comparison)| !comparisons[i + 1..].iter().any(|rich| worse(simple, rich));
    let found = comparisons.iter().enumerate().find(suits);
    found.map_or(Reflectance::Isotropic, |(_, comparison)| comparison.reflectance)
}

/// `chosen`, unless it is near another one that is better with all steps (`full`): the next richer one where lobes are round, a round one where they are not.
/// The errors of both, if tried, become those.
fn verified(
    chosen: Reflectance,
    comparisons: &mut [Comparison],
    full: &mut dyn FnMut(Reflectance) -> Result<f64>,
) -> Result<Reflectance> {
    let Some(found) = comparisons.iter().position(|one| one.reflectance == chosen) else { return Ok(chosen) };
    let stretched = chosen == Reflectance::Anisotropic;
    let first = if stretched { found.saturating_sub(1) } else { found };
    let [simple, richer, ..] = &mut comparisons[first..] else { return Ok(chosen) };
    let squares = |one: &Comparison| one.error.powi(2);
    let (sure, gain) = if stretched {
        (squares(richer) < (1.0 - ANISOTROPIC_SURE) * squares(simple), ANISOTROPIC_NEAR_GAIN)
    } else {
        // Two roughnesses have to be better with few steps already.
        (richer.reflectance == Reflectance::Anisotropic || squares(richer) > NEAR * squares(simple), NEAR_GAIN)
    };
    if sure {
        return Ok(chosen);
    }
    for one in [&mut *simple, &mut *richer] {
        one.error = full(one.reflectance)?;
    }
    let better = squares(richer) < (1.0 - gain) * squares(simple);
    Ok(if better { richer.reflectance } else { simple.reflectance })
}

#[cfg(test)]
mod tests {
    use super::{CANDIDATES, Choice, Comparison, simplest, verified};
    use crate::cancel::CancelToken;
    use crate::capture::Capture;
    use crate::color::Transfer;
    use crate::fit::anisotropy;
    use crate::fit::direct::{DirectFit, Relief, fit_direct};
    use crate::fit::options::{FitOptions, Refine, Reflectance};
    use crate::fit::testing::photo;
    use crate::maps::{Lobe, Maps};
    use crate::progress::Control;
    use crate::shot::Shot;

    const SIDE: usize = 20;
    const PIXELS: usize = SIDE * SIDE;

    /// Nine photos of a plate with a grain in its colour, its lobe stretched by `vector`.
    fn capture(diffuse: f32, specular: [f32; 3], roughness: f32, vector: Option<[f32; 2]>) -> Capture {
        let mut random = fastrand::Rng::with_seed(4);
        let mut maps = Maps::new(Lobe::Isotropic, SIDE, SIDE, vec![0.0; 10 * PIXELS]).unwrap();
        for (i, value) in maps.data_mut().iter_mut().enumerate() {
            *value = match i / PIXELS {
                ..3 => diffuse * (0.8 + 0.4 * random.f32()),
                3 | 4 => 0.0,
                5 => 1.0,
                6 => roughness,
                plane => specular[plane - 7],
            };
        }
        let maps = anisotropy::join(maps, &vector.map_or(Vec::new(), |vector| vec![vector; PIXELS])).unwrap();
        let shown = |i: usize| {
            let angle = i as f64 * 2.4;
            let place = [0.35 * i as f64 * angle.cos(), 0.35 * i as f64 * angle.sin(), 2.4];
            let shot = Shot { camera: place, light: place, light_intensity: [10.0; 3] };
            photo(&maps, shot)
        };
        Capture::new((0..9).map(shown).collect(), 2.0, Transfer::Linear).unwrap()
    }

    /// The errors of all candidates.
    fn comparisons(errors: [f64; 4]) -> Vec<Comparison> {
        let comparison = |(reflectance, error)| Comparison { reflectance, error };
        CANDIDATES.into_iter().zip(errors).map(comparison).collect()
    }

    fn chosen(capture: &Capture, options: &FitOptions) -> Choice {
        Control::silently(CancelToken::new(), |control| Choice::new(capture, options, control)).unwrap()
    }

    #[test]
    fn a_scene_gets_what_it_requires() {
        let brushed = capture(0.01, [0.9, 0.8, 0.7], 0.38, Some([0.5, -0.9]));
        for (capture, expected) in [
            (&capture(0.4, [0.0; 3], 1.0, None), Reflectance::Diffuse),
            (&capture(0.3, [0.04; 3], 0.35, None), Reflectance::Dielectric),
            (&capture(0.01, [0.9, 0.6, 0.3], 0.4, None), Reflectance::Isotropic),
            (&brushed, Reflectance::Anisotropic),
        ] {
            let choice = chosen(capture, &FitOptions::default());
            assert_eq!(choice.reflectance, expected, "{choice:?}");
            assert_eq!(choice.comparisons.len(), 4);
        }
        // What is asked for is taken, and two photos decide nothing.
        let asked = FitOptions::default().reflectance(Reflectance::Dielectric).refine(Refine::None);
        let choice = chosen(&brushed, &asked);
        assert!(choice.reflectance == Reflectance::Dielectric && choice.refine == Refine::None);
        assert!(choice.comparisons.is_empty());
        let two = brushed.select(&[0, 4]).unwrap();
        assert_eq!(chosen(&two, &FitOptions::default()).reflectance, Reflectance::Isotropic);
    }

    #[test]
    fn the_brushing_is_found() {
        let vector = [0.5f32, -0.9];
        let capture = capture(0.01, [0.9, 0.8, 0.7], 0.38, Some(vector));
        let options = FitOptions::default().reflectance(Reflectance::Anisotropic);
        let fit = |control: &mut Control<'_>| fit_direct(&capture, Relief::Flat, &options, &mut Vec::new(), control);
        let (DirectFit { maps, .. }, _) = Control::silently(CancelToken::new(), fit).unwrap();
        let angle = 0.5 * vector[1].atan2(vector[0]);
        let first = maps.lobe().tangent_plane();
        for p in 0..PIXELS {
            let along = maps.plane(first)[p] * angle.cos() + maps.plane(first + 1)[p] * angle.sin();
            assert!(along.abs() > 5f32.to_radians().cos(), "{along}");
        }
        let ratio = maps.plane(7)[0] / maps.plane(6)[0];
        let expected = vector[0].hypot(vector[1]).exp();
        assert!((ratio / expected - 1.0).abs() < 0.25, "{ratio} {expected}");
    }

    #[test]
    fn near_ones_are_tried_with_all_steps() {
        let of = |mut comparisons: Vec<Comparison>, first, errors: [f64; 2]| {
            let mut tried = Vec::new();
            let mut full = |reflectance| {
                tried.push(reflectance);
                Ok(errors[tried.len() - 1])
            };
            let chosen = verified(first, &mut comparisons, &mut full).unwrap();
            (chosen, tried)
        };
        let chosen = |first, errors| of(comparisons([0.2, 0.05, 0.052, 0.05]), first, errors);
        let pair = vec![Reflectance::Dielectric, Reflectance::Isotropic];
        assert_eq!(chosen(Reflectance::Dielectric, [0.04, 0.039]), (Reflectance::Isotropic, pair.clone()));
        assert_eq!(chosen(Reflectance::Dielectric, [0.04, 0.0399]), (Reflectance::Dielectric, pair));
        // Two roughnesses have to be better with few steps already.
        assert_eq!(chosen(Reflectance::Isotropic, [0.0; 2]), (Reflectance::Isotropic, vec![]));
        let lobes = vec![Reflectance::Isotropic, Reflectance::Anisotropic];
        assert_eq!(chosen(Reflectance::Anisotropic, [0.04, 0.036]), (Reflectance::Isotropic, lobes.clone()));
        assert_eq!(chosen(Reflectance::Anisotropic, [0.04, 0.034]), (Reflectance::Anisotropic, lobes));
        let much_better = comparisons([0.2, 0.05, 0.052, 0.03]);
        assert_eq!(of(much_better, Reflectance::Anisotropic, [0.0; 2]), (Reflectance::Anisotropic, vec![]));
        assert_eq!(chosen(Reflectance::Diffuse, [0.04, 0.03]).0, Reflectance::Dielectric);
    }

    #[test]
    fn ties_are_for_the_simpler_one() {
        let chosen = |errors| simplest(&comparisons(errors));
        assert_eq!(chosen([0.05; 4]), Reflectance::Diffuse);
        assert_eq!(chosen([0.05, 0.04, 0.04, 0.04]), Reflectance::Dielectric);
        assert_eq!(chosen([0.05, 0.045, 0.04, 0.039]), Reflectance::Isotropic);
        assert_eq!(chosen([0.05, 0.045, 0.04, 0.02]), Reflectance::Anisotropic);
        assert_eq!(chosen([0.003, 0.002, 0.002, 0.001]), Reflectance::Dielectric);
        // A richer one may be worse.
        assert_eq!(chosen([0.05, 0.04, 0.06, 0.06]), Reflectance::Dielectric);
    }
}
