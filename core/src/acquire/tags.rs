//! Finds the tags of a sheet in a photo.
//!
//! Dark connected areas whose convex hull is a quadrilateral are looked at: their cells are read through the map of the quadrilateral, and compared with the codes of the sheet in
//! all four turns. Then every edge is measured in the photo's own pixels: across it, the share of light between the black inside and the white outside says where it is, to a few hundredths of a pixel.

use std::ops::Range;

use super::geometry::Homography;
use super::median;
use super::sheet::{CELLS, DATA_CELLS, Sheet, Tag};
use crate::cancel::CancelToken;
use crate::error::Result;
use crate::memory;

/// The longer side of the picture that tags are looked for in.
const SEARCH_SIDE: usize = 1800;
/// Bytes that looking for tags takes beside the photo's brightness: the picture and its root, sums, what is dark and a list of it.
pub const SEARCH_MEMORY: u64 = (SEARCH_SIDE * SEARCH_SIDE * (4 + 8 + 1 + 8)) as u64;
/// Sides of the neighbourhoods that say what is dark, as shares of the longer side: tags are as large as they are.
const NEIGHBOURHOODS: [f64; 3] = [0.12, 0.05, 0.02];
/// What is below this share of the mean around it is dark, in square roots of radiance.
const DARK: f64 = 0.75;
/// The smallest side of a tag in the picture that is searched, and the largest share of its longer side.
const SIDE_MIN: f64 = 12.0;
const SIDE_MAX: f64 = 0.6;
/// Share of its convex hull that a quadrilateral covers at least.
const QUADRILATERAL: f64 = 0.85;
/// Cells that may be read wrongly: codes differ in eleven.
const WRONG_CELLS_MAX: u32 = 2;
/// Border cells that may look white.
const WRONG_BORDER_MAX: usize = 2;
/// Contrast of black and white below which nothing is read, as a share of white.
const CONTRAST_MIN: f64 = 0.2;

/// Points along an edge at which it is measured, the share of the edge that they span, and the step across it in pixels.
const EDGE_POINTS: usize = 32;
const EDGE_SPAN: Range<f64> = 0.06..0.94;
const EDGE_STEP: f64 = 0.5;
/// How far a profile across an edge reaches, in cells and in pixels. The border inside and the white outside are one cell wide.
const REACH_CELLS: f64 = 0.42;
const REACH_PIXELS: Range<f64> = 1.5..14.0;
/// Points farther than this from the line of their edge are left out, in standard deviations.
const EDGE_OUTLIER: f64 = 2.5;
/// An edge with fewer points that were measured is not believed.
const EDGE_POINTS_MIN: usize = 12;

/// A photo's brightness, linear, rows from the top.
pub struct Grey {
    pub width: usize,
    pub height: usize,
    pub values: Vec<f32>,
}

impl Grey {
    /// The value at `x`, `y`, where the centre of the first pixel is at (0.5, 0.5).
    fn at(&self, x: f64, y: f64) -> f64 {
        let (x, y) = ((x - 0.5).clamp(0.0, (self.width - 1) as f64), (y - 0.5).clamp(0.0, (self.height - 1) as f64));
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f64, y - row as f64);
        let (right, below) = ((column + 1).min(self.width - 1), (row + 1).min(self.height - 1));
        let value = |row: usize, column: usize| f64::from(self.values[row * self.width + column]);
        (1.0 - fy) * ((1.0 - fx) * value(row, column) + fx * value(row, right))
            + fy * ((1.0 - fx) * value(below, column) + fx * value(below, right))
    }

    /// The mean over squares of `factor` pixels; what is left over at the right and below is left out.
    fn shrunk(&self, factor: usize) -> Result<Self> {
        let (width, height) = (self.width / factor, self.height / factor);
        let mut values = memory::filled(0.0f32, width * height)?;
        for (row, out) in values.chunks_exact_mut(width).enumerate() {
            for line in self.values[row * factor * self.width..].chunks_exact(self.width).take(factor) {
                for (out, pixels) in out.iter_mut().zip(line.chunks_exact(factor)) {
                    *out += pixels.iter().sum::<f32>();
                }
            }
        }
        let share = 1.0 / (factor * factor) as f32;
        values.iter_mut().for_each(|value| *value *= share);
        Ok(Self { width, height, values })
    }
}

/// A tag that was found in a photo.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// Its place in [`Sheet::tags`].
    pub index: usize,
    /// Its corners as in [`Tag::corners`], in pixels; the upper left corner of the photo is the origin.
    pub corners: [[f64; 2]; 4],
    /// Points on the edges from each corner to the next, in pixels.
    pub edges: [Vec<[f64; 2]>; 4],
    /// Standard deviation of the blur across the edges, in pixels.
    pub blur: f64,
}

/// The tags of a sheet in a photo.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Detection {
    pub tags: Vec<Found>,
    /// Ids of tags that are in the photo more than once, and not among the others.
    pub doubled: Vec<usize>,
    /// How many tags are there as a mirror shows them.
    pub mirrored: usize,
}

/// Finds the tags of `sheet` in a photo.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled), [`Error::OutOfMemory`](crate::Error::OutOfMemory).
pub fn detect(photo: &Grey, sheet: &Sheet, cancel: &CancelToken) -> Result<Detection> {
    let factor = (photo.width.max(photo.height)).div_ceil(SEARCH_SIDE);
    if photo.width / factor < CELLS || photo.height / factor < CELLS {
        return Ok(Detection::default());
    }
    let mut small = photo.shrunk(factor)?;
    // Square roots are nearer to what the eye takes for contrast: shadows are seen.
    small.values.iter_mut().for_each(|value| *value = value.max(0.0).sqrt());
    let sums = Sums::new(&small)?;
    let mut seen: Vec<Candidate> = Vec::new();
    let mut mirrored = Vec::new();
    for neighbourhood in NEIGHBOURHOODS {
        cancel.check()?;
        let radius = (neighbourhood / 2.0 * small.width.max(small.height) as f64).ceil() as usize;
        for quadrilateral in quadrilaterals(&small, &sums, radius, cancel)? {
            match read(&small, &quadrilateral, sheet) {
                Some(Reading::Upright(candidate)) if !seen.iter().any(|other| other.is_same(&candidate)) => {
                    seen.push(candidate)
                }
                Some(Reading::Mirrored(candidate))
                    if !mirrored.iter().any(|other: &Candidate| other.is_same(&candidate)) =>
                {
                    mirrored.push(candidate);
                }
                _ => {}
            }
        }
    }
    let mut detection = Detection { mirrored: mirrored.len(), ..Detection::default() };
    for (index, tag) in sheet.tags.iter().enumerate() {
        let mut places = seen.iter().filter(|candidate| candidate.index == index);
        match (places.next(), places.next()) {
            (Some(candidate), None) => {
                let corners = candidate.corners.map(|corner| corner.map(|x| x * factor as f64));
                detection.tags.extend(measured(photo, index, corners));
            }
            (Some(_), Some(_)) => detection.doubled.push(tag.id),
            (None, _) => {}
        }
    }
    Ok(detection)
}

/// A tag before its edges are measured.
struct Candidate {
    index: usize,
    corners: [[f64; 2]; 4],
}

impl Candidate {
    fn is_same(&self, other: &Self) -> bool {
        let side = distance(self.corners[0], self.corners[1]);
        self.index == other.index && distance(center(&self.corners), center(&other.corners)) < 0.5 * side
    }
}

fn center(corners: &[[f64; 2]; 4]) -> [f64; 2] {
    [0, 1].map(|i| corners.iter().map(|corner| corner[i]).sum::<f64>() / 4.0)
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Sums over rectangles from the upper left.
struct Sums {
    width: usize,
    sums: Vec<f64>,
}

impl Sums {
    fn new(picture: &Grey) -> Result<Self> {
        let width = picture.width + 1;
        let mut sums = memory::filled(0.0, width * (picture.height + 1))?;
        for (row, values) in picture.values.chunks_exact(picture.width).enumerate() {
            let mut sum = 0.0;
            for (column, &value) in values.iter().enumerate() {
                sum += f64::from(value);
                sums[(row + 1) * width + column + 1] = sums[row * width + column + 1] + sum;
            }
        }
        Ok(Self { width, sums })
    }

    /// The mean over the pixels at most `radius` away along each axis.
    fn mean(&self, row: usize, column: usize, radius: usize) -> f64 {
        let height = self.sums.len() / self.width;
        let (top, bottom) = (row.saturating_sub(radius), (row + radius + 1).min(height - 1));
        let (left, right) = (column.saturating_sub(radius), (column + radius + 1).min(self.width - 1));
        let sum = |row: usize, column: usize| self.sums[row * self.width + column];
        let total = sum(bottom, right) - sum(top, right) - sum(bottom, left) + sum(top, left);
        total / ((bottom - top) * (right - left)) as f64
    }
}

/// The quadrilaterals that dark connected areas fill; their corners in the picture, clockwise.
fn quadrilaterals(picture: &Grey, sums: &Sums, radius: usize, cancel: &CancelToken) -> Result<Vec<[[f64; 2]; 4]>> {
    let (width, height) = (picture.width, picture.height);
    let mut dark = memory::filled(false, width * height)?;
    for (row, line) in dark.chunks_exact_mut(width).enumerate() {
        for (column, dark) in line.iter_mut().enumerate() {
            *dark = f64::from(picture.values[row * width + column]) < DARK * sums.mean(row, column, radius);
        }
    }
    let largest = SIDE_MAX * width.max(height) as f64;
    let mut found = Vec::new();
    let mut stack = Vec::new();
    // The first and the last column of each row of an area.
    let mut rows: Vec<[usize; 2]> = Vec::new();
    for start in 0..dark.len() {
        if !dark[start] {
            continue;
        }
        if start % width == 0 {
            cancel.check()?;
        }
        let first_row = start / width;
        rows.clear();
        dark[start] = false;
        stack.push(start);
        while let Some(p) = stack.pop() {
            let (row, column) = (p / width, p % width);
            // Areas are met at their first row.
            if row - first_row >= rows.len() {
                rows.resize(row - first_row + 1, [usize::MAX, 0]);
            }
            let span = &mut rows[row - first_row];
            *span = [span[0].min(column), span[1].max(column)];
            let neighbours = [
                (column > 0).then(|| p - 1),
                (column + 1 < width).then(|| p + 1),
                (row > 0).then(|| p - width),
                (row + 1 < height).then(|| p + width),
            ];
            for next in neighbours.into_iter().flatten() {
                if std::mem::take(&mut dark[next]) {
                    stack.push(next);
                }
            }
        }
        let left = rows.iter().map(|span| span[0]).min().unwrap_or(0);
        let right = rows.iter().map(|span| span[1]).max().unwrap_or(0);
        let (across, down) = ((right - left + 1) as f64, rows.len() as f64);
        let touches = left == 0 || right + 1 == width || first_row == 0 || first_row + rows.len() == height;
        if touches || across.min(down) < SIDE_MIN || across.max(down) > largest {
            continue;
        }
        let corners = rows.iter().enumerate().flat_map(|(i, &[left, right])| {
            let (top, bottom) = ((first_row + i) as f64, (first_row + i + 1) as f64);
            [[left as f64, top], [left as f64, bottom], [(right + 1) as f64, top], [(right + 1) as f64, bottom]]
        });
        found.extend(quadrilateral(&convex_hull(corners.collect())));
    }
    Ok(found)
}

/// The convex hull of points, clockwise as seen in a picture.
fn convex_hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    points.dedup();
    let half = |points: &mut dyn Iterator<Item = &[f64; 2]>| {
        let mut hull: Vec<[f64; 2]> = Vec::new();
        for &point in points {
            while hull.len() >= 2 && turn(hull[hull.len() - 2], hull[hull.len() - 1], point) <= 0.0 {
                hull.pop();
            }
            hull.push(point);
        }
        hull.pop();
        hull
    };
    let mut hull = half(&mut points.iter());
    hull.extend(half(&mut points.iter().rev()));
    hull
}

/// Twice the area of a triangle, above 0 if it goes round clockwise in a picture.
fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn area(polygon: &[[f64; 2]]) -> f64 {
    let next = |i: usize| polygon[(i + 1) % polygon.len()];
    polygon.iter().enumerate().map(|(i, a)| a[0] * next(i)[1] - a[1] * next(i)[0]).sum::<f64>() / 2.0
}

/// The four corners of a hull that is a quadrilateral but for jagged edges: corners that cut off least are left out one by one.
fn quadrilateral(hull: &[[f64; 2]]) -> Option<[[f64; 2]; 4]> {
    let whole = area(hull);
    let mut left = hull.to_vec();
    while left.len() > 4 {
        let cut = |i: usize| turn(left[(i + left.len() - 1) % left.len()], left[i], left[(i + 1) % left.len()]).abs();
        let least = (0..left.len()).min_by(|&a, &b| cut(a).total_cmp(&cut(b)))?;
        left.remove(least);
    }
    let corners: [[f64; 2]; 4] = left.try_into().ok()?;
    let shortest = (0..4).map(|i| distance(corners[i], corners[(i + 1) % 4])).fold(f64::INFINITY, f64::min);
    (area(&corners) >= QUADRILATERAL * whole && shortest >= SIDE_MIN / 2.0).then_some(corners)
}

enum Reading {
    Upright(Candidate),
    Mirrored(Candidate),
}

/// Reads the cells inside of a quadrilateral, and finds the tag that has them.
fn read(picture: &Grey, corners: &[[f64; 2]; 4], sheet: &Sheet) -> Option<Reading> {
    let side = CELLS as f64;
    let square = [[0.0, 0.0], [side, 0.0], [side, side], [0.0, side]];
    let pairs: Vec<_> = square.into_iter().zip(*corners).collect();
    let map = Homography::between(&pairs)?;
    // The mean over the middle of a cell.
    let cell = |row: isize, column: isize| {
        let mut sum = 0.0;
        for (dy, dx) in [(0.3, 0.3), (0.3, 0.7), (0.7, 0.3), (0.7, 0.7), (0.5, 0.5)] {
            let [x, y] = map.apply([column as f64 + dx, row as f64 + dy]);
            sum += picture.at(x, y) / 5.0;
        }
        sum
    };
    let last = CELLS as isize - 1;
    let ring = |from: isize, to: isize| {
        let along = move |i: isize| [(from, i), (i + 1, from), (to, i + 1), (i, to)];
        (from..to).flat_map(along).map(|(row, column)| cell(row, column))
    };
    let (black, white) = (median(ring(0, last))?, median(ring(-1, last + 1))?);
    let middle = (black + white) / 2.0;
    let is_readable = white - black > CONTRAST_MIN * white
        && ring(0, last).filter(|&value| value > middle).count() <= WRONG_BORDER_MAX;
    if !is_readable {
        return None;
    }
    let mut cells = [[false; DATA_CELLS]; DATA_CELLS];
    for (row, cells) in cells.iter_mut().enumerate() {
        for (column, white) in cells.iter_mut().enumerate() {
            *white = cell(row as isize + 1, column as isize + 1) > middle;
        }
    }
    for (index, tag) in sheet.tags.iter().enumerate() {
        for turns in 0..4 {
            // The corner that is the tag's upper left one.
            let turned =
                |mirrored: bool| std::array::from_fn(|i| corners[if mirrored { turns + 4 - i } else { turns + i } % 4]);
            if wrong_cells(tag, &cells, turns, false) <= WRONG_CELLS_MAX {
                return Some(Reading::Upright(Candidate { index, corners: turned(false) }));
            }
            if wrong_cells(tag, &cells, turns, true) <= WRONG_CELLS_MAX {
                return Some(Reading::Mirrored(Candidate { index, corners: turned(true) }));
            }
        }
    }
    None
}

/// How many of the cells that were read are not those of `tag`, whose upper left corner is corner `turns` of what was read, clockwise.
fn wrong_cells(tag: &Tag, cells: &[[bool; DATA_CELLS]; DATA_CELLS], turns: usize, mirrored: bool) -> u32 {
    let last = DATA_CELLS - 1;
    let mut wrong = 0;
    for row in 0..DATA_CELLS {
        for column in 0..DATA_CELLS {
            let (i, j) = if mirrored { (column, row) } else { (row, column) };
            let (i, j) = match turns {
                0 => (i, j),
                1 => (j, last - i),
                2 => (last - i, last - j),
                _ => (last - j, i),
            };
            wrong += u32::from(tag.is_white(row + 1, column + 1) != cells[i][j]);
        }
    }
    wrong
}

/// Measures the edges of a tag whose corners are known to a pixel or two of the picture that was searched.
fn measured(photo: &Grey, index: usize, mut corners: [[f64; 2]; 4]) -> Option<Found> {
    let mut edges: [Vec<[f64; 2]>; 4] = Default::default();
    let mut blur = 0.0;
    // The second time from the lines of the first.
    for _ in 0..2 {
        let around = [0, 1, 2, 3].map(|i| edge(photo, corners[i], corners[(i + 1) % 4]));
        let [Some(a), Some(b), Some(c), Some(d)] = around else { return None };
        let lines = [&a, &b, &c, &d].map(|(points, _)| Line::through(points));
        for i in 0..4 {
            corners[i] = lines[(i + 3) % 4].meet(&lines[i])?;
        }
        blur = median([a.1, b.1, c.1, d.1])?;
        edges = [a.0, b.0, c.0, d.0];
    }
    Some(Found { index, corners, edges, blur })
}

/// Points on the edge from `a` to `b`, black on the right, and its blur: where the light across it is half of what it is outside, by the area under the profile.
fn edge(photo: &Grey, a: [f64; 2], b: [f64; 2]) -> Option<(Vec<[f64; 2]>, f64)> {
    let length = distance(a, b);
    let along = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
    // To the left of the way around, which is clockwise: outwards.
    let out = [along[1], -along[0]];
    let reach = (REACH_CELLS * length / CELLS as f64).clamp(REACH_PIXELS.start, REACH_PIXELS.end);
    let steps = (2.0 * reach / EDGE_STEP).ceil() as usize;
    let step = 2.0 * reach / steps as f64;
    let (mut points, mut blurs) = (Vec::new(), Vec::new());
    for k in 0..EDGE_POINTS {
        let share = EDGE_SPAN.start + (EDGE_SPAN.end - EDGE_SPAN.start) * (k as f64 + 0.5) / EDGE_POINTS as f64;
        let middle = [0, 1].map(|i| a[i] + share * (b[i] - a[i]));
        let inside = |point: [f64; 2]| {
            (0.0..photo.width as f64).contains(&point[0]) && (0.0..photo.height as f64).contains(&point[1])
        };
        let place = |s: f64| [middle[0] + s * out[0], middle[1] + s * out[1]];
        if !inside(place(-reach)) || !inside(place(reach)) {
            continue;
        }
        let profile: Vec<f64> = (0..=steps)
            .map(|i| {
                let [x, y] = place(i as f64 * step - reach);
                photo.at(x, y)
            })
            .collect();
        // Levels from the outer fifths.
        let ends = (steps / 5).max(1);
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let (black, white) = (mean(&profile[..ends]), mean(&profile[profile.len() - ends..]));
        if white - black <= CONTRAST_MIN * white {
            continue;
        }
        let share = |i: usize| (profile[i] - black) / (white - black);
        let above = (0..steps).map(|i| (share(i) + share(i + 1)) / 2.0 * step).sum::<f64>();
        let at = reach - above;
        // The second moment of the slope.
        let moment: f64 =
            (0..steps).map(|i| (share(i + 1) - share(i)) * ((i as f64 + 0.5) * step - reach - at).powi(2)).sum();
        points.push(place(at));
        blurs.push(moment.max(0.0).sqrt());
    }
    if points.len() < EDGE_POINTS_MIN {
        return None;
    }
    for _ in 0..2 {
        let line = Line::through(&points);
        let spread =
            (points.iter().map(|&point| line.distance(point).powi(2)).sum::<f64>() / points.len() as f64).sqrt();
        points.retain(|&point| line.distance(point).abs() <= EDGE_OUTLIER * spread.max(0.05));
    }
    if points.len() < EDGE_POINTS_MIN {
        return None;
    }
    Some((points, median(blurs)?))
}

/// A line: the points p with `normal . p = offset`.
#[derive(Clone, Copy)]
pub struct Line {
    normal: [f64; 2],
    offset: f64,
}

impl Line {
    /// The line nearest to `points`, of which there are two or more.
    pub fn through(points: &[[f64; 2]]) -> Self {
        let count = points.len() as f64;
        let mean = [0, 1].map(|i| points.iter().map(|point| point[i]).sum::<f64>() / count);
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for point in points {
            let (x, y) = (point[0] - mean[0], point[1] - mean[1]);
            xx += x * x;
            xy += x * y;
            yy += y * y;
        }
        let (sin, cos) = (0.5 * (2.0 * xy).atan2(xx - yy)).sin_cos();
        let normal = [-sin, cos];
        Self { normal, offset: normal[0] * mean[0] + normal[1] * mean[1] }
    }

    pub fn distance(&self, point: [f64; 2]) -> f64 {
        self.normal[0] * point[0] + self.normal[1] * point[1] - self.offset
    }

    /// Where two lines meet; `None` if they are parallel.
    pub fn meet(&self, other: &Self) -> Option<[f64; 2]> {
        let determinant = self.normal[0] * other.normal[1] - self.normal[1] * other.normal[0];
        (determinant.abs() > 1e-3).then(|| {
            [
                (self.offset * other.normal[1] - self.normal[1] * other.offset) / determinant,
                (self.normal[0] * other.offset - self.offset * other.normal[0]) / determinant,
            ]
        })
    }
}
