//! White paper and grey patches in a photo.

use super::geometry::Homography;
use super::light::{self, Paper};
use super::rectify::Part;
use super::sheet::{Sheet, Tag};
use super::tags::Found;
use crate::cancel::CancelToken;
use crate::color::double::srgb_encode;
use crate::error::Result;
use crate::io::Stored;
use crate::io::profile::Decoding;

use super::camera::Place;

/// Share of the white between two tags, and of a grey patch, that is looked at.
const PAPER_SHARE: f64 = 0.4;
const GREY_SHARE: f64 = 0.5;
/// Points along a side of what is looked at.
const POINTS: usize = 5;

/// A place of paper, or on a grey patch, as a photo shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// Where it is on the sheet.
    pub at: [f64; 2],
    /// The grey patch; `None` for white.
    pub grey: Option<usize>,
    /// Its mean, as the file's curve says, in the file's own primaries.
    pub value: [f64; 3],
}

/// The paper between neighbouring tags, and the grey patches, without what is saturated or black. Where they are is known from the tags alone, to a pixel or two.
pub fn measured(
    photo: &Stored,
    decoding: &Decoding,
    sheet: &Sheet,
    tags: &[Found],
    cancel: &CancelToken,
) -> Result<Vec<Measured>> {
    let on = tags.iter().flat_map(|tag| sheet.tags[tag.index].corners.into_iter().zip(tag.corners));
    let Some(map) = Homography::between(&on.collect::<Vec<_>>()) else { return Ok(Vec::new()) };
    let mut found = Vec::new();
    for (at, half, grey) in places(sheet) {
        let share = |i: usize| half * (2.0 * i as f64 / (POINTS - 1) as f64 - 1.0);
        let place = |i: usize| map.apply([at[0] + share(i % POINTS), at[1] + share(i / POINTS)]);
        let pixels: Vec<[f64; 2]> = (0..POINTS * POINTS).map(place).collect();
        if !pixels.iter().flatten().all(|x| x.is_finite()) {
            continue;
        }
        let Some(part) = Part::around(photo, decoding, None, &pixels, cancel)? else { continue };
        let colors: Vec<([f64; 3], u8)> = pixels.iter().map(|&pixel| part.at(pixel)).collect();
        let value = [0, 1, 2].map(|c| colors.iter().map(|(color, _)| color[c]).sum::<f64>() / colors.len() as f64);
        if colors.iter().all(|(_, saturated)| *saturated == 0) && value.iter().all(|value| *value > 0.0) {
            found.push(Measured { at, grey, value });
        }
    }
    Ok(found)
}

/// Middles of what is looked at, half its side, and the grey patch that it is on.
fn places(sheet: &Sheet) -> Vec<([f64; 2], f64, Option<usize>)> {
    let center = |tag: &Tag| [0, 1].map(|i| tag.corners.iter().map(|corner| corner[i]).sum::<f64>() / 4.0);
    let white = sheet.tags.iter().enumerate().map(|(i, tag)| {
        let (a, b) = (center(tag), center(&sheet.tags[(i + 1) % sheet.tags.len()]));
        let gap = (a[0] - b[0]).hypot(a[1] - b[1]) - sheet.tag_side();
        ([0, 1].map(|k| (a[k] + b[k]) / 2.0), PAPER_SHARE * gap / 2.0, None)
    });
    // The last patch is white paper.
    let grey = |i: usize| (i < light::GREYS).then_some(i);
    let greys = sheet.greys.iter().enumerate().map(|(i, &at)| (at, GREY_SHARE * sheet.grey_side / 2.0, grey(i)));
    white.chain(greys).collect()
}

/// What was measured, as the light's estimate takes it: in the frame of a camera whose picture was turned by so many quarters afterwards. `dark` is what was measured without
/// flash, and how much longer this photo was exposed.
pub fn papers(measured: &[Measured], dark: Option<(&[Measured], f64)>, place: &Place, quarter_turns: u8) -> Vec<Paper> {
    let normal = [0, 1, 2].map(|i| place.rotation[i][2]);
    let without = |at: [f64; 2]| {
        let (dark, share) = dark?;
        dark.iter().find(|dark| dark.at == at).map(|dark| (dark.value.map(srgb_encode), share))
    };
    let paper = |measured: &Measured| {
        let (dark, dark_share) = without(measured.at).unwrap_or_default();
        Paper {
            code: measured.value.map(srgb_encode),
            dark,
            dark_share,
            grey: measured.grey,
            point: turned_back(place.apply([measured.at[0], measured.at[1], 0.0]), quarter_turns),
            normal: turned_back(normal, quarter_turns),
        }
    };
    measured.iter().map(paper).collect()
}

/// A vector of the frame of a turned picture (x right, y down) in the frame of the picture as it was taken.
pub fn turned_back(vector: [f64; 3], quarter_turns: u8) -> [f64; 3] {
    (0..quarter_turns % 4).fold(vector, |[x, y, z], _| [y, -x, z])
}

/// The inverse of [`turned_back`].
pub fn turned(vector: [f64; 3], quarter_turns: u8) -> [f64; 3] {
    (0..quarter_turns % 4).fold(vector, |[x, y, z], _| [-y, x, z])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_that_was_turned_clockwise_has_its_right_below() {
        assert_eq!(turned([1.0, 0.0, 5.0], 1), [-0.0, 1.0, 5.0]);
        for turns in 0..4 {
            assert_eq!(turned_back(turned([1.0, 2.0, 3.0], turns), turns), [1.0, 2.0, 3.0]);
        }
    }

    #[test]
    fn what_is_looked_at_is_no_tag() {
        let sheet = Sheet::new(100.0).unwrap();
        let places = places(&sheet);
        assert_eq!((places.len(), places.iter().filter(|place| place.2.is_none()).count()), (24, 17));
        for (at, half, _) in places {
            for tag in &sheet.tags {
                let [[left, top], _, [right, bottom], _] = tag.corners;
                let apart = at[0] + half < left || at[0] - half > right || at[1] + half < bottom || at[1] - half > top;
                assert!(apart, "{at:?} {half} {tag:?}");
            }
        }
    }
}
