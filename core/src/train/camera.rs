//! Captures: where camera and light stand, what a camera makes of the radiance, and what the network gets to see.
//!
//! Half the width of the patch is the unit of length: a capture covers x and y from -1 to 1, and what is seen of it is all or a square tile.

use std::f32::consts::PI;
use std::f64::consts::TAU;

use super::VALIDATION_SEED;
use super::dice::{Dice, Purpose};
use crate::brdf::{Surface, shade_point};
use crate::color::Transfer;
use crate::maps::{Lobe, Maps, NORMAL_PLANE};
use crate::nn::{INPUTS, PhotoView};
use crate::shot::Shot;

/// Smallest share of the capture's width that is seen.
const TILE_MIN: f32 = 0.1;
/// Smallest z of a tilted sample's normals: grazing.
const GRAZING: f32 = 0.02;

/// Where the synthetic literature (Deschaintre et al. 2019, Luo et al. 2024) has its cameras: this far above the patch, and as far off its middle at most.
const PAPER_DISTANCE: f32 = 2.146;
const PAPER_REACH: f32 = 1.2;

/// How materials are photographed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Captures {
    /// One in three from near, with every defect; whole patches and tiles of them; lamp and lens together or apart.
    Any,
    /// From 2 to 3 above the whole patch, offsets up to 1.2, by a perfect camera.
    Near,
    /// From 3 to 9 above the whole patch, offsets up to 2.4 and 0.45 of the distance, with every defect.
    Real,
    /// As the synthetic literature renders them: 2.146 above the whole patch, offsets up to 1.2, lamp and lens one, white reads 1 straight below; a perfect camera.
    Paper,
}

impl Captures {
    /// All of them, by name.
    pub const ALL: [(&'static str, Self); 4] =
        [("any", Self::Any), ("near", Self::Near), ("real", Self::Real), ("paper", Self::Paper)];

    /// A capture of `maps` of `photos` photos.
    pub(super) fn of(self, maps: Maps<f32>, photos: usize, dice: &mut Dice) -> Captured {
        match self {
            Self::Any => {
                let geometry = draw_geometry(dice, photos, &Habits::TRAINING);
                photograph(maps, geometry, dice)
            }
            Self::Near => clean_photos(maps, draw_geometry(dice, photos, &Habits::validation(1.0))),
            Self::Real => {
                let geometry = draw_geometry(dice, photos, &Habits::validation(0.0));
                photograph(maps, geometry, dice)
            }
            Self::Paper => clean_photos(maps, draw_paper_geometry(dice, photos)),
        }
    }
}

/// How often captures have which form: probabilities.
#[derive(Clone, Copy, Debug)]
pub(super) struct Habits {
    /// From near.
    near: f32,
    /// All of the capture is seen.
    whole: f32,
    /// Lamp and lens are one, or a few hundredths of the distance apart.
    collocated: f32,
}

impl Habits {
    /// What networks are trained on.
    pub const TRAINING: Self = Self { near: 1.0 / 3.0, whole: 0.35, collocated: 0.75 };

    /// What they are judged on.
    pub const fn validation(near: f32) -> Self {
        Self { near, whole: 1.0, collocated: 1.0 }
    }
}

/// The part of a capture that is seen, of pixels that are square.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Window {
    /// Its width in units of the capture's.
    pub share: f32,
    pub centre: [f32; 2],
}

impl Window {
    pub const WHOLE: Self = Self { share: 1.0, centre: [0.0; 2] };

    fn draw(dice: &mut Dice, whole: f32) -> Self {
        let share = if dice.chance(whole) { 1.0 } else { dice.log_uniform(1.0, TILE_MIN) };
        Self { share, centre: [0; 2].map(|_| dice.uniform(-1.0, 1.0) * (1.0 - share)) }
    }

    /// Where pixel `at` of `size` x `size` lies.
    fn position(&self, at: usize, size: usize) -> [f32; 2] {
        let place = |index: usize| (2.0 * index as f32 + 1.0) / size as f32 - 1.0;
        [place(at % size) * self.share + self.centre[0], -place(at / size) * self.share + self.centre[1]]
    }

    /// The same shot in a frame in which what is seen covers x and y from -1 to 1.
    pub fn framed(&self, shot: &Shot) -> Shot {
        let share = f64::from(self.share);
        let [x, y] = self.centre.map(f64::from);
        let moved = |[px, py, pz]: [f64; 3]| [(px - x) / share, (py - y) / share, pz / share];
        Shot {
            camera: moved(shot.camera),
            light: moved(shot.light),
            light_intensity: shot.light_intensity.map(|value| value / (share * share)),
        }
    }
}

/// Where camera and light stand, as stated, and what is seen.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Geometry {
    pub shots: Vec<Shot>,
    pub window: Window,
}

/// Photos of a material.
pub(super) struct Captured {
    /// As stored: gamma 2.2 in 8 bits, (N, 3, H, W).
    pub photos: Vec<f32>,
    /// Whether a pixel is saturated, (N, H, W).
    pub saturated: Vec<bool>,
    pub stated: Geometry,
    /// The material as it lay there.
    pub maps: Maps<f32>,
}

/// Stated geometry of a capture of `photos` photos. The intensity is such that a white diffuse patch at the centre reads 0.4 to 1.6, one for
/// the whole capture.
pub(super) fn draw_geometry(dice: &mut Dice, photos: usize, habits: &Habits) -> Geometry {
    let near = dice.chance(habits.near);
    let distance = if near { dice.uniform(2.0, 3.0) } else { dice.log_uniform(3.0, 9.0) };
    // Hand-held rings are wide or narrow; some captures look straight down.
    let reach = if near { 1.2 } else { (0.45 * distance).min(2.4) } * dice.uniform(0.4, 1.0);
    let place = |dice: &mut Dice, straight: bool| {
        let radius = reach * dice.uniform(0.0, 1.0).sqrt() * if straight { 0.1 } else { 1.0 };
        let (sine, cosine) = dice.uniform(0.0, 2.0 * PI).sin_cos();
        [radius * cosine, radius * sine, distance * dice.uniform(0.9, 1.1)]
    };
    let straight = dice.chance(0.5);
    let cameras: Vec<[f32; 3]> = (0..photos).map(|photo| place(dice, straight && photo == 0)).collect();
    let apart = !dice.chance(habits.collocated);
    let beside =
        if dice.chance(0.25) { [0.03, 0.03, 0.01].map(|share| dice.normal(share) * distance) } else { [0.0; 3] };
    let lights: Vec<[f32; 3]> = cameras
        .iter()
        .map(|camera| if apart { place(dice, false) } else { std::array::from_fn(|axis| camera[axis] + beside[axis]) })
        .collect();
    let white = dice.log_uniform(0.4, 1.6);
    let irradiance = |light: &[f32; 3]| light[2] / square(*light).powf(1.5);
    let mean = lights.iter().map(irradiance).sum::<f32>() / photos as f32;
    let light_intensity = [f64::from(white * PI / mean); 3];
    let shots = cameras.iter().zip(&lights).map(|(camera, light)| Shot {
        camera: camera.map(f64::from),
        light: light.map(f64::from),
        light_intensity,
    });
    Geometry { shots: shots.collect(), window: Window::draw(dice, habits.whole) }
}

/// Geometry of a capture of the synthetic literature, see [`Captures::Paper`].
fn draw_paper_geometry(dice: &mut Dice, photos: usize) -> Geometry {
    let light_intensity = [f64::from(PI * PAPER_DISTANCE * PAPER_DISTANCE); 3];
    let shot = |_| {
        let radius = PAPER_REACH * dice.uniform(0.0, 1.0).sqrt();
        let (sine, cosine) = dice.uniform(0.0, 2.0 * PI).sin_cos();
        let place = [radius * cosine, radius * sine, PAPER_DISTANCE].map(f64::from);
        Shot { camera: place, light: place, light_intensity }
    };
    Geometry { shots: (0..photos).map(shot).collect(), window: Window::WHOLE }
}

/// How a sample leans.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lean {
    /// By how much, in radians.
    pub angle: f32,
    /// Towards where its normal leans, counter-clockwise from x, in radians.
    pub towards: f32,
}

impl Lean {
    fn draw(dice: &mut Dice) -> Self {
        let angle = if dice.chance(0.7) { (9.0 * dice.uniform(0.0, 1.0).powf(1.5)).to_radians() } else { 0.0 };
        Self { angle, towards: dice.uniform(0.0, 2.0 * PI) }
    }

    /// By how much the sample rises along x and y.
    pub fn rise(self) -> [f32; 2] {
        // A surface whose normal is (sin t cos a, sin t sin a, cos t) falls towards a.
        let fall = self.angle.tan();
        [-fall * self.towards.cos(), -fall * self.towards.sin()]
    }

    /// Turns the normals with the sample; what turned away from the camera is brought back to grazing.
    pub fn tilt(self, maps: &mut Maps<f32>) {
        let (sine, cosine) = self.angle.sin_cos();
        let (ax, ay) = (-self.towards.sin(), self.towards.cos());
        let pixels = maps.width() * maps.height();
        let planes = &mut maps.data_mut()[NORMAL_PLANE * pixels..(NORMAL_PLANE + 3) * pixels];
        for at in 0..pixels {
            let [x, y, z] = [0, 1, 2].map(|axis| planes[axis * pixels + at]);
            // Rodrigues' rotation about (ax, ay, 0).
            let along = (ax * x + ay * y) * (1.0 - cosine);
            let turned = [
                x * cosine + ay * z * sine + ax * along,
                y * cosine - ax * z * sine + ay * along,
                (z * cosine + (ax * y - ay * x) * sine).max(GRAZING),
            ];
            let length = square(turned).max(1e-30).sqrt();
            for (axis, value) in turned.into_iter().enumerate() {
                planes[axis * pixels + at] = value / length;
            }
        }
    }
}

/// Photos of `maps` by a perfect camera with 8 bits.
pub(super) fn clean_photos(maps: Maps<f32>, geometry: Geometry) -> Captured {
    let size = maps.width();
    let mut photos: Vec<f32> =
        geometry.shots.iter().flat_map(|shot| radiance(&maps, shot, &geometry.window, [0.0; 2])).collect();
    photos.iter_mut().for_each(|value| *value = stored(*value));
    let saturated = saturated(&photos, size * size);
    Captured { photos, saturated, stated: geometry, maps }
}

/// A capture of `maps` by a real camera under the stated `geometry`: everything that goes wrong does so here.
///
/// Photos are rendered under positions and powers that differ a little from the stated ones, of a tilted sample, and suffer vignetting, stray
/// light, blur, misregistration, noise, saturation and 8 bits.
pub(super) fn photograph(mut maps: Maps<f32>, geometry: Geometry, dice: &mut Dice) -> Captured {
    let size = maps.width();
    let pixels = size * size;
    let Geometry { shots: mut stated, window } = geometry;
    let lean = Lean::draw(dice);
    lean.tilt(&mut maps);

    let distance = stated.iter().map(|shot| shot.camera[2] as f32).sum::<f32>() / stated.len() as f32;
    let slack = if dice.chance(0.3) { 0.0 } else { dice.uniform(0.0, 1.0) };
    let all = dice.normal(0.06);
    let tint = [0; 3].map(|_| dice.normal(0.02));
    let mut photos: Vec<Vec<f32>> = Vec::with_capacity(stated.len());
    for shot in &stated {
        let moved = [0; 3].map(|_| dice.normal(0.012) * distance * slack);
        let lamp = moved.map(|moved| moved + dice.normal(0.004) * distance * slack);
        let own = dice.normal(0.03);
        let at = |place: [f64; 3], off: [f32; 3]| std::array::from_fn(|axis| place[axis] + f64::from(off[axis]));
        let power = |channel: usize| f64::from(((all + tint[channel] + own) * slack).exp());
        let true_shot = Shot {
            camera: at(shot.camera, moved),
            light: at(shot.light, lamp),
            light_intensity: std::array::from_fn(|channel| shot.light_intensity[channel] * power(channel)),
        };
        photos.push(radiance(&maps, &true_shot, &window, lean.rise()));
    }

    // Whoever takes the photos exposes so that at most a fifth of the picture is saturated, mostly.
    if dice.chance(0.9) {
        let darker = 1.0 / bright(&photos, size).max(1.0);
        photos.iter_mut().flatten().for_each(|value| *value *= darker);
        stated.iter_mut().flat_map(|shot| &mut shot.light_intensity).for_each(|value| *value *= f64::from(darker));
    }

    // Vignetting of lens and lamp grows with the distance from the centre of the capture.
    let fade = if dice.chance(0.5) { dice.uniform(0.0, 0.25) } else { 0.0 };
    // Stray light: the room's, reflected by the diffuse albedo, and flare.
    let stray = if dice.chance(0.4) { dice.uniform(0.0, 0.015) } else { 0.0 };
    let flare = 0.2 * dice.uniform(0.0, 1.0);
    let white: [f32; 3] = std::array::from_fn(|channel| {
        let sum: f32 = stated.iter().map(|shot| shot.light_intensity[channel] as f32).sum();
        sum / stated.len() as f32 / (distance * distance * PI)
    });
    for photo in &mut photos {
        for (index, value) in photo.iter_mut().enumerate() {
            let [x, y] = window.position(index % pixels, size);
            let room = stray * white[index / pixels] * (0.8 * maps.data()[index] + flare);
            *value = *value * (1.0 - fade * (x * x + y * y) / 2.0) + room;
        }
    }

    let apart = slack * dice.uniform(0.0, 1.0);
    let tap = if dice.chance(0.5) { dice.uniform(0.0, 0.22) } else { 0.0 };
    for photo in &mut photos {
        let off = [0.4, 0.4, 0.5, 0.4, 0.4, 0.5].map(|share| dice.normal(share) * apart * 2.0 / size as f32);
        *photo = registered(photo, size, off);
        blur(photo, size, tap);
    }

    let shot_noise = dice.log_uniform(1e-3, 1.5e-2);
    let read_noise = dice.log_uniform(2e-4, 3e-3);
    let mut photos = photos.concat();
    for value in &mut photos {
        let deviation = (shot_noise * shot_noise * value.clamp(0.0, 1.0) + read_noise * read_noise).sqrt();
        *value = stored((*value + dice.normal(deviation)).max(0.0));
    }
    let mut saturated = saturated(&photos, pixels);
    // In a photo made smaller, pixels count as saturated that are so in part.
    if dice.chance(0.3) {
        saturated = saturated.chunks_exact(pixels).flat_map(|photo| widened(photo, size)).collect();
    }
    Captured { photos, saturated, stated: Geometry { shots: stated, window }, maps }
}

/// Writes what the network sees of every photo to `out`, (N, [`INPUTS`], H, W). Without `directions` the planes that follow from positions are 0.
pub(super) fn write_input(captured: &Captured, directions: bool, out: &mut [f32]) {
    let size = captured.maps.width();
    let pixels = size * size;
    let photos = captured.photos.chunks_exact(3 * pixels).zip(captured.saturated.chunks_exact(pixels));
    for ((out, shot), (photo, saturated)) in
        out.chunks_exact_mut(INPUTS * pixels).zip(&captured.stated.shots).zip(photos)
    {
        let view = PhotoView::new(&captured.stated.window.framed(shot), 2.0);
        for at in 0..pixels {
            let [x, y] = Window::WHOLE.position(at, size).map(f64::from);
            let linear = [0, 1, 2].map(|channel| Transfer::Gamma22.decode(photo[channel * pixels + at]));
            for (plane, value) in view.planes(linear, saturated[at], x, y).into_iter().enumerate() {
                out[plane * pixels + at] = value;
            }
        }
        if !directions {
            out[3 * pixels..6 * pixels].fill(0.0);
            out[7 * pixels..].fill(0.0);
        }
    }
}

/// Where camera and light stand for `views` renderings that are compared, for a patch from -1 to 1.
///
/// One in three has camera and light together above the patch; the others lie such that a random point of it reflects the light into the
/// camera: there specular and roughness show.
pub(super) fn draw_views(dice: &mut Dice, views: usize) -> Vec<Shot> {
    let view = |index: usize| {
        let distance = dice.log_uniform(2.0, 6.0);
        let (camera, light) = if index.is_multiple_of(3) {
            let radius = 0.5 * distance * dice.uniform(0.0, 1.0).sqrt();
            let (sine, cosine) = dice.uniform(0.0, 2.0 * PI).sin_cos();
            let place = [radius * cosine, radius * sine, distance];
            (place, place)
        } else {
            let [x, y] = [0; 2].map(|_| dice.uniform(-0.9, 0.9));
            let height = dice.uniform(0.3, 1.0);
            let (sine, cosine) = dice.uniform(0.0, 2.0 * PI).sin_cos();
            let flat = (1.0 - height * height).sqrt();
            let other = dice.log_uniform(2.0, 6.0);
            let camera = [x - flat * cosine * other, y - flat * sine * other, height * other];
            (camera, [x + flat * cosine * distance, y + flat * sine * distance, height * distance])
        };
        let intensity = PI * dice.log_uniform(0.4, 2.0) * distance * distance;
        Shot { camera: camera.map(f64::from), light: light.map(f64::from), light_intensity: [f64::from(intensity); 3] }
    };
    (0..views).map(view).collect()
}

/// Where re-renderings are compared in validation: above the patch, light and camera together.
pub(super) fn fixed_views(views: usize) -> Vec<Shot> {
    // They are part of what a score means, and the same for every network.
    const DISTANCE: f64 = 2.25;
    const REACH: f64 = 0.7;
    const WHITE: f64 = 0.444;
    let mut dice = Dice::new(VALIDATION_SEED, Purpose::Validation, [u64::MAX, 0]);
    let mut uniform = |low: f64, high: f64| low + (high - low) * f64::from(dice.uniform(0.0, 1.0));
    let places: Vec<[f64; 3]> = (0..views)
        .map(|_| {
            let (radius, angle) = (REACH * uniform(0.0, 1.0).sqrt(), uniform(0.0, TAU));
            [radius * angle.cos(), radius * angle.sin(), DISTANCE * uniform(0.9, 1.1)]
        })
        .collect();
    let irradiance = |[x, y, z]: &[f64; 3]| z / (x * x + y * y + z * z).powf(1.5);
    let mean = places.iter().map(irradiance).sum::<f64>() / views as f64;
    let shot = |place| Shot { camera: place, light: place, light_intensity: [WHITE * f64::from(PI) / mean; 3] };
    places.into_iter().map(shot).collect()
}

fn square(v: [f32; 3]) -> f32 {
    v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
}

/// Radiance of square `maps`, (3, H, W), of a sample that rises by `rise` along x and y.
fn radiance(maps: &Maps<f32>, shot: &Shot, window: &Window, rise: [f32; 2]) -> Vec<f32> {
    let size = maps.width();
    let pixels = size * size;
    let mut out = vec![0.0; 3 * pixels];
    for at in 0..pixels {
        let value = |plane: usize| maps.data()[plane * pixels + at];
        let surface = Surface {
            diffuse: [value(0), value(1), value(2)],
            normal: [value(3), value(4), value(5)],
            roughness: [value(6), 0.0],
            specular: [value(7), value(8), value(9)],
            tangent: [0.0; 3],
        };
        let [x, y] = window.position(at, size);
        let position = [x, y, rise[0] * x + rise[1] * y].map(f64::from);
        for (channel, value) in shade_point(Lobe::Isotropic, &surface, position, shot).into_iter().enumerate() {
            out[channel * pixels + at] = value;
        }
    }
    out
}

/// The radiance below which four fifths of the pixels lie, each counted by its brightest channel; one pixel in sixteen is looked at.
fn bright(photos: &[Vec<f32>], size: usize) -> f32 {
    let pixels = size * size;
    let mut values: Vec<f32> = photos
        .iter()
        .flat_map(|photo| {
            let places =
                (0..size).step_by(4).flat_map(|row| (0..size).step_by(4).map(move |column| row * size + column));
            places.map(|at| photo[at].max(photo[pixels + at]).max(photo[2 * pixels + at]))
        })
        .collect();
    values.sort_unstable_by(f32::total_cmp);
    let place = 0.8 * (values.len() - 1) as f32;
    let (low, high) = (values[place.floor() as usize], values[place.ceil() as usize]);
    low + (high - low) * (place - place.floor())
}

/// The photo, (3, H, W), shifted, turned and scaled: every pixel is read from where the matrix I + `off` takes it, in [-1, 1].
fn registered(photo: &[f32], size: usize, off: [f32; 6]) -> Vec<f32> {
    let last = (size - 1) as f32;
    let place = |index: usize| (2.0 * index as f32 + 1.0) / size as f32 - 1.0;
    let pixel = |place: f32| (((place + 1.0) * size as f32 - 1.0) / 2.0).clamp(0.0, last);
    let mut out = vec![0.0; photo.len()];
    for at in 0..size * size {
        let (x, y) = (place(at % size), place(at / size));
        let u = pixel(x + off[0] * x + off[1] * y + off[2]);
        let v = pixel(y + off[3] * x + off[4] * y + off[5]);
        let (left, top) = (u as usize, v as usize);
        let (right, bottom) = ((left + 1).min(size - 1), (top + 1).min(size - 1));
        let (x, y) = (u - left as f32, v - top as f32);
        for (out, plane) in out.chunks_exact_mut(size * size).zip(photo.chunks_exact(size * size)) {
            let row = |row: usize| plane[row * size + left] * (1.0 - x) + plane[row * size + right] * x;
            out[at] = row(top) * (1.0 - y) + row(bottom) * y;
        }
    }
    out
}

/// Blur of lens and resampling along both axes: three taps, those beside with the weight `tap`.
fn blur(photo: &mut [f32], size: usize, tap: f32) {
    if tap == 0.0 {
        return;
    }
    for plane in photo.chunks_exact_mut(size * size) {
        for stride in [1, size] {
            let other = if stride == 1 { size } else { 1 };
            for line in 0..size {
                let mut before = plane[line * other];
                for index in 0..size {
                    let at = line * other + index * stride;
                    let after = if index + 1 < size { plane[at + stride] } else { plane[at] };
                    let value = plane[at];
                    plane[at] = value * (1.0 - 2.0 * tap) + tap * (before + after);
                    before = value;
                }
            }
        }
    }
}

/// Radiance as an 8-bit photo in gamma 2.2 stores it.
fn stored(radiance: f32) -> f32 {
    (Transfer::Gamma22.encode(radiance.clamp(0.0, 1.0)) * 255.0).round() / 255.0
}

/// Whether any channel of a pixel stands at the upper end; `photos` (N, 3, H, W).
fn saturated(photos: &[f32], pixels: usize) -> Vec<bool> {
    let photo = |photo: &[f32]| -> Vec<bool> {
        (0..pixels).map(|at| (0..3).any(|channel| photo[channel * pixels + at] >= 1.0)).collect()
    };
    photos.chunks_exact(3 * pixels).flat_map(photo).collect()
}

/// A mask and its neighbours, also across corners.
fn widened(mask: &[bool], size: usize) -> Vec<bool> {
    let near = |index: usize| index.saturating_sub(1)..(index + 2).min(size);
    (0..mask.len())
        .map(|at| near(at / size).any(|row| near(at % size).any(|column| mask[row * size + column])))
        .collect()
}
