//! What training sees: captures of crops of photographed and procedural materials as the network gets them, and the true maps.
//!
//! The paper (Luo et al. 2024, section 3.4) trains on renderings of synthetic materials under random lights. Here the materials are those of a
//! [`Library`] and procedural ones, varied, and photographed by a camera with all its defects. `python/svbrdf_gcn/training` trains on them with PyTorch.
//! What a step sees follows from the seed and its number alone: no random numbers are carried from step to step.

mod augment;
mod camera;
mod dice;
mod library;
mod noise;
mod procedural;
#[cfg(test)]
mod tests;
mod texture;

use std::ops::{Range, RangeInclusive};

use rayon::ThreadPool;
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::maps::{Lobe, Maps};
use crate::nn::INPUTS;
use crate::shot::Shot;
use crate::{memory, pool};
use camera::Captured;
pub use camera::Captures;
use dice::{Dice, Purpose};
pub use library::Library;
use noise::Transform;
use texture::{Crop, Texture};

/// Most pixels of a texture to one of a crop.
const STEP_MAX: f32 = 2.8;
/// Sides of a crop or a procedural material, in pixels.
const SIDES: RangeInclusive<usize> = 8..=4096;
/// Captures of a batch, and renderings of each.
const COUNTS: RangeInclusive<usize> = 1..=4096;
/// Most photos of a capture.
const PHOTOS_MAX: usize = 64;
/// Seed of the captures that networks are judged on.
const VALIDATION_SEED: u64 = 20_240_101;
/// Planes of the true maps.
const MAPS: usize = Lobe::Isotropic.planes();
/// Values of a shot in a [`Batch`].
const SHOT: usize = 9;

/// How many kinds of procedural materials there are.
pub const KINDS: usize = procedural::COUNT;

/// What batches are drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Seed of everything random.
    pub seed: u64,
    /// How often a batch has 1, 2, 3 ... photos, relatively.
    pub photos: Vec<f64>,
    /// Share of procedural materials in a batch, [0, 1].
    pub procedural: f64,
    /// The pool of procedural materials holds `groups` times `per_group`.
    pub groups: usize,
    /// Every `refresh` steps as many of the oldest are replaced.
    pub per_group: usize,
    /// See `per_group`.
    pub refresh: usize,
    /// Side of a procedural material in pixels.
    pub size: usize,
    /// How materials are photographed.
    pub captures: Captures,
    /// Whether the network is shown where camera and light stood; else the planes that follow from positions are 0.
    pub directions: bool,
    /// Renderings per capture that a loss compares.
    pub views: usize,
}

impl Settings {
    fn check(&self) -> Result<()> {
        within("procedural", self.procedural, 0.0..=1.0)?;
        within("groups", self.groups, 1..=1 << 16)?;
        within("per_group", self.per_group, 1..=1 << 16)?;
        within("refresh", self.refresh, 1..=1 << 40)?;
        within("size", self.size, SIDES)?;
        within("views", self.views, COUNTS)?;
        within("numbers in photos", self.photos.len(), 1..=PHOTOS_MAX)?;
        let are_weights = self.photos.iter().all(|weight| (0.0..=1e9).contains(weight));
        if !are_weights || self.photos.iter().sum::<f64>() <= 0.0 {
            let reason = format!("expected weights of 0 or more, one of them above 0, got {:?}", self.photos);
            return Err(Error::invalid("photos", reason));
        }
        let bytes = (self.groups * self.per_group) as u64 * Texture::bytes(self.size);
        memory::check("the procedural materials", bytes, memory::allowed(None, 0))
    }
}

/// Fails unless `value` lies in `range`.
fn within<T: PartialOrd + std::fmt::Display>(name: &str, value: T, range: RangeInclusive<T>) -> Result<()> {
    if range.contains(&value) {
        return Ok(());
    }
    Err(Error::invalid(name, format!("expected {} to {}, got {value}", range.start(), range.end())))
}

/// Captures of materials, all with the same number of photos, of square crops of the same size.
///
/// A crop covers x and y from -1 to 1. Nine numbers are a shot: camera, light, light intensity.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// Captures.
    pub count: usize,
    /// Photos of each.
    pub photos: usize,
    /// Pixels of a side.
    pub size: usize,
    /// Renderings of each that a loss compares.
    pub compared: usize,
    /// What the network sees, (count, photos, 13, size, size): the photo in gamma 2.2, 3; its ratio to a white surface, 3; saturation, 1; direction to the
    /// light, 3; half vector, 3.
    pub inputs: Vec<f32>,
    /// The true maps, (count, 10, size, size): diffuse 3, normal 3, roughness 1, specular 3.
    pub maps: Vec<f32>,
    /// Where the photos are said to be taken from, (count, photos, 3, 3).
    pub shots: Vec<f32>,
    /// Where renderings are compared, (count, compared, 3, 3).
    pub views: Vec<f32>,
}

impl Batch {
    /// Fails unless a batch of these sizes can be drawn.
    fn check([count, photos, size, compared]: [usize; 4]) -> Result<()> {
        within("count", count, COUNTS)?;
        within("photos", photos, 1..=PHOTOS_MAX)?;
        within("size", size, SIDES)?;
        within("views", compared, COUNTS)?;
        // Crops, those that they are mixed of, and what the captures hold of them.
        let planes = (count * (photos * INPUTS + 3 * MAPS)) as u64;
        memory::check("the batch", 4 * planes * (size * size) as u64, memory::allowed(None, 0))
    }

    /// `count` captures as `draw` gives them, each with the shots of its renderings.
    fn drawn(
        [count, photos, size, compared]: [usize; 4],
        directions: bool,
        draw: impl Fn(usize) -> Result<(Captured, Vec<Shot>)> + Sync,
    ) -> Result<Self> {
        let pixels = size * size;
        let filled = |len: usize| memory::filled(0f32, count * len);
        let (mut inputs, mut maps) = (filled(photos * INPUTS * pixels)?, filled(MAPS * pixels)?);
        let (mut shots, mut views) = (filled(photos * SHOT)?, filled(compared * SHOT)?);
        let seen = inputs.par_chunks_mut(photos * INPUTS * pixels).zip(maps.par_chunks_mut(MAPS * pixels));
        let placed = shots.par_chunks_mut(photos * SHOT).zip(views.par_chunks_mut(compared * SHOT));
        seen.zip(placed).enumerate().try_for_each(|(index, ((inputs, maps), (shots, views)))| {
            let (captured, compared) = draw(index)?;
            camera::write_input(&captured, directions, inputs);
            maps.copy_from_slice(captured.maps.data());
            let framed: Vec<Shot> =
                captured.stated.shots.iter().map(|shot| captured.stated.window.framed(shot)).collect();
            write_shots(&framed, shots);
            write_shots(&compared, views);
            Ok(())
        })?;
        Ok(Self { count, photos, size, compared, inputs, maps, shots, views })
    }
}

fn write_shots(shots: &[Shot], out: &mut [f32]) {
    for (shot, out) in shots.iter().zip(out.chunks_exact_mut(SHOT)) {
        let values = shot.camera.iter().chain(&shot.light).chain(&shot.light_intensity);
        out.iter_mut().zip(values).for_each(|(out, &value)| *out = value as f32);
    }
}

/// Materials to train on and to judge by, and captures of them.
pub struct Data {
    settings: Settings,
    library: Library,
    pool: Pool,
    threads: ThreadPool,
}

impl Data {
    /// Captures of the materials of `library` and of procedural ones, drawn on `threads` threads, all if `None`.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] naming a setting out of its range; [`Error::OutOfMemory`] if the procedural materials need more than three quarters of the
    /// free memory.
    pub fn new(library: Library, settings: Settings, threads: Option<usize>) -> Result<Self> {
        settings.check()?;
        Ok(Self { pool: Pool::new(&settings), threads: pool::pool(threads)?, library, settings })
    }

    /// What step `step` sees: `count` captures of `size` x `size` pixels. The same numbers give the same bits, whatever was drawn before.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] naming a size out of its range; [`Error::OutOfMemory`] if there is no room for the batch.
    pub fn batch(&mut self, step: u64, count: usize, size: usize) -> Result<Batch> {
        let Self { settings, library, pool, threads } = self;
        let seed = settings.seed;
        let mut dice = Dice::new(seed, Purpose::Step, [step, 0]);
        let photos = 1 + dice.weighted(&settings.photos);
        let sizes = [count, photos, size, settings.views];
        Batch::check(sizes)?;
        threads.install(|| {
            // The mixture's partners, which may be the materials themselves.
            let mut partners: Vec<usize> = (0..count).collect();
            dice.shuffle(&mut partners);

            let procedural = (count as f64 * settings.procedural).round_ties_even() as usize;
            let textures = if procedural > 0 { pool.at(step)? } else { &[] };
            let crops: Vec<Maps<f32>> = (0..count)
                .into_par_iter()
                .map(|index| {
                    let mut dice = Dice::new(seed, Purpose::Crop, [step, index as u64]);
                    let textures = if index < procedural { textures } else { library.training() };
                    let mut maps = draw_crop(&mut dice, textures, size)?;
                    augment::vary(&mut maps, &mut dice);
                    Ok(maps)
                })
                .collect::<Result<_>>()?;
            Batch::drawn(sizes, settings.directions, |index| {
                let mut dice = Dice::new(seed, Purpose::Capture, [step, index as u64]);
                let mut maps = crops[index].clone();
                augment::mix(&mut maps, &crops[partners[index]], &mut dice);
                let captured = settings.captures.of(maps, photos, &mut dice);
                Ok((captured, camera::draw_views(&mut dice, settings.views)))
            })
        })
    }

    /// Captures of held-out materials, whole and upright, `size` x `size` pixels: those from `materials.start` up to `materials.end` in the library's order, which
    /// are always the same. Renderings are compared at `views` places, the same for every material.
    ///
    /// # Errors
    /// As [`Data::batch`]; [`Error::InvalidArgument`] if there are no such materials.
    pub fn validation(
        &self,
        captures: Captures,
        photos: usize,
        size: usize,
        materials: Range<usize>,
        views: usize,
    ) -> Result<Batch> {
        let textures = self.library.validation().get(materials.clone()).filter(|textures| !textures.is_empty());
        let textures = textures.ok_or_else(|| {
            let held_out = self.library.validation().len();
            Error::invalid("materials", format!("expected some of the {held_out} held out, got {materials:?}"))
        })?;
        let sizes = [textures.len(), photos, size, views];
        Batch::check(sizes)?;
        let compared = camera::fixed_views(views);
        self.threads.install(|| {
            Batch::drawn(sizes, self.settings.directions, |index| {
                let texture = &textures[index];
                let step = texture.side() as f32 / size as f32;
                let maps = texture.sample(size, &Crop { step, angle: 0.0, centre: [0.5; 2], mirrored: false })?;
                let numbers = [(captures as u64) << 32 | photos as u64, (materials.start + index) as u64];
                let mut dice = Dice::new(VALIDATION_SEED, Purpose::Validation, numbers);
                Ok((captures.of(maps, photos, &mut dice), compared.clone()))
            })
        })
    }
}

/// Maps of procedural material `number`, (10, `size`, `size`); [`KINDS`] kinds take turns.
///
/// # Errors
/// [`Error::InvalidArgument`] if `size` is out of its range.
pub fn procedural_material(seed: u64, number: u64, size: usize) -> Result<Maps<f32>> {
    within("size", size, SIDES)?;
    procedural::material(seed, number, &Transform::new(size))
}

/// A crop of a random texture at a random place, angle and scale; three in ten keep the axes of the texture.
fn draw_crop(dice: &mut Dice, textures: &[Texture], size: usize) -> Result<Maps<f32>> {
    let last = textures.len().checked_sub(1).ok_or_else(|| Error::invalid("library", "no materials"))?;
    let texture = &textures[dice.integer(0, last)];
    // From twice magnified to the whole texture in one crop.
    let widest = (texture.side() as f32 / size as f32).clamp(1.0, STEP_MAX);
    let step = dice.log_uniform(0.5, widest);
    let angle = dice.uniform(0.0, std::f32::consts::TAU);
    let quarter = std::f32::consts::FRAC_PI_2;
    let angle = if dice.chance(0.3) { (angle / quarter).round() * quarter } else { angle };
    let centre = [0; 2].map(|_| dice.uniform(0.0, 1.0));
    texture.sample(size, &Crop { step, angle, centre, mirrored: dice.chance(0.5) })
}

/// The newest procedural materials. Every `refresh` steps `per_group` of the oldest are replaced, one after the other.
struct Pool {
    seed: u64,
    per_group: u64,
    refresh: u64,
    transform: Transform,
    /// Material `n` lies at `n` modulo their number.
    textures: Vec<Texture>,
    count: usize,
    /// How many were made, by the seed's order.
    made: u64,
}

impl Pool {
    fn new(settings: &Settings) -> Self {
        let &Settings { seed, groups, per_group, refresh, size, .. } = settings;
        Self {
            seed,
            per_group: per_group as u64,
            refresh: refresh as u64,
            transform: Transform::new(size),
            textures: Vec::new(),
            count: groups * per_group,
            made: 0,
        }
    }

    /// The materials at step `step`.
    fn at(&mut self, step: u64) -> Result<&[Texture]> {
        let count = self.count as u64;
        let newest = count + step.saturating_mul(self.per_group) / self.refresh;
        let oldest = newest - count;
        // Of a later step, or none at all: all anew.
        let first = if self.textures.is_empty() || self.made > newest { oldest } else { self.made.max(oldest) };
        let fresh: Vec<Texture> = (first..newest)
            .into_par_iter()
            .map(|number| Ok(Texture::new(&procedural::material(self.seed, number, &self.transform)?)))
            .collect::<Result<_>>()?;
        if fresh.len() == self.count {
            self.textures = fresh;
            self.textures.rotate_right((first % count) as usize);
        } else {
            for (number, texture) in (first..newest).zip(fresh) {
                self.textures[(number % count) as usize] = texture;
            }
        }
        self.made = newest;
        Ok(&self.textures)
    }
}
