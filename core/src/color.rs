//! Transfer functions between stored pixel values and linear radiance, and the primaries of linear values.

use serde::{Deserialize, Serialize};

use crate::image::Image;

/// Exponent of `gamma2.2`: of photos, of the codes of albedos and roughness, and of the codes in which errors are measured.
pub(crate) const GAMMA: f64 = 2.2;

/// How the pixel values of a photo file relate to linear radiance.
///
/// The function is always stated, never guessed: captures of the literature use gamma 2.2, cameras give sRGB or raw linear files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Transfer {
    /// `stored = linear^(1/2.2)`.
    #[serde(rename = "gamma2.2")]
    Gamma22,
    /// The piecewise curve of IEC 61966-2-1.
    Srgb,
    /// `stored = linear`.
    Linear,
}

impl Transfer {
    /// The name used on the command line and in every file: `gamma2.2`, `srgb` or `linear`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gamma22 => "gamma2.2",
            Self::Srgb => "srgb",
            Self::Linear => "linear",
        }
    }

    /// The inverse of [`Transfer::name`].
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Gamma22, Self::Srgb, Self::Linear].into_iter().find(|transfer| transfer.name() == name)
    }

    /// Linear value of a stored one. Negative values are kept for `Linear` and read as 0 otherwise.
    pub fn decode(self, stored: f32) -> f32 {
        match self {
            Self::Gamma22 => stored.max(0.0).powf(GAMMA as f32),
            Self::Srgb => single::srgb_decode(stored),
            Self::Linear => stored,
        }
    }

    /// Stored value of a linear one; the inverse of [`Transfer::decode`].
    pub fn encode(self, linear: f32) -> f32 {
        match self {
            Self::Gamma22 => linear.max(0.0).powf(1.0 / GAMMA as f32),
            Self::Srgb => single::srgb_encode(linear),
            Self::Linear => linear,
        }
    }
}

/// sRGB's curve (IEC 61966-2-1) for floats of one precision.
macro_rules! srgb_curve {
    ($precision:ident, $float:ty) => {
        pub(crate) mod $precision {
            /// Linear value of a stored one; of negative ones 0.
            pub fn srgb_decode(stored: $float) -> $float {
                if stored <= 0.04045 { stored.max(0.0) / 12.92 } else { ((stored + 0.055) / 1.055).powf(2.4) }
            }

            /// The inverse of [`srgb_decode`].
            pub fn srgb_encode(linear: $float) -> $float {
                if linear <= 0.003_130_8 { linear.max(0.0) * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
            }
        }
    };
}

srgb_curve!(single, f32);
srgb_curve!(double, f64);

/// The primaries and white point of linear RGB values in files.
///
/// Everything is computed in linear Rec. 709: photos (and their light) are converted when they are read, albedos when they are written. Rec. 709
/// lies within ACEScg, so that albedos in [0, 1] stay in [0, 1] when written; what is read may come out below 0 or above 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum ColorSpace {
    /// Rec. 709 primaries, white D65: those of sRGB, of most cameras' pictures and of the captures of the literature.
    #[default]
    Rec709,
    /// ACEScg: AP1 primaries, the ACES white (about D60).
    AcesCg,
}

impl ColorSpace {
    /// The name used on the command line and in every file: `rec709` or `acescg`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rec709 => "rec709",
            Self::AcesCg => "acescg",
        }
    }

    /// The inverse of [`ColorSpace::name`].
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Rec709, Self::AcesCg].into_iter().find(|space| space.name() == name)
    }

    /// The matrix that takes a linear RGB column vector of this space to `target`, white to white.
    ///
    /// # Source
    /// Rec. 709: ITU-R BT.709-6, items 1.3 and 1.4. AP1: SMPTE ST 2065-1 and S-2014-004, white x = 0.32168, y = 0.33767. Between the whites the
    /// Bradford adaptation (linear, complete). A test derives the numbers from these.
    pub fn matrix_to(self, target: Self) -> [[f64; 3]; 3] {
        match (self, target) {
            (Self::AcesCg, Self::Rec709) => ACESCG_TO_REC709,
            (Self::Rec709, Self::AcesCg) => REC709_TO_ACESCG,
            (Self::Rec709, Self::Rec709) | (Self::AcesCg, Self::AcesCg) => IDENTITY,
        }
    }

    /// Linear RGB of this space as linear RGB of `target`; not limited to any range.
    pub fn convert(self, target: Self, rgb: [f64; 3]) -> [f64; 3] {
        transformed(&self.matrix_to(target), rgb)
    }

    /// [`ColorSpace::convert`] for every pixel of an RGB image; other images are left as they are.
    pub fn convert_image(self, target: Self, image: &mut Image) {
        if self != target {
            apply_to_image(&self.matrix_to(target), image);
        }
    }

    /// Its primaries and white.
    pub(crate) fn chromaticities(self) -> Chromaticities {
        match self {
            Self::Rec709 => Chromaticities::REC709,
            Self::AcesCg => Chromaticities::AP1,
        }
    }
}

/// Where the primaries and the white of RGB values lie: CIE 1931 x and y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Chromaticities {
    /// Of red, green and blue.
    pub primaries: [[f64; 2]; 3],
    pub white: [f64; 2],
}

impl Chromaticities {
    /// ITU-R BT.709-6, items 1.3 and 1.4.
    pub const REC709: Self = Self { primaries: [[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]], white: [0.3127, 0.3290] };

    /// SMPTE ST 2065-1 and S-2014-004.
    pub const AP1: Self =
        Self { primaries: [[0.713, 0.293], [0.165, 0.830], [0.128, 0.044]], white: [0.32168, 0.33767] };

    /// Adobe RGB (1998) Color Image Encoding, 4.3.1.
    pub const ADOBE_RGB: Self = Self { primaries: [[0.64, 0.33], [0.21, 0.71], [0.15, 0.06]], white: [0.3127, 0.3290] };

    /// The matrix that takes linear RGB column vectors to Rec. 709, white to white by the Bradford adaptation; none where the numbers
    /// make no colours.
    pub fn to_rec709(self) -> Option<Matrix> {
        let whites = adaptation(xyz(self.white), xyz(Self::REC709.white));
        let matrix = product(&inverse(&Self::REC709.to_xyz()), &product(&whites, &self.to_xyz()));
        is_usable(&matrix).then_some(matrix)
    }

    /// RGB to XYZ: columns are the primaries, scaled so that RGB (1, 1, 1) is the white.
    fn to_xyz(self) -> Matrix {
        let columns = self.primaries.map(xyz);
        let unscaled = std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i]));
        let scale = transformed(&inverse(&unscaled), xyz(self.white));
        std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i] * scale[j]))
    }
}

/// The matrix from XYZ relative to the white D50 of ICC profiles to linear Rec. 709.
pub(crate) fn d50_to_rec709() -> Matrix {
    // ICC.1:2022, 7.2.16.
    let d50 = [0.9642, 1.0, 0.8249];
    product(&inverse(&Chromaticities::REC709.to_xyz()), &adaptation(d50, xyz(Chromaticities::REC709.white)))
}

/// Linear and complete Bradford adaptation between two whites, both XYZ.
fn adaptation(from: [f64; 3], to: [f64; 3]) -> Matrix {
    const BRADFORD: Matrix = [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]];
    let (from, to) = (transformed(&BRADFORD, from), transformed(&BRADFORD, to));
    let gains = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { to[i] / from[i] } else { 0.0 }));
    product(&inverse(&BRADFORD), &product(&gains, &BRADFORD))
}

pub(crate) type Matrix = [[f64; 3]; 3];

pub(crate) fn product(a: &Matrix, b: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

/// Whether no entry differs by more than `tolerance`.
pub(crate) fn is_close(a: &Matrix, b: &Matrix, tolerance: f64) -> bool {
    a.iter().flatten().zip(b.iter().flatten()).all(|(a, b)| (a - b).abs() <= tolerance)
}

/// Whether a matrix between colour spaces is one of numbers that colours can have; those of primaries on a line are huge or not finite.
pub(crate) fn is_usable(matrix: &Matrix) -> bool {
    matrix.iter().flatten().all(|entry| entry.abs() < 1e4)
}

/// Takes every pixel of an RGB image through `matrix`; other images are left as they are.
pub(crate) fn apply_to_image(matrix: &Matrix, image: &mut Image) {
    if image.channels() == 3 {
        for pixel in image.data_mut().as_chunks_mut().0 {
            *pixel = transformed(matrix, pixel.map(f64::from)).map(|value| value as f32);
        }
    }
}

fn transformed(matrix: &Matrix, v: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

fn xyz([x, y]: [f64; 2]) -> [f64; 3] {
    [x / y, 1.0, (1.0 - x - y) / y]
}

fn minor(m: &Matrix, i: usize, j: usize) -> f64 {
    let (a, b, c, d) = ((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3);
    m[a][c] * m[b][d] - m[a][d] * m[b][c]
}

/// By cofactors; not finite where there is none.
fn inverse(m: &Matrix) -> Matrix {
    let determinant: f64 = (0..3).map(|j| m[0][j] * minor(m, 0, j)).sum();
    std::array::from_fn(|i| std::array::from_fn(|j| minor(m, j, i) / determinant))
}

const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

const ACESCG_TO_REC709: [[f64; 3]; 3] = [
    [1.705_050_992_657_983_3, -0.621_792_120_657_004_7, -0.083_258_872_000_978_67],
    [-0.130_256_417_507_043_47, 1.140_804_736_575_401_5, -0.010_548_319_068_358_007],
    [-0.024_003_356_804_618_126, -0.128_968_976_064_970_63, 1.152_972_332_869_588_7],
];

const REC709_TO_ACESCG: [[f64; 3]; 3] = [
    [0.613_097_402_401_187_6, 0.339_523_146_184_105_7, 0.047_379_451_414_706_68],
    [0.070_193_722_469_581_73, 0.916_353_879_057_344_1, 0.013_452_398_473_074_1],
    [0.020_615_592_882_226_974, 0.109_569_772_938_135_48, 0.869_814_634_179_637_6],
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_values() {
        // IEC 61966-2-1: 18 % grey is stored as 0.4614; gamma 2.2 stores 0.5 for 0.5^2.2 = 0.21764.
        assert!((Transfer::Srgb.encode(0.18) - 0.461_356).abs() < 1e-5);
        assert!((Transfer::Gamma22.decode(0.5) - 0.217_637_64).abs() < 1e-6);
    }

    #[test]
    fn decode_inverts_encode() {
        for transfer in [Transfer::Gamma22, Transfer::Srgb, Transfer::Linear] {
            for i in 0..=1000 {
                let linear = i as f32 / 500.0;
                let back = transfer.decode(transfer.encode(linear));
                assert!((back - linear).abs() < 1e-5 * linear.max(0.1), "{transfer:?} {linear} {back}");
            }
            assert_eq!(Transfer::from_name(transfer.name()), Some(transfer));
        }
    }

    #[test]
    fn matrices_follow_from_primaries_and_whites() {
        let to_rec709 = Chromaticities::AP1.to_rec709().unwrap();
        assert!(is_close(&ColorSpace::AcesCg.matrix_to(ColorSpace::Rec709), &to_rec709, 1e-14));
        assert!(is_close(&ColorSpace::Rec709.matrix_to(ColorSpace::AcesCg), &inverse(&to_rec709), 1e-14));
        assert_eq!(ColorSpace::AcesCg.matrix_to(ColorSpace::AcesCg), IDENTITY);
        assert!(is_close(&Chromaticities::REC709.to_rec709().unwrap(), &IDENTITY, 1e-14));
        // The luminance of the primaries of BT.709 is in the standard to four digits.
        for (got, expected) in Chromaticities::REC709.to_xyz()[1].iter().zip([0.2126, 0.7152, 0.0722]) {
            assert!((got - expected).abs() < 5e-5);
        }
        // The colorants of the profile that IEC 61966-2-1 publishes for sRGB, relative to D50, to its four digits.
        let colorants = [[0.4361, 0.3851, 0.1431], [0.2225, 0.7169, 0.0606], [0.0139, 0.0971, 0.7141]];
        assert!(is_close(&product(&d50_to_rec709(), &colorants), &IDENTITY, 5e-4));
    }

    #[test]
    fn numbers_that_make_no_colors() {
        let line = Chromaticities { primaries: [[0.2, 0.2], [0.3, 0.3], [0.4, 0.4]], white: [0.3127, 0.3290] };
        assert_eq!(line.to_rec709(), None);
        for broken in [0.0, f64::NAN, f64::INFINITY] {
            assert_eq!(Chromaticities { white: [0.3, broken], ..Chromaticities::REC709 }.to_rec709(), None);
            let mut primaries = Chromaticities::REC709.primaries;
            primaries[1][1] = broken;
            assert_eq!(Chromaticities { primaries, ..Chromaticities::REC709 }.to_rec709(), None);
        }
    }

    #[test]
    fn rec709_lies_within_acescg() {
        let matrix = ColorSpace::Rec709.matrix_to(ColorSpace::AcesCg);
        assert!(matrix.iter().flatten().all(|&entry| entry > 0.0));
        for row in matrix {
            assert!((row.iter().sum::<f64>() - 1.0).abs() < 1e-15);
        }
        for space in [ColorSpace::Rec709, ColorSpace::AcesCg] {
            assert_eq!(ColorSpace::from_name(space.name()), Some(space));
        }
    }
}
