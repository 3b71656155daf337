//! Photos without a sheet: the corners of the sample's square patch are known in each of them.

use super::AcquireOptions;
use crate::error::{Error, Result};

/// The smallest and the largest patch, in millimetres.
const WIDTH: std::ops::RangeInclusive<f64> = 1.0..=10_000.0;
/// A square patch of the sample and where its corners are in every photo.
#[derive(Clone, Debug, PartialEq)]
pub struct Corners {
    width: f64,
    photos: Vec<[[f64; 2]; 4]>,
}

impl Corners {
    /// A patch `width` millimetres wide. `photos` are, for each photo, its upper left, upper right, lower right and lower left corner: in pixels from the photo's
    /// upper left corner, x to the right and y down, in the photo as viewers show it (turned as its EXIF data ask).
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] for a width below 1 mm or above 10 m, and for corners that are not clockwise around a convex quadrilateral.
    pub fn new(width: f64, photos: Vec<[[f64; 2]; 4]>) -> Result<Self> {
        if !WIDTH.contains(&width) {
            let (low, high) = (WIDTH.start(), WIDTH.end());
            return Err(Error::invalid("patch_width", format!("expected {low} mm to {high} mm, got {width} mm")));
        }
        for (index, corners) in photos.iter().enumerate() {
            let turn = |i: usize| {
                let [a, b, c] = [0, 1, 2].map(|k| corners[(i + k) % 4]);
                (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
            };
            if !corners.iter().flatten().all(|x| x.is_finite()) || !(0..4).all(|i| turn(i) > 0.0) {
                let reason = format!(
                    "of photo {index}: expected x,y of the upper left corner and on clockwise around a convex quadrilateral, got {corners:?}"
                );
                return Err(Error::invalid("corners", reason));
            }
        }
        Ok(Self { width, photos })
    }

    /// Width of the patch in millimetres.
    pub fn width(&self) -> f64 {
        self.width
    }

    /// Of each photo, the patch's corners in pixels, clockwise from the upper left.
    pub fn photos(&self) -> &[[[f64; 2]; 4]] {
        &self.photos
    }

    /// Whether they are those of so many photos, and nothing is asked for that only a sheet tells.
    pub(super) fn check(&self, photos: usize, options: &AcquireOptions) -> Result<()> {
        if self.photos.len() != photos {
            let got = format!("expected those of each of the {photos} photos, got those of {}", self.photos.len());
            return Err(Error::invalid("corners", got));
        }
        if options.light_offset.is_none() {
            return Err(Error::invalid(
                "light_offset",
                "expected where the flash is: without a sheet it cannot be found, got auto",
            ));
        }
        if let Some(dark) = &options.dark {
            let reason = format!("is for photos of a sheet: expected none beside corners, got {}", dark.display());
            return Err(Error::invalid("dark", reason));
        }
        if options.depth != 0.0 {
            let reason = format!("corners are the sample's own: expected 0 beside them, got {}", options.depth);
            return Err(Error::invalid("depth", reason));
        }
        Ok(())
    }

    /// The corners in the plane of the patch, whose middle is the origin.
    pub(super) fn on_patch(&self) -> [[f64; 2]; 4] {
        let half = self.width / 2.0;
        [[-half, half], [half, half], [half, -half], [-half, -half]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: [[f64; 2]; 4] = [[10.0, 10.0], [90.0, 12.0], [95.0, 80.0], [8.0, 85.0]];

    #[test]
    fn corners_are_clockwise_and_of_every_photo() {
        let corners = Corners::new(96.0, vec![SQUARE; 2]).unwrap();
        let options = AcquireOptions::of_corners(corners.clone());
        assert_eq!(corners.on_patch()[0], [-48.0, 48.0]);
        assert!(corners.check(2, &options).is_ok());
        let said = |result: Result<()>| result.unwrap_err().to_string();
        assert!(said(corners.check(3, &options)).ends_with("each of the 3 photos, got those of 2"));
        let of = |change: fn(&mut AcquireOptions)| {
            let mut options = options.clone();
            change(&mut options);
            said(corners.check(2, &options))
        };
        assert!(of(|options| options.light_offset = None).starts_with("light_offset: "));
        assert!(of(|options| options.depth = 1.0).ends_with("got 1"));
        assert!(of(|options| options.dark = Some("dark.png".into())).ends_with("got dark.png"));
        let mut counterclockwise = SQUARE;
        counterclockwise.reverse();
        let mut crossed = SQUARE;
        crossed.swap(1, 2);
        let mut absent = SQUARE;
        absent[3][0] = f64::NAN;
        for wrong in [counterclockwise, crossed, absent, [[5.0; 2]; 4]] {
            let message = Corners::new(96.0, vec![SQUARE, wrong]).unwrap_err().to_string();
            assert!(message.starts_with("corners: of photo 1: expected x,y of the upper left corner"), "{message}");
        }
        assert!(Corners::new(0.0, vec![SQUARE]).unwrap_err().to_string().ends_with("1 mm to 10000 mm, got 0 mm"));
    }
}
