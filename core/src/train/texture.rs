//! Periodic textures that crops are sampled from.

use half::f16;

use crate::color::Transfer;
use crate::error::Result;
use crate::maps::{Lobe, Maps};

/// Values of a texel.
const TEXEL: usize = 9;
/// Pixels of the texture to one of the crop from which on the half resolution is sampled.
const HALF_FROM: f32 = 1.4;

/// Diffuse albedo in gamma 2.2, normal x and y, roughness, specular albedo in gamma 2.2.
type Texel = [f16; TEXEL];

/// A periodic material, in its resolution and in half of it.
///
/// The values of a pixel lie together in half precision: a crop turned by any angle reads four places per pixel, and hundreds of materials
/// fit into memory.
pub(super) struct Texture {
    levels: [Level; 2],
}

struct Level {
    side: usize,
    texels: Vec<Texel>,
}

/// Where a crop lies in a texture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crop {
    /// Pixels of the texture to one of the crop.
    pub step: f32,
    /// By how much the crop is turned counter-clockwise, in radians.
    pub angle: f32,
    /// In units of the texture, x to the right and y downwards.
    pub centre: [f32; 2],
    /// Mirrored in x.
    pub mirrored: bool,
}

impl Texture {
    /// A texture of square `maps`.
    pub fn new(maps: &Maps<f32>) -> Self {
        let side = maps.width().min(maps.height());
        let planes: [&[f32]; 10] = std::array::from_fn(|plane| maps.plane(plane));
        let texel = |at: usize| {
            let code = |plane: usize| Transfer::Gamma22.encode(planes[plane][at].clamp(0.0, 1.0));
            let (diffuse, specular) = ([0, 1, 2].map(code), [7, 8, 9].map(code));
            let [r, g, b] = diffuse;
            let [x, y, z] = specular;
            [r, g, b, planes[3][at], planes[4][at], planes[6][at], x, y, z].map(f16::from_f32)
        };
        let texels = (0..side * side).map(|at| texel(at / side * maps.width() + at % side)).collect();
        let full = Level { side, texels };
        let half = full.halved();
        Self { levels: [full, half] }
    }

    /// Bytes of a texture with this side.
    pub fn bytes(side: usize) -> u64 {
        let pixels = (side as u64).saturating_mul(side as u64);
        (pixels + pixels / 4).saturating_mul(size_of::<Texel>() as u64)
    }

    /// Pixels of a side.
    pub fn side(&self) -> usize {
        self.levels[0].side
    }

    /// Maps of a crop of `size` x `size` pixels, its normals turned with it.
    pub fn sample(&self, size: usize, crop: &Crop) -> Result<Maps<f32>> {
        let coarse = usize::from(crop.step > HALF_FROM);
        let level = &self.levels[coarse];
        let scale = if coarse == 1 { crop.step / 2.0 } else { crop.step };
        let (sine, cosine) = crop.angle.sin_cos();
        let mirror = if crop.mirrored { -1.0 } else { 1.0 };
        let centre = crop.centre.map(|at| at * level.side as f32);
        let middle = (size as f32 - 1.0) / 2.0;
        let pixels = size * size;
        let mut data = vec![0.0; 10 * pixels];
        for at in 0..pixels {
            // x right and y up in the crop, turned back into the texture.
            let x = ((at % size) as f32 - middle) * mirror;
            let y = middle - (at / size) as f32;
            let u = (cosine * x + sine * y) * scale + centre[0];
            let v = centre[1] - (cosine * y - sine * x) * scale;
            let texel = level.at(u, v);
            let (nx, ny) = (texel[3], texel[4]);
            let nz = (1.0 - nx * nx - ny * ny).max(0.01).sqrt();
            let length = (nx * nx + ny * ny + nz * nz).sqrt();
            let linear = |code: f32| Transfer::Gamma22.decode(code.clamp(0.0, 1.0));
            let values = [
                linear(texel[0]),
                linear(texel[1]),
                linear(texel[2]),
                (cosine * nx - sine * ny) * mirror / length,
                (sine * nx + cosine * ny) / length,
                nz / length,
                texel[5].clamp(0.0, 1.0),
                linear(texel[6]),
                linear(texel[7]),
                linear(texel[8]),
            ];
            for (plane, value) in values.into_iter().enumerate() {
                data[plane * pixels + at] = value;
            }
        }
        Maps::new(Lobe::Isotropic, size, size, data)
    }
}

impl Level {
    /// Means of two by two pixels; normals are averaged as slopes are, roughly.
    fn halved(&self) -> Self {
        let side = (self.side / 2).max(1);
        let mean = |at: usize| {
            let (row, column) = (at / side * 2, at % side * 2);
            let texels = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(down, right)| {
                self.texels[(row + down).min(self.side - 1) * self.side + (column + right).min(self.side - 1)]
            });
            std::array::from_fn(|value| {
                f16::from_f32(texels.iter().map(|texel| texel[value].to_f32()).sum::<f32>() / 4.0)
            })
        };
        Self { side, texels: (0..side * side).map(mean).collect() }
    }

    /// Bilinear interpolation; whole coordinates are pixels, and the texture repeats.
    fn at(&self, u: f32, v: f32) -> [f32; TEXEL] {
        let wrap = |value: f32| value.rem_euclid(self.side as f32) as usize % self.side;
        let (left, top) = (wrap(u.floor()), wrap(v.floor()));
        let (right, bottom) = ((left + 1) % self.side, (top + 1) % self.side);
        let (x, y) = (u - u.floor(), v - v.floor());
        let read = |row: usize, column: usize| &self.texels[row * self.side + column];
        let corners = [
            (read(top, left), (1.0 - x) * (1.0 - y)),
            (read(top, right), x * (1.0 - y)),
            (read(bottom, left), (1.0 - x) * y),
            (read(bottom, right), x * y),
        ];
        std::array::from_fn(|value| corners.iter().map(|(texel, weight)| texel[value].to_f32() * weight).sum())
    }
}
