//! What a caller may choose about a fit.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::nn::Mirror;
use crate::progress::{CancelToken, Stage};

/// The most steps a stage takes: days, even on small photos.
pub const MAX_STEPS: usize = 10_000_000;

/// How much time a fit may spend: the lengths of its stages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Preset {
    /// A first look.
    Draft,
    /// The paper's lengths.
    #[default]
    Balanced,
    /// Until nothing is gained any more.
    High,
}

impl Preset {
    /// Steps on the latent code.
    pub const fn latent_steps(self) -> usize {
        match self {
            Self::Draft => 3,
            Self::Balanced => 10,
            Self::High => 30,
        }
    }

    /// Steps on the parameters of the adapters.
    pub const fn adapter_steps(self) -> usize {
        match self {
            Self::Draft => 100,
            Self::Balanced => 1000,
            Self::High => 3000,
        }
    }

    /// How many mirror images of `photos` photos the default network predicts maps of, whose mean is taken. Few photos leave most to the network; with more than four
    /// nothing is gained.
    pub const fn mirror_images(self, photos: usize) -> usize {
        match (self, photos) {
            (Self::Balanced, 1) => 2,
            (Self::High, ..=4) => Mirror::IMAGES.len(),
            _ => 1,
        }
    }

    /// Levenberg-Marquardt steps per pixel of the finish, at most.
    pub const fn finish_steps(self) -> usize {
        match self {
            Self::Draft => 4,
            Self::Balanced => 12,
            Self::High => 40,
        }
    }

    /// How often the stages direct and finish run, each time from the relief that was found before; one is kept only if it predicts photos left out
    /// better.
    pub const fn passes(self) -> usize {
        match self {
            Self::Draft => 1,
            Self::Balanced => 2,
            Self::High => 4,
        }
    }

    /// Steps on the maps themselves. More than 300 fit the photos better and new ones worse.
    pub const fn direct_steps(self) -> usize {
        match self {
            Self::Draft => 100,
            Self::Balanced | Self::High => 300,
        }
    }
}

/// Which way leads from photos to maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Method {
    /// [`Method::Network`].
    #[default]
    Auto,
    /// With a network. The default one predicts the maps, which are then fitted to the photos pixel by pixel; one of the paper's form
    /// encodes the photos, then the latent code is optimised, then the adapters.
    Network,
    /// Without a network: optimise the maps themselves under simple priors.
    Direct,
}

/// What a surface is taken to be made of. All maps are written in any case.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Reflectance {
    /// The simplest that predicts photos left out as well as the others do; with one or two photos, [`Reflectance::Isotropic`].
    #[default]
    Auto,
    /// Lambert's law alone: specular albedo 0, roughness 1.
    Diffuse,
    /// A specular albedo near 4 %, the same for all channels.
    Dielectric,
    /// Any specular albedo, metals too.
    Isotropic,
    /// Two roughnesses and a tangent: brushed metal, satin, hair.
    Anisotropic,
}

impl Reflectance {
    /// The name used in files, options and messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Diffuse => "diffuse",
            Self::Dielectric => "dielectric",
            Self::Isotropic => "isotropic",
            Self::Anisotropic => "anisotropic",
        }
    }
}

/// What of the capture's own statements a fit may correct.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Refine {
    /// What predicts photos left out better: [`Refine::Light`], [`Refine::None`] or [`Refine::All`].
    #[default]
    Auto,
    /// Nothing: the stated light exactly.
    None,
    /// A factor on the stated light of each photo.
    Light,
    /// That, and the position of camera and light, which move together.
    All,
}

impl Refine {
    /// The name used in files, options and messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::None => "none",
            Self::Light => "light",
            Self::All => "all",
        }
    }
}

/// Options of [`fit_material`](crate::fit_material).
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct FitOptions {
    /// Lengths of the stages that the fields for steps leave open. Each of these is at most [`MAX_STEPS`].
    pub preset: Preset,
    /// The way from photos to maps.
    pub method: Method,
    /// What the surface is taken to be made of; a network of the paper's form has its own.
    pub reflectance: Reflectance,
    /// What of the capture's statements may be corrected.
    pub refine: Refine,
    /// Steps on the latent code, instead of the preset's.
    pub latent_steps: Option<usize>,
    /// Steps on the adapters, instead of the preset's.
    pub adapter_steps: Option<usize>,
    /// Steps on the maps, instead of the preset's; 0: none.
    pub direct_steps: Option<usize>,
    /// Steps of the finish, instead of the preset's; 0: none. With `direct_steps` 0 too, the maps are those the network predicts.
    pub finish_steps: Option<usize>,
    /// Most bytes the run may use; three quarters of the free memory if `None`.
    pub max_memory: Option<u64>,
    /// Seed of everything random. The same seed, thread count and CPU give the same bits.
    pub seed: u64,
    /// Threads, 1 to 1024; all the machine offers if `None`.
    pub threads: Option<usize>,
    /// Stop a stage when its loss has flattened; on if `None`.
    pub early_stop: Option<bool>,
    /// Stops the run from another thread.
    pub cancel: CancelToken,
}

impl FitOptions {
    /// # Errors
    /// [`Error::InvalidArgument`] naming a number of steps that is too large. Threads are checked where they are started.
    pub(crate) fn check(&self) -> Result<()> {
        let steps = [
            ("latent_steps", self.latent_steps),
            ("adapter_steps", self.adapter_steps),
            ("direct_steps", self.direct_steps),
            ("finish_steps", self.finish_steps),
        ];
        match steps.into_iter().find(|(_, steps)| steps.is_some_and(|steps| steps > MAX_STEPS)) {
            Some((name, Some(steps))) => {
                Err(Error::invalid(name, format!("expected at most {MAX_STEPS}, got {steps}")))
            }
            _ => Ok(()),
        }
    }

    /// Steps of a stage, at most.
    pub(crate) fn steps(&self, stage: Stage) -> usize {
        match stage {
            Stage::Encode => 1,
            Stage::Latent => self.latent_steps.unwrap_or(self.preset.latent_steps()),
            Stage::Adapters => self.adapter_steps.unwrap_or(self.preset.adapter_steps()),
            Stage::Direct => self.direct_steps.unwrap_or(self.preset.direct_steps()),
            Stage::Finish => self.finish_steps.unwrap_or(self.preset.finish_steps()),
            Stage::Acquire => 0,
        }
    }

    /// The defaults of a preset.
    pub fn preset(preset: Preset) -> Self {
        Self { preset, ..Self::default() }
    }

    /// Sets [`FitOptions::method`].
    #[must_use]
    pub fn method(mut self, method: Method) -> Self {
        self.method = method;
        self
    }

    /// Sets [`FitOptions::reflectance`].
    #[must_use]
    pub fn reflectance(mut self, reflectance: Reflectance) -> Self {
        self.reflectance = reflectance;
        self
    }

    /// Sets [`FitOptions::refine`].
    #[must_use]
    pub fn refine(mut self, refine: Refine) -> Self {
        self.refine = refine;
        self
    }

    /// Sets [`FitOptions::latent_steps`].
    #[must_use]
    pub fn latent_steps(mut self, steps: usize) -> Self {
        self.latent_steps = Some(steps);
        self
    }

    /// Sets [`FitOptions::adapter_steps`].
    #[must_use]
    pub fn adapter_steps(mut self, steps: usize) -> Self {
        self.adapter_steps = Some(steps);
        self
    }

    /// Sets [`FitOptions::direct_steps`].
    #[must_use]
    pub fn direct_steps(mut self, steps: usize) -> Self {
        self.direct_steps = Some(steps);
        self
    }

    /// Sets [`FitOptions::finish_steps`].
    #[must_use]
    pub fn finish_steps(mut self, steps: usize) -> Self {
        self.finish_steps = Some(steps);
        self
    }

    /// Sets [`FitOptions::max_memory`].
    #[must_use]
    pub fn max_memory(mut self, bytes: u64) -> Self {
        self.max_memory = Some(bytes);
        self
    }

    /// Sets [`FitOptions::seed`].
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Sets [`FitOptions::threads`].
    #[must_use]
    pub fn threads(mut self, threads: usize) -> Self {
        self.threads = Some(threads);
        self
    }

    /// Sets [`FitOptions::early_stop`].
    #[must_use]
    pub fn early_stop(mut self, on: bool) -> Self {
        self.early_stop = Some(on);
        self
    }

    /// Sets [`FitOptions::cancel`].
    #[must_use]
    pub fn cancel(mut self, token: CancelToken) -> Self {
        self.cancel = token;
        self
    }
}
