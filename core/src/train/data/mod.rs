//! What a step of training sees: captures of crops of photographed and procedural materials.
//!
//! It follows from the seed and the step's number alone; no random numbers are carried from step to step.

mod augment;
pub(super) mod camera;
mod dice;
pub(super) mod library;
mod noise;
mod procedural;
#[cfg(test)]
mod tests;
mod texture;

use rayon::prelude::*;

use super::batch::{Batch, Example};
use super::config::{Configuration, DataSettings};
use crate::error::{Error, Result};
use crate::maps::Maps;
use camera::Habits;
pub(super) use dice::{Dice, Purpose};
use noise::Transform;
pub(super) use texture::{Crop, Texture};

/// Most pixels of a texture to one of a crop.
const STEP_MAX: f32 = 2.8;

/// Materials to train on.
pub(crate) struct Data {
    seed: u64,
    photos: Vec<f64>,
    procedural: f64,
    views: usize,
    library: Vec<Texture>,
    pool: Pool,
}

impl Data {
    /// Captures of the materials of `library` and of procedural ones.
    pub fn new(config: &Configuration, library: Vec<Texture>) -> Self {
        Self {
            seed: config.seed,
            photos: config.photos.clone(),
            procedural: config.data.procedural,
            views: config.loss.views,
            library,
            pool: Pool::new(config.seed, &config.data),
        }
    }

    /// How many materials there are, procedural ones aside.
    pub fn materials(&self) -> usize {
        self.library.len()
    }

    /// What step `step` sees: `count` captures of `size` x `size` pixels.
    ///
    /// # Errors
    /// [`Error::InvalidArgument`] if there are no materials.
    pub fn batch(&mut self, step: u64, count: usize, size: usize) -> Result<Batch> {
        let mut dice = Dice::new(self.seed, Purpose::Step, [step, 0]);
        let photos = 1 + dice.weighted(&self.photos);
        // The mixture's partners, which may be the materials themselves.
        let mut partners: Vec<usize> = (0..count).collect();
        dice.shuffle(&mut partners);

        let procedural = (count as f64 * self.procedural).round_ties_even() as usize;
        let pool = if procedural > 0 { self.pool.at(step)? } else { &[] };
        let (seed, library) = (self.seed, &self.library);
        let crops: Vec<Maps<f32>> = (0..count)
            .into_par_iter()
            .map(|index| {
                let mut dice = Dice::new(seed, Purpose::Crop, [step, index as u64]);
                let mut maps = draw_crop(&mut dice, if index < procedural { pool } else { library }, size)?;
                augment::vary(&mut maps, &mut dice);
                Ok(maps)
            })
            .collect::<Result<_>>()?;
        let examples = (0..count)
            .into_par_iter()
            .map(|index| {
                let mut dice = Dice::new(seed, Purpose::Capture, [step, index as u64]);
                let mut maps = crops[index].clone();
                augment::mix(&mut maps, &crops[partners[index]], &mut dice);
                let geometry = camera::draw_geometry(&mut dice, photos, &Habits::TRAINING);
                let captured = camera::photograph(maps, geometry, &mut dice);
                let inputs = camera::network_input(&captured);
                Example { inputs, maps: captured.maps.into_data(), views: camera::draw_views(&mut dice, self.views) }
            })
            .collect();
        Ok(Batch { photos, height: size, width: size, examples })
    }
}

/// A crop of a random texture at a random place, angle and scale; three in ten keep the axes of the texture.
fn draw_crop(dice: &mut Dice, textures: &[Texture], size: usize) -> Result<Maps<f32>> {
    let last = textures.len().checked_sub(1).ok_or_else(|| Error::invalid("data.pack", "no materials"))?;
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
    fn new(seed: u64, settings: &DataSettings) -> Self {
        let DataSettings { groups, per_group, refresh, size, .. } = *settings;
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
