//! The picture that shows a person what was found in photos: where tags and sample are in each, the rectified patches, where cameras stood, and what is missing.

use super::Reference;
use super::geometry::norm;
use super::missing::highlight;
use super::report::{LeftOut, Missing, PhotoReport, Report};
use crate::capture::Photo;
use crate::error::Result;
use crate::image::Image;
use crate::io::profile::Decoding;
use crate::io::resize::{fit_size, shrink};
use crate::io::{RowReader, Stored};
use crate::picture::{Color, LETTER, Picture, TEXT_LINE, on_screen, wrapped};
use crate::shot::Shot;

/// Photos that are shown, at most.
pub const SHOWN: usize = 48;
/// The longer side of a photo on the sheet.
const PHOTO: usize = 320;
/// Side of a patch on the sheet; photos lie on a side of the same height.
const PATCH: usize = 240;
/// Bytes of a photo on the sheet, and of its patch.
pub const SHOWN_BYTES: u64 = 4 * 3 * (PHOTO * PHOTO + PATCH * PATCH) as u64;
const MARGIN: usize = 20;
const COLUMNS: usize = 3;
/// Width of a photo with its patch.
const CELL: usize = PHOTO + MARGIN / 2 + PATCH;
const WIDTH: usize = COLUMNS * (CELL + MARGIN) + MARGIN;
/// Side of the drawings of where cameras stood.
const DRAWING: usize = CELL;

const BACKGROUND: Color = [0.11; 3];
const FIELD: Color = [0.17; 3];
const INK: Color = [0.93; 3];
const FAINT: Color = [0.62; 3];
const TAG: Color = [0.25, 0.95, 0.4];
const SAMPLE: Color = [1.0, 0.62, 0.1];
const CAMERA: Color = [0.35, 0.8, 1.0];
const LIGHT: Color = [1.0, 0.9, 0.3];
const SATURATED: Color = [1.0, 0.0, 0.9];
const WRONG: Color = [1.0, 0.3, 0.25];

/// A photo made small.
pub struct Thumbnail {
    image: Image,
    /// Pixels of it for one of the photo.
    scale: f64,
}

impl Thumbnail {
    /// A photo made small, as programs show it.
    pub fn new(stored: &Stored, decoding: &Decoding) -> Result<Self> {
        let (pixels, colors) = (stored.pixels(), stored.pixels().colors());
        let full = (stored.width, stored.height);
        let (width, height) = fit_size(full.0, full.1, Some(PHOTO));
        let reader = RowReader::new(pixels, decoding, None);
        let (values, _) = shrink(full, (width, height), colors, |y, row, _| {
            reader.read(y, row, None);
            Ok(())
        })?;
        let rgb = values.chunks_exact(colors).flat_map(|pixel| [0, 1, 2].map(|c| on_screen(pixel[c % colors])));
        Ok(Self { image: Image::new(width, height, 3, rgb.collect())?, scale: width as f64 / full.0 as f64 })
    }
}

/// Where things are in a photo of the capture, in pixels from its upper left corner.
pub struct Marks {
    pub tags: Vec<[[f64; 2]; 4]>,
    /// The outline of the patch.
    pub patch: Vec<[f64; 2]>,
}

/// A photo of the capture as the sheet shows it.
pub struct Shown {
    pub thumbnail: Option<Thumbnail>,
    pub marks: Marks,
}

/// The contact sheet. `shown` belongs to the photos of the report and of the capture, `left_out` to those left out, as far as they are shown.
pub fn contact_sheet(
    report: &Report,
    photos: &[Photo],
    shown: &[Shown],
    left_out: &[Option<Thumbnail>],
    reference: &Reference,
) -> Result<Image> {
    let count = shown.iter().filter(|shown| shown.thumbnail.is_some()).count();
    let out = left_out.iter().flatten().count();
    let row = 2 * TEXT_LINE + PATCH + MARGIN;
    let head = headline(report);
    let advice: Vec<(Color, String)> = advice(report);
    let text_rows = advice.len();
    let rows = count.div_ceil(COLUMNS) + out.div_ceil(COLUMNS);
    let height = MARGIN
        + TEXT_LINE * head.len()
        + MARGIN / 2
        + rows * row
        + TEXT_LINE
        + DRAWING
        + TEXT_LINE
        + MARGIN
        + TEXT_LINE * text_rows
        + MARGIN;
    let mut picture = Picture::new(WIDTH, height, BACKGROUND)?;
    let mut y = MARGIN;
    for (i, line) in head.iter().enumerate() {
        picture.text([MARGIN, y], WIDTH - 2 * MARGIN, line, if i == 0 { INK } else { FAINT });
        y += TEXT_LINE;
    }
    y += MARGIN / 2;
    let cell = |i: usize, y: usize| [MARGIN + i % COLUMNS * (CELL + MARGIN), y + i / COLUMNS * row];
    let all =
        report.photos.iter().zip(photos).zip(shown).enumerate().filter(|(_, (_, shown))| shown.thumbnail.is_some());
    for (place, (i, ((about, photo), shown))) in all.enumerate() {
        photo_cell(&mut picture, cell(place, y), i, about, photo, shown)?;
    }
    y += count.div_ceil(COLUMNS) * row;
    let all =
        report.left_out.iter().zip(left_out).filter_map(|(about, thumbnail)| thumbnail.as_ref().map(|t| (about, t)));
    for (place, (about, thumbnail)) in all.enumerate() {
        left_out_cell(&mut picture, cell(place, y), about, thumbnail);
    }
    y += out.div_ceil(COLUMNS) * row;

    let shots: Vec<Shot> = photos.iter().map(|photo| photo.shot).collect();
    let titles = ["cameras from above, the flash yellow", "cameras from the lower edge", "highlights of a flat sample"];
    for (i, title) in titles.iter().enumerate() {
        picture.text([MARGIN + i * (CELL + MARGIN), y], CELL, title, INK);
        picture.area([MARGIN + i * (CELL + MARGIN), y + TEXT_LINE], [DRAWING, DRAWING], FIELD);
    }
    y += TEXT_LINE;
    let top = y as f64;
    let left = |i: usize| (MARGIN + i * (CELL + MARGIN)) as f64;
    from_above(&mut picture, [left(0), top], &shots, &report.missing, reference);
    from_aside(&mut picture, [left(1), top], &shots, &report.missing, reference);
    highlights(&mut picture, [left(2), top], photos, &shots, reference)?;
    y += DRAWING;
    picture.text([MARGIN, y + 6], 2 * CELL, "red crosses: from where photos are missing", FAINT);
    y += TEXT_LINE + MARGIN;
    for (color, line) in &advice {
        picture.text([MARGIN, y], WIDTH - 2 * MARGIN, line, *color);
        y += TEXT_LINE;
    }
    Ok(picture.into_image())
}

/// What was found, in two or more lines.
fn headline(report: &Report) -> Vec<String> {
    let (used, out) = (report.photos.len(), report.left_out.len());
    let mut lines = vec![format!("{used} of {} photos used, rectified to {1} x {1} pixels", used + out, report.size)];
    for (i, lens) in report.lenses.iter().enumerate() {
        let exif = lens.focal_length_from_exif.map_or(String::new(), |f| format!(" (EXIF: {f:.0})"));
        // At a tangent of one half.
        let share = |[a, b]: [f64; 2]| 100.0 * (1.0 - (0.25 * a + 0.0625 * b).exp());
        let lost = share([lens.fall_off[0] + lens.flash_fall_off[0], lens.fall_off[1] + lens.flash_fall_off[1]]);
        let [right, up] = lens.light_offset;
        lines.push(format!(
            "lens {}: {} photos, focal length {:.0} pixels{exif}, radial {:.3} {:.3}",
            i + 1,
            lens.photos,
            lens.focal_length,
            lens.radial[0],
            lens.radial[1]
        ));
        let tone: Vec<String> = lens.tone.iter().map(|t| format!("{t:+.3}")).collect();
        lines.push(format!(
            "lens and flash lose {lost:.0} % at 27 degrees, flash {right:.0} mm right and {up:.0} mm up of the lens, tone curve {}",
            tone.join(" ")
        ));
    }
    lines
}

/// What is assumed, what is missing, then the warnings, in lines.
fn advice(report: &Report) -> Vec<(Color, String)> {
    let width = WIDTH - 2 * MARGIN;
    let missing = report.missing.iter().map(|missing| (SAMPLE, &missing.text));
    let warnings = report.warnings.iter().map(|warning| (WRONG, warning));
    let assumptions: Vec<String> = report.assumptions.iter().map(|text| format!("assumed: {text}")).collect();
    assumptions
        .iter()
        .map(|text| (INK, text))
        .chain(missing)
        .chain(warnings)
        .flat_map(|(color, text)| wrapped(text, width).into_iter().map(move |line| (color, line)))
        .collect()
}

fn photo_cell(
    picture: &mut Picture,
    [x, y]: [usize; 2],
    index: usize,
    about: &PhotoReport,
    photo: &Photo,
    shown: &Shown,
) -> Result<()> {
    let Some(thumbnail) = &shown.thumbnail else { return Ok(()) };
    picture.text([x, y], CELL, &format!("{} {}", index + 1, about.photo), INK);
    let top = y + TEXT_LINE;
    let (scale, image, at) = fitted(thumbnail, [x, top])?;
    picture.image(&image, at);
    let place = |point: &[f64; 2]| [at[0] as f64 + scale * point[0], at[1] as f64 + scale * point[1]];
    for tag in &shown.marks.tags {
        picture.outline(&tag.iter().map(place).collect::<Vec<_>>(), 1.8, TAG);
    }
    picture.outline(&shown.marks.patch.iter().map(place).collect::<Vec<_>>(), 1.8, SAMPLE);
    picture.image(&patch(photo, PATCH, true)?, [x + PHOTO + MARGIN / 2, top]);
    let found = match about.blur {
        Some(blur) => format!("{} tags, off {:.2} px, blur {blur:.1} px", about.tags, about.tag_error),
        None => format!("corners off {:.2} px", about.tag_error),
    };
    let words = format!("{found}, full {:.1} %", 100.0 * about.saturated);
    picture.text([x, top + PATCH + 6], CELL, &words, FAINT);
    Ok(())
}

fn left_out_cell(picture: &mut Picture, [x, y]: [usize; 2], about: &LeftOut, thumbnail: &Thumbnail) {
    picture.text([x, y], CELL, &format!("left out: {}", about.photo), WRONG);
    let top = y + TEXT_LINE;
    if let Ok((_, image, at)) = fitted(thumbnail, [x, top]) {
        picture.image(&image, at);
    }
    for (i, line) in wrapped(&about.reason, PATCH).iter().take(PATCH / TEXT_LINE).enumerate() {
        picture.text([x + PHOTO + MARGIN / 2, top + i * TEXT_LINE], PATCH, line, WRONG);
    }
}

/// A thumbnail in a box of [`PHOTO`] x [`PATCH`] pixels at a place: pixels of it for one of the photo, itself, and where it begins.
fn fitted(thumbnail: &Thumbnail, [x, y]: [usize; 2]) -> Result<(f64, Image, [usize; 2])> {
    let image = &thumbnail.image;
    let small = shrunk(image, [PHOTO.min(image.width()), PATCH.min(image.height())])?;
    let scale = thumbnail.scale * small.width() as f64 / image.width() as f64;
    let at = [x + (PHOTO - small.width()) / 2, y + (PATCH - small.height()) / 2];
    Ok((scale, small, at))
}

/// An image made as small as fits into a box.
fn shrunk(image: &Image, [most_width, most_height]: [usize; 2]) -> Result<Image> {
    let full = (image.width(), image.height());
    let share = (most_width as f64 / full.0 as f64).min(most_height as f64 / full.1 as f64).min(1.0);
    let size = [full.0, full.1].map(|side| ((side as f64 * share).round() as usize).max(1));
    let (values, _) = shrink(full, (size[0], size[1]), 3, |y, row, _| {
        row.copy_from_slice(&image.data()[y * 3 * full.0..(y + 1) * 3 * full.0]);
        Ok(())
    })?;
    Image::new(size[0], size[1], 3, values)
}

/// A rectified photo as programs show it, `side` pixels wide; what is saturated is marked if asked for.
fn patch(photo: &Photo, side: usize, marked: bool) -> Result<Image> {
    let image = &photo.image;
    let (width, channels) = (image.width(), 3 * image.width());
    let small = side.min(width);
    let (mut values, masks) = shrink((width, width), (small, small), 3, |y, row, mask| {
        row.copy_from_slice(&image.data()[y * channels..(y + 1) * channels]);
        mask.copy_from_slice(&photo.saturated[y * width..(y + 1) * width]);
        Ok(())
    })?;
    for (pixel, mask) in values.chunks_exact_mut(3).zip(masks) {
        if marked && mask != 0 {
            pixel.copy_from_slice(&SATURATED);
        } else {
            pixel.iter_mut().for_each(|value| *value = on_screen(*value));
        }
    }
    // Enlarged by repetition where the photos are smaller than the sheet shows them.
    let value = |i: usize| {
        let (p, c) = (i / 3, i % 3);
        values[3 * (p / side * small / side * small + p % side * small / side) + c]
    };
    Image::new(side, side, 3, (0..3 * side * side).map(value).collect())
}

/// Millimetres that a drawing reaches from its middle: all cameras, and the sheet.
fn reach(shots: &[Shot], missing: &[Missing], reference: &Reference, of: impl Fn([f64; 3]) -> f64) -> f64 {
    let cameras = shots.iter().map(|shot| shot.camera).chain(missing.iter().map(|missing| missing.camera));
    1.12 * cameras.map(of).fold(1.1 * reference.half_width(), f64::max)
}

/// Cameras as seen from above: x to the right, y up.
fn from_above(
    picture: &mut Picture,
    [left, top]: [f64; 2],
    shots: &[Shot],
    missing: &[Missing],
    reference: &Reference,
) {
    let reach = reach(shots, missing, reference, |[x, y, _]| x.abs().max(y.abs()));
    let (middle, scale) = (DRAWING as f64 / 2.0, DRAWING as f64 / 2.0 / reach);
    let place = |[x, y, _]: [f64; 3]| [left + middle + scale * x, top + middle - scale * y];
    let square =
        |half: f64| [[-half, half], [half, half], [half, -half], [-half, -half]].map(|[x, y]| place([x, y, 0.0]));
    picture.outline(&square(reference.half_width()), 1.5, FAINT);
    picture.outline(&square(reference.patch() / 2.0), 2.0, SAMPLE);
    for tag in reference.tags() {
        picture.outline(&tag.corners.map(|[x, y]| place([x, y, 0.0])), 1.0, FAINT);
    }
    cameras(picture, shots, missing, place);
}

/// Cameras as seen along the sheet from its lower edge: x to the right, z up.
fn from_aside(
    picture: &mut Picture,
    [left, top]: [f64; 2],
    shots: &[Shot],
    missing: &[Missing],
    reference: &Reference,
) {
    let across = reach(shots, missing, reference, |[x, _, _]| x.abs());
    let up = reach(shots, missing, reference, |[_, _, z]| z);
    let side = DRAWING as f64;
    let scale = (side / 2.0 / across).min(0.92 * side / up);
    let ground = top + 0.95 * side;
    let place = |[x, _, z]: [f64; 3]| [left + side / 2.0 + scale * x, ground - scale * z];
    let half = reference.half_width();
    picture.line(place([-half, 0.0, 0.0]), place([half, 0.0, 0.0]), 3.0, FAINT);
    let half = reference.patch() / 2.0;
    picture.line(place([-half, 0.0, 0.0]), place([half, 0.0, 0.0]), 5.0, SAMPLE);
    cameras(picture, shots, missing, place);
}

fn cameras(picture: &mut Picture, shots: &[Shot], missing: &[Missing], place: impl Fn([f64; 3]) -> [f64; 2]) {
    for shot in shots {
        picture.line(place(shot.camera), place([0.0; 3]), 1.0, [0.3; 3]);
    }
    for missing in missing {
        picture.cross(place(missing.camera), 7.0, WRONG);
    }
    for (i, shot) in shots.iter().enumerate() {
        let at = place(shot.camera);
        picture.dot(place(shot.light), 4.0, LIGHT);
        picture.dot(at, 6.0, CAMERA);
        number(picture, at, i);
    }
}

/// The number of a photo beside a point.
fn number(picture: &mut Picture, [x, y]: [f64; 2], index: usize) {
    let text = (index + 1).to_string();
    let at = [(x + 9.0).max(0.0) as usize, (y - 7.0).max(0.0) as usize];
    picture.text(at, text.len() * LETTER, &text, INK);
}

/// The patch, dimmed, and where each photo has the highlight of a flat sample.
fn highlights(
    picture: &mut Picture,
    [left, top]: [f64; 2],
    photos: &[Photo],
    shots: &[Shot],
    reference: &Reference,
) -> Result<()> {
    let side = DRAWING as f64;
    // The patch takes the middle; highlights may stand beside it.
    let inner = 0.5 * side;
    let scale = inner / reference.patch();
    let corner = [left + (side - inner) / 2.0, top + (side - inner) / 2.0];
    let above = shots.iter().enumerate().max_by(|a, b| leaning(a.1).total_cmp(&leaning(b.1)));
    if let Some((index, _)) = above {
        let mut image = patch(&photos[index], inner as usize, false)?;
        image.data_mut().iter_mut().for_each(|value| *value *= 0.55);
        picture.image(&image, corner.map(|x| x as usize));
    }
    let place = |[x, y]: [f64; 2]| [left + side / 2.0 + scale * x, top + side / 2.0 - scale * y];
    let half = reference.patch() / 2.0;
    picture.outline(&[[-half, half], [half, half], [half, -half], [-half, -half]].map(place), 2.0, SAMPLE);
    picture.line(place([-half, 0.0]), place([half, 0.0]), 1.0, SAMPLE);
    picture.line(place([0.0, -half]), place([0.0, half]), 1.0, SAMPLE);
    for (i, shot) in shots.iter().enumerate() {
        let at = highlight(shot);
        let most = half * side / inner * 0.95;
        let shown = place(at.map(|x| x.clamp(-most, most)));
        picture.dot(shown, 6.0, LIGHT);
        number(picture, shown, i);
    }
    Ok(())
}

/// The cosine of the angle that a camera leans by.
fn leaning(shot: &Shot) -> f64 {
    shot.camera[2] / norm(shot.camera)
}
