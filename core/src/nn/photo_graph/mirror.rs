//! Mirror images of a capture: what a network makes of them tells of the same surface, so that their mean errs less than one of them.

use crate::raw::NORMAL;
use crate::shot::Shot;

/// Which sides of a capture change places before a network sees it. Its prediction is mirrored back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mirror {
    /// Left and right.
    pub x: bool,
    /// Top and bottom.
    pub y: bool,
}

impl Mirror {
    /// The capture as it is, and its mirror images.
    pub const IMAGES: [Self; 4] = [
        Self { x: false, y: false },
        Self { x: true, y: false },
        Self { x: false, y: true },
        Self { x: true, y: true },
    ];

    /// Where camera and light stand in the mirror.
    pub(super) fn shot(self, shot: &Shot) -> Shot {
        let mirrored = |[x, y, z]: [f64; 3]| [if self.x { -x } else { x }, if self.y { -y } else { y }, z];
        Shot { camera: mirrored(shot.camera), light: mirrored(shot.light), ..*shot }
    }

    /// Which of `count` rows is seen at `row`.
    pub(super) fn row(self, row: usize, count: usize) -> usize {
        if self.y { count - 1 - row } else { row }
    }

    /// Which of `count` columns is seen at `column`.
    pub(super) fn column(self, column: usize, count: usize) -> usize {
        if self.x { count - 1 - column } else { column }
    }

    /// Mirrors planes of rows of `width` values back.
    pub(super) fn undo(self, planes: &mut [f32], height: usize, width: usize) {
        for plane in planes.chunks_exact_mut(height * width) {
            if self.y {
                let (top, bottom) = plane.split_at_mut(height / 2 * width);
                top.chunks_exact_mut(width)
                    .zip(bottom.rchunks_exact_mut(width))
                    .for_each(|(a, b)| a.swap_with_slice(b));
            }
            if self.x {
                plane.chunks_exact_mut(width).for_each(<[f32]>::reverse);
            }
        }
    }

    /// [`Mirror::undo`] of nine raw planes: what leaned to a side that changed places leans to the other.
    pub(super) fn undo_raw(self, raw: &mut [f32], height: usize, width: usize) {
        self.undo(raw, height, width);
        for (axis, _) in [self.x, self.y].into_iter().enumerate().filter(|(_, mirrored)| *mirrored) {
            raw[(NORMAL + axis) * height * width..][..height * width].iter_mut().for_each(|value| *value = -*value);
        }
    }
}
