//! The fit without one photo, for each of some: maps that can be judged on that photo.

use super::{DirectFit, Problem, light};
use crate::capture::Capture;
use crate::error::Result;
use crate::fit::optim::holdout::{REHEARSAL_SIDE, left_out, thinned, thinned_planes};
use crate::fit::options::{FitOptions, Refine};
use crate::fit::verdict::Expected;
use crate::image::Image;
use crate::metrics::{photo_rmse, photo_rmse_smooth_gain};
use crate::progress::Control;
use crate::render::{photo_loss, render_maps};

/// The largest specular albedo of dielectrics: that of gems is a little less.
const DIELECTRIC_MAX: f32 = 0.15;

/// What [`fit_direct`](super::fit_direct) finds on some pixels where one photo is left out.
pub(crate) struct Folds {
    /// All photos on a regular grid of pixels, and which pixels of the capture these are.
    pub thinned: Capture,
    pub pixels: Vec<usize>,
    /// The photo left out, and what was found; its light is that with which the maps predict it best.
    pub folds: Vec<(usize, DirectFit)>,
}

impl Folds {
    /// Share of pixels whose specular albedo, its mean over the channels, is above that of dielectrics: the mean over folds.
    pub fn metallic_share(&self) -> f64 {
        let share = |(_, direct): &(usize, DirectFit)| {
            let first = direct.maps.lobe().specular_plane();
            let [r, g, b] = [0, 1, 2].map(|c| direct.maps.plane(first + c));
            let metallic = (0..r.len()).filter(|&p| r[p] + g[p] + b[p] > 3.0 * DIELECTRIC_MAX);
            metallic.count() as f64 / r.len() as f64
        };
        self.folds.iter().map(share).sum::<f64>() / self.folds.len().max(1) as f64
    }

    /// Root mean square of the errors (gamma 2.2 codes) of the photos left out, each under the light that suits it best.
    pub fn error(&self) -> Result<f64> {
        let mut sum = 0.0;
        for (without, direct) in &self.folds {
            let mut target = self.thinned.photos()[*without].target()?;
            let gain = light::held_out_gain(&self.thinned, *without, &direct.maps)?;
            target.set_shot(light::lit(target.shot(), gain));
            sum += photo_loss(&direct.maps, self.thinned.patch_size(), &[target], None)? / 1000.0;
        }
        Ok((sum / self.folds.len().max(1) as f64).sqrt())
    }

    /// Expected errors of a new photo, from how the photos left out are missed under their stated light; `None` if there are none.
    pub fn expected(&self) -> Result<Option<Expected>> {
        let mut errors = Vec::new();
        for (without, direct) in &self.folds {
            let photo = &self.thinned.photos()[*without];
            let (width, height) = (self.thinned.width(), self.thinned.height());
            let planes = render_maps(&direct.maps, self.thinned.patch_size(), &photo.shot)?;
            let rendering = Image::from_planar(width, height, 3, &planes)?;
            errors.push([photo_rmse(&rendering, &photo.image)?, photo_rmse_smooth_gain(&rendering, &photo.image)?]);
        }
        Ok(Expected::of(&errors))
    }
}

/// The relief of each fold.
#[derive(Clone, Copy)]
pub(crate) enum FoldRelief<'a> {
    Flat,
    /// The same for all, of the whole capture.
    Common(&'a [f32]),
    /// One each, on the fold's pixels.
    Each(&'a [Vec<f32>]),
}

/// [`fit_direct`](super::fit_direct) without one photo, for each of some photos, on a part of the pixels: maps that can be judged on that photo. `relief` as it was chosen
/// for all photos. `photo_deviation`: what photos are taken to miss, so that fits of different reflectances compare.
///
/// # Errors
/// As [`fit_direct`](super::fit_direct).
pub(crate) fn fit_folds(
    capture: &Capture,
    relief: FoldRelief<'_>,
    photo_deviation: Option<f64>,
    most: usize,
    options: &FitOptions,
    control: &mut Control<'_>,
) -> Result<Folds> {
    let (thin, pixels) = thinned(capture, REHEARSAL_SIDE)?;
    let common = match relief {
        FoldRelief::Common(relief) => Some(thinned_planes(relief, 2, &pixels)),
        FoldRelief::Flat | FoldRelief::Each(_) => None,
    };
    // A single photo cannot be left out.
    let count = if capture.len() > 1 { capture.len() } else { 0 };
    let left_out: Vec<(usize, usize)> = left_out(count, most).enumerate().collect();
    let folds = control.each(&left_out, |&(fold, without), control| {
        let rest: Vec<usize> = (0..capture.len()).filter(|&photo| photo != without).collect();
        let rest = thin.select(&rest)?;
        let relief = match relief {
            FoldRelief::Each(reliefs) => Some(reliefs[fold].clone()),
            FoldRelief::Flat | FoldRelief::Common(_) => common.clone(),
        };
        let mut problem = Problem::new(&rest, crate::fit::targets(&rest)?, relief, options)?;
        problem.prior.photo = photo_deviation.unwrap_or(problem.prior.photo);
        let (mut direct, _) = problem.fit_in_rounds(&rest, options, control)?;
        let gain = match options.refine {
            Refine::None => 1.0,
            Refine::Auto | Refine::Light | Refine::All => light::held_out_gain(&thin, without, &direct.maps)?,
        };
        direct.shots.insert(without, light::lit(&thin.photos()[without].shot, gain));
        Ok((without, direct))
    })?;
    Ok(Folds { thinned: thin, pixels, folds })
}
