//! Where the tags of a printed sheet are.
//!
//! A sheet's frame is in millimetres: the centre of its window is the origin, x right, y up.

use crate::error::{Error, Result};

/// Cells along the side of a tag's black square: six of data and a black border of one.
pub const CELLS: usize = 8;
/// Cells of data along a side.
pub const DATA_CELLS: usize = CELLS - 2;

/// The first 32 codes of the family 36h11, row by row from the upper left, the first cell in the highest of 36 bits; 1 is white.
///
/// # Source
/// Olson, "AprilTag: A robust and flexible visual fiducial system", ICRA 2011, and the authors' generator for 36h11: codes are steps of 982,451,653.
const CODES: [u64; 32] = [
    0xd5d628584,
    0xd97f18b49,
    0xdd280910e,
    0xe479e9c98,
    0xebcbca822,
    0xf31dab3ac,
    0x056a5d085,
    0x10652e1d4,
    0x22b1dfead,
    0x265ad0472,
    0x34fe91b86,
    0x3ff962cd5,
    0x43a25329a,
    0x474b4385f,
    0x4e9d243e9,
    0x5246149ae,
    0x5997f5538,
    0x683bb6c4c,
    0x6be4a7211,
    0x7e3158eea,
    0x81da494af,
    0x858339a74,
    0x8cd51a5fe,
    0x9f21cc2d7,
    0xa2cabc89c,
    0xadc58d9eb,
    0xb16e7dfb0,
    0xb8c05eb3a,
    0xd25ef139d,
    0xd607e1962,
    0xe4aba3076,
    0x2dde6a3da,
];

/// Tags along a side of the ring, with those at its corners.
const TAGS_PER_SIDE: usize = 5;
const TAGS: usize = 4 * (TAGS_PER_SIDE - 1);
/// The first tag of our own sheets: the other kind has 0 to 15.
const OWN_FIRST_ID: usize = 16;
/// Side of a tag of our own sheets, and the white between tags and window, as shares of the window.
const OWN_TAG: f64 = 0.2;
const OWN_GAP: f64 = 0.07;
/// Share of the window that is left out along each side of our own sheets: edges that were cut by hand, and their shadow.
const OWN_MARGIN: f64 = 0.02;

/// The bar that tells whether a print is true to scale, in millimetres, and how long it may come out.
pub const BAR: f64 = 100.0;
const PRINTED_BAR: std::ops::RangeInclusive<f64> = 50.0..=200.0;

/// From the ring of tags of our own sheets down to a row of grey patches, in millimetres; the side of a patch, and the patches as shares of white.
pub const BELOW: f64 = 5.0;
pub const GREY_SIDE: f64 = 9.0;
pub const GREYS: [f64; 8] = [0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0];

/// The smallest and the largest window, in millimetres.
const WINDOW: std::ops::RangeInclusive<f64> = 20.0..=1000.0;

/// One tag of a sheet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tag {
    /// Its number in the family 36h11.
    pub id: usize,
    /// Upper left, upper right, lower right and lower left corner of its black square, in millimetres.
    pub corners: [[f64; 2]; 4],
}

impl Tag {
    /// Whether the cell in this row and column of the black square is white.
    pub fn is_white(&self, row: usize, column: usize) -> bool {
        is_white(CODES[self.id], row, column)
    }
}

fn is_white(code: u64, row: usize, column: usize) -> bool {
    let data = 1..=DATA_CELLS;
    data.contains(&row) && data.contains(&column) && {
        let place = (row - 1) * DATA_CELLS + column - 1;
        code >> (DATA_CELLS * DATA_CELLS - 1 - place) & 1 == 1
    }
}

/// A printed sheet: tags around a square window.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Sheet {
    /// Its tags, clockwise from the upper left.
    pub tags: Vec<Tag>,
    /// Width of the window, in millimetres.
    pub window: f64,
    /// Width of the square in the window's middle that is captured, in millimetres.
    pub patch: f64,
    /// The middles of its grey patches, from black to white, and the side of one.
    pub(crate) greys: Vec<[f64; 2]>,
    pub(crate) grey_side: f64,
}

impl Sheet {
    /// Our own sheet with a window of this width in millimetres: sixteen tags from 16 on around it.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] for a window below 20 mm or above 1 m.
    pub fn new(window: f64) -> Result<Self> {
        check_width("window", window)?;
        let tag = OWN_TAG * window;
        let pitch = (window + 2.0 * OWN_GAP * window + tag) / (TAGS_PER_SIDE - 1) as f64;
        let tags = ring(OWN_FIRST_ID, tag, pitch);
        let y = -(tags[0].corners[0][1] + BELOW + GREY_SIDE / 2.0);
        let greys = (0..GREYS.len()).map(|i| [GREY_SIDE * (i as f64 + 0.5 - GREYS.len() as f64 / 2.0), y]).collect();
        Ok(Self { tags, window, patch: (1.0 - 2.0 * OWN_MARGIN) * window, greys, grey_side: GREY_SIDE })
    }

    /// The frame of svbrdf-diff-renderer: sixteen tags from 0 on, two tag sides from one to the next, `frame_width` millimetres from outer edge to outer edge.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] for a frame below 20 mm or above 1 m.
    pub fn tags16(frame_width: f64) -> Result<Self> {
        check_width("frame_width", frame_width)?;
        let tag = frame_width / (2 * TAGS_PER_SIDE - 1) as f64;
        let window = 7.0 * tag;
        let tags = ring(0, tag, 2.0 * tag);
        Ok(Self { tags, window, patch: window - 0.5 * tag, greys: Vec::new(), grey_side: GREY_SIDE })
    }

    /// The sheet as a printer scaled it: the bar of 100 mm came out `length` millimetres long.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] for a bar below 50 mm or above 200 mm.
    pub fn with_printed_bar(self, length: f64) -> Result<Self> {
        if !PRINTED_BAR.contains(&length) {
            let (low, high) = (PRINTED_BAR.start(), PRINTED_BAR.end());
            let reason = format!("expected the printed length of {BAR} mm, {low} mm to {high} mm, got {length} mm");
            return Err(Error::invalid("printed_bar", reason));
        }
        let factor = length / BAR;
        let scale = |tag: Tag| Tag { corners: tag.corners.map(|corner| corner.map(|x| x * factor)), ..tag };
        let tags = self.tags.into_iter().map(scale).collect();
        let greys = self.greys.into_iter().map(|at| at.map(|x| x * factor)).collect();
        let (window, patch, grey_side) = (self.window * factor, self.patch * factor, self.grey_side * factor);
        Ok(Self { tags, window, patch, greys, grey_side })
    }

    /// Side of a tag.
    pub(crate) fn tag_side(&self) -> f64 {
        self.tags[0].corners[1][0] - self.tags[0].corners[0][0]
    }

    /// Half the width from outer edge to outer edge.
    pub(crate) fn half_width(&self) -> f64 {
        self.tags[0].corners[0][1]
    }
}

fn check_width(name: &str, width: f64) -> Result<()> {
    if WINDOW.contains(&width) {
        return Ok(());
    }
    let (low, high) = (WINDOW.start(), WINDOW.end());
    Err(Error::invalid(name, format!("expected {low} mm to {high} mm, got {width} mm")))
}

/// Tags clockwise from the upper left, their centres on a square.
fn ring(first_id: usize, side: f64, pitch: f64) -> Vec<Tag> {
    let steps = TAGS_PER_SIDE - 1;
    let half = pitch * steps as f64 / 2.0;
    let tag = |i: usize| {
        let along = pitch * (i % steps) as f64 - half;
        let [x, y] = [[along, half], [half, -along], [-along, -half], [-half, along]][i / steps];
        let corner = |right: f64, up: f64| [x + right * side / 2.0, y + up * side / 2.0];
        Tag { id: first_id + i, corners: [corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0), corner(-1.0, -1.0)] }
    };
    (0..TAGS).map(tag).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A code turned by quarter turns.
    fn turned(code: u64, turns: usize) -> u64 {
        (0..turns).fold(code, |code, _| {
            let cells = (0..36).map(|place| is_white(code, 6 - place % 6, place / 6 + 1));
            cells.fold(0, |turned, white| turned << 1 | u64::from(white))
        })
    }

    #[test]
    fn codes_are_of_the_family() {
        for (i, &code) in CODES.iter().enumerate() {
            // Steps of the generator, and the distance that the family is named for, in any turn.
            let is_steps_from = |before: u64| (1..32).any(|steps| (before + steps * 982_451_653) % (1 << 36) == code);
            assert!(i == 0 || is_steps_from(CODES[i - 1]), "{i}");
            for (j, &other) in CODES.iter().enumerate().take(i + 1) {
                for turns in 0..4 {
                    let distance = (turned(code, turns) ^ other).count_ones();
                    assert!(distance >= 11 || (i == j && turns == 0), "{i} {j} {turns}: {distance}");
                }
            }
        }
        assert_eq!(turned(CODES[0], 4), CODES[0]);
    }

    #[test]
    fn our_sheet() {
        let sheet = Sheet::new(100.0).unwrap();
        assert_eq!(sheet.tags.len(), 16);
        assert_eq!(sheet.tags.iter().map(|tag| tag.id).collect::<Vec<_>>(), (16..32).collect::<Vec<_>>());
        assert!((sheet.tag_side() - 20.0).abs() < 1e-9 && (sheet.half_width() - 77.0).abs() < 1e-9);
        assert_eq!(sheet.tags[0].corners[0], [-77.0, 77.0]);
        assert_eq!(sheet.patch, 96.0);
        // The fifth is at the upper right, the ninth at the lower right, and nothing reaches into the window.
        assert!(sheet.tags[4].corners[1][0] > 76.9 && sheet.tags[4].corners[1][1] > 76.9);
        assert!(sheet.tags[8].corners[2][0] > 76.9 && sheet.tags[8].corners[2][1] < -76.9);
        let farthest = |corner: &[f64; 2]| corner[0].abs().max(corner[1].abs());
        assert!(sheet.tags.iter().flat_map(|tag| &tag.corners).all(|corner| farthest(corner) > 56.9));
        let halved = Sheet::new(100.0).unwrap().with_printed_bar(50.0).unwrap();
        assert_eq!(halved.tags, Sheet::new(50.0).unwrap().tags);
        assert_eq!((halved.window, halved.patch, halved.grey_side), (50.0, 48.0, 4.5));
        assert_eq!((halved.greys[0], sheet.greys[7]), ([-15.75, -43.25], [31.5, -86.5]));
        let message = Sheet::new(50.0).unwrap().with_printed_bar(9.8).unwrap_err().to_string();
        assert!(message.starts_with("printed_bar: ") && message.ends_with("50 mm to 200 mm, got 9.8 mm"), "{message}");
        let message = Sheet::new(5.0).unwrap_err().to_string();
        assert!(message.contains("window") && message.contains("20 mm") && message.contains("got 5 mm"), "{message}");
    }

    #[test]
    fn the_frame_of_svbrdf_diff_renderer() {
        let sheet = Sheet::tags16(170.0).unwrap();
        let tag = 170.0 / 9.0;
        assert!((sheet.tag_side() - tag).abs() < 1e-9 && (sheet.half_width() - 85.0).abs() < 1e-9);
        assert!((sheet.patch - 6.5 * tag).abs() < 1e-9);
        // Tag 5 is the second on the right.
        assert!((sheet.tags[5].corners[0][0] - (85.0 - tag)).abs() < 1e-9);
        assert!((sheet.tags[5].corners[0][1] - (85.0 - 2.0 * tag)).abs() < 1e-9);
        assert!((sheet.tags[13].corners[3][1] - (-85.0 + 2.0 * tag)).abs() < 1e-9);
    }
}
