//! The material as a metallic surface under a dielectric coat: what Blender's Principled BSDF, OpenPBR, glTF and game engines have instead of
//! a diffuse and a specular albedo.
//!
//! Ours reflects, at normal incidence, `D = d (1 - s)` diffusely and `s` (RGB) specularly. A metallic surface with base colour b,
//! metallic m and a dielectric part of normal reflectance f reflects
//!
//! - diffusely `(1 - m) b a(f)`, where a(f) is what the coat lets through: `1 - max f` in Blender, OpenPBR and glTF, 1 in Unreal
//! - specularly `m b + (1 - m) f`
//!
//! For a given m, per channel, `b = D / ((1 - m) a)` and `f = (s - m b) / (1 - m)` are exact where both are in range. Where b is not, it is limited;
//! where f is not, it is limited and b is the least squares solution of both equations. Of all m the one is taken that leaves the least
//! squared error plus a penalty on dielectrics brighter than [`DIELECTRIC_MAX`]: such reflectances are metals unless the colours say otherwise.
//! What error is left is measured on every pixel and reported.

use rayon::prelude::*;
use serde::Serialize;

use crate::error::Result;
use crate::image::Image;
use crate::material::Material;
use crate::{memory, pool};

/// The brightest normal reflectance that a dielectric has in practice (index of refraction 1.79); Blender's specular level 1, Unreal's specular 1.
pub const DIELECTRIC_MAX: f64 = 0.08;

/// Normal reflectance of the usual dielectric (index of refraction 1.5).
pub const DIELECTRIC_USUAL: f64 = 0.04;

/// Squared error that a dielectric part may spare by being above [`DIELECTRIC_MAX`] by 1.
const BRIGHT_PENALTY: f64 = 0.02;

/// Costs that differ by less are the same: errors of about 2e-5.
const NEGLIGIBLE: f64 = 1e-9;

/// Steps of m that are tried before the best one is refined.
const COARSE_STEPS: usize = 16;
const REFINEMENTS: usize = 10;

/// Mean and largest absolute difference over pixels and channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Difference {
    /// Mean.
    pub mean: f64,
    /// Largest.
    pub max: f64,
}

impl Difference {
    fn of(differences: impl Iterator<Item = f64>) -> Self {
        let (mut sum, mut count, mut max) = (0.0, 0, 0.0f64);
        for difference in differences {
            sum += difference.abs();
            count += 1;
            max = max.max(difference.abs());
        }
        Self { mean: sum / f64::from(count.max(1)), max }
    }
}

/// How far a converted material's reflectance at normal incidence is from the original's, linear, both within [0, 1].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Loss {
    /// Diffuse reflectance, d (1 - s).
    pub diffuse: Difference,
    /// Specular reflectance, s.
    pub specular: Difference,
}

/// What a target's dielectric part can be.
#[derive(Clone, Copy, Debug)]
pub(super) struct Dielectric {
    /// Its least normal reflectance.
    pub min: f64,
    /// Its greatest.
    pub max: f64,
    /// Whether it has a colour.
    pub tinted: bool,
    /// Whether the diffuse part below gets only what it lets through.
    pub attenuates: bool,
}

impl Dielectric {
    /// Blender's Principled BSDF, OpenPBR and glTF with KHR_materials_specular.
    pub const FREE: Self = Self { min: 0.0, max: 1.0, tinted: true, attenuates: true };
    /// Unreal: 0.08 times a grey specular, nothing taken from the diffuse part.
    pub const UNREAL: Self = Self { min: 0.0, max: DIELECTRIC_MAX, tinted: false, attenuates: false };

    /// What the dielectric part lets through to the diffuse part.
    fn through(self, f: [f64; 3]) -> f64 {
        if self.attenuates { 1.0 - f.into_iter().fold(0.0, f64::max) } else { 1.0 }
    }
}

/// One pixel: base colour, metallic, normal reflectance of the dielectric part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Solution {
    pub base: [f64; 3],
    pub metallic: f64,
    pub dielectric: [f64; 3],
}

impl Solution {
    /// Diffuse and specular reflectance at normal incidence.
    fn reflectance(&self, target: Dielectric) -> ([f64; 3], [f64; 3]) {
        let (m, through) = (self.metallic, target.through(self.dielectric));
        let diffuse = self.base.map(|b| (1.0 - m) * b * through);
        (diffuse, std::array::from_fn(|c| m * self.base[c] + (1.0 - m) * self.dielectric[c]))
    }

    /// The squared error, and the penalty on bright dielectrics.
    fn cost(&self, target: Dielectric, diffuse: [f64; 3], specular: [f64; 3]) -> f64 {
        let (got_diffuse, got_specular) = self.reflectance(target);
        (0..3)
            .map(|c| {
                let bright = (self.dielectric[c] - DIELECTRIC_MAX).max(0.0);
                let penalty = BRIGHT_PENALTY * (1.0 - self.metallic) * bright * bright;
                (got_diffuse[c] - diffuse[c]).powi(2) + (got_specular[c] - specular[c]).powi(2) + penalty
            })
            .sum()
    }

    /// The best metallic surface for a diffuse and a specular reflectance.
    pub fn new(target: Dielectric, diffuse: [f64; 3], specular: [f64; 3]) -> Self {
        let at = |m: f64| {
            let solution = Self::with_metallic(target, m, diffuse, specular);
            (solution.cost(target, diffuse, specular), solution)
        };
        let better = |best: (f64, Self), other: (f64, Self)| if other.0 < best.0 - NEGLIGIBLE { other } else { best };
        let mut best = at(0.0);
        if best.0 < NEGLIGIBLE {
            return best.1;
        }
        for step in 1..=COARSE_STEPS {
            best = better(best, at(step as f64 / COARSE_STEPS as f64));
        }
        let mut reach = 0.5 / COARSE_STEPS as f64;
        for _ in 0..REFINEMENTS {
            let m = best.1.metallic;
            best = better(better(best, at((m - reach).max(0.0))), at((m + reach).min(1.0)));
            reach /= 2.0;
        }
        best.1
    }

    /// The best one with this metallic.
    fn with_metallic(target: Dielectric, m: f64, diffuse: [f64; 3], specular: [f64; 3]) -> Self {
        if m == 1.0 {
            let dielectric = [DIELECTRIC_USUAL.clamp(target.min, target.max); 3];
            return Self { base: specular.map(|s| s.clamp(0.0, 1.0)), metallic: 1.0, dielectric };
        }
        let rest = 1.0 - m;
        // What the coat lets through depends on the coat: it is found with the last one's, which settles at once.
        let mut dielectric = [DIELECTRIC_USUAL.clamp(target.min, target.max); 3];
        for _ in 0..2 {
            let p = rest * target.through(dielectric);
            let free = |c: usize| {
                let base = exact_base(p, diffuse[c]);
                (specular[c] - m * base) / rest
            };
            dielectric = if target.tinted {
                std::array::from_fn(|c| free(c).clamp(target.min, target.max))
            } else {
                [grey(target, p, m, diffuse, specular); 3]
            };
        }
        let p = rest * target.through(dielectric);
        let base = std::array::from_fn(|c| {
            let left = specular[c] - rest * dielectric[c];
            ((p * diffuse[c] + m * left) / (p * p + m * m).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0)
        });
        Self { base, metallic: m, dielectric }
    }
}

/// The base colour that makes the diffuse reflectance exact, as far as it can.
fn exact_base(p: f64, diffuse: f64) -> f64 {
    if diffuse >= p { 1.0 } else { diffuse / p }
}

/// The best grey dielectric: the error is convex in it, so that thirds of the interval can be discarded.
fn grey(target: Dielectric, p: f64, m: f64, diffuse: [f64; 3], specular: [f64; 3]) -> f64 {
    let error = |f: f64| -> f64 {
        (0..3)
            .map(|c| {
                let left = specular[c] - (1.0 - m) * f;
                let base = ((p * diffuse[c] + m * left) / (p * p + m * m)).clamp(0.0, 1.0);
                (p * base - diffuse[c]).powi(2) + (m * base - left).powi(2)
            })
            .sum()
    };
    let (mut low, mut high) = (target.min, target.max);
    while high - low > 1e-5 {
        let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if error(a) <= error(b) { high = b } else { low = a }
    }
    (low + high) / 2.0
}

/// Diffuse and specular reflectance at normal incidence of every pixel.
fn reflectances(material: &Material) -> Result<Vec<([f64; 3], [f64; 3])>> {
    let albedos = material.diffuse_albedo.data().as_chunks::<3>().0;
    let both = albedos.iter().zip(material.specular_albedo.data().as_chunks::<3>().0).map(|(d, s)| {
        let specular = s.map(f64::from);
        (std::array::from_fn(|c| f64::from(d[c]) * (1.0 - specular[c])), specular)
    });
    memory::collected(albedos.len(), both)
}

/// How far the solutions are from the reflectances they stand for.
fn loss(target: Dielectric, solutions: &[Solution], pixels: &[([f64; 3], [f64; 3])]) -> Loss {
    let pairs = || solutions.iter().map(|s| s.reflectance(target)).zip(pixels);
    Loss {
        diffuse: Difference::of(pairs().flat_map(|(got, expected)| (0..3).map(move |c| got.0[c] - expected.0[c]))),
        specular: Difference::of(pairs().flat_map(|(got, expected)| (0..3).map(move |c| got.1[c] - expected.1[c]))),
    }
}

/// A metallic surface per pixel, and how far it is from the material.
pub(super) struct Metallic {
    /// (H, W, 3), linear, [0, 1].
    pub base_color: Image,
    /// (H, W, 1), [0, 1].
    pub metallic: Image,
    /// (H, W, 3), normal reflectance of the dielectric part.
    pub dielectric: Image,
    pub loss: Loss,
}

impl Metallic {
    pub fn new(material: &Material, target: Dielectric) -> Result<Self> {
        let pixels = reflectances(material)?;
        let mut solutions = memory::reserved(pixels.len())?;
        pool::inside(|| {
            solutions.par_extend(pixels.par_iter().map(|&(d, s)| Solution::new(target, d, s)));
            Ok(())
        })?;
        let (width, height) = (material.width(), material.height());
        let image = |values: &dyn Fn(&Solution) -> [f64; 3]| {
            let values = solutions.iter().flat_map(|s| values(s).map(|value| value as f32));
            Image::new(width, height, 3, memory::collected(3 * solutions.len(), values)?)
        };
        let metallic = memory::collected(solutions.len(), solutions.iter().map(|s: &Solution| s.metallic as f32))?;
        Ok(Self {
            base_color: image(&|s| s.base)?,
            metallic: Image::new(width, height, 1, metallic)?,
            dielectric: image(&|s| s.dielectric)?,
            loss: loss(target, &solutions, &pixels),
        })
    }

    /// The loss where a viewer takes the usual dielectric part, glTF's without extensions, instead of this one.
    pub fn loss_with_usual_dielectric(&self, material: &Material) -> Result<Loss> {
        let colors = self.base_color.data().as_chunks::<3>().0.iter().zip(self.metallic.data());
        let usual = |(base, &metallic): (&[f32; 3], &f32)| Solution {
            base: base.map(f64::from),
            metallic: metallic.into(),
            dielectric: [DIELECTRIC_USUAL; 3],
        };
        let solutions = memory::collected(colors.len(), colors.map(usual))?;
        Ok(loss(Dielectric::FREE, &solutions, &reflectances(material)?))
    }

    /// The brightest channel of the dielectric part, and its colour, 1 in that channel (white where it is black).
    pub fn level_and_tint(&self) -> Result<(Image, Image)> {
        let (mut level, mut tint) = (Vec::new(), Vec::new());
        for f in self.dielectric.data().as_chunks::<3>().0 {
            let brightest = f[0].max(f[1]).max(f[2]);
            level.push(brightest);
            tint.extend(f.map(|v| if brightest > 0.0 { v / brightest } else { 1.0 }));
        }
        let (width, height) = (self.dielectric.width(), self.dielectric.height());
        Ok((Image::new(width, height, 1, level)?, Image::new(width, height, 3, tint)?))
    }
}

/// The maps of a material for Blender's Principled BSDF (4.0 and later), as floats; all (H, W, C), rows from the top.
///
/// The normal reflectance is `metallic * base_color + (1 - metallic) * ((ior - 1)/(ior + 1))^2 * 2 * specular_level * specular_tint`.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Principled {
    /// Base Color, (H, W, 3), linear Rec. 709, [0, 1].
    pub base_color: Image,
    /// Metallic, (H, W, 1), [0, 1].
    pub metallic: Image,
    /// Roughness, (H, W, 1), perceptual, [0, 1]; of an anisotropic material the geometric mean of its two.
    pub roughness: Image,
    /// Specular IOR Level, (H, W, 1), [0, 1]; 0.5 is the reflectance that `ior` has.
    pub specular_level: Image,
    /// Specular Tint, (H, W, 3), linear Rec. 709, [0, 1].
    pub specular_tint: Image,
    /// IOR of the whole material: 1.5 unless a dielectric part brighter than 0.08 asks for more.
    pub ior: f64,
    /// Normals, (H, W, 3), unit, +x right, +y up, +z out of the surface.
    pub normal: Image,
    /// Anisotropic and Anisotropic Rotation, of an anisotropic material.
    pub anisotropy: Option<Anisotropy>,
    /// How far reflectances at normal incidence are from the material's.
    pub loss: Loss,
}

/// The anisotropic sockets of Blender's Principled BSDF.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Anisotropy {
    /// Anisotropic, (H, W, 1), [0, 1]: alpha along the tangent times `sqrt(1 - 0.9 a)` is the roughness squared, divided by it is alpha across.
    pub amount: Image,
    /// Anisotropic Rotation, (H, W, 1), [0, 0.5): turns of the direction of the greater roughness, counter-clockwise from +x.
    pub rotation: Image,
    /// Largest ratio of the two alphas that is asked for; above 10 it cannot be held.
    pub largest_ratio: f64,
}

impl Principled {
    /// The maps of a material.
    ///
    /// # Errors
    /// As [`Material::to_maps`].
    ///
    /// # Example
    /// ```
    /// use svbrdf_gcn::export::principled::Principled;
    /// use svbrdf_gcn::{Image, Material};
    ///
    /// let gold = Material {
    ///     diffuse_albedo: Image::new(1, 1, 3, vec![0.0; 3])?,
    ///     specular_albedo: Image::new(1, 1, 3, vec![1.0, 0.77, 0.34])?,
    ///     roughness: Image::new(1, 1, 1, vec![0.3])?,
    ///     normal: Image::new(1, 1, 3, vec![0.0, 0.0, 1.0])?,
    ///     tangent: None,
    ///     patch_size: 1.0,
    ///     unit: None,
    ///     warnings: Vec::new(),
    /// };
    /// let principled = Principled::from_material(&gold)?;
    /// assert_eq!(principled.metallic.data(), [1.0]);
    /// assert_eq!(principled.base_color, gold.specular_albedo);
    /// # Ok::<(), svbrdf_gcn::Error>(())
    /// ```
    pub fn from_material(material: &Material) -> Result<Self> {
        let material = material.limited()?;
        let metallic = Metallic::new(&material, Dielectric::FREE)?;
        let (mut level, specular_tint) = metallic.level_and_tint()?;
        let brightest = level.data().iter().fold(0.0, |brightest, &v| f64::max(brightest, v.into()));
        let ior = if brightest <= DIELECTRIC_MAX + 1e-6 { 1.5 } else { ior_of(brightest / 2.0) };
        let scale = 2.0 * normal_reflectance(ior);
        for value in level.data_mut() {
            *value = (f64::from(*value) / scale).min(1.0) as f32;
        }
        Ok(Self {
            base_color: metallic.base_color,
            metallic: metallic.metallic,
            roughness: mean_roughness(&material.roughness)?,
            specular_level: level,
            specular_tint,
            ior,
            anisotropy: material.tangent.as_ref().map(|tangent| Anisotropy::new(&material, tangent)).transpose()?,
            normal: material.normal,
            loss: metallic.loss,
        })
    }

    /// The diffuse and the specular reflectance at normal incidence that these maps stand for, (H, W, 3) each.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`](crate::Error::ShapeMismatch) if the maps do not fit one another.
    pub fn reflectance(&self) -> Result<(Image, Image)> {
        let scale = 2.0 * normal_reflectance(self.ior);
        let (mut diffuse, mut specular) = (Vec::new(), Vec::new());
        let colors = self.base_color.data().chunks_exact(3).zip(self.specular_tint.data().chunks_exact(3));
        let scalars = self.metallic.data().iter().zip(self.specular_level.data());
        for ((base, tint), (&metallic, &level)) in colors.zip(scalars) {
            let solution = Solution {
                base: std::array::from_fn(|c| base[c].into()),
                metallic: metallic.into(),
                dielectric: std::array::from_fn(|c| scale * f64::from(level) * f64::from(tint[c])),
            };
            let (d, s) = solution.reflectance(Dielectric::FREE);
            diffuse.extend(d.map(|v| v as f32));
            specular.extend(s.map(|v| v as f32));
        }
        let (width, height) = (self.base_color.width(), self.base_color.height());
        Ok((Image::new(width, height, 3, diffuse)?, Image::new(width, height, 3, specular)?))
    }
}

/// `((ior - 1)/(ior + 1))^2`.
pub fn normal_reflectance(ior: f64) -> f64 {
    ((ior - 1.0) / (ior + 1.0)).powi(2)
}

/// The inverse of [`normal_reflectance`], for [0, 1).
pub fn ior_of(normal_reflectance: f64) -> f64 {
    let root = normal_reflectance.sqrt();
    (1.0 + root) / (1.0 - root)
}

/// One perceptual roughness: alpha is the geometric mean of the two alphas.
fn mean_roughness(roughness: &Image) -> Result<Image> {
    if roughness.channels() == 1 {
        return Ok(roughness.clone());
    }
    let data = roughness.data().as_chunks::<2>().0.iter().map(|[x, y]| (x * y).sqrt()).collect();
    Image::new(roughness.width(), roughness.height(), 1, data)
}

/// Both alphas of an anisotropic material, the greater first, and the unit tangent along the greater one, x not negative.
pub(super) fn alphas(material: &Material, tangent: &Image) -> Vec<([f64; 2], [f64; 3])> {
    let vectors = tangent.data().as_chunks::<3>().0.iter().zip(material.normal.data().as_chunks::<3>().0);
    let roughness = material.roughness.data().as_chunks::<2>().0;
    vectors
        .zip(roughness)
        .map(|((t, n), &[x, y])| {
            let (t, n) = (t.map(f64::from), n.map(f64::from));
            let alpha = [x, y].map(|r| f64::from(r).powi(2));
            let (alpha, along) = if alpha[0] >= alpha[1] {
                (alpha, t)
            } else {
                let across = [n[1] * t[2] - n[2] * t[1], n[2] * t[0] - n[0] * t[2], n[0] * t[1] - n[1] * t[0]];
                ([alpha[1], alpha[0]], across)
            };
            let backwards = along[0] < 0.0 || (along[0] == 0.0 && along[1] < 0.0);
            (alpha, if backwards { along.map(|v| -v) } else { along })
        })
        .collect()
}

impl Anisotropy {
    /// Cycles: alpha along = r^2 / aspect, across = r^2 aspect, aspect = sqrt(1 - 0.9 anisotropic).
    fn new(material: &Material, tangent: &Image) -> Result<Self> {
        let (mut amount, mut rotation, mut largest_ratio) = (Vec::new(), Vec::new(), 1.0f64);
        for ([greater, lesser], [x, y, _]) in alphas(material, tangent) {
            let ratio = if greater > 0.0 { lesser / greater } else { 1.0 };
            largest_ratio = largest_ratio.max(1.0 / ratio.max(1e-6));
            amount.push(((1.0 - ratio) / 0.9).min(1.0) as f32);
            let turns = y.atan2(x) / std::f64::consts::TAU;
            rotation.push(if turns < 0.0 { turns + 0.5 } else { turns } as f32);
        }
        let (width, height) = (material.width(), material.height());
        Ok(Self {
            amount: Image::new(width, height, 1, amount)?,
            rotation: Image::new(width, height, 1, rotation)?,
            largest_ratio,
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn solve(target: Dielectric, d: [f64; 3], s: [f64; 3]) -> (Solution, f64, f64) {
        let diffuse = std::array::from_fn(|c| d[c] * (1.0 - s[c]));
        let solution = Solution::new(target, diffuse, s);
        let (got_diffuse, got_specular) = solution.reflectance(target);
        let worst = |a: [f64; 3], b: [f64; 3]| (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f64::max);
        (solution, worst(got_diffuse, diffuse), worst(got_specular, s))
    }

    fn material(d: [f32; 3], s: [f32; 3], roughness: &[f32], tangent: Option<[f32; 3]>) -> Material {
        let image = |values: &[f32]| Image::new(1, 1, values.len(), values.to_vec()).unwrap();
        Material {
            diffuse_albedo: image(&d),
            specular_albedo: image(&s),
            roughness: image(roughness),
            normal: image(&[0.0, 0.0, 1.0]),
            tangent: tangent.map(|t| image(&t)),
            patch_size: 1.0,
            unit: None,
            warnings: Vec::new(),
        }
    }

    #[test]
    fn plain_dielectrics_and_metals_are_exact() {
        for target in [Dielectric::FREE, Dielectric::UNREAL] {
            // Base colour is the diffuse albedo where the coat takes what ours takes, else the diffuse reflectance.
            let (plastic, diffuse, specular) = solve(target, [0.5, 0.3, 0.1], [0.05; 3]);
            assert_eq!(plastic.metallic, 0.0);
            assert!(diffuse < 1e-6 && specular < 1e-5, "{diffuse} {specular}");
            let expected = if target.attenuates { 0.5 } else { 0.5 * 0.95 };
            assert!((plastic.base[0] - expected).abs() < 1e-4, "{plastic:?}");
            let (gold, diffuse, specular) = solve(target, [0.0; 3], [1.0, 0.77, 0.34]);
            assert_eq!((gold.metallic, gold.base), (1.0, [1.0, 0.77, 0.34]));
            assert!(diffuse == 0.0 && specular < 1e-12);
            let (black, diffuse, specular) = solve(target, [0.0; 3], [0.0; 3]);
            assert_eq!((black.metallic, black.base), (0.0, [0.0; 3]));
            assert!(diffuse == 0.0 && specular < 1e-5);
        }
        // A coloured dielectric is for those that can tint it.
        let s = [0.06, 0.04, 0.02];
        assert!(solve(Dielectric::FREE, [0.2; 3], s).2 < 1e-12);
        assert!(solve(Dielectric::UNREAL, [0.2; 3], s).2 > 0.005);
    }

    #[test]
    fn noise_in_the_diffuse_of_a_metal_stays_a_metal() {
        let (copper, diffuse, specular) = solve(Dielectric::FREE, [0.02, 0.05, 0.08], [0.9, 0.6, 0.5]);
        assert!(copper.metallic > 0.8, "{copper:?}");
        assert!(diffuse < 0.05 && specular < 0.02, "{diffuse} {specular}");
        // A strongly coloured diffuse under a bright grey coat is no metal.
        let (lacquer, diffuse, specular) = solve(Dielectric::FREE, [0.6, 0.02, 0.02], [0.25; 3]);
        assert!(lacquer.metallic < 0.3, "{lacquer:?}");
        assert!(diffuse < 0.05 && specular < 0.05, "{diffuse} {specular}");
    }

    #[test]
    fn index_of_refraction() {
        assert!((normal_reflectance(1.5) - 0.04).abs() < 1e-15);
        for ior in [1.0, 1.3, 1.79, 5.0] {
            assert!((ior_of(normal_reflectance(ior)) - ior).abs() < 1e-12);
        }
    }

    #[test]
    fn anisotropy_gives_both_alphas_back() {
        // Cycles' own formula, along the direction of the rotation.
        for (rx, ry, along_x) in [(0.6f32, 0.4f32, true), (0.3, 0.5, false), (0.4, 0.4, true)] {
            let material = material([0.2; 3], [0.04; 3], &[rx, ry], Some([1.0, 0.0, 0.0]));
            let maps = Principled::from_material(&material).unwrap();
            let anisotropy = maps.anisotropy.unwrap();
            let aspect = (1.0 - 0.9 * anisotropy.amount.data()[0]).sqrt();
            let alpha = maps.roughness.data()[0].powi(2);
            let expected = (rx.max(ry).powi(2), rx.min(ry).powi(2));
            assert!((alpha / aspect - expected.0).abs() < 1e-6 && (alpha * aspect - expected.1).abs() < 1e-6);
            assert_eq!(anisotropy.rotation.data()[0], if along_x { 0.0 } else { 0.25 });
        }
        let slanted = material([0.2; 3], [0.04; 3], &[0.6, 0.4], Some([-0.5, 0.75f32.sqrt(), 0.0]));
        let rotation = Principled::from_material(&slanted).unwrap().anisotropy.unwrap().rotation;
        assert!((rotation.data()[0] - 1.0 / 3.0).abs() < 1e-6);
    }

    #[test]
    fn maps_say_what_the_loss_says() {
        // A bright coloured dielectric asks for a higher index of refraction.
        let material = material([0.7, 0.1, 0.1], [0.2, 0.25, 0.3], &[0.3], None);
        let maps = Principled::from_material(&material).unwrap();
        let (diffuse, specular) = maps.reflectance().unwrap();
        let off = |got: &Image, expected: [f32; 3]| {
            Difference::of(got.data().iter().zip(expected).map(|(a, b)| f64::from(a - b)))
        };
        let expected =
            std::array::from_fn(|c| material.diffuse_albedo.data()[c] * (1.0 - material.specular_albedo.data()[c]));
        assert!((off(&diffuse, expected).max - maps.loss.diffuse.max).abs() < 1e-6);
        assert!((off(&specular, [0.2, 0.25, 0.3]).max - maps.loss.specular.max).abs() < 1e-6);
        assert!(maps.ior > 1.5 && maps.specular_level.data()[0] <= 1.0);
        assert!(maps.loss.specular.max < 0.02 && maps.loss.diffuse.max < 0.02, "{:?}", maps.loss);
    }

    proptest! {
        #[test]
        fn solutions_are_in_range_and_no_worse_than_a_plain_one(
            d in proptest::array::uniform3(0.0..1.0f64),
            s in proptest::array::uniform3(0.0..1.0f64),
        ) {
            for target in [Dielectric::FREE, Dielectric::UNREAL] {
                let diffuse = std::array::from_fn(|c| d[c] * (1.0 - s[c]));
                let best = Solution::new(target, diffuse, s);
                let in_range = |v: f64| (0.0..=1.0).contains(&v);
                prop_assert!(best.base.into_iter().all(in_range) && in_range(best.metallic));
                prop_assert!(best.dielectric.into_iter().all(|f| (target.min..=target.max).contains(&f)));
                let cost = best.cost(target, diffuse, s);
                for m in [0.0, 0.25, 0.5, 1.0] {
                    let other = Solution::with_metallic(target, m, diffuse, s).cost(target, diffuse, s);
                    prop_assert!(cost <= other + 2.0 * NEGLIGIBLE);
                }
                // An independent search over all of a plain metal and a plain dielectric.
                let metal = Solution { base: s, metallic: 1.0, dielectric: [DIELECTRIC_USUAL; 3] };
                prop_assert!(cost <= metal.cost(target, diffuse, s) + 2.0 * NEGLIGIBLE);
            }
        }
    }
}
