//! The work of [`acquire`](super::acquire()): every photo is looked at, lenses and places are found together, every photo is rectified, and its light found.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

use rayon::prelude::*;

use super::camera::{Calibration, Lens, Place, Points, Precision, calibrate};
use super::contact_sheet::{self, Marks, Shown, Thumbnail, contact_sheet};
use super::light::{self, FallOff, Known, PLACES_MIN, Tone};
use super::papers::{Measured, measured, papers, turned, turned_back};
use super::rectify::{ToneTable, View, decoding, grey, pixels_across, rectified};
use super::report::{LeftOut, LensReport, PhotoReport, Report};
use super::sheet::Sheet;
use super::tags::{self, Detection, Found, Line, detect};
use super::{AcquireOptions, Acquisition, Reference, assumptions, median, missing, save};
use crate::cancel::CancelToken;
use crate::capture::{Acquired, AcquiredPhoto, Capture, Photo};
use crate::color::{Matrix, Transfer};
use crate::error::{Error, Result};
use crate::image::Image;
use crate::io::profile::Decoding;
use crate::io::{CameraData, Samples, Stored, demand, read_stored};
use crate::progress::{Progress, ProgressFn, Stage};
use crate::shot::Shot;
use crate::unit::Unit;
use crate::{memory, pool};

/// The fewest tags that tell where a photo was taken from.
const TAGS_MIN: usize = 4;
/// Progress is reported this often.
const REPORT_EVERY: Duration = Duration::from_millis(50);
/// Photos that are worked on at a time, at most.
const AT_A_TIME: usize = 4;
/// Bytes of a pixel of a rectified photo, and of its files before they are written.
const KEPT_BYTES: u64 = 3 * 4 + 1 + 3 * 2;
/// Bytes of a photo's pixel beside those stored: linear RGB and what is saturated, at most of all of them.
const WORK_BYTES: u64 = 3 * 4 + 1;
/// Rounds in which corners are measured anew where the lens bends no lines.
const ROUNDS: usize = 2;
/// A photo whose points are this many times as far off as those of the photos of its lens usually are, and farther than [`Precision::error_max`], is left out.
const ERROR_RATIO: f64 = 4.0;
/// Longer side of the rectified photos where nothing is asked for.
const SIZE: usize = 1024;
/// Blur in pixels of the rectified photo from which on it is worth a word.
const BLUR: f64 = 1.0;
/// Deviation of the paper from what position and light explain from which on it is worth a word, as a share.
const PAPER_ERROR: f64 = 0.05;
/// Likewise, from which on a photo is left out where the paper of the others is off by so much less as [`ERROR_RATIO`] says.
const PAPER_ERROR_MAX: f64 = 0.2;
/// Share of light that is not the flash's, and deviation of its colour from that of other photos, from which on they are worth a word.
const AMBIENT: f64 = 0.05;
const WHITE_BALANCE: f64 = 0.05;
/// Greys that photos show in the mean, at least, if they are to tell the tone curve.
const GREYS_MIN: usize = 3;

/// A photo in which the sheet was found, or whose corners are known.
pub(super) struct Sighting {
    /// Its place among the photos that were given.
    index: usize,
    path: PathBuf,
    size: [usize; 2],
    pub(super) camera: CameraData,
    tags: Vec<Found>,
    papers: Vec<Measured>,
    /// Whether its values are linear by themselves.
    is_linear: bool,
    to_rec709: Option<Matrix>,
    notes: Vec<String>,
}

/// A photo whose place is known.
pub(super) struct Placed {
    pub(super) sighting: Sighting,
    lens: usize,
    place: Place,
    error: f64,
}

/// [`acquire`](super::acquire()) under options that were checked.
pub fn acquire(photos: &[PathBuf], options: &AcquireOptions, progress: &mut ProgressFn<'_>) -> Result<Acquisition> {
    // What the callback stops is this run alone.
    let options = AcquireOptions { cancel: options.cancel.child(), ..options.clone() };
    let done = AtomicUsize::new(0);
    let steps = 2 * photos.len() + usize::from(options.dark.is_some());
    let mut report = |step: usize| {
        options.cancel.check()?;
        if progress(&Progress { stage: Stage::Acquire, step, steps, loss: None }) == ControlFlow::Break(()) {
            options.cancel.cancel();
        }
        options.cancel.check()
    };
    report(0)?;
    let acquisition = watched(|| of_photos(photos, &options, &done), || drop(report(done.load(Ordering::Relaxed))))?;
    report(steps)?;
    Ok(acquisition)
}

/// Runs `work` on threads of our own while this one looks at it, every [`REPORT_EVERY`].
fn watched<T: Send>(work: impl FnOnce() -> Result<T> + Send, mut look: impl FnMut()) -> Result<T> {
    let (sender, receiver) = sync_channel(1);
    pool::pool(None)?.in_place_scope(|scope| {
        scope.spawn(move |_| drop(sender.send(work())));
        loop {
            match receiver.recv_timeout(REPORT_EVERY) {
                Ok(result) => return result,
                Err(RecvTimeoutError::Timeout) => look(),
                // The work has panicked, and so does the scope.
                Err(RecvTimeoutError::Disconnected) => return Err(Error::Cancelled),
            }
        }
    })
}

/// [`acquire`], counting what is done: every photo twice.
fn of_photos(photos: &[PathBuf], options: &AcquireOptions, done: &AtomicUsize) -> Result<Acquisition> {
    let count = plan(photos, options)?;
    let mut left_out = Vec::new();
    let (mut sightings, mut thumbnails) = (Vec::new(), Vec::new());
    // The photo without flash is the last.
    let numbered: Vec<(usize, &PathBuf)> = photos.iter().chain(&options.dark).enumerate().collect();
    for (thumbnail, sighting) in at_a_time(&numbered, count, done, |&(index, path)| sighting(index, path, options))? {
        thumbnails.push(thumbnail);
        match sighting {
            Ok(sighting) => sightings.push(sighting),
            Err(photo) => left_out.push(photo),
        }
    }
    let (mut lenses, mut placed) = place(sightings, options, &mut left_out);
    let dark = match &options.dark {
        Some(path) => Some(without_flash(path, photos.len(), &mut placed, &left_out)?),
        None => None,
    };
    let mut light = lit(&mut lenses, &placed, dark.as_ref(), options);
    let size = output_size(&lenses, &placed, options);
    let dark = match &dark {
        Some(dark) => Some((dark, prepare(dark, &lenses, size, options)?)),
        None => None,
    };
    let prepared = at_a_time(&placed, count, done, |photo| prepare(photo, &lenses, size, options))?;
    let dark = dark.as_ref().map(|(photo, prepared)| (*photo, prepared));
    let assumptions = match &options.reference {
        Reference::Sheet(_) => Vec::new(),
        Reference::Corners(_) => assume_light(&mut light, &placed, &prepared, &lenses, options)?,
    };
    assemble(&placed, prepared, &light, dark, assumptions, lenses, size, options, left_out, thumbnails)
}

/// Light that no sheet tells, and what is assumed of the photos.
fn assume_light(
    light: &mut [Lit],
    placed: &[Placed],
    prepared: &[Prepared],
    lenses: &[LensReport],
    options: &AcquireOptions,
) -> Result<Vec<String>> {
    let (exposures, are_known) = assumptions::exposures(placed);
    let all = placed.iter().zip(prepared).zip(&exposures);
    let usable: Vec<_> = all
        .filter_map(|((photo, prepared), &exposure)| {
            let (image, saturated) = prepared.patch.as_ref().ok()?;
            let shot = shot(photo, &lenses[photo.lens], [1.0; 3], options);
            shot.misplaced().is_none().then_some((image, saturated.as_slice(), shot, exposure))
        })
        .collect();
    if !usable.is_empty() {
        let intensity = assumptions::intensity(&usable, options.reference.patch())?;
        light.iter_mut().zip(exposures).for_each(|(light, exposure)| light.intensity = [intensity * exposure; 3]);
    }
    Ok(assumptions::assumptions(lenses, are_known, options))
}

/// Where camera and flash stood, seen from the middle of the sample.
fn shot(photo: &Placed, lens: &LensReport, light_intensity: [f64; 3], options: &AcquireOptions) -> Shot {
    let up = |point: [f64; 3]| [point[0], point[1], point[2] + options.depth];
    let [right, above] = lens.light_offset;
    let flash = photo.place.in_sheet(turned([right, -above, 0.0], photo.sighting.camera.quarter_turns()));
    Shot { camera: up(photo.place.position()), light: up(flash), light_intensity }
}

/// Takes the photo without flash, which is number `index`, out of the others.
///
/// # Errors
/// [`Error::InvalidArgument`] if the sheet was not found in it.
fn without_flash(path: &Path, index: usize, placed: &mut Vec<Placed>, left_out: &[LeftOut]) -> Result<Placed> {
    if let Some(at) = placed.iter().position(|photo| photo.sighting.index == index) {
        return Ok(placed.remove(at));
    }
    let reason = left_out.iter().find(|out| out.index == index).map_or("cannot be used", |out| &out.reason);
    Err(Error::invalid("dark", format!("{}: {reason}", path.display())))
}

/// The share of a photo without flash that is in another: by their exposures, if both are known.
fn exposure_ratio(photo: &CameraData, dark: &CameraData) -> f64 {
    photo.exposure.zip(dark.exposure).map_or(1.0, |(photo, dark)| photo / dark)
}

/// The light of one photo.
#[derive(Clone, Copy, Debug, Default)]
struct Lit {
    intensity: [f64; 3],
    /// Only a sheet tells them.
    error: Option<f64>,
    ambient: Option<f64>,
}

/// Why a photo cannot be used whose paper is not lit as the flash would, while that of the others is.
fn other_light(light: &[Lit]) -> Vec<Option<String>> {
    let errors: Vec<(usize, f64)> = light.iter().enumerate().filter_map(|(i, light)| Some((i, light.error?))).collect();
    let usual = median(errors.iter().map(|&(_, error)| error)).unwrap_or_default();
    let mut reasons = vec![None; light.len()];
    for (i, error) in errors.into_iter().filter(|&(_, error)| error > PAPER_ERROR_MAX && error > ERROR_RATIO * usual) {
        reasons[i] = Some(format!(
            "its paper is off by {:.0} % from what a flash explains, that of other photos by {:.0} %: the flash did not fire, or other light is stronger",
            100.0 * error,
            100.0 * usual
        ));
    }
    reasons
}

/// The light of every photo, and what its lens and the camera do to it, as the sheet's paper tells.
fn lit(lenses: &mut [LensReport], placed: &[Placed], dark: Option<&Placed>, options: &AcquireOptions) -> Vec<Lit> {
    let mut light = vec![Lit::default(); placed.len()];
    for (index, lens) in lenses.iter_mut().enumerate() {
        let own: Vec<usize> = (0..placed.len()).filter(|&i| placed[i].lens == index).collect();
        lens.light_offset = options.light_offset.unwrap_or_default();
        if own.is_empty() || matches!(options.reference, Reference::Corners(_)) {
            continue;
        }
        let papers = |i: &usize| {
            let Placed { sighting, place, .. } = &placed[*i];
            let dark = dark.map(|dark| {
                let ratio = exposure_ratio(&sighting.camera, &dark.sighting.camera);
                (dark.sighting.papers.as_slice(), ratio)
            });
            papers(&sighting.papers, dark, place, sighting.camera.quarter_turns())
        };
        let papers: Vec<Vec<light::Paper>> = own.iter().map(papers).collect();
        let greys = papers.iter().flatten().filter(|paper| paper.grey.is_some()).count();
        let is_linear = own.iter().any(|&i| placed[i].sighting.is_linear);
        let known = Known {
            white: options.paper_white,
            offset: options.light_offset,
            // Without greys nothing tells a curve from a fall-off.
            is_srgb: is_linear || greys < GREYS_MIN * papers.len(),
        };
        let found = light::estimate(&papers, known);
        (lens.tone, lens.fall_off, lens.flash_fall_off) = (found.tone.0, found.fall_off.lens, found.fall_off.flash);
        lens.light_offset = found.offset;
        for (k, &i) in own.iter().enumerate() {
            let intensity = match &placed[i].sighting.to_rec709 {
                Some(matrix) => matrix.map(|row| (0..3).map(|c| row[c] * found.intensities[k][c]).sum()),
                None => found.intensities[k],
            };
            light[i] = Lit { intensity, error: Some(found.errors[k]), ambient: Some(found.ambient[k]) };
        }
    }
    light
}

/// How many photos are worked on at a time within the budget.
///
/// # Errors
/// [`Error::OutOfMemory`] if there is not the memory for one.
fn plan(photos: &[PathBuf], options: &AcquireOptions) -> Result<usize> {
    let side = options.size.unwrap_or(SIZE) as u64;
    let shown = photos.len().min(contact_sheet::SHOWN) as u64;
    let kept = KEPT_BYTES * side * side * photos.len() as u64 + 2 * contact_sheet::SHOWN_BYTES * shown;
    // Of what is no photo the reading says what is wrong.
    let demands = photos.iter().chain(&options.dark).filter_map(|path| demand(path, &options.cancel).ok());
    let one =
        demands.map(|demand| demand.decoding.max(demand.stored + WORK_BYTES * (demand.size.0 * demand.size.1) as u64));
    let one = one.max().unwrap_or(0) + tags::SEARCH_MEMORY;
    let allowed = memory::allowed(options.max_memory, 0);
    let needed = |count: usize| kept.saturating_add(one.saturating_mul(count as u64));
    memory::check(&format!("acquiring {} photos", photos.len()), needed(1), allowed)?;
    Ok((1..=AT_A_TIME).rev().find(|&count| needed(count) <= allowed).unwrap_or(1))
}

/// `work` on `count` of the items at a time, counted in `done`; in their order.
fn at_a_time<'a, T: Sync, U: Send>(
    items: &'a [T],
    count: usize,
    done: &AtomicUsize,
    work: impl Fn(&'a T) -> Result<U> + Sync,
) -> Result<Vec<U>> {
    let mut all = Vec::with_capacity(items.len());
    for some in items.chunks(count) {
        let made: Vec<Result<U>> = some
            .par_iter()
            .map(|item| {
                let made = work(item);
                done.fetch_add(1, Ordering::Relaxed);
                made
            })
            .collect();
        for item in made {
            all.push(item?);
        }
    }
    Ok(all)
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// A photo made small, if it is to be shown, and what was found in it.
type Look = (Option<Thumbnail>, std::result::Result<Sighting, LeftOut>);

/// Looks for what tells where a photo was taken from.
fn sighting(index: usize, path: &Path, options: &AcquireOptions) -> Result<Look> {
    let name = name_of(path);
    let stored = read_stored(path, &options.cancel)?;
    let (decoding, note) = decoding(&name, &stored)?;
    let thumbnail = (index < contact_sheet::SHOWN).then(|| Thumbnail::new(&stored, &decoding)).transpose()?;
    let on_sheet = match &options.reference {
        Reference::Sheet(sheet) => match on_sheet(&stored, &decoding, sheet, &options.cancel)? {
            Ok(found) => found,
            Err(reason) => return Ok((thumbnail, Err(LeftOut { photo: name, reason, index }))),
        },
        Reference::Corners(_) => OnSheet::default(),
    };
    let OnSheet { tags, papers, notes } = on_sheet;
    let mut notes: Vec<String> = stored.notes.iter().cloned().chain(note).chain(notes).collect();
    if stored.camera.flash_fired == Some(false) {
        notes.push("its EXIF data say that the flash did not fire".to_owned());
    }
    let size = [stored.width, stored.height];
    let is_linear = matches!(stored.pixels().samples, Samples::F32(_));
    let (path, camera, to_rec709) = (path.to_owned(), stored.camera, decoding.to_rec709);
    let sighting = Sighting { index, path, size, camera, tags, papers, is_linear, to_rec709, notes };
    Ok((thumbnail, Ok(sighting)))
}

/// What a photo shows of a sheet.
#[derive(Default)]
struct OnSheet {
    tags: Vec<Found>,
    papers: Vec<Measured>,
    notes: Vec<String>,
}

/// Looks for the sheet in a photo; why it cannot be used if it is not there as it should be.
fn on_sheet(
    stored: &Stored,
    decoding: &Decoding,
    sheet: &Sheet,
    cancel: &CancelToken,
) -> Result<std::result::Result<OnSheet, String>> {
    let Detection { tags, doubled, mirrored } = detect(&grey(stored, decoding, cancel)?, sheet, cancel)?;
    let all = sheet.tags.len();
    if tags.len() < TAGS_MIN {
        return Ok(Err(if mirrored > tags.len() {
            "shows the sheet as a mirror does: take it with the main camera, or flip it back".to_owned()
        } else if doubled.len() >= TAGS_MIN {
            format!("shows {} tags more than once: one sheet in each photo", doubled.len())
        } else {
            format!(
                "{} of the sheet's {all} tags were found, {TAGS_MIN} are needed: show the whole sheet, in focus",
                tags.len()
            )
        }));
    }
    let mut notes = Vec::new();
    if !doubled.is_empty() {
        notes.push(format!("tags {doubled:?} are there more than once and were not used"));
    }
    let papers = measured(stored, decoding, sheet, &tags, cancel)?;
    let white = papers.iter().filter(|paper| paper.grey.is_none()).count();
    if white < PLACES_MIN {
        return Ok(Err(format!(
            "the paper is overexposed or black but in {white} of {all} places, {PLACES_MIN} are needed: expose it right, the flash on"
        )));
    }
    Ok(Ok(OnSheet { tags, papers, notes }))
}

/// The lenses that photos were taken with, and where each stood. Photos that do not agree with the others of their lens are left out.
fn place(
    sightings: Vec<Sighting>,
    options: &AcquireOptions,
    left_out: &mut Vec<LeftOut>,
) -> (Vec<LensReport>, Vec<Placed>) {
    let mut groups: Vec<Vec<Sighting>> = Vec::new();
    for sighting in sightings {
        let same = |group: &&mut Vec<Sighting>| {
            let [width, height] = group[0].size;
            let turned = sighting.size == [width, height] || sighting.size == [height, width];
            turned && group[0].camera.has_same_lens(&sighting.camera)
        };
        match groups.iter_mut().find(same) {
            Some(group) => group.push(sighting),
            None => groups.push(vec![sighting]),
        }
    }
    let (mut lenses, mut placed) = (Vec::new(), Vec::new());
    for mut group in groups {
        let Some(calibration) = calibrated(&mut group, options, left_out) else { continue };
        let Calibration { lens, places, errors, focal_length_deviation } = calibration;
        let [width, height] = group[0].size;
        let focal_length_from_exif = group[0].camera.focal_length_in_pixels(width, height);
        let photos = group.len();
        for ((sighting, place), error) in group.into_iter().zip(places).zip(errors) {
            placed.push(Placed { sighting, lens: lenses.len(), place, error });
        }
        lenses.push(LensReport {
            photos,
            focal_length: lens.focal_length,
            focal_length_deviation,
            focal_length_from_exif,
            radial: lens.radial,
            fall_off: [0.0; 2],
            flash_fall_off: [0.0; 2],
            tone: [0.0; light::TONE],
            light_offset: [0.0; 2],
        });
    }
    (lenses, placed)
}

/// The lens of a group of photos, without those that do not agree.
fn calibrated(group: &mut Vec<Sighting>, options: &AcquireOptions, left_out: &mut Vec<LeftOut>) -> Option<Calibration> {
    loop {
        let [width, height] = group.first()?.size;
        let precision = match &options.reference {
            Reference::Sheet(_) => Precision::TAGS,
            Reference::Corners(_) => Precision::CORNERS,
        };
        let (longer, focal_length) = (width.max(height), group[0].camera.focal_length_in_pixels(width, height));
        let mut lens = None;
        let mut found = None;
        for _ in 0..=ROUNDS {
            let points: Vec<Points> = group.iter().map(|sighting| points(sighting, lens.as_ref(), options)).collect();
            let calibration = calibrate(&points, longer, focal_length, precision)?;
            lens = Some(calibration.lens);
            found = Some(calibration);
        }
        let calibration = found?;
        let mut sorted = calibration.errors.clone();
        sorted.sort_by(f64::total_cmp);
        let usual = sorted[(sorted.len() - 1) / 2];
        let limit = (ERROR_RATIO * usual).max(precision.error_max * longer as f64);
        let worst = (0..group.len()).max_by(|&a, &b| calibration.errors[a].total_cmp(&calibration.errors[b]))?;
        if calibration.errors[worst] <= limit {
            return Some(calibration);
        }
        let sighting = group.remove(worst);
        let reason = format!(
            "its {} are {:.1} pixels from where they should be, those of other photos {usual:.1}: {}",
            if sighting.tags.is_empty() { "corners" } else { "tags" },
            calibration.errors[worst],
            if sighting.tags.is_empty() { "check them" } else { "a bent sheet, another zoom, or motion" },
        );
        left_out.push(LeftOut { photo: name_of(&sighting.path), reason, index: sighting.index });
    }
}

/// Corners of tags (or of the patch) in their plane and in the photo, from its middle. With a lens, edges of tags are straight lines where that bends none.
fn points(sighting: &Sighting, lens: Option<&Lens>, options: &AcquireOptions) -> Points {
    let middle = sighting.size.map(|size| size as f64 / 2.0);
    let from_middle = |point: [f64; 2]| [point[0] - middle[0], point[1] - middle[1]];
    let sheet = match &options.reference {
        Reference::Sheet(sheet) => sheet,
        Reference::Corners(corners) => {
            let at = corners.photos()[sighting.index].map(from_middle);
            return corners.on_patch().into_iter().zip(at).collect();
        }
    };
    let mut points = Points::new();
    for tag in &sighting.tags {
        let corners = match lens {
            None => tag.corners.map(|corner| Some(from_middle(corner))),
            Some(lens) => {
                let lines = [0, 1, 2, 3].map(|i| {
                    let straight: Vec<_> =
                        tag.edges[i].iter().map(|&point| lens.undistort(from_middle(point))).collect();
                    Line::through(&straight)
                });
                [0, 1, 2, 3].map(|i| lines[(i + 3) % 4].meet(&lines[i]).map(|direction| lens.distort(direction)))
            }
        };
        for (on, at) in sheet.tags[tag.index].corners.into_iter().zip(corners) {
            points.extend(at.map(|at| (on, at)));
        }
    }
    points
}

/// Side of the rectified photos: what is asked for, but no finer than the finest photo.
fn output_size(lenses: &[LensReport], placed: &[Placed], options: &AcquireOptions) -> usize {
    let across = |photo: &Placed| {
        let lens = lenses[photo.lens].lens();
        let view = View { lens: &lens, place: &photo.place, size: photo.sighting.size };
        pixels_across(&view, options.reference.patch(), options.depth)
    };
    let finest = placed.iter().map(across).fold(0.0, f64::max).ceil() as usize;
    options.size.unwrap_or(SIZE).min(finest.max(16))
}

/// A photo that was rectified.
struct Prepared {
    patch: std::result::Result<(Image, Vec<u8>), String>,
    /// Pixels of the photo across the patch.
    across: f64,
    blur: Option<f64>,
}

fn prepare(photo: &Placed, lenses: &[LensReport], size: usize, options: &AcquireOptions) -> Result<Prepared> {
    let name = name_of(&photo.sighting.path);
    let stored = read_stored(&photo.sighting.path, &options.cancel)?;
    let (decoding, _) = decoding(&name, &stored)?;
    let (lens, tone) = (lenses[photo.lens].lens(), ToneTable::new(Tone(lenses[photo.lens].tone)));
    let view = View { lens: &lens, place: &photo.place, size: photo.sighting.size };
    let patch = options.reference.patch();
    let rectified = rectified(&stored, (&decoding, &tone), &view, (patch, options.depth, size), &options.cancel)?;
    let across = pixels_across(&view, patch, options.depth);
    let tags = &photo.sighting.tags;
    let blurs = tags.iter().map(|tag| tag.blur).sum::<f64>();
    let blur = (!tags.is_empty()).then(|| blurs / tags.len() as f64 * size as f64 / across);
    let patch = rectified.ok_or_else(|| "the sample's square is not all in the photo".to_owned());
    Ok(Prepared { patch, across, blur })
}

/// A photo of the capture to be.
struct Usable<'a> {
    photo: &'a Placed,
    light: Lit,
    across: f64,
    blur: Option<f64>,
    image: Image,
    saturated: Vec<u8>,
}

/// Light of every photo, fall-off divided out, and what there is to say.
#[allow(clippy::too_many_arguments, reason = "all that is known")]
fn assemble(
    placed: &[Placed],
    prepared: Vec<Prepared>,
    light: &[Lit],
    dark: Option<(&Placed, &Prepared)>,
    assumptions: Vec<String>,
    lenses: Vec<LensReport>,
    size: usize,
    options: &AcquireOptions,
    mut left_out: Vec<LeftOut>,
    mut thumbnails: Vec<Option<Thumbnail>>,
) -> Result<Acquisition> {
    let mut usable: Vec<Usable<'_>> = Vec::new();
    let other_light = other_light(light);
    for (((photo, Prepared { patch, across, blur }), &light), other_light) in
        placed.iter().zip(prepared).zip(light).zip(other_light)
    {
        let Sighting { index, path, .. } = &photo.sighting;
        let patch = patch.and_then(|patch| other_light.map_or(Ok(patch), Err));
        match patch {
            Err(reason) => left_out.push(LeftOut { photo: name_of(path), reason, index: *index }),
            Ok((image, saturated)) => usable.push(Usable { photo, light, across, blur, image, saturated }),
        }
    }
    if usable.is_empty() {
        let reasons: Vec<String> =
            left_out.iter().take(5).map(|out| format!("{}: {}", out.photo, out.reason)).collect();
        let more = if left_out.len() > 5 { format!("; and {} more", left_out.len() - 5) } else { String::new() };
        return Err(Error::invalid(
            "photos",
            format!(
                "none can be used: {}{more}; svbrdf-gcn sheet writes the sheet to print, docs/capturing.md says how to use it, and how to do without",
                reasons.join("; ")
            ),
        ));
    }
    let (mut photos, mut reports, mut warnings, mut shown) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let usual = usual_white(usable.iter().map(|photo| photo.light.intensity));
    for Usable { photo, light, across, blur, mut image, saturated } in usable {
        let Placed { sighting, lens, place, error } = photo;
        let file = name_of(&sighting.path);
        if let Some((dark, Prepared { patch: Ok((without, _)), .. })) = dark {
            let ratio = exposure_ratio(&sighting.camera, &dark.sighting.camera) as f32;
            let values = image.data_mut().iter_mut().zip(without.data());
            values.for_each(|(value, dark)| *value = (*value - ratio * dark).max(0.0));
        }
        divide_fall_off(&mut image, photo, &lenses[*lens], options);
        let shot = shot(photo, &lenses[*lens], light.intensity, options);
        if let Some((field, reason)) = shot.misplaced() {
            left_out.push(LeftOut { photo: file, reason: format!("{field} {reason}"), index: sighting.index });
            continue;
        }
        warnings.extend(sighting.notes.iter().map(|note| format!("{file}: {note}")));
        if let Some(blur) = blur.filter(|&blur| blur > BLUR) {
            warnings.push(format!(
                "{file}: is blurred by {blur:.1} pixels of the rectified photo; hold still, and let the camera focus"
            ));
        }
        if let Some(ambient) = light.ambient.filter(|&ambient| ambient > AMBIENT && dark.is_none()) {
            warnings.push(format!(
                "{file}: some {:.0} % of the light on its paper do not come from the flash; darken the room, or give a photo taken without flash (dark)",
                100.0 * ambient
            ));
        }
        let white = white_balance(light.intensity, usual);
        if white > WHITE_BALANCE {
            warnings.push(format!(
                "{file}: its white balance differs from that of other photos by {:.0} %; lock it, if the camera lets you",
                100.0 * white
            ));
        }
        if let Some(error) = light.error.filter(|&error| error > PAPER_ERROR) {
            warnings.push(format!(
                "{file}: its paper is off by {:.0} % from what one light explains; keep other light out, and the sheet flat",
                100.0 * error
            ));
        }
        let full = saturated.iter().filter(|&&bits| bits != 0).count();
        reports.push(PhotoReport {
            photo: file,
            file: save::photo_name(photos.len()),
            lens: *lens,
            orientation: sighting.camera.orientation,
            tags: sighting.tags.len(),
            tag_error: *error,
            position_error: error / across,
            blur,
            paper_error: light.error,
            ambient: light.ambient,
            saturated: full as f64 / saturated.len() as f64,
        });
        photos.push(Photo { name: save::photo_name(photos.len()), shot, image, saturated });
        let lens = lenses[*lens].lens();
        let marks = marks(sighting, &View { lens: &lens, place, size: sighting.size }, options);
        shown.push(Shown { thumbnail: thumbnails[sighting.index].take(), marks });
    }
    warnings.extend(left_out.iter().map(|out| format!("{}: left out: {}", out.photo, out.reason)));
    let about = |photo: &PhotoReport| AcquiredPhoto {
        file: photo.file.clone(),
        position_error: Some(photo.position_error),
        paper_error: photo.paper_error,
    };
    let acquired = Acquired { photos: reports.iter().map(about).collect(), assumptions: assumptions.clone() };
    let capture = Capture::new(photos, options.reference.patch(), Transfer::Linear)?
        .with_unit(Unit::new("mm"))
        .with_acquired(acquired);
    let shots: Vec<Shot> = capture.photos().iter().map(|photo| photo.shot).collect();
    let missing = missing::missing(&shots, options.reference.patch());
    let not_used: Vec<Option<Thumbnail>> = left_out.iter().map(|out| thumbnails[out.index].take()).collect();
    let report = Report { photos: reports, left_out, lenses, size, assumptions, missing, warnings };
    let contact_sheet = contact_sheet(&report, capture.photos(), &shown, &not_used, &options.reference)?;
    Ok(Acquisition { capture: Arc::new(capture), report, contact_sheet })
}

/// Where tags and patch are in a photo.
fn marks(sighting: &Sighting, view: &View<'_>, options: &AcquireOptions) -> Marks {
    let half = options.reference.patch() / 2.0;
    let corners = [[-half, half], [half, half], [half, -half], [-half, -half]];
    let patch = corners.map(|[x, y]| view.pixel([x, y, -options.depth])).to_vec();
    Marks { tags: sighting.tags.iter().map(|tag| tag.corners).collect(), patch }
}

/// Takes out of a rectified photo what lens and flash lose towards the edges.
fn divide_fall_off(image: &mut Image, photo: &Placed, lens: &LensReport, options: &AcquireOptions) {
    let (side, patch) = (image.width(), options.reference.patch());
    let pitch = patch / side as f64;
    let fall_off = FallOff { lens: lens.fall_off, flash: lens.flash_fall_off };
    let row = |(y, row): (usize, &mut [f32])| {
        for (x, pixel) in row.chunks_exact_mut(3).enumerate() {
            let at = [(x as f64 + 0.5) * pitch - patch / 2.0, patch / 2.0 - (y as f64 + 0.5) * pitch, -options.depth];
            let point = turned_back(photo.place.apply(at), photo.sighting.camera.quarter_turns());
            let factor = 1.0 / fall_off.share(point, lens.light_offset);
            pixel.iter_mut().for_each(|value| *value = (f64::from(*value) * factor) as f32);
        }
    };
    image.data_mut().par_chunks_exact_mut(3 * side).enumerate().for_each(row);
}

/// Red and blue light as shares of green.
fn ratios([red, green, blue]: [f64; 3]) -> [f64; 2] {
    [red / green, blue / green]
}

/// The medians of [`ratios`].
fn usual_white(light: impl Iterator<Item = [f64; 3]>) -> [f64; 2] {
    let all: Vec<[f64; 2]> = light.map(ratios).collect();
    [0, 1].map(|i| median(all.iter().map(|ratios| ratios[i])).unwrap_or(1.0))
}

/// How far a light's colour is from what is usual, as a share.
fn white_balance(light: [f64; 3], usual: [f64; 2]) -> f64 {
    let found = ratios(light);
    (0..2).map(|i| (found[i] / usual[i] - 1.0).abs()).fold(0.0, f64::max)
}
