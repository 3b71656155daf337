//! What a user may expect of fitted maps, and what would make them better.
//!
//! Not from the paper.

use serde::Serialize;

use crate::capture::{AcquiredPhoto, Capture, Photo};
use crate::color::GAMMA;
use crate::fit::direct::light;
use crate::image::Image;
use crate::render::encode_radiance;
use crate::shot::Shot;

/// Expected error of a new photo up to which maps are good, and above which they are poor.
const GOOD: f64 = 0.04;
const POOR: f64 = 0.10;
/// Share of the expected error that a smooth gain has to take away before the light is called uneven.
const UNEVEN: f64 = 0.3;
/// Angle in radians that the half vectors of the photos span in the middle of the patch, below which highlights hardly move.
const PARALLAX: f64 = 0.2;
/// Shift of a photo against its rendering, in pixels, from which its positions are in doubt.
const SHIFT: f64 = 1.0;
/// Smallest side of photos of which shifts are looked for.
const SHIFT_SIDE_MIN: usize = 16;
/// Share of saturated values from which it is worth a word.
const SATURATED: f64 = 0.05;
/// Share of pixels that are black in every photo from which maps may be those of a mirror.
const BLACK_SHARE: f64 = 0.5;
/// How far the known points of an acquired photo are from where they should be, as a share of the patch's width, from which on its position is in doubt: a pixel of maps of 512.
const ACQUIRED_POSITION: f64 = 1.0 / 512.0;
/// Deviation of an acquired photo's paper from what one light explains from which on its light is in doubt: half of [`GOOD`] on white, in codes of gamma 2.2.
const ACQUIRED_LIGHT: f64 = GAMMA * GOOD / 2.0;
/// The deviation of the photos' codes at which the finish believes them least.
const UNEXPLAINED: f64 = 0.2;
/// Angle in radians from the normal at which another photo is proposed, and how many directions are looked at.
const NEXT_ANGLE: f64 = 0.4;
const NEXT_DIRECTIONS: usize = 24;

/// Codes of reasons that are warnings, too.
const PHOTOS_CONTRADICT: &str = "photos_contradict";
const LIGHT_WRONG: &str = "light_wrong";
/// Not a warning, but no good maps either.
const UNSEEN: &str = "highlight_unseen";

/// How good maps are for what they are made for: to look like the sample under new light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Grade {
    /// A new photo would hardly be told from its rendering, and nothing contradicts.
    Good,
    /// Right in the whole, with errors that can be seen.
    Usable,
    /// Not what the photos show.
    Poor,
}

impl Grade {
    /// The name used in files and messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Usable => "usable",
            Self::Poor => "poor",
        }
    }
}

/// One thing that keeps maps from being better.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Reason {
    /// A word that stays the same: `photos_contradict`, `light_wrong`, `assumed`, `light_uneven`, `positions`, `one_photo`, `little_parallax`,
    /// `highlight_unseen`, `saturated`, `unexplained`, `model_lacks`, `acquired_positions`, `acquired_light`.
    pub code: &'static str,
    /// What was found.
    pub text: String,
    /// What to do.
    pub advice: String,
}

/// What a user may expect of fitted maps.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Verdict {
    /// All in one word; `verdict` in files.
    #[serde(rename = "verdict")]
    pub grade: Grade,
    /// Expected RMSE of a new photo (gamma 2.2, clamped to [0, 1]) under its stated light, from photos that were left out; `None` where no fit
    /// without a photo was made.
    pub expected_error: Option<f64>,
    /// What remains of it after a smooth gain ([`photo_rmse_smooth_gain`](crate::metrics::photo_rmse_smooth_gain)): the material's part.
    pub material_error: Option<f64>,
    /// Whether the expectation comes from the network's certainty alone: a single photo cannot be left out.
    pub estimated: bool,
    /// Why the grade is not better, the gravest first; hints for good maps, too.
    pub reasons: Vec<Reason>,
}

/// Expected errors of a new photo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Expected {
    pub error: f64,
    pub material: f64,
    pub estimated: bool,
}

impl Verdict {
    /// What must not be overlooked: photos that contradict the others, and wrong light.
    pub(super) fn warnings(&self) -> impl Iterator<Item = String> + '_ {
        let grave = |reason: &&Reason| [PHOTOS_CONTRADICT, LIGHT_WRONG].contains(&reason.code);
        self.reasons.iter().filter(grave).map(|Reason { text, advice, .. }| format!("{text}; {advice}"))
    }
}

impl Expected {
    /// The mean of what was found for photos that were left out, each without and after a smooth gain.
    pub fn of(errors: &[[f64; 2]]) -> Option<Self> {
        let mean = |i: usize| errors.iter().map(|error| error[i]).sum::<f64>() / errors.len() as f64;
        (!errors.is_empty()).then(|| Self { error: mean(0), material: mean(1), estimated: false })
    }
}

/// What the verdict is made of.
pub(super) struct Evidence<'a> {
    /// All photos.
    pub capture: &'a Capture,
    /// Photos that contradict the others.
    pub contradicting: &'a [usize],
    /// The photos that were fitted.
    pub kept: &'a [usize],
    pub expected: Option<Expected>,
    /// Of the photos that were fitted.
    pub gains: Option<&'a [f64]>,
    pub photo_deviation: Option<f64>,
    /// Whether the diffuse albedo is at its limit in much of the patch.
    pub at_limit: bool,
    /// Share of pixels that are black in every photo.
    pub black_share: f64,
    /// How far each photo lies beside its rendering, in pixels: [`shift`].
    pub shifts: &'a [f64],
}

/// The verdict on a fit.
pub(super) fn verdict(evidence: &Evidence<'_>) -> Verdict {
    let photos = evidence.capture.photos();
    let kept: Vec<&Photo> = evidence.kept.iter().map(|&photo| &photos[photo]).collect();
    let fitted_all = kept.len() == photos.len();
    let mut reasons = Vec::new();
    let mut reason = |code, text: String, advice: &str| reasons.push(Reason { code, text, advice: advice.to_owned() });
    for &photo in evidence.contradicting {
        let outcome = if fitted_all { "but was fitted, as the network takes no fewer" } else { "and was left out" };
        reason(
            PHOTOS_CONTRADICT,
            format!("{}: contradicts the other photos {outcome}", photos[photo].name),
            "check its positions, its light and what it shows",
        );
    }
    if evidence.at_limit {
        reason(
            LIGHT_WRONG,
            "the diffuse albedo is at its limit of 1 in much of the patch".into(),
            "state a stronger light (light_intensity), or one that is nearer",
        );
    } else if let Some(gains) = evidence.gains
        && let Some((photo, gain)) = kept.iter().zip(gains).find(|(_, gain)| light::at_limit(**gain))
    {
        reason(
            LIGHT_WRONG,
            format!("{}: its light is {gain:.2} times what is stated, the most that a fit grants", photo.name),
            "measure the light of each photo, or fix exposure and flash",
        );
    }
    if let Some(assumed) = evidence.capture.assumed() {
        reason(
            "assumed",
            assumed.summary(),
            "take several photos and state where camera and light stood in a capture.json (docs/captures.md)",
        );
    }
    if let Some(acquired) = evidence.capture.acquired() {
        if !acquired.assumptions.is_empty() {
            reason(
                "assumed",
                acquired.assumptions.join("; "),
                "lay a printed sheet around the sample (docs/capturing.md)",
            );
        }
        let used = || acquired.photos.iter().filter(|photo| kept.iter().any(|kept| kept.name == photo.file));
        let worst = |error: fn(&AcquiredPhoto) -> Option<f64>| {
            let errors = used().filter_map(|photo| Some((photo, error(photo)?)));
            errors.max_by(|a, b| a.1.total_cmp(&b.1))
        };
        if let Some((photo, error)) = worst(|photo| photo.position_error).filter(|worst| worst.1 > ACQUIRED_POSITION) {
            reason(
                "acquired_positions",
                format!(
                    "{}: what tells its position is off by {:.2} % of the patch's width",
                    photo.file,
                    100.0 * error
                ),
                "lay the sheet flat, keep its tags in focus, and do not zoom between photos",
            );
        }
        if let Some((photo, error)) = worst(|photo| photo.paper_error).filter(|worst| worst.1 > ACQUIRED_LIGHT) {
            reason(
                "acquired_light",
                format!("{}: its paper is off by {:.0} % from what one light explains", photo.file, 100.0 * error),
                "keep other light and shadows out, switch HDR off, and print on matt paper",
            );
        }
    }
    let shift = |photo: usize| evidence.shifts[photo];
    let farthest = evidence.kept.iter().copied().max_by(|&a, &b| shift(a).total_cmp(&shift(b)));
    if let Some(photo) = farthest.filter(|&photo| shift(photo) > SHIFT) {
        reason(
            "positions",
            format!("{}: lies {:.1} pixels beside its rendering", photos[photo].name, shift(photo)),
            "check the positions of camera and light, and that the photos are aligned",
        );
    }
    let next = || {
        let [x, y, z] = next_place(&kept);
        let unit = evidence.capture.unit().map_or(String::new(), |unit| format!(" {unit}"));
        format!("another photo from about ({x:.3}, {y:.3}, {z:.3}){unit} would help most")
    };
    if kept.len() == 1 {
        reason("one_photo", "one photo shows every pixel from one side only".into(), &next());
    } else if span(&kept) < PARALLAX {
        reason("little_parallax", "highlights are in the same place in all photos".into(), &next());
    }
    if evidence.black_share > BLACK_SHARE {
        let text = format!(
            "{:.0} % of the pixels are black in every photo: they reflect nothing, or hardly a photo shows their highlight",
            100.0 * evidence.black_share
        );
        reason(UNSEEN, text, "take more photos, so that the highlight of the flash passes over the whole sample");
    }
    let values = kept.iter().map(|photo| 3 * photo.saturated.len()).sum::<usize>() as f64;
    let saturated: u32 = kept.iter().flat_map(|photo| &photo.saturated).map(|bits| bits.count_ones()).sum();
    let share = f64::from(saturated) / values;
    if share > SATURATED {
        let text = format!("{:.0} % of the photos' values are saturated", 100.0 * share);
        reason("saturated", text, "expose less, so that highlights keep their brightness");
    }
    if let Some(expected) = evidence.expected
        && expected.error > GOOD
        && !expected.estimated
    {
        if expected.material < (1.0 - UNEVEN) * expected.error {
            reason(
                "light_uneven",
                format!(
                    "of the expected error of {:.3} a smooth change of the light would take away {:.3}",
                    expected.error,
                    expected.error - expected.material
                ),
                "check the positions and the intensity of the light, and keep other light out",
            );
        }
        if evidence.photo_deviation.is_some_and(|deviation| deviation >= UNEXPLAINED) {
            reason(
                "unexplained",
                "no maps explain all photos pixel by pixel".into(),
                "check positions and alignment; depth, translucency and layers are not part of the model",
            );
        } else if expected.material > POOR {
            reason(
                "model_lacks",
                format!("left-out photos are missed by {:.3} after a smooth gain, too", expected.material),
                "more photos may help; depth, translucency and layers are not part of the model",
            );
        }
    }
    let mut grade = match evidence.expected {
        Some(Expected { error, .. }) if error > POOR => Grade::Poor,
        Some(Expected { error, estimated: false, .. }) if error <= GOOD => Grade::Good,
        _ => Grade::Usable,
    };
    if !evidence.contradicting.is_empty() {
        // Without them the maps are those of the others.
        grade = grade.max(if fitted_all { Grade::Poor } else { Grade::Usable });
    }
    if reasons.iter().any(|reason| [LIGHT_WRONG, UNSEEN].contains(&reason.code)) {
        grade = grade.max(Grade::Usable);
    }
    Verdict {
        grade,
        expected_error: evidence.expected.map(|expected| expected.error),
        material_error: evidence.expected.map(|expected| expected.material),
        estimated: evidence.expected.is_some_and(|expected| expected.estimated),
        reasons,
    }
}

/// Where the half vector of `shot` in the middle of the patch meets the plane at height 1.
fn half(shot: &Shot) -> [f64; 2] {
    let unit = |v: [f64; 3]| {
        let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        v.map(|x| x / length)
    };
    let (camera, light) = (unit(shot.camera), unit(shot.light));
    let sum = [0, 1, 2].map(|i| camera[i] + light[i]);
    [sum[0] / sum[2], sum[1] / sum[2]]
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// How far the half vectors of the photos lie apart at most.
fn span(photos: &[&Photo]) -> f64 {
    let halves: Vec<[f64; 2]> = photos.iter().map(|photo| half(&photo.shot)).collect();
    halves.iter().flat_map(|&a| halves.iter().map(move |&b| distance(a, b))).fold(0.0, f64::max)
}

/// From where another photo would show highlights farthest from those of the others, at the distance of these.
fn next_place(photos: &[&Photo]) -> [f64; 3] {
    let length = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let far = photos.iter().map(|photo| length(photo.shot.camera)).sum::<f64>() / photos.len() as f64;
    let place = |direction: usize| {
        let angle = std::f64::consts::TAU * direction as f64 / NEXT_DIRECTIONS as f64;
        [angle.cos() * NEXT_ANGLE.sin(), angle.sin() * NEXT_ANGLE.sin(), NEXT_ANGLE.cos()].map(|x| far * x)
    };
    let nearest = |place: [f64; 3]| {
        let new = half(&Shot { camera: place, light: place, light_intensity: [1.0; 3] });
        photos.iter().map(|photo| distance(new, half(&photo.shot))).fold(f64::INFINITY, f64::min)
    };
    (0..NEXT_DIRECTIONS).map(place).fold((0.0, place(0)), |best, place| best_of(best, (nearest(place), place))).1
}

fn best_of<T>(best: (f64, T), other: (f64, T)) -> (f64, T) {
    if other.0 > best.0 { other } else { best }
}

/// By how many pixels `photo` lies beside its rendering.
pub(super) fn shift(photo: &Photo, rendering: &Image) -> f64 {
    let (width, height) = (rendering.width(), rendering.height());
    if width < SHIFT_SIDE_MIN || height < SHIFT_SIDE_MIN {
        return 0.0;
    }
    let grey = |image: &Image| -> Vec<f64> {
        let code = |rgb: &[f32]| f64::from(encode_radiance((rgb[0] + rgb[1] + rgb[2]) / 3.0)).clamp(0.0, 1.0);
        image.data().chunks_exact(3).map(code).collect()
    };
    shift_between(&grey(&photo.image), &grey(rendering), width)
}

/// By how many pixels `rendered` has to be moved to come nearest to `seen`: one step of Lucas and Kanade.
///
/// # Source
/// Lucas and Kanade, "An Iterative Image Registration Technique with an Application to Stereo Vision", IJCAI 1981.
fn shift_between(seen: &[f64], rendered: &[f64], width: usize) -> f64 {
    let height = seen.len() / width;
    let (mut xx, mut xy, mut yy, mut x, mut y) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for row in 1..height - 1 {
        for column in 1..width - 1 {
            let p = row * width + column;
            let slope = |image: &[f64], step: usize| (image[p + step] - image[p - step]) / 2.0;
            // Both pictures' slopes: noise of one alone would shorten the shift.
            let across = (slope(seen, 1) + slope(rendered, 1)) / 2.0;
            let down = (slope(seen, width) + slope(rendered, width)) / 2.0;
            let off = rendered[p] - seen[p];
            // Where the maps miss something else, a shift explains nothing.
            let weight = 1.0 / (1.0 + (off / 0.1).powi(2));
            xx += weight * across * across;
            xy += weight * across * down;
            yy += weight * down * down;
            x += weight * across * off;
            y += weight * down * off;
        }
    }
    let determinant = xx * yy - xy * xy;
    // A picture without detail does not tell.
    if determinant > 1e-3 * (xx + yy).powi(2) && xx + yy > 1e-4 * (width * height) as f64 {
        ((yy * x - xy * y) / determinant).hypot((xx * y - xy * x) / determinant)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::{Evidence, Expected, Grade, SHIFT, Verdict, shift, verdict};
    use crate::capture::{Acquired, AcquiredPhoto, Capture, Photo};
    use crate::color::Transfer;
    use crate::image::Image;
    use crate::shot::Shot;

    const SIDE: usize = 24;

    /// A photo of waves, `by` columns to the right.
    fn photo(place: [f64; 3], by: f32) -> Photo {
        let wave = |p: usize| {
            let (x, y) = ((p % SIDE) as f32 - by, (p / SIDE) as f32);
            0.3 + 0.1 * (0.5 * x).sin() + 0.1 * (0.4 * y + 0.1 * x).cos()
        };
        let data = (0..SIDE * SIDE).flat_map(|p| [wave(p); 3]).collect();
        let shot = Shot { camera: place, light: place, light_intensity: [12.0; 3] };
        let image = Image::new(SIDE, SIDE, 3, data).unwrap();
        Photo { name: format!("{place:?}"), shot, image, saturated: vec![0; SIDE * SIDE] }
    }

    fn capture(count: usize) -> Capture {
        let place = |i: usize| [0.5 * i as f64 - 0.5, 0.3, 2.0];
        Capture::new((0..count).map(|i| photo(place(i), 0.0)).collect(), 1.0, Transfer::Linear).unwrap()
    }

    fn judged(capture: &Capture, change: impl FnOnce(&mut Evidence<'_>)) -> Verdict {
        let kept: Vec<usize> = (0..capture.len()).collect();
        let shifts = vec![0.0; capture.len()];
        let mut evidence = Evidence {
            capture,
            contradicting: &[],
            kept: &kept,
            expected: Some(Expected { error: 0.02, material: 0.018, estimated: false }),
            gains: None,
            photo_deviation: Some(0.025),
            at_limit: false,
            black_share: 0.1,
            shifts: &shifts,
        };
        change(&mut evidence);
        verdict(&evidence)
    }

    fn codes(verdict: &Verdict) -> Vec<&str> {
        verdict.reasons.iter().map(|reason| reason.code).collect()
    }

    #[test]
    fn nothing_wrong_is_good() {
        let judged = judged(&capture(4), |_| {});
        assert_eq!((judged.grade, codes(&judged)), (Grade::Good, vec![]));
        assert_eq!((judged.expected_error, judged.material_error), (Some(0.02), Some(0.018)));
        assert_eq!(judged.warnings().count(), 0);
    }

    #[test]
    fn the_expected_error_decides() {
        let capture = capture(4);
        let of = |error, material| {
            judged(&capture, |evidence| evidence.expected = Some(Expected { error, material, estimated: false }))
        };
        assert_eq!((of(0.06, 0.055).grade, codes(&of(0.06, 0.055))), (Grade::Usable, vec![]));
        assert_eq!((of(0.06, 0.03).grade, codes(&of(0.06, 0.03))), (Grade::Usable, vec!["light_uneven"]));
        assert_eq!((of(0.12, 0.11).grade, codes(&of(0.12, 0.11))), (Grade::Poor, vec!["model_lacks"]));
        let unknown = judged(&capture, |evidence| evidence.expected = None);
        assert_eq!((unknown.grade, unknown.expected_error), (Grade::Usable, None));
    }

    #[test]
    fn contradictions_and_wrong_light_are_warnings_too() {
        let capture = capture(5);
        let without = judged(&capture, |evidence| (evidence.contradicting, evidence.kept) = (&[3], &[0, 1, 2, 4]));
        assert_eq!((without.grade, codes(&without)), (Grade::Usable, vec!["photos_contradict"]));
        assert!(
            without
                .warnings()
                .next()
                .unwrap()
                .starts_with("[1.0, 0.3, 2.0]: contradicts the other photos and was left out;")
        );
        let with = judged(&capture, |evidence| evidence.contradicting = &[3]);
        assert_eq!((with.grade, with.warnings().count()), (Grade::Poor, 1));
        let bright = judged(&capture, |evidence| evidence.at_limit = true);
        assert_eq!((bright.grade, codes(&bright)), (Grade::Usable, vec!["light_wrong"]));
        let mirror = judged(&capture, |evidence| evidence.black_share = 0.9);
        assert_eq!((mirror.grade, codes(&mirror)), (Grade::Usable, vec!["highlight_unseen"]));
        const GAINS: [f64; 5] = [1.0, 2.013, 1.0, 0.9, 1.0];
        let bright = judged(&capture, |evidence| evidence.gains = Some(&GAINS));
        assert_eq!(codes(&bright), ["light_wrong"]);
        assert!(bright.reasons[0].text.starts_with("[0.0, 0.3, 2.0]: its light is 2.01 times"), "{bright:?}");
    }

    #[test]
    fn one_place_asks_for_another() {
        let alone = judged(&capture(1), |evidence| {
            evidence.expected = Some(Expected { error: 0.03, material: 0.03, estimated: true });
        });
        assert_eq!((alone.grade, codes(&alone), alone.estimated), (Grade::Usable, vec!["one_photo"], true));
        // The photo is to the left and above: the next one is opposite.
        assert!(
            alone.reasons[0].advice.contains("about (0.") && alone.reasons[0].advice.contains(", -0."),
            "{alone:?}"
        );
        let near = [[0.0, 0.0, 2.0], [0.1, 0.0, 2.0]].map(|place| photo(place, 0.0)).to_vec();
        let near = judged(&Capture::new(near, 1.0, Transfer::Linear).unwrap(), |_| {});
        assert_eq!((near.grade, codes(&near)), (Grade::Good, vec!["little_parallax"]));
    }

    #[test]
    fn shifts_are_measured_and_named() {
        let rendering = photo([0.0, 0.0, 2.0], 0.0).image;
        for by in [0.0, 0.5, 1.5] {
            let found = shift(&photo([0.0, 0.0, 2.0], by), &rendering);
            assert!((found - f64::from(by)).abs() < 0.05 + 0.1 * f64::from(by), "{by} {found}");
        }
        let flat = Image::new(SIDE, SIDE, 3, vec![0.2; 3 * SIDE * SIDE]).unwrap();
        assert!(shift(&photo([0.0, 0.0, 2.0], 0.0), &flat) < SHIFT);
        let shifted = judged(&capture(3), |evidence| evidence.shifts = &[0.1, 2.0, 0.3]);
        assert_eq!(codes(&shifted), ["positions"]);
        assert!(shifted.reasons[0].text.starts_with("[0.0, 0.3, 2.0]: lies 2.0 pixels"), "{shifted:?}");
    }

    #[test]
    fn what_acquire_found_counts_for_photos_that_were_fitted() {
        let about = |i: usize, position: f64, paper: Option<f64>| AcquiredPhoto {
            file: capture(4).photos()[i].name.clone(),
            position_error: Some(position),
            paper_error: paper,
        };
        let of = |photos: Vec<AcquiredPhoto>, assumptions: &[&str], kept: &'static [usize]| {
            let assumptions = assumptions.iter().map(|&text| text.to_owned()).collect();
            let capture = capture(4).with_acquired(Acquired { photos, assumptions });
            judged(&capture, |evidence| evidence.kept = kept)
        };
        let all: &[usize] = &[0, 1, 2, 3];
        let fine = of(vec![about(0, 0.0015, Some(0.04)), about(1, 0.0001, None)], &[], all);
        assert_eq!((fine.grade, codes(&fine)), (Grade::Good, vec![]));
        let photos = || vec![about(0, 0.003, Some(0.01)), about(2, 0.004, Some(0.2)), about(1, 0.0, None)];
        let off = of(photos(), &["the flash is at the lens", "a square"], all);
        assert_eq!(codes(&off), ["assumed", "acquired_positions", "acquired_light"]);
        assert_eq!(off.reasons[0].text, "the flash is at the lens; a square");
        assert!(off.reasons[1].text.starts_with("[0.5, 0.3, 2.0]: ") && off.reasons[1].text.contains("0.40 %"));
        assert!(off.reasons[2].text.ends_with("off by 20 % from what one light explains"), "{off:?}");
        assert_eq!(codes(&of(photos(), &[], &[1, 3])), Vec::<&str>::new());
    }

    #[test]
    fn saturation_is_named() {
        let mut bright = photo([0.0, 0.0, 2.0], 0.0);
        bright.saturated.fill(0b011);
        let capture = Capture::new(vec![bright, photo([0.8, 0.0, 2.0], 0.0)], 1.0, Transfer::Linear).unwrap();
        let judged = judged(&capture, |_| {});
        assert_eq!(codes(&judged), ["saturated"]);
        assert!(judged.reasons[0].text.starts_with("33 %"), "{judged:?}");
    }
}
