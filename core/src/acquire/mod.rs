//! From raw photos to a capture: a printed sheet of tags around the sample tells where cameras stood and how bright the light was. Where there is no sheet, the corners of the
//! sample's patch in each photo tell where cameras stood.
//!
//! Every photo goes through `tags` (where the sheet's tags are), all of one lens through `camera` (the lens, and where it stood), every photo through `rectify` (the patch as it looks from
//! straight above) and all of one lens through `light` (how bright the light was, from the paper).

#[cfg(feature = "acquire")]
mod assumptions;
#[cfg(feature = "acquire")]
mod camera;
#[cfg(feature = "acquire")]
mod contact_sheet;
mod corners;
#[cfg(feature = "acquire")]
mod geometry;
#[cfg(feature = "acquire")]
mod light;
#[cfg(feature = "acquire")]
mod missing;
#[cfg(feature = "acquire")]
mod papers;
#[cfg(feature = "acquire")]
mod pipeline;
mod print;
#[cfg(feature = "acquire")]
mod rectify;
mod report;
mod save;
mod sheet;
#[cfg(feature = "acquire")]
mod tags;

use std::path::PathBuf;
use std::sync::Arc;

pub use corners::Corners;
pub use print::Paper;
pub use report::{LeftOut, LensReport, Missing, PhotoReport, Report};
#[cfg(feature = "cli")]
pub(crate) use save::check_folder;
pub use sheet::{Sheet, Tag};

use crate::cancel::CancelToken;
use crate::capture::{Capture, MAX_PHOTOS};
use crate::error::{Error, Result};
use crate::image::Image;
use crate::progress::ProgressFn;

/// What tells where photos were taken from.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Reference {
    /// A printed sheet that lies around the sample.
    Sheet(Sheet),
    /// The corners of the sample's patch in every photo.
    Corners(Corners),
}

impl Reference {
    /// Width of the square that is captured, in millimetres.
    pub(crate) fn patch(&self) -> f64 {
        match self {
            Self::Sheet(sheet) => sheet.patch,
            Self::Corners(corners) => corners.width(),
        }
    }

    /// The tags around it.
    fn tags(&self) -> &[Tag] {
        match self {
            Self::Sheet(sheet) => &sheet.tags,
            Self::Corners(_) => &[],
        }
    }

    /// Half the width of all that is known of.
    fn half_width(&self) -> f64 {
        match self {
            Self::Sheet(sheet) => sheet.half_width(),
            Self::Corners(corners) => corners.width() / 2.0,
        }
    }
}

/// How photos are made a capture.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct AcquireOptions {
    /// What tells where photos were taken from.
    pub reference: Reference,
    /// How far the sample lies below the sheet's face, in millimetres; 0 where corners are given, which are the sample's own.
    pub depth: f64,
    /// Side of the rectified photos in pixels; 1024 if `None`. They are never finer than the photos.
    pub size: Option<usize>,
    /// Where the flash is, seen from the lens: to the right and up in the photo as the camera took it, before it was turned upright; in millimetres. `None`: it is found from the paper.
    pub light_offset: Option<[f64; 2]>,
    /// A photo of the sheet without flash, exposed as the others: what it shows is subtracted.
    pub dark: Option<PathBuf>,
    /// Diffuse albedo of the sheet's paper.
    pub paper_white: f64,
    /// Most bytes the work may use; three quarters of the free memory if `None`.
    pub max_memory: Option<u64>,
    /// Stops the work from another thread.
    pub cancel: CancelToken,
}

impl AcquireOptions {
    /// The sample at the face of `sheet`, the flash at the lens, paper of diffuse albedo 0.8.
    pub fn new(sheet: Sheet) -> Self {
        Self::of(Reference::Sheet(sheet))
    }

    /// A patch whose corners are known in every photo, the flash at the lens.
    pub fn of_corners(corners: Corners) -> Self {
        Self::of(Reference::Corners(corners))
    }

    fn of(reference: Reference) -> Self {
        let (size, max_memory, cancel) = (None, None, CancelToken::new());
        let (light_offset, dark) = (Some([0.0; 2]), None);
        Self { reference, depth: 0.0, size, light_offset, dark, paper_white: 0.8, max_memory, cancel }
    }

    fn check(&self, photos: usize) -> Result<()> {
        let [right, up] = self.light_offset.unwrap_or_default();
        if ![self.depth, right, up].iter().all(|value| value.abs() < 1e4) {
            let reason = format!("expected lengths below 10 m, got {} and {:?}", self.depth, [right, up]);
            return Err(Error::invalid("depth, light_offset", reason));
        }
        if !(self.paper_white > 0.0 && self.paper_white <= 1.0) {
            let reason = format!("expected an albedo above 0 and at most 1, got {}", self.paper_white);
            return Err(Error::invalid("paper_white", reason));
        }
        if let Some(size) = self.size.filter(|size| !(16..=16384).contains(size)) {
            return Err(Error::invalid("size", format!("expected 16 to 16384 pixels, got {size}")));
        }
        if photos == 0 || photos > MAX_PHOTOS {
            return Err(Error::invalid("photos", format!("expected 1 to {MAX_PHOTOS}, got {photos}")));
        }
        match &self.reference {
            Reference::Sheet(_) => Ok(()),
            Reference::Corners(corners) => corners.check(photos, self),
        }
    }
}

/// A capture made of raw photos, and how it came about.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Acquisition {
    /// The rectified photos with their positions, in millimetres.
    pub capture: Arc<Capture>,
    /// What was found in every photo.
    pub report: Report,
    /// A picture of it, in values for the screen: the photos with tags and sample drawn in, the rectified patches, where cameras stood, what is missing.
    pub contact_sheet: Image,
}

/// Makes a capture of photos that show the sample in the window of a printed sheet ([`Sheet`]), or of which the patch's corners are known ([`Corners`]).
///
/// Photos that cannot be used are left out, and named in the report with the reason. `progress` is called on the calling thread some twenty times a second and at the
/// end, of a stage [`Stage::Acquire`](crate::progress::Stage::Acquire) with two steps for each photo.
///
/// # Errors
/// [`Error::InvalidArgument`] for options out of range, if no photo can be used, and in a build without the feature `acquire`; [`Error::Io`] and [`Error::UnsupportedFormat`] for files that cannot be read;
/// [`Error::OutOfMemory`]; [`Error::Cancelled`].
///
/// # Example
/// ```no_run
/// use std::ops::ControlFlow;
///
/// use svbrdf_gcn::acquire::{AcquireOptions, Sheet, acquire};
///
/// let photos: Vec<std::path::PathBuf> = vec!["1.jpg".into(), "2.jpg".into(), "3.jpg".into()];
/// let options = AcquireOptions::new(Sheet::new(100.0)?);
/// let acquisition = acquire(&photos, &options, &mut |progress| {
///     println!("{} of {}", progress.step, progress.steps);
///     ControlFlow::Continue(())
/// })?;
/// acquisition.save("leather")?;
/// # Ok::<(), svbrdf_gcn::Error>(())
/// ```
pub fn acquire(photos: &[PathBuf], options: &AcquireOptions, progress: &mut ProgressFn<'_>) -> Result<Acquisition> {
    options.check(photos.len())?;
    #[cfg(feature = "acquire")]
    return pipeline::acquire(photos, options, progress);
    #[cfg(not(feature = "acquire"))]
    {
        let _ = progress;
        let reason =
            "this build has no raw photos: build the crate svbrdf-gcn with its feature acquire, got a build without";
        Err(Error::invalid("acquire", reason))
    }
}

/// The middle one of `values`, the upper one of two; `None` where there are none.
#[cfg(feature = "acquire")]
fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}
