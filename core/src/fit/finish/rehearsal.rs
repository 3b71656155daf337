//! Maps that have not seen one photo, on some pixels: by predicting that photo from them the finish chooses how to weight what it knows.

use crate::capture::Capture;
use crate::fit::anisotropy;
use crate::fit::direct::{DirectFit, Folds, light};
use crate::fit::optim::holdout::{LEFT_OUT, REHEARSAL_SIDE, grid, left_out, thinned_planes};
use crate::raw::{RAW, encode};
use crate::shot::Shot;

/// On some pixels, the maps so far as they are where one photo is left out: they decide what is believed how much.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rehearsal {
    /// Columns and rows of the grid of `pixels`.
    pub size: [usize; 2],
    /// Which pixels of the capture.
    pub pixels: Vec<usize>,
    /// One for each photo left out.
    pub folds: Vec<Fold>,
}

/// Maps that have not seen one photo.
#[derive(Clone, Debug)]
pub(crate) struct Fold {
    /// The photo.
    pub without: usize,
    /// Nine planes of raw values of the pixels.
    pub raw: Vec<f32>,
    /// Their anisotropy; none where lobes are round.
    pub anisotropy: Vec<[f32; 2]>,
    /// How all photos are taken to be lit.
    pub shots: Vec<Shot>,
}

impl Rehearsal {
    /// The maps that `direct` finds where a photo is left out.
    pub fn of_direct(folds: Folds, floor: f32) -> Self {
        let Folds { thinned, pixels, folds } = folds;
        let fold = |(without, direct): (usize, DirectFit)| {
            let mut raw = vec![0.0; RAW * pixels.len()];
            let (round, anisotropy) = anisotropy::split(&direct.maps);
            encode(&round, floor, &mut raw);
            Fold { without, raw, anisotropy, shots: direct.shots }
        };
        let folds = folds.into_iter().map(fold).collect();
        Self { size: [thinned.width(), thinned.height()], pixels, folds }
    }

    /// The prediction, which hardly changes where a photo is left out.
    pub fn of_prediction(capture: &Capture, prediction: &[f32]) -> Self {
        let (size, pixels) = grid(capture.width(), capture.height(), REHEARSAL_SIDE);
        let raw = thinned_planes(prediction, RAW, &pixels);
        let shots = light::stated(capture);
        let fold = |without| Fold { without, raw: raw.clone(), anisotropy: Vec::new(), shots: shots.clone() };
        Self { size, folds: left_out(capture.len(), LEFT_OUT).map(fold).collect(), pixels }
    }
}
