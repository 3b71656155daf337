//! Sheets as PDF and SVG, true to scale.

use std::fmt::Write;

use super::sheet::{BAR, BELOW, CELLS, GREY_SIDE, GREYS, Sheet};
use crate::error::{Error, Result};

/// A format of paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Paper {
    /// 210 x 297 mm.
    A4,
    /// 8.5 x 11 inches.
    Letter,
    /// 297 x 420 mm.
    A3,
}

impl Paper {
    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::A4 => "a4",
            Self::Letter => "letter",
            Self::A3 => "a3",
        }
    }

    /// Width and height in millimetres.
    pub const fn size(self) -> [f64; 2] {
        match self {
            Self::A4 => [210.0, 297.0],
            Self::Letter => [215.9, 279.4],
            Self::A3 => [297.0, 420.0],
        }
    }
}

/// Paper that printers leave white, in millimetres.
const MARGIN: f64 = 10.0;
/// What everything below the row of greys and it need.
const FOOT: f64 = 88.0;
const TEXT: f64 = 3.6;
const LINE: f64 = 0.25;
const MM_PER_POINT: f64 = 25.4 / 72.0;

const INSTRUCTIONS: [&str; 5] = [
    "1. Print at 100 % on matt paper. The bar must be 100 mm long: if not, give its length with --printed-bar.",
    "2. Cut out the window. Lay the sheet flat on the surface, the arrow away from you. Darken the room.",
    "3. Flash on, HDR and zoom off. All tags in every picture, in focus, from about 25 cm:",
    "4. one photo from straight above, six to eight from around it, leaning by 20 to 30 degrees.",
    "5. svbrdf-gcn fit *.jpg -o my-material",
];

/// What is drawn, in millimetres from the upper left of the page, y down.
enum Shape {
    /// Areas of one grey, 0 black to 1 white, filled together.
    Area(Vec<Vec<[f64; 2]>>, f64),
    /// A line of text, where its base line begins.
    Text([f64; 2], f64, String),
}

impl Sheet {
    /// The sheet as a PDF file of one page.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] if the window does not fit on the paper.
    pub fn to_pdf(&self, paper: Paper) -> Result<Vec<u8>> {
        Ok(pdf(&self.shapes(paper)?, paper))
    }

    /// The sheet as an SVG file.
    ///
    /// # Errors
    /// As [`Sheet::to_pdf`].
    pub fn to_svg(&self, paper: Paper) -> Result<String> {
        Ok(svg(&self.shapes(paper)?, paper))
    }

    /// Everything on the page.
    fn shapes(&self, paper: Paper) -> Result<Vec<Shape>> {
        let [width, height] = paper.size();
        let half = self.half_width();
        // A white border of one cell belongs to the tags.
        let free = (width - 2.0 * MARGIN).min(height - 2.0 * MARGIN - BELOW - FOOT);
        let needed = 2.0 * half;
        if needed > free {
            let largest = (self.window * free / needed).floor();
            let reason =
                format!("expected at most {largest} mm, which fits on {}, got {} mm", paper.name(), self.window);
            return Err(Error::invalid("window", reason));
        }
        let (center_x, center_y) = (width / 2.0, MARGIN + BELOW + half);
        let place = |[x, y]: [f64; 2]| [center_x + x, center_y - y];
        let mut shapes = Vec::new();
        for tag in &self.tags {
            shapes.push(Shape::Area(vec![tag.corners.map(place).to_vec()], 0.0));
            let [x, y] = place(tag.corners[0]);
            let cell = self.tag_side() / CELLS as f64;
            let mut white = Vec::new();
            for row in 0..CELLS {
                for column in (0..CELLS).filter(|&column| tag.is_white(row, column)) {
                    white.push(rectangle([x + column as f64 * cell, y + row as f64 * cell], [cell, cell]));
                }
            }
            shapes.push(Shape::Area(white, 1.0));
        }
        // The window, and the arrow that says which way is up.
        let [left, top] = place([-self.window / 2.0, self.window / 2.0]);
        shapes.push(Shape::Area(frame([left, top], [self.window; 2], LINE), 0.5));
        let arrow = [[0.0, -0.04], [0.02, -0.015], [-0.02, -0.015]];
        let arrow = arrow.map(|[x, y]| [center_x + x * self.window, top + y * self.window]);
        shapes.push(Shape::Area(vec![arrow.to_vec()], 0.35));
        self.foot(&mut shapes, [center_x, center_y + half + BELOW]);
        Ok(shapes)
    }

    /// Greys, bar, instructions and drawing, from `top` down.
    fn foot(&self, shapes: &mut Vec<Shape>, [center, top]: [f64; 2]) {
        let first = center - GREY_SIDE * GREYS.len() as f64 / 2.0;
        for (i, &grey) in GREYS.iter().enumerate() {
            let at = [first + i as f64 * GREY_SIDE, top];
            shapes.push(Shape::Area(vec![rectangle(at, [GREY_SIDE; 2])], grey));
        }
        shapes.push(Shape::Area(frame([first, top], [GREY_SIDE * GREYS.len() as f64, GREY_SIDE], LINE), 0.5));
        let bar = top + GREY_SIDE + 5.0;
        shapes.push(Shape::Area(vec![rectangle([center - BAR / 2.0, bar], [BAR, 2.0])], 0.0));
        let text = format!(
            "100 mm          window {} mm, tags {} to {}",
            self.window,
            self.tags[0].id,
            self.tags[self.tags.len() - 1].id
        );
        shapes.push(Shape::Text([center - BAR / 2.0, bar + 6.5], TEXT, text));
        let left = center - 95.0;
        for (i, line) in INSTRUCTIONS.iter().enumerate() {
            let base_line = bar + 14.0 + i as f64 * 1.45 * TEXT;
            shapes.push(Shape::Text([left, base_line], 0.92 * TEXT, (*line).to_owned()));
        }
        drawing(shapes, [center, bar + 14.0 + 1.45 * TEXT * INSTRUCTIONS.len() as f64 + 29.0]);
    }
}

/// A side view: the surface, the sheet on it, and telephones above, the one in the middle upright.
fn drawing(shapes: &mut Vec<Shape>, [center, ground]: [f64; 2]) {
    shapes.push(Shape::Area(vec![rectangle([center - 24.0, ground], [48.0, 2.0])], 0.8));
    for side in [-1.0, 1.0] {
        let from = if side < 0.0 { -22.0 } else { 9.0 };
        shapes.push(Shape::Area(vec![rectangle([center + from, ground - 0.8], [13.0, 0.8])], 0.0));
    }
    for lean in [-28f64, 0.0, 28.0] {
        let (sin, cos) = lean.to_radians().sin_cos();
        let turn = |[x, y]: [f64; 2]| [center + x * cos - y * sin, ground - 0.8 + x * sin + y * cos];
        let ray = |x: f64| vec![turn([-0.1, -22.0]), turn([0.1, -22.0]), turn([x + 0.1, -1.0]), turn([x - 0.1, -1.0])];
        shapes.push(Shape::Area(vec![ray(-9.0), ray(9.0)], 0.6));
        let body = [[-6.0, -24.0], [6.0, -24.0], [6.0, -22.5], [-6.0, -22.5]].map(turn);
        shapes.push(Shape::Area(vec![body.to_vec()], 0.2));
    }
}

fn rectangle([x, y]: [f64; 2], [width, height]: [f64; 2]) -> Vec<[f64; 2]> {
    vec![[x, y], [x + width, y], [x + width, y + height], [x, y + height]]
}

/// The outline of a rectangle; `line` is its width, centred.
fn frame([x, y]: [f64; 2], [width, height]: [f64; 2], line: f64) -> Vec<Vec<[f64; 2]>> {
    let (x, y, across, down) = (x - line / 2.0, y - line / 2.0, width + line, height + line);
    vec![
        rectangle([x, y], [across, line]),
        rectangle([x, y + height], [across, line]),
        rectangle([x, y], [line, down]),
        rectangle([x + width, y], [line, down]),
    ]
}

/// A PDF file: its objects, and where each of them begins.
fn pdf(shapes: &[Shape], paper: Paper) -> Vec<u8> {
    let [width, height] = paper.size().map(|mm| mm / MM_PER_POINT);
    // Millimetres from the upper left.
    let mut content = format!("{:.6} 0 0 {:.6} 0 {height:.4} cm\n", 1.0 / MM_PER_POINT, -1.0 / MM_PER_POINT);
    for shape in shapes {
        match shape {
            Shape::Area(areas, grey) => {
                put(&mut content, format_args!("{grey} g\n"));
                for area in areas {
                    for (i, [x, y]) in area.iter().enumerate() {
                        put(&mut content, format_args!("{x:.4} {y:.4} {} ", if i == 0 { "m" } else { "l" }));
                    }
                    content += "h\n";
                }
                content += "f\n";
            }
            // The page is turned upside down, so the letters are turned back.
            Shape::Text([x, y], size, text) => {
                let escaped = text.replace('\\', "\\\\").replace('(', "\\(").replace(')', "\\)");
                put(&mut content, format_args!("0 g BT /F1 {size} Tf 1 0 0 -1 {x:.4} {y:.4} Tm ({escaped}) Tj ET\n"));
            }
        }
    }
    let objects = [
        // Viewers are asked not to scale what they print.
        "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>".to_owned(),
        "<< /Type /Pages /Kids [3 0 R] /Count 1 >>".to_owned(),
        format!(
            "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.4} {height:.4}] /Contents 4 0 R /Resources << /Font << /F1 5 0 R >> >> >>"
        ),
        format!("<< /Length {} >>\nstream\n{content}endstream", content.len()),
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>".to_owned(),
    ];
    let mut file = String::from("%PDF-1.6\n");
    let mut places = String::new();
    for (i, object) in objects.iter().enumerate() {
        put(&mut places, format_args!("{:010} 00000 n \n", file.len()));
        put(&mut file, format_args!("{} 0 obj\n{object}\nendobj\n", i + 1));
    }
    let (table, count) = (file.len(), objects.len() + 1);
    put(
        &mut file,
        format_args!(
            "xref\n0 {count}\n0000000000 65535 f \n{places}trailer\n<< /Size {count} /Root 1 0 R >>\nstartxref\n{table}\n%%EOF\n"
        ),
    );
    file.into_bytes()
}

fn svg(shapes: &[Shape], paper: Paper) -> String {
    let [width, height] = paper.size();
    let mut file = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" viewBox=\"0 0 {width} {height}\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n"
    );
    for shape in shapes {
        match shape {
            Shape::Area(areas, grey) => {
                let code = (grey * 255.0).round();
                put(&mut file, format_args!("<path fill=\"rgb({code},{code},{code})\" d=\""));
                for area in areas {
                    for (i, [x, y]) in area.iter().enumerate() {
                        put(&mut file, format_args!("{}{x:.4} {y:.4}", if i == 0 { "M" } else { "L" }));
                    }
                    file += "Z";
                }
                file += "\"/>\n";
            }
            Shape::Text([x, y], size, text) => {
                let escaped = text.replace('&', "&amp;").replace('<', "&lt;");
                put(
                    &mut file,
                    format_args!(
                        "<text x=\"{x:.4}\" y=\"{y:.4}\" font-size=\"{size}\" font-family=\"Helvetica, Arial, sans-serif\" xml:space=\"preserve\">{escaped}</text>\n"
                    ),
                );
            }
        }
    }
    file += "</svg>\n";
    file
}

/// Appends to a string.
fn put(text: &mut String, arguments: std::fmt::Arguments<'_>) {
    // That cannot fail.
    let _ = text.write_fmt(arguments);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_of_a_pdf_are_where_its_table_says() {
        let file = String::from_utf8(Sheet::new(100.0).unwrap().to_pdf(Paper::A4).unwrap()).unwrap();
        let start: usize = file.lines().rev().nth(1).unwrap().parse().unwrap();
        assert!(file[start..].starts_with("xref\n0 6\n"));
        for (i, line) in file[start..].lines().skip(3).take(5).enumerate() {
            let place: usize = line[..10].parse().unwrap();
            assert!(file[place..].starts_with(&format!("{} 0 obj\n", i + 1)), "{line}");
        }
        assert!(file.contains("/MediaBox [0 0 595.2756 841.8898]"), "A4 in points");
        let stream = file.find("stream\n").unwrap() + 7;
        let length: usize =
            file[..stream].rsplit("/Length ").next().unwrap().split(' ').next().unwrap().parse().unwrap();
        assert!(file[stream + length..].starts_with("endstream"));
    }

    #[test]
    fn what_does_not_fit_is_refused_with_what_does() {
        for paper in [Paper::A4, Paper::Letter, Paper::A3] {
            let message = Sheet::new(300.0).unwrap().to_pdf(paper).unwrap_err().to_string();
            assert!(message.contains(paper.name()) && message.contains("got 300 mm"), "{message}");
            let largest: f64 = message.split("at most ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
            assert!(largest >= 100.0, "{message}");
            Sheet::new(largest).unwrap().to_svg(paper).unwrap();
        }
    }

    #[test]
    fn nothing_lies_outside_of_the_page() {
        for (paper, window) in [(Paper::A4, 100.0), (Paper::Letter, 100.0), (Paper::A3, 150.0), (Paper::A4, 20.0)] {
            let [width, height] = paper.size();
            for shape in Sheet::new(window).unwrap().shapes(paper).unwrap() {
                let points = match &shape {
                    Shape::Area(areas, _) => areas.concat(),
                    // A letter of Helvetica is half as wide as high.
                    Shape::Text([x, y], size, text) => vec![[*x, *y], [x + 0.5 * size * text.len() as f64, y - size]],
                };
                for [x, y] in points {
                    assert!(
                        (5.0..width - 5.0).contains(&x) && (5.0..height - 5.0).contains(&y),
                        "{x} {y} on {paper:?}"
                    );
                }
            }
        }
    }
}
