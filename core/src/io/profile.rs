//! What files say of their colours (ICC profiles, PNG's chunks, chromaticities of OpenEXR), and how stored values become linear
//! Rec. 709 by that and by what the capture states.

use std::sync::Arc;

use moxcms::{
    ColorProfile, DataColorSpace, Layout, ParametricCurve, ProfileText, RenderingIntent, ToneReprCurve,
    TransformF32Executor, TransformOptions,
};

use crate::color::{Chromaticities, ColorSpace, Matrix, Transfer, d50_to_rec709, is_close, is_usable, product};

/// Curves that differ by less everywhere are taken as the same where the transfer function is stated: sRGB's and gamma 2.2 differ by 0.008.
const SAME_CURVE: f32 = 0.02;

/// Profiles of sRGB come in many roundings: what differs by less is sRGB.
const SAME_AS_SRGB: f32 = 0.003;

/// Entries of matrices to Rec. 709 that differ by less are the same: chromaticities come in three decimals.
const SAME_PRIMARIES: f64 = 0.003;

/// What a file says of its colours.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum FileColors {
    /// The bytes of an ICC profile.
    Icc(Vec<u8>),
    /// Code points of ITU-T H.273, as in PNG's `cICP`: primaries and transfer function.
    CodePoints { primaries: u8, transfer: u8 },
    /// Chromaticities, and the exponent that decodes stored values where there is one.
    Chromaticities { chromaticities: Chromaticities, gamma: Option<f32>, source: &'static str },
}

/// What a capture says of its photos' colours.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stated {
    pub transfer: Transfer,
    /// None where neither the capture nor the caller says anything.
    pub color_space: Option<ColorSpace>,
    /// What files say counts for nothing.
    pub ignore_profiles: bool,
}

/// The curve of one channel, from stored to linear values.
type Curve = Arc<dyn Fn(f32) -> f32 + Send + Sync>;

#[derive(Clone)]
enum Curves {
    Transfer(Transfer),
    Separate([Curve; 3]),
    /// A profile's table of colours, to linear values in the primaries of `TABLE_SPACE`.
    Table(Arc<TransformF32Executor>),
}

/// How stored values become linear Rec. 709.
#[derive(Clone)]
pub(crate) struct Decoding {
    curves: Curves,
    /// Applied to linear values last; none where they are Rec. 709 already.
    pub to_rec709: Option<Matrix>,
}

/// What a file says, understood.
struct Understood {
    /// For messages.
    name: String,
    /// None where the file says nothing of it.
    curves: Option<Curves>,
    to_rec709: Matrix,
}

impl Decoding {
    /// By the transfer function alone.
    pub fn transfer(transfer: Transfer) -> Self {
        Self { curves: Curves::Transfer(transfer), to_rec709: None }
    }

    /// By what is stated, and by what the file says where nothing is; with a note where the file's word counted or contradicts.
    ///
    /// With the transfer function sRGB a file's own curve counts, since that is what programs show: a photo in Display P3 is a photo
    /// in sRGB to whoever looks at it. With another one stated, primaries count where the curve is the stated one.
    ///
    /// # Errors
    /// The reason, if nothing that is read can be made of the file's values: PQ and HLG.
    pub fn new(stated: Stated, colors: Option<&FileColors>, channels: usize) -> Result<(Self, Option<String>), String> {
        let Stated { transfer, color_space, ignore_profiles } = stated;
        let plain = Self {
            curves: Curves::Transfer(transfer),
            to_rec709: (color_space == Some(ColorSpace::AcesCg))
                .then(|| ColorSpace::AcesCg.matrix_to(ColorSpace::Rec709)),
        };
        let Some(colors) = colors.filter(|_| !ignore_profiles) else { return Ok((plain, None)) };
        if let FileColors::CodePoints { transfer: code @ (16 | 18), .. } = colors {
            let name = if *code == 16 { "PQ" } else { "HLG" };
            return Err(format!(
                "a picture in {name} (HDR video); read are SDR pictures: convert it to OpenEXR, or read its values as they are with ignore_profiles"
            ));
        }
        let file = match colors.understood(channels) {
            Ok(file) => file,
            Err(reason) => return Ok((plain, Some(format!("{reason}; read as {}", transfer.name())))),
        };
        let name = &file.name;
        let space = color_space.unwrap_or_default();
        let primaries = space.matrix_to(ColorSpace::Rec709);
        let same_primaries = channels == 1 || is_close(&file.to_rec709, &primaries, SAME_PRIMARIES);
        let apart = file.curves.as_ref().map_or(0.0, |curves| curves.distance(transfer));
        if color_space.is_some() {
            let contradicts = !same_primaries || apart > SAME_CURVE;
            let note = format!("{name} not used: {} in {} is stated", transfer.name(), space.name());
            return Ok((plain, contradicts.then_some(note)));
        }
        if transfer == Transfer::Srgb {
            if same_primaries && apart <= SAME_AS_SRGB {
                return Ok((plain, None));
            }
            let curves = file.curves.unwrap_or(Curves::Transfer(transfer));
            let decoding = Self { curves, to_rec709: (channels == 3).then_some(file.to_rec709) };
            return Ok((decoding, Some(format!("converted to Rec. 709 by {name}"))));
        }
        if apart > SAME_CURVE {
            return Ok((plain, Some(format!("{name} not used: the photo is read as {}", transfer.name()))));
        }
        if same_primaries {
            return Ok((plain, None));
        }
        let decoding = Self { to_rec709: Some(file.to_rec709), ..plain };
        Ok((decoding, Some(format!("converted to Rec. 709 by {name}"))))
    }

    /// Whether all channels have the same curve.
    pub fn is_uniform(&self) -> bool {
        !matches!(self.curves, Curves::Separate(_))
    }

    /// The value that a stored one of channel `channel` stands for; linear after [`Decoding::finish`].
    pub fn value(&self, channel: usize, stored: f32) -> f32 {
        match &self.curves {
            Curves::Transfer(transfer) => transfer.decode(stored),
            Curves::Separate(curves) => curves[channel](stored),
            Curves::Table(_) => stored,
        }
    }

    /// Makes a row of values of three channels linear, where their curves are not those of single channels.
    pub fn finish(&self, row: &mut [f32]) {
        if let Curves::Table(table) = &self.curves {
            let source = row.to_vec();
            // Both have the same length, a multiple of three: the one thing that is checked.
            if table.transform(&source, row).is_err() {
                row.fill(f32::NAN);
            }
        }
    }
}

impl Curves {
    /// How far the curves lie from `transfer` at most.
    fn distance(&self, transfer: Transfer) -> f32 {
        const STEPS: usize = 64;
        let values = (0..=STEPS).map(|i| i as f32 / STEPS as f32);
        match self {
            Self::Transfer(own) => values.map(|v| (own.decode(v) - transfer.decode(v)).abs()).fold(0.0, f32::max),
            Self::Separate(curves) => values
                .flat_map(|v| curves.iter().map(move |curve| (curve(v) - transfer.decode(v)).abs()))
                .fold(0.0, f32::max),
            Self::Table(_) => f32::INFINITY,
        }
    }
}

impl FileColors {
    /// Fails with the reason for the user.
    fn understood(&self, channels: usize) -> Result<Understood, String> {
        match self {
            // The parser meets hostile files; what it stumbles over is no profile.
            Self::Icc(bytes) => std::panic::catch_unwind(|| understood_icc(bytes, channels))
                .unwrap_or_else(|_| Err("a colour profile that is broken".to_owned())),
            &Self::CodePoints { primaries, transfer } => {
                let name = format!("cICP {primaries}, {transfer}");
                let unknown = || format!("{name}, which is not known");
                let chromaticities = of_code_point(primaries).ok_or_else(unknown)?;
                let curve: Curve = match transfer {
                    1 | 6 | 14 | 15 => Arc::new(bt709_decode),
                    4 => power(2.2),
                    5 => power(2.8),
                    8 => Arc::new(|v| v),
                    13 => Arc::new(|v| Transfer::Srgb.decode(v)),
                    _ => return Err(unknown()),
                };
                let to_rec709 = chromaticities.to_rec709().ok_or_else(unknown)?;
                Ok(Understood {
                    name,
                    curves: Some(Curves::Separate([curve.clone(), curve.clone(), curve])),
                    to_rec709,
                })
            }
            Self::Chromaticities { chromaticities, gamma, source } => {
                let to_rec709 = chromaticities.to_rec709().ok_or_else(|| format!("{source} that make no colours"))?;
                let curves = gamma.map(|gamma| Curves::Separate([power(gamma), power(gamma), power(gamma)]));
                Ok(Understood { name: (*source).to_owned(), curves, to_rec709 })
            }
        }
    }
}

fn power(gamma: f32) -> Curve {
    Arc::new(move |v| v.max(0.0).powf(gamma))
}

/// ITU-R BT.709-6, item 1.2, inverted.
fn bt709_decode(v: f32) -> f32 {
    if v < 0.081 { v.max(0.0) / 4.5 } else { ((v + 0.099) / 1.099).powf(1.0 / 0.45) }
}

/// The primaries of ITU-T H.273, table 2.
fn of_code_point(primaries: u8) -> Option<Chromaticities> {
    let d65 = [0.3127, 0.3290];
    let (primaries, white) = match primaries {
        1 => return Some(Chromaticities::REC709),
        5 => ([[0.64, 0.33], [0.29, 0.60], [0.15, 0.06]], d65),
        6 | 7 => ([[0.630, 0.340], [0.310, 0.595], [0.155, 0.070]], d65),
        9 => ([[0.708, 0.292], [0.170, 0.797], [0.131, 0.046]], d65),
        11 => ([[0.680, 0.320], [0.265, 0.690], [0.150, 0.060]], [0.314, 0.351]),
        12 => ([[0.680, 0.320], [0.265, 0.690], [0.150, 0.060]], d65),
        _ => return None,
    };
    Some(Chromaticities { primaries, white })
}

fn understood_icc(bytes: &[u8], channels: usize) -> Result<Understood, String> {
    let profile = ColorProfile::new_from_slice(bytes).map_err(|e| format!("a colour profile that is broken ({e})"))?;
    let name = format!("the colour profile {:?}", description(&profile));
    let unused = |why: &str| format!("{name} cannot be used ({why})");
    let linear = |curve: &Option<ToneReprCurve>| {
        let curve = curve.as_ref().ok_or_else(|| unused("it has no curves"))?;
        let curve = curve_of(curve).filter(|curve| (0..=256).all(|i| (0.0..=2.0).contains(&curve(i as f32 / 256.0))));
        curve.ok_or_else(|| unused("its curves are broken"))
    };
    // White to white, where the profile has a table for that; else the one that every profile of tables has.
    let intent = match (&profile.lut_a_to_b_colorimetric, &profile.lut_a_to_b_perceptual) {
        (Some(_), _) => Some(RenderingIntent::RelativeColorimetric),
        (None, Some(_)) => Some(RenderingIntent::Perceptual),
        (None, None) => None,
    };
    match (profile.color_space, channels, intent) {
        (DataColorSpace::Gray, 1, _) => {
            let curve = linear(&profile.gray_trc)?;
            let to_rec709 = ColorSpace::Rec709.matrix_to(ColorSpace::Rec709);
            Ok(Understood { name, curves: Some(Curves::Separate([curve.clone(), curve.clone(), curve])), to_rec709 })
        }
        (DataColorSpace::Rgb, 3, Some(rendering_intent)) => {
            // A linear space that is wide enough for whatever a table holds.
            let wide = ColorProfile::new_aces_aces_2065_1_linear();
            let options = TransformOptions { rendering_intent, ..TransformOptions::default() };
            let table = profile.create_transform_f32(Layout::Rgb, &wide, Layout::Rgb, options);
            let table = table.map_err(|e| unused(&e.to_string()))?;
            Ok(Understood { name, curves: Some(Curves::Table(table)), to_rec709: colorants_to_rec709(&wide) })
        }
        (DataColorSpace::Rgb, _, None) => {
            let curves = [linear(&profile.red_trc)?, linear(&profile.green_trc)?, linear(&profile.blue_trc)?];
            let to_rec709 = colorants_to_rec709(&profile);
            if !is_usable(&to_rec709) {
                return Err(unused("its primaries make no colours"));
            }
            Ok(Understood { name, curves: Some(Curves::Separate(curves)), to_rec709 })
        }
        (space, ..) => Err(unused(&format!("it is one of {space:?} for a photo of {channels} channels"))),
    }
}

/// The curve of a profile; moxcms evaluates them too, but 0 to a power is not 0 there.
///
/// # Source
/// ICC.1:2022, 10.6 and 10.18.
fn curve_of(curve: &ToneReprCurve) -> Option<Curve> {
    match curve {
        ToneReprCurve::Lut(values) => match values.as_slice() {
            [] => Some(Arc::new(|v| v)),
            &[gamma] => Some(power(f32::from(gamma) / 256.0)),
            _ => {
                let values = values.clone();
                let last = values.len() - 1;
                Some(Arc::new(move |v| {
                    let place = v.clamp(0.0, 1.0) * last as f32;
                    let below = (place as usize).min(last - 1);
                    let (low, high) = (f32::from(values[below]), f32::from(values[below + 1]));
                    (low + (place - below as f32) * (high - low)) / 65535.0
                }))
            }
        },
        ToneReprCurve::Parametric(parameters) if parameters.is_empty() => None,
        ToneReprCurve::Parametric(parameters) => {
            let ParametricCurve { g, a, b, c, d, e, f } = ParametricCurve::new(parameters)?;
            Some(Arc::new(move |v| if v < d { c * v + f } else { (a * v + b).max(0.0).powf(g) + e }))
        }
    }
}

/// Of linear values, by the primaries of a profile, which are relative to D50.
fn colorants_to_rec709(profile: &ColorProfile) -> Matrix {
    product(&d50_to_rec709(), &profile.colorant_matrix().v)
}

fn description(profile: &ColorProfile) -> String {
    let text = match &profile.description {
        Some(ProfileText::PlainString(text)) => text.as_str(),
        Some(ProfileText::Localizable(texts)) => texts.first().map_or("", |text| text.value.as_str()),
        Some(ProfileText::Description(text)) => text.ascii_string.as_str(),
        None => "",
    };
    text.trim_matches(|c: char| c == '\0' || c.is_whitespace()).chars().take(80).collect()
}
