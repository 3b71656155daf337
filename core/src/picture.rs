//! A picture to draw on: lines, dots, images and words, in values for the screen.

use crate::color::Transfer;
use crate::error::Result;
use crate::font;
use crate::image::Image;
use crate::memory;

/// A colour for the screen, 0 to 1.
pub type Color = [f32; 3];

/// A linear value as a screen shows it.
pub fn on_screen(value: f32) -> f32 {
    Transfer::Srgb.encode(value).clamp(0.0, 1.0)
}

/// By what letters are enlarged.
const FONT_SCALE: usize = 2;
/// Columns from one letter to the next, and rows of a line of text.
pub const LETTER: usize = (font::WIDTH + 1) * FONT_SCALE;
pub const TEXT_LINE: usize = (font::HEIGHT + 4) * FONT_SCALE;

/// The picture.
pub struct Picture {
    image: Image,
}

impl Picture {
    /// A picture of one colour.
    pub fn new(width: usize, height: usize, background: Color) -> Result<Self> {
        let values = memory::collected(3 * width * height, background.into_iter().cycle().take(3 * width * height))?;
        Ok(Self { image: Image::new(width, height, 3, values)? })
    }

    pub fn into_image(self) -> Image {
        self.image
    }

    /// A pixel; `None` beside the picture.
    fn pixel(&mut self, x: isize, y: isize) -> Option<&mut [f32]> {
        let (width, height) = (self.image.width() as isize, self.image.height() as isize);
        let inside = (0..width).contains(&x) && (0..height).contains(&y);
        let start = 3 * (y * width + x);
        inside.then(|| &mut self.image.data_mut()[start as usize..start as usize + 3])
    }

    /// Mixes `share` of a colour into a pixel; nothing happens beside the picture.
    fn mix(&mut self, x: isize, y: isize, color: Color, share: f32) {
        for (value, color) in self.pixel(x, y).into_iter().flatten().zip(color) {
            *value += share * (color - *value);
        }
    }

    /// Gives a pixel a colour; nothing happens beside the picture.
    fn put(&mut self, x: usize, y: usize, color: &[f32]) {
        if let Some(pixel) = self.pixel(x as isize, y as isize) {
            pixel.copy_from_slice(color);
        }
    }

    /// Mixes a colour into pixels by their distance from something, which is solid up to `radius` and reaches over `bounds`: left, top, right and bottom.
    fn blend(&mut self, bounds: [f64; 4], radius: f64, color: Color, distance: impl Fn([f64; 2]) -> f64) {
        let limit = |value: f64, end: usize| value.clamp(-1.0, end as f64 + 1.0) as isize;
        let (width, height) = (self.image.width(), self.image.height());
        let reach = radius + 1.0;
        for y in limit((bounds[1] - reach).floor(), height)..limit((bounds[3] + reach).ceil(), height) {
            for x in limit((bounds[0] - reach).floor(), width)..limit((bounds[2] + reach).ceil(), width) {
                let share = (radius + 0.5 - distance([x as f64 + 0.5, y as f64 + 0.5])).clamp(0.0, 1.0);
                if share > 0.0 {
                    self.mix(x, y, color, share as f32);
                }
            }
        }
    }

    /// A straight line.
    pub fn line(&mut self, a: [f64; 2], b: [f64; 2], width: f64, color: Color) {
        let along = [b[0] - a[0], b[1] - a[1]];
        let length2 = along[0] * along[0] + along[1] * along[1];
        if !length2.is_finite() {
            return;
        }
        let bounds = [a[0].min(b[0]), a[1].min(b[1]), a[0].max(b[0]), a[1].max(b[1])];
        self.blend(bounds, width / 2.0, color, |[x, y]| {
            let share = if length2 > 0.0 { ((x - a[0]) * along[0] + (y - a[1]) * along[1]) / length2 } else { 0.0 };
            let share = share.clamp(0.0, 1.0);
            (x - a[0] - share * along[0]).hypot(y - a[1] - share * along[1])
        });
    }

    /// Lines from each point to the next, and back to the first.
    pub fn outline(&mut self, points: &[[f64; 2]], width: f64, color: Color) {
        for (i, &point) in points.iter().enumerate() {
            self.line(point, points[(i + 1) % points.len()], width, color);
        }
    }

    /// A full circle.
    pub fn dot(&mut self, [x, y]: [f64; 2], radius: f64, color: Color) {
        self.blend([x, y, x, y], radius, color, |at| (at[0] - x).hypot(at[1] - y));
    }

    /// A cross of two slanted lines.
    pub fn cross(&mut self, [x, y]: [f64; 2], size: f64, color: Color) {
        self.line([x - size, y - size], [x + size, y + size], 2.5, color);
        self.line([x - size, y + size], [x + size, y - size], 2.5, color);
    }

    /// A full rectangle, its upper left corner at (x, y).
    pub fn area(&mut self, [x, y]: [usize; 2], [width, height]: [usize; 2], color: Color) {
        for row in y..y + height {
            for column in x..x + width {
                self.put(column, row, &color);
            }
        }
    }

    /// An image of three channels, its upper left corner at (x, y).
    pub fn image(&mut self, image: &Image, [x, y]: [usize; 2]) {
        for (row, pixels) in image.data().chunks_exact(3 * image.width()).enumerate() {
            for (column, pixel) in pixels.chunks_exact(3).enumerate() {
                self.put(x + column, y + row, pixel);
            }
        }
    }

    /// A line of text from (x, y), its upper left corner; what is longer than `width` pixels is cut off.
    pub fn text(&mut self, [x, y]: [usize; 2], width: usize, text: &str, color: Color) {
        for (i, character) in text.chars().take(width / LETTER).enumerate() {
            for row in 0..font::HEIGHT * FONT_SCALE {
                for column in 0..font::WIDTH * FONT_SCALE {
                    if font::is_set(character, row / FONT_SCALE, column / FONT_SCALE) {
                        self.put(x + i * LETTER + column, y + row, &color);
                    }
                }
            }
        }
    }
}

/// Text in lines of at most `width` pixels, broken between words.
pub fn wrapped(text: &str, width: usize) -> Vec<String> {
    let most = (width / LETTER).max(1);
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        // Longer than a line: nothing to break it at.
        let word: String = word.chars().take(most).collect();
        let line = lines.last().map_or(0, |line| line.chars().count());
        if line > 0 && line + 1 + word.chars().count() > most {
            lines.push(String::new());
        }
        if let Some(line) = lines.last_mut() {
            if !line.is_empty() {
                line.push(' ');
            }
            line.push_str(&word);
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(picture: &Picture, x: usize, y: usize) -> Color {
        let start = 3 * (y * picture.image.width() + x);
        std::array::from_fn(|c| picture.image.data()[start + c])
    }

    #[test]
    fn lines_and_dots_are_where_they_should_be() {
        let mut picture = Picture::new(40, 30, [0.0; 3]).unwrap();
        picture.line([5.0, 10.5], [35.0, 10.5], 3.0, [1.0, 0.5, 0.0]);
        assert_eq!([at(&picture, 20, 9), at(&picture, 20, 10), at(&picture, 20, 11)], [[1.0, 0.5, 0.0]; 3]);
        assert_eq!([at(&picture, 20, 7), at(&picture, 20, 13), at(&picture, 38, 10)], [[0.0; 3]; 3]);
        picture.dot([20.0, 22.0], 3.0, [0.0, 1.0, 1.0]);
        assert_eq!(at(&picture, 20, 22), [0.0, 1.0, 1.0]);
        assert_eq!(at(&picture, 20, 27), [0.0; 3]);
        // Beside the picture there is nothing.
        picture.dot([-50.0, 400.0], 3.0, [1.0; 3]);
        picture.line([f64::NAN, 0.0], [f64::INFINITY, 3.0], 2.0, [1.0; 3]);
        picture.line([-1e9, 5.0], [1e9, 5.0], 1.0, [1.0; 3]);
        assert_eq!(at(&picture, 0, 4)[0] + at(&picture, 0, 5)[0], 1.0);
    }

    #[test]
    fn text_is_broken_between_words() {
        assert_eq!(wrapped("take one photo from here", 10 * LETTER), ["take one", "photo from", "here"]);
        assert_eq!(wrapped("abcdefghijkl m", 5 * LETTER), ["abcde", "m"]);
        assert_eq!(wrapped("", 100), [""]);
    }
}
