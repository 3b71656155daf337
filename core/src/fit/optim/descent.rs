//! The loop both stages of the network fit share: Adam steps, the best state kept, a flat loss noticed, a broken step undone.

use std::collections::VecDeque;

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::fit::optim::adam::Adam;
use crate::progress::{Control, Stage};

/// Parameters that one thread looks at, at a time.
const PART: usize = 1 << 15;
/// Factor on the learning rate after a step that led to a value that is not finite.
const BACK_OFF: f64 = 0.5;
/// Broken steps after which a descent ends with the best state it has.
const MAX_ROLLBACKS: usize = 12;

/// When a loss counts as flat: the best loss fell by less than `tolerance` times itself over the last `window` steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EarlyStop {
    /// Steps looked back, at least 1.
    pub window: usize,
    /// Relative fall of the best loss over the window that is still worth going on for.
    pub tolerance: f64,
}

impl Default for EarlyStop {
    /// A thousandth over a hundred steps.
    fn default() -> Self {
        Self { window: 100, tolerance: 1e-3 }
    }
}

/// How to descend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// The stage reported with every step.
    pub stage: Stage,
    /// Adam steps at most.
    pub steps: usize,
    /// Adam's learning rate at the start.
    pub learning_rate: f64,
    /// Share of it left at the last step, reached along half a cosine; 1 keeps it constant.
    pub final_rate: f64,
    /// When to stop before `steps`; never if `None`.
    pub early_stop: Option<EarlyStop>,
    /// Steps of the stage before this descent and after it, for the progress.
    pub around: [usize; 2],
}

/// What a descent did.
#[derive(Clone, Debug, PartialEq)]
pub struct Descent {
    /// Steps taken.
    pub steps: usize,
    /// The loss before the first step.
    pub first_loss: f64,
    /// The loss after the last step; NaN if it was not finite.
    pub last_loss: f64,
    /// The loss of the state returned, the least there was.
    pub best_loss: f64,
    /// Steps taken to reach that state.
    pub best_step: usize,
    /// How often a loss or gradient was not finite and the state went back to the best one, with half the learning rate.
    pub rollbacks: usize,
    /// Whether the loss was flat before all steps were taken.
    pub stopped_early: bool,
}

/// Minimises `evaluate` over `params` by Adam and leaves the best state seen in `params`.
///
/// `evaluate(params, gradient, control)` returns the loss and, if asked, fills all of `gradient` (as long as `params`);
/// it should poll `control` if it takes longer than some 100 ms. The state after the last step is evaluated too, without gradient.
/// When loss or gradient are not finite the state goes back to the best one, Adam starts afresh and the learning rate is halved;
/// after 12 times the descent ends with the best state.
///
/// # Errors
/// [`Error::NonFinite`] if the very first loss or gradient is not finite; [`Error::Cancelled`], with the best state in `params`;
/// whatever `evaluate` returns.
pub fn descend(
    params: &mut [f32],
    settings: &Settings,
    control: &mut Control<'_>,
    mut evaluate: impl FnMut(&[f32], Option<&mut [f32]>, &mut Control<'_>) -> Result<f64>,
) -> Result<Descent> {
    let mut best = params.to_vec();
    let result = run(params, &mut best, settings, control, &mut evaluate);
    params.copy_from_slice(&best);
    result
}

fn run(
    params: &mut [f32],
    best: &mut [f32],
    settings: &Settings,
    control: &mut Control<'_>,
    evaluate: &mut impl FnMut(&[f32], Option<&mut [f32]>, &mut Control<'_>) -> Result<f64>,
) -> Result<Descent> {
    let &Settings { stage, steps, mut learning_rate, final_rate, early_stop, around: [before, after] } = settings;
    let whole = before + steps + after;
    let mut adam = Adam::new(params.len());
    let mut gradient = vec![0.0; params.len()];
    let mut descent = Descent {
        steps: 0,
        first_loss: f64::NAN,
        last_loss: f64::NAN,
        best_loss: f64::INFINITY,
        best_step: 0,
        rollbacks: 0,
        stopped_early: false,
    };
    // The best loss after each of the last evaluations, to look back over the window of the early stop.
    let mut best_losses = VecDeque::new();
    // A descent that goes on with a stage has nothing to report yet.
    if before == 0 {
        control.report(stage, 0, whole, None)?;
    }
    for step in 0..=steps {
        let last = step == steps;
        let loss = evaluate(params, (!last).then_some(&mut gradient[..]), control)?;
        let finite = loss.is_finite() && (last || gradient.par_chunks(PART).all(all_finite));
        descent.steps = step;
        descent.last_loss = if loss.is_finite() { loss } else { f64::NAN };
        if step == 0 {
            descent.first_loss = descent.last_loss;
        }
        if finite {
            if loss < descent.best_loss {
                descent.best_loss = loss;
                descent.best_step = step;
                best.par_chunks_mut(PART)
                    .zip(params.par_chunks(PART))
                    .for_each(|(best, now)| best.copy_from_slice(now));
            }
        } else if descent.best_loss == f64::INFINITY {
            return Err(Error::NonFinite { stage: stage.name().to_owned(), iteration: step });
        } else {
            descent.rollbacks += 1;
        }
        if last || descent.rollbacks > MAX_ROLLBACKS {
            break;
        }
        if let Some(EarlyStop { window, tolerance }) = early_stop {
            let before = if best_losses.len() < window.max(1) { None } else { best_losses.pop_front() };
            best_losses.push_back(descent.best_loss);
            if before.is_some_and(|before: f64| before - descent.best_loss <= tolerance * before.abs()) {
                descent.stopped_early = true;
                break;
            }
        }
        if finite {
            adam.step(params, &gradient, learning_rate * rate_left(step, steps, final_rate));
        } else {
            // The next evaluation is of the best state again: its gradient is needed for the smaller step.
            params.copy_from_slice(best);
            adam.reset();
            learning_rate *= BACK_OFF;
        }
        control.report(stage, before + step + 1, whole, Some(loss))?;
    }
    Ok(descent)
}

/// Whether all `values` are numbers: none is as large as infinity. Without a branch, so that many are looked at together.
fn all_finite(values: &[f32]) -> bool {
    let largest = values.iter().fold(0, |largest, value| value.abs().to_bits().max(largest));
    largest < f32::INFINITY.to_bits()
}

/// Share of the learning rate at `step` of `steps`.
fn rate_left(step: usize, steps: usize, final_rate: f64) -> f64 {
    let cosine = (std::f64::consts::PI * step as f64 / steps as f64).cos();
    final_rate + (1.0 - final_rate) * (1.0 + cosine) / 2.0
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::{EarlyStop, Settings, descend};
    use crate::error::{Error, Result};
    use crate::progress::{CancelToken, Control, Progress, Stage};

    const SETTINGS: Settings = Settings {
        stage: Stage::Adapters,
        steps: 400,
        learning_rate: 0.05,
        final_rate: 1.0,
        early_stop: None,
        around: [0; 2],
    };

    /// A bowl around (1, -2) with bottom value `floor`.
    fn bowl(floor: f64) -> impl FnMut(&[f32], Option<&mut [f32]>, &mut Control<'_>) -> Result<f64> {
        move |x, gradient, _| {
            let (a, b) = (x[0] - 1.0, x[1] + 2.0);
            if let Some(gradient) = gradient {
                gradient.copy_from_slice(&[2.0 * a, 20.0 * b]);
            }
            Ok(floor + f64::from(a * a + 10.0 * b * b))
        }
    }

    fn go_on(_: &Progress) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    #[test]
    fn reaches_the_bottom_and_returns_the_best_state() {
        let mut x = [0.0f32, 0.0];
        let mut callback = go_on;
        let mut control = Control::new(&mut callback, CancelToken::new());
        let descent = descend(&mut x, &SETTINGS, &mut control, bowl(0.0)).unwrap();
        assert_eq!((descent.steps, descent.first_loss), (400, 41.0));
        assert!(descent.best_loss < 1e-3, "{}", descent.best_loss);
        assert!(descent.best_loss <= descent.last_loss && descent.best_step <= 400, "{descent:?}");
        assert_eq!(bowl(0.0)(&x, None, &mut control).unwrap(), descent.best_loss);
    }

    #[test]
    fn a_falling_rate_settles() {
        // A kink at 1: steps of constant length go on jumping over it.
        let end = |final_rate| {
            let mut losses = Vec::new();
            let mut callback = |progress: &Progress| {
                losses.extend(progress.loss);
                ControlFlow::Continue(())
            };
            let mut control = Control::new(&mut callback, CancelToken::new());
            let settings = Settings { final_rate, ..SETTINGS };
            let kink = |x: &[f32], gradient: Option<&mut [f32]>, _: &mut Control<'_>| {
                gradient.into_iter().for_each(|gradient| gradient[0] = (x[0] - 1.0).signum());
                Ok(f64::from((x[0] - 1.0).abs()))
            };
            descend(&mut [0.0], &settings, &mut control, kink).unwrap();
            losses[380..].iter().sum::<f64>() / 20.0
        };
        assert!(end(0.01) < 0.3 * end(1.0), "{} {}", end(0.01), end(1.0));
    }

    #[test]
    fn stops_when_flat_and_not_before() {
        let early_stop = Some(EarlyStop { window: 20, tolerance: 1e-3 });
        let settings = Settings { steps: 5000, early_stop, ..SETTINGS };
        let mut callback = go_on;
        let mut control = Control::new(&mut callback, CancelToken::new());
        let descent = descend(&mut [0.0, 0.0], &settings, &mut control, bowl(1.0)).unwrap();
        assert!(descent.stopped_early && descent.steps < 1000, "{}", descent.steps);
        assert!(descent.best_loss < 1.01, "{}", descent.best_loss);
    }

    #[test]
    fn a_broken_step_goes_back_with_a_smaller_one() {
        // Anything left of 0.5 is fine, beyond it the loss is NaN: the descent has to creep up to the wall.
        let mut x = [0.0f32];
        let mut callback = go_on;
        let mut control = Control::new(&mut callback, CancelToken::new());
        let settings = Settings { steps: 300, learning_rate: 0.4, ..SETTINGS };
        let descent = descend(&mut x, &settings, &mut control, |x, gradient, _| {
            if let Some(gradient) = gradient {
                gradient[0] = -1.0;
            }
            Ok(if x[0] > 0.5 { f64::NAN } else { f64::from(1.0 - x[0]) })
        })
        .unwrap();
        assert!(descent.rollbacks > 3, "{}", descent.rollbacks);
        assert!(x[0] > 0.45 && x[0] <= 0.5, "{}", x[0]);
    }

    #[test]
    fn a_first_value_that_is_not_finite_is_an_error() {
        let mut callback = go_on;
        let mut control = Control::new(&mut callback, CancelToken::new());
        for (loss, slope) in [(f64::NAN, 0.0), (1.0, f32::INFINITY)] {
            let result = descend(&mut [0.0], &SETTINGS, &mut control, |_, gradient, _| {
                gradient.into_iter().for_each(|gradient| gradient.fill(slope));
                Ok(loss)
            });
            assert!(matches!(result, Err(Error::NonFinite { iteration: 0, .. })), "{result:?}");
        }
    }

    #[test]
    fn cancelling_leaves_the_best_state_and_reports_every_step() {
        let mut seen = Vec::new();
        let mut callback = |progress: &Progress| {
            seen.push(progress.step);
            if progress.step == 10 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let mut x = [0.0f32, 0.0];
        let mut control = Control::new(&mut callback, CancelToken::new());
        let result = descend(&mut x, &SETTINGS, &mut control, bowl(0.0));
        assert!(matches!(result, Err(Error::Cancelled)));
        assert!(x[0] > 0.1 && x[1] < -0.1, "{x:?}");
        assert_eq!(seen, (0..=10).collect::<Vec<_>>());
    }
}
