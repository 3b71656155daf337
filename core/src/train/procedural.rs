//! Procedural materials: what photographed libraries lack - glossy, metallic, strongly bumped surfaces.
//!
//! All lengths are in units of the texture; relief is given as the root mean square of its slope, so that no material is flatter or steeper than was drawn.

use std::f32::consts::{FRAC_PI_2, PI, TAU};

use super::dice::{Dice, Purpose};
use super::noise::{Spectrum, Transform};
use crate::error::Result;
use crate::maps::{Lobe, Maps};

type Rgb = [f32; 3];
/// One value per pixel.
type Field = Vec<f32>;

/// Reflectance at normal incidence, linear RGB: gold, copper, aluminium, iron, silver, titanium, chromium, brass, nickel, bronze.
const METALS: [Rgb; 10] = [
    [1.0, 0.77, 0.34],
    [0.95, 0.64, 0.54],
    [0.91, 0.92, 0.92],
    [0.56, 0.57, 0.58],
    [0.97, 0.96, 0.92],
    [0.54, 0.5, 0.45],
    [0.55, 0.56, 0.56],
    [0.89, 0.79, 0.43],
    [0.66, 0.61, 0.53],
    [0.71, 0.51, 0.29],
];

/// Steepest slope of a relief.
const SLOPE_MAX: f32 = 3.0;

/// Makes materials of one kind.
type Kind = fn(&mut Draw) -> Result<Maps<f32>>;

/// All kinds; materials take turns.
const KINDS: [(&str, Kind); 14] = [
    ("painted", painted),
    ("brushed", brushed),
    ("hammered", hammered),
    ("rusted", rusted),
    ("chipped", chipped),
    ("scratched", scratched),
    ("flakes", flakes),
    ("woven", woven),
    ("leather", leather),
    ("tiled", tiled),
    ("grained", grained),
    ("printed", printed),
    ("stucco", stucco),
    ("ribbed", ribbed),
];

/// How many kinds there are.
pub(super) const COUNT: usize = KINDS.len();

/// Procedural material `number`; the same numbers give the same material.
pub(super) fn material(seed: u64, number: u64, transform: &Transform) -> Result<Maps<f32>> {
    let (_, make) = KINDS[(number % KINDS.len() as u64) as usize];
    make(&mut Draw { dice: Dice::new(seed, Purpose::Procedural, [number, 0]), transform })
}

/// Random values and fields for one texture.
struct Draw<'a> {
    dice: Dice,
    transform: &'a Transform,
}

/// Voronoi cells: per pixel the distances to the nearest and second nearest point, in cells, and three random values of the nearest.
struct Cells {
    near: Field,
    second: Field,
    values: Vec<[f32; 3]>,
}

impl Draw<'_> {
    fn uniform(&mut self, low: f32, high: f32) -> f32 {
        self.dice.uniform(low, high)
    }

    fn log_uniform(&mut self, low: f32, high: f32) -> f32 {
        self.dice.log_uniform(low, high)
    }

    fn integer(&mut self, low: usize, high: usize) -> f32 {
        self.dice.integer(low, high) as f32
    }

    fn coin(&mut self, probability: f32) -> bool {
        self.dice.chance(probability)
    }

    fn pixels(&self) -> usize {
        self.transform.side() * self.transform.side()
    }

    /// A value per pixel, of its place in [0, 1): x to the right and y downwards.
    fn each(&self, value: impl Fn(usize, f32, f32) -> f32) -> Field {
        let side = self.transform.side();
        let place = |index: usize| index as f32 / side as f32;
        (0..side * side).map(|at| value(at, place(at % side), place(at / side))).collect()
    }

    fn noise(&mut self, spectrum: Spectrum) -> Field {
        self.transform.noise(&mut self.dice, &spectrum)
    }

    /// Noise of any falloff.
    fn cloud(&mut self) -> Field {
        let falloff = self.uniform(0.8, 1.8);
        self.noise(Spectrum::new(falloff, 2.0, 0.5))
    }

    /// Smooth displacements in units of the texture, x and y.
    fn warp(&mut self, amount: f32, coarse: f32) -> [Field; 2] {
        [0, 1].map(|_| {
            let mut field = self.noise(Spectrum::new(2.5, coarse, 0.1));
            field.iter_mut().for_each(|value| *value *= amount);
            field
        })
    }

    /// Voronoi cells around one jittered point in each field of an `across` x `down` grid; `warp` displaces the places.
    fn cells(&mut self, warp: Option<&[Field; 2]>, across: f32, down: f32, jitter: f32) -> Cells {
        let (columns, rows) = (across as usize, down as usize);
        let table: Vec<[f32; 5]> =
            (0..columns * rows).map(|_| std::array::from_fn(|_| self.uniform(0.0, 1.0))).collect();
        let side = self.transform.side();
        let mut cells = Cells { near: Vec::new(), second: Vec::new(), values: Vec::new() };
        for at in 0..self.pixels() {
            let [wx, wy] = warp.map_or([0.0; 2], |[wx, wy]| [wx[at], wy[at]]);
            let u = ((at % side) as f32 / side as f32 + wx) * across;
            let v = ((at / side) as f32 / side as f32 + wy) * down;
            let (mut near, mut second, mut values) = (9.0, 9.0, [0.0; 3]);
            for j in -1..=1 {
                for i in -1..=1 {
                    let (column, row) = (u.floor() + i as f32, v.floor() + j as f32);
                    // The remainder of a small negative number may round up to the divisor.
                    let index = (row.rem_euclid(down) as usize).min(rows - 1) * columns
                        + (column.rem_euclid(across) as usize).min(columns - 1);
                    let [x, y, a, b, c] = table[index];
                    let place = |offset: f32| 0.5 + jitter * (offset - 0.5);
                    let distance = (u - column - place(x)).hypot(v - row - place(y));
                    if distance < near {
                        (near, second, values) = (distance, near, [a, b, c]);
                    } else {
                        second = second.min(distance);
                    }
                }
            }
            cells.near.push(near);
            cells.second.push(second);
            cells.values.push(values);
        }
        cells
    }

    /// A linear albedo of any hue.
    fn color(&mut self, low: f32, high: f32, saturation: f32) -> Rgb {
        let (hue, power) = (self.uniform(0.0, 1.0), self.uniform(0.5, 2.0));
        let (value, saturation) = (self.uniform(low.sqrt(), high.sqrt()).powi(2), self.uniform(0.0, saturation));
        [0.0, 1.0 / 3.0, 2.0 / 3.0].map(|shift| {
            let tint = (0.5 + 0.5 * (TAU * (hue + shift)).cos()).max(0.0).powf(power);
            value * (1.0 - saturation * (1.0 - tint))
        })
    }

    /// A color of any brightness and saturation.
    fn any_color(&mut self) -> Rgb {
        self.color(0.02, 0.9, 0.9)
    }

    /// F0 of a metal; one in six is a coloured coating.
    fn metal(&mut self) -> Rgb {
        if self.coin(0.17) {
            return self.color(0.3, 0.9, 0.9);
        }
        let (index, share) = (self.dice.integer(0, METALS.len() - 1), self.uniform(0.75, 1.0));
        scaled(METALS[index], share)
    }

    /// F0 of a dielectric.
    fn coat(&mut self) -> Rgb {
        [if self.coin(0.55) { self.uniform(0.03, 0.055) } else { self.log_uniform(0.02, 0.4) }; 3]
    }

    /// F0 of a metal or of a dielectric.
    fn metal_or_coat(&mut self, metallic: bool) -> Rgb {
        if metallic { self.metal() } else { self.coat() }
    }

    /// Slopes (to the right and upwards) of periodic height, scaled to the root mean square `rms` and limited.
    fn slopes(&self, height: &Field, rms: f32) -> [Field; 2] {
        let side = self.transform.side();
        let difference = |at: usize, [right, down]: [usize; 2]| {
            let (row, column) = (at / side, at % side);
            let place = |right: usize, down: usize| (row + down) % side * side + (column + right) % side;
            (height[place(right, down)] - height[place(side - right, side - down)]) / 2.0
        };
        let along = |step: [usize; 2]| (0..height.len()).map(|at| difference(at, step)).collect::<Field>();
        // The row below is the one after.
        let (mut x, mut y) = (along([1, 0]), along([0, 1]));
        let power: f64 = x.iter().zip(&y).map(|(x, y)| f64::from(x * x + y * y)).sum();
        let scale = rms / ((power / height.len() as f64).sqrt() as f32).max(1e-6);
        x.iter_mut().for_each(|x| *x = (*x * scale).clamp(-SLOPE_MAX, SLOPE_MAX));
        y.iter_mut().for_each(|y| *y = (-*y * scale).clamp(-SLOPE_MAX, SLOPE_MAX));
        [x, y]
    }

    /// Gentle slopes of smooth height.
    fn undulation(&mut self, spectrum: Spectrum, low: f32, high: f32) -> [Field; 2] {
        let (height, rms) = (self.noise(spectrum), self.log_uniform(low, high));
        self.slopes(&height, rms)
    }

    /// Maps of a material: `point` gives diffuse and specular albedo and roughness of a pixel; the slopes of all reliefs add up.
    fn finish<const N: usize>(
        &self,
        reliefs: [[Field; 2]; N],
        point: impl Fn(usize) -> (Rgb, Rgb, f32),
    ) -> Result<Maps<f32>> {
        let (side, pixels) = (self.transform.side(), self.pixels());
        let mut data = vec![0.0; 10 * pixels];
        for at in 0..pixels {
            let (diffuse, specular, roughness) = point(at);
            let [x, y] = [0, 1].map(|axis| reliefs.iter().map(|relief| relief[axis][at]).sum::<f32>());
            let length = (x * x + y * y + 1.0).sqrt();
            let ([r, g, b], [f, h, k]) =
                (diffuse.map(|value| value.clamp(0.0, 0.95)), specular.map(|value| value.clamp(0.005, 1.0)));
            let values = [r, g, b, -x / length, -y / length, 1.0 / length, roughness.clamp(0.07, 1.0), f, h, k];
            for (plane, value) in values.into_iter().enumerate() {
                data[plane * pixels + at] = value;
            }
        }
        Maps::new(Lobe::Isotropic, side, side, data)
    }
}

/// From 0 to 1 across `edge`, smoothly over `width`.
fn step(value: f32, edge: f32, width: f32) -> f32 {
    let t = ((value - edge) / width + 0.5).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// `a` where `share` is 1, `b` where it is 0.
fn mix(share: f32, a: f32, b: f32) -> f32 {
    b + share * (a - b)
}

fn mixed(share: f32, a: Rgb, b: Rgb) -> Rgb {
    std::array::from_fn(|channel| mix(share, a[channel], b[channel]))
}

fn scaled(color: Rgb, factor: f32) -> Rgb {
    color.map(|value| value * factor)
}

fn times(a: Rgb, b: Rgb) -> Rgb {
    std::array::from_fn(|channel| a[channel] * b[channel])
}

/// What lies behind the decimal point.
fn fraction(value: f32) -> f32 {
    value - value.floor()
}

/// Glossy or satin paint with orange peel, dust and faint stains.
fn painted(d: &mut Draw) -> Result<Maps<f32>> {
    let (stain, dust) = (d.cloud(), d.cloud());
    let (color, coat) = (d.any_color(), d.coat());
    let (stained, dusty, rough) = (d.uniform(0.0, 0.15), d.uniform(0.0, 0.06), d.uniform(0.1, 0.6));
    let (coarse, fine) = (d.log_uniform(8.0, 40.0), d.uniform(0.03, 0.15));
    let peel = d.undulation(Spectrum::new(1.0, coarse, fine), 0.005, 0.15);
    d.finish([peel], |at| (scaled(color, 1.0 + stained * stain[at]), coat, rough + dusty * dust[at]))
}

/// Metal brushed in one direction.
fn brushed(d: &mut Draw) -> Result<Maps<f32>> {
    let angle = if d.coin(0.6) { 0.0 } else { d.uniform(0.0, PI) };
    let stretch = d.log_uniform(15.0, 60.0);
    let streaks = d.noise(Spectrum::new(0.4, 2.0, 0.5).stretched(stretch, angle));
    let (metal, cloud) = (d.metal(), d.cloud());
    let (bright, rough) = (d.uniform(0.0, 0.1), d.uniform(0.15, 0.5));
    let (streaked, clouded) = (d.uniform(0.01, 0.06), d.uniform(0.0, 0.05));
    let rms = d.log_uniform(0.02, 0.15);
    let relief = d.slopes(&streaks, rms);
    d.finish([relief], |at| {
        let roughness = rough + streaked * streaks[at] + clouded * cloud[at];
        ([0.0; 3], scaled(metal, 1.0 + bright * streaks[at]), roughness)
    })
}

/// Metal or glaze with dents.
fn hammered(d: &mut Draw) -> Result<Maps<f32>> {
    let count = d.integer(5, 24);
    let cells = d.cells(None, count, count, 0.8);
    let (round, uneven, cloud) = (d.coin(0.5), d.uniform(0.0, 0.05), d.cloud());
    let height = d.each(|at, _, _| {
        let (near, second) = (cells.near[at], cells.second[at]);
        let dent = if round { near * near } else { -(second - near).min(0.5) };
        dent + uneven * cloud[at]
    });
    let rms = d.log_uniform(0.08, 0.5);
    let relief = d.slopes(&height, rms);
    let metallic = d.coin(0.7);
    let (specular, diffuse) = (d.metal_or_coat(metallic), if metallic { [0.0; 3] } else { d.any_color() });
    let (rough, clouded, cloud) = (d.uniform(0.12, 0.45), d.uniform(0.0, 0.1), d.cloud());
    d.finish([relief], |at| {
        let shade = if metallic { 0.9 + 0.1 * cells.values[at][0] } else { 1.0 };
        (diffuse, scaled(specular, shade), rough + clouded * cloud[at])
    })
}

/// Metal, polished to cast, with dull oxide patches.
fn rusted(d: &mut Draw) -> Result<Maps<f32>> {
    let falloff = d.uniform(1.2, 2.0);
    let field = d.noise(Spectrum::new(falloff, 2.0, 0.5));
    let (edge, width) = (d.uniform(-1.0, 2.5), d.uniform(0.1, 1.0));
    let patches = d.each(|at, _, _| step(field[at], edge, width));
    let grain = d.noise(Spectrum::new(0.5, 16.0, 0.5));
    let (coat, metal) = (d.coat(), d.metal());
    let rust = if d.coin(0.6) { times(d.color(0.05, 0.3, 0.5), [1.0, 0.55, 0.3]) } else { d.any_color() };
    let (dull, bare) = (d.uniform(0.5, 0.95), d.uniform(0.1, 0.55));
    let (raised, uneven, cloud) = (d.uniform(-0.5, 1.5), d.uniform(0.0, 0.2), d.cloud());
    let height = d.each(|at, _, _| patches[at] * raised * (1.0 + 0.4 * grain[at]) + uneven * cloud[at]);
    let rms = d.log_uniform(0.04, 0.35);
    let relief = d.slopes(&height, rms);
    d.finish([relief], |at| {
        let diffuse = scaled(rust, patches[at] * (1.0 + 0.25 * grain[at]).max(0.2));
        (diffuse, mixed(patches[at], coat, metal), mix(patches[at], dull, bare) + 0.03 * grain[at])
    })
}

/// Paint that has come off metal, primer or wood in places.
fn chipped(d: &mut Draw) -> Result<Maps<f32>> {
    let falloff = d.uniform(1.0, 1.7);
    let field = d.noise(Spectrum::new(falloff, 2.0, 0.5));
    let (edge, width) = (d.uniform(-1.6, 0.3), d.uniform(0.02, 0.15));
    let paint = d.each(|at, _, _| step(field[at], edge, width));
    let metallic = d.coin(0.75);
    let under = if metallic { [0.0; 3] } else { d.color(0.05, 0.5, 0.9) };
    let stretch = d.log_uniform(1.0, 20.0);
    let grain = d.noise(Spectrum::new(0.7, 8.0, 0.5).stretched(stretch, 0.0));
    let (coat, bare, color) = (d.coat(), d.metal_or_coat(metallic), d.any_color());
    let (glossy, rough) = (d.uniform(0.12, 0.6), d.uniform(0.2, 0.7));
    let (rms, grained) = (d.log_uniform(0.05, 0.3), d.log_uniform(0.02, 0.2));
    let edges = d.slopes(&paint, rms);
    // The grain shows where the paint is gone.
    let mut fine = d.slopes(&grain, grained + 0.01);
    for field in &mut fine {
        let share = |paint: f32| ((1.0 - paint) * grained + 0.01) / (grained + 0.01);
        field.iter_mut().zip(&paint).for_each(|(slope, &paint)| *slope *= share(paint));
    }
    d.finish([edges, fine], |at| {
        let above = scaled(color, 1.0 + 0.05 * grain[at]);
        let diffuse = mixed(paint[at], above, scaled(under, 1.0 + 0.2 * grain[at]));
        (diffuse, mixed(paint[at], coat, bare), mix(paint[at], glossy, rough + 0.06 * grain[at]))
    })
}

/// Polished metal, plastic or lacquer with scratches and smears.
fn scratched(d: &mut Draw) -> Result<Maps<f32>> {
    let mut lines = vec![0.0f32; d.pixels()];
    for _ in 0..3 {
        let (stretch, angle) = (d.log_uniform(20.0, 80.0), d.uniform(0.0, PI));
        let stroke = d.noise(Spectrum::new(0.1, 2.0, 0.5).stretched(stretch, angle));
        let edge = d.uniform(2.2, 3.2);
        lines.iter_mut().zip(&stroke).for_each(|(line, stroke)| *line = line.max(step(*stroke, edge, 0.8)));
    }
    let metallic = d.coin(0.5);
    let smear = d.noise(Spectrum::new(1.5, 2.0, 0.5));
    let (specular, diffuse) = (d.metal_or_coat(metallic), if metallic { [0.0; 3] } else { d.any_color() });
    let (bright, rough) = (d.uniform(0.0, 1.0), d.uniform(0.08, 0.35));
    let (smeared, dull) = (d.uniform(0.0, 0.06), d.uniform(0.05, 0.4));
    let (rms, grooves) = (d.log_uniform(0.02, 0.12), d.each(|at, _, _| -lines[at]));
    let relief = [d.slopes(&grooves, rms), d.undulation(Spectrum::new(1.5, 2.0, 0.1), 0.005, 0.08)];
    d.finish(relief, |at| {
        let roughness = rough + smeared * smear[at] + dull * lines[at];
        (scaled(diffuse, 1.0 + bright * lines[at]), specular, roughness)
    })
}

/// Metallic paint, glitter, mica: small flakes, each with its own normal.
fn flakes(d: &mut Draw) -> Result<Maps<f32>> {
    let count = d.integer(24, 64);
    let cells = d.cells(None, count, count, 1.0);
    let (dense, radius) = (d.uniform(0.0, 0.8), d.uniform(0.3, 0.9));
    let share = d.each(|at, _, _| step(cells.values[at][2], dense, 0.05) * step(-cells.near[at], -radius, 0.2));
    let lean = d.log_uniform(0.03, 0.5);
    let flake = if d.coin(0.7) { d.metal() } else { d.color(0.2, 0.8, 0.9) };
    let (strength, coat, color) = (d.uniform(0.3, 1.0), d.coat(), d.color(0.02, 0.6, 0.9));
    let (shiny, rough) = (d.uniform(0.1, 0.4), d.uniform(0.15, 0.6));
    let sparkle = [0, 1].map(|axis| d.each(|at, _, _| lean * share[at] * (2.0 * cells.values[at][axis] - 1.0)));
    let waves = d.undulation(Spectrum::new(1.5, 4.0, 0.1), 0.005, 0.1);
    d.finish([sparkle, waves], |at| {
        let specular = mixed(share[at] * strength, flake, coat);
        (scaled(color, 1.0 - 0.8 * share[at]), specular, mix(share[at], shiny, rough))
    })
}

/// Plain, twill and basket weaves of yarns.
fn woven(d: &mut Draw) -> Result<Maps<f32>> {
    let amount = d.uniform(0.0, 0.006);
    let [wx, wy] = d.warp(amount, 2.0);
    let (across, down, plain) = (4.0 * d.integer(3, 16), 4.0 * d.integer(3, 16), d.coin(0.5));
    let place = |at: usize, x: f32, y: f32| ((x + wx[at]) * across, (y + wy[at]) * down);
    let top = d.each(|at, x, y| {
        let (u, v) = place(at, x, y);
        let crossing = u.floor() + v.floor();
        let above = if plain { crossing.rem_euclid(2.0) < 1.0 } else { crossing.rem_euclid(4.0) < 2.0 };
        f32::from(u8::from(above))
    });
    let height = d.each(|at, x, y| {
        let (u, v) = place(at, x, y);
        let (u, v) = (fraction(u) - 0.5, fraction(v) - 0.5);
        let yarn = |across: f32, along: f32| {
            (0.5 + 0.5 * (TAU * across).cos()).max(0.0).sqrt() * (0.6 + 0.4 * (PI * along).cos())
        };
        (top[at] * yarn(u, v)).max((1.0 - top[at]) * yarn(v, u))
    });
    let fibre = d.noise(Spectrum::new(0.2, 20.0, 0.5));
    let (first, one) = (d.any_color(), d.coin(0.5));
    let second = if one { first } else { d.any_color() };
    let silky = d.coin(0.4);
    let specular = if silky {
        let least = first.iter().copied().fold(0.05, f32::max);
        let tint = first.map(|value| value.max(0.05) / least);
        let (strength, tinted) = (d.uniform(0.04, 0.35), d.uniform(0.0, 1.0));
        scaled(mixed(tinted, tint, [1.0; 3]), strength)
    } else {
        d.coat()
    };
    let rough = if silky { d.uniform(0.25, 0.55) } else { d.uniform(0.5, 1.0) };
    let (rms, fibrous) = (d.log_uniform(0.1, 0.6), d.each(|at, _, _| height[at] + 0.05 * fibre[at]));
    let relief = d.slopes(&fibrous, rms);
    d.finish([relief], |at| {
        let shade = (0.35 + 0.65 * height[at]) * (1.0 + 0.15 * fibre[at]);
        (scaled(mixed(top[at], first, second), shade), specular, rough + 0.05 * fibre[at])
    })
}

/// Grained skin: cells of two sizes with creases between, dull to patent.
fn leather(d: &mut Draw) -> Result<Maps<f32>> {
    let amount = d.uniform(0.0, 0.02);
    let warp = d.warp(amount, 4.0);
    let count = d.integer(10, 40);
    let down = (count * d.uniform(0.6, 1.0)).floor().max(4.0);
    let cells = d.cells(Some(&warp), count, down, 1.0);
    let (edge, width) = (d.uniform(0.0, 0.12), d.uniform(0.15, 0.5));
    let crease = d.each(|at, _, _| step(cells.second[at] - cells.near[at], edge, width));
    let small = d.noise(Spectrum::new(0.8, 2.0 * count, 0.4));
    let fold = d.noise(Spectrum::new(2.0, 2.0, 0.1));
    let fine = d.uniform(0.0, 0.15);
    let height = d.each(|at, _, _| crease[at] * (0.8 + 0.2 * cells.values[at][0]) + fine * small[at]);
    let (worn, color, coat) = (d.uniform(0.0, 0.6), d.color(0.02, 0.5, 0.9), d.coat());
    let (rough, dull) = (d.uniform(0.2, 0.65), d.uniform(-0.1, 0.15));
    let (rms, folded) = (d.log_uniform(0.08, 0.45), d.log_uniform(0.01, 0.12));
    let relief = [d.slopes(&height, rms), d.slopes(&fold, folded)];
    d.finish(relief, |at| {
        let shade = (1.0 - worn * (1.0 - crease[at])) * (1.0 + 0.06 * small[at] + 0.06 * fold[at]);
        (scaled(color, shade), coat, rough + dull * (1.0 - crease[at]) + 0.02 * small[at])
    })
}

/// Glazed tiles, bricks and panels with grout, each a little tilted.
fn tiled(d: &mut Draw) -> Result<Maps<f32>> {
    let (across, down) = (d.integer(2, 10), 2.0 * d.integer(1, 5));
    let offset = if d.coin(0.5) { 0.5 } else { 0.0 };
    let (columns, rows) = (across as usize, down as usize);
    let table: Vec<[f32; 4]> = (0..columns * rows).map(|_| std::array::from_fn(|_| d.uniform(0.0, 1.0))).collect();
    let place = |x: f32, y: f32| {
        let v = y * down;
        (x * across + offset * v.floor().rem_euclid(2.0), v)
    };
    let side = d.transform.side();
    let values: Vec<[f32; 4]> = (0..d.pixels())
        .map(|at| {
            let (u, v) = place((at % side) as f32 / side as f32, (at / side) as f32 / side as f32);
            let column = (u.floor().rem_euclid(across) as usize).min(columns - 1);
            table[(v.floor() as usize).min(rows - 1) * columns + column]
        })
        .collect();
    let gap = d.log_uniform(0.003, 0.015);
    let soft = gap * d.uniform(0.5, 1.5);
    let tile = d.each(|_, x, y| {
        let (u, v) = place(x, y);
        let border = |at: f32, count: f32| fraction(at).min(1.0 - fraction(at)) / count;
        step(border(u, across).min(border(v, down)), gap, soft)
    });
    let grain = d.cloud();
    let (share, one, two) = (d.uniform(0.0, 0.7), d.any_color(), d.any_color());
    let (varied, stained) = (d.uniform(0.0, 0.5), d.uniform(0.0, 0.15));
    let (grout, sand) = (d.color(0.1, 0.6, 0.3), d.noise(Spectrum::new(0.5, 16.0, 0.5)));
    let metallic = d.coin(0.15);
    let specular = d.metal_or_coat(metallic);
    let (rough, differ, dull) = (d.uniform(0.08, 0.6), d.uniform(0.0, 0.1), d.uniform(0.6, 0.95));
    let lean = d.uniform(0.0, 0.06);
    let tilt = [1, 2].map(|value| d.each(|at, _, _| lean * tile[at] * (values[at][value] - 0.5)));
    let (rms, fine) = (d.log_uniform(0.08, 0.4), d.log_uniform(0.005, 0.12));
    let relief = [d.slopes(&tile, rms), d.slopes(&grain, fine), tilt];
    d.finish(relief, |at| {
        let shade = (1.0 + varied * (values[at][0] - 0.5)) * (1.0 + stained * grain[at]);
        let glaze = if metallic { [0.0; 3] } else { scaled(if values[at][3] < share { one } else { two }, shade) };
        let diffuse = mixed(tile[at], glaze, scaled(grout, 1.0 + 0.2 * sand[at]));
        let roughness = mix(tile[at], rough + differ * (values[at][0] - 0.5), dull);
        (diffuse, mixed(tile[at], specular, [0.04; 3]), roughness)
    })
}

/// Wood: rings drawn out along the grain, raw to varnished.
fn grained(d: &mut Draw) -> Result<Maps<f32>> {
    let amount = d.uniform(0.005, 0.06);
    let [wx, _] = d.warp(amount, 2.0);
    let rings = d.integer(3, 20);
    let wave = d.noise(Spectrum::new(1.5, 2.0, 0.3).stretched(8.0, FRAC_PI_2));
    let lines = d.each(|at, x, _| (TAU * (rings * (x + wx[at]) + 0.3 * wave[at])).cos());
    let stretch = d.log_uniform(10.0, 40.0);
    let pores = d.noise(Spectrum::new(0.2, 4.0, 0.5).stretched(stretch, FRAC_PI_2));
    let edge = d.uniform(0.8, 2.0);
    let holes = d.each(|at, _, _| step(pores[at], edge, 0.6));
    let (light, depth) = (d.color(0.1, 0.6, 0.3), d.uniform(0.3, 1.6));
    let light = times(light, [1.0, 0.7, 0.42].map(|tint: f32| tint.powf(depth)));
    let (ringed, dark, coat) = (d.uniform(0.1, 0.5), d.uniform(0.0, 0.5), d.coat());
    let (rough, striped, dull) = (d.uniform(0.15, 0.8), d.uniform(0.0, 0.08), d.uniform(0.0, 0.2));
    let (rms, height) = (d.log_uniform(0.02, 0.25), d.each(|at, _, _| 0.1 * lines[at] - holes[at]));
    let relief = [d.slopes(&height, rms), d.undulation(Spectrum::new(1.5, 2.0, 0.1), 0.005, 0.05)];
    d.finish(relief, |at| {
        let shade = (1.0 - ringed * (0.5 + 0.5 * lines[at])) * (1.0 - dark * holes[at]) * (1.0 + 0.05 * pores[at]);
        (scaled(light, shade), coat, rough + striped * lines[at] + dull * holes[at])
    })
}

/// Prints: areas of flat colour under one gloss, or inks, varnish and foil that differ in it.
fn printed(d: &mut Draw) -> Result<Maps<f32>> {
    let amount = d.uniform(0.0, 0.05);
    let warp = d.warp(amount, 2.0);
    let [wx, wy] = &warp;
    let kind = d.uniform(0.0, 1.0);
    let field = if kind < 0.25 {
        let (across, down) = (d.integer(0, 8), d.integer(1, 8));
        d.each(|at, x, y| (TAU * (across * (x + wx[at]) + down * (y + wy[at]))).sin())
    } else if kind < 0.5 {
        let (across, down) = (d.integer(1, 8), d.integer(1, 8));
        d.each(|at, x, y| (TAU * across * (x + wx[at])).sin() * (TAU * down * (y + wy[at])).sin())
    } else if kind < 0.75 {
        let count = d.integer(3, 12);
        let cells = d.cells(Some(&warp), count, count, 1.0);
        let (dots, radius) = (d.coin(0.5), d.uniform(0.2, 0.5));
        d.each(|at, _, _| if dots { radius - cells.near[at] } else { cells.values[at][0] - 0.5 })
    } else {
        d.noise(Spectrum::new(1.5, 3.0, 0.2))
    };
    let second = d.noise(Spectrum::new(1.8, 3.0, 0.2));
    let edge = d.uniform(0.0, 1.5);
    let one = d.each(|at, _, _| step(field[at], 0.0, 0.03));
    let two = d.each(|at, _, _| step(second[at], edge, 0.05));
    let (top, ink, ground) = (d.any_color(), d.any_color(), d.any_color());
    let foil = if d.coin(0.3) { 1.0 } else { 0.0 };
    let rough = d.uniform(0.12, 0.7);
    let other = if d.coin(0.6) { d.uniform(0.1, 0.9) } else { rough };
    let (metal, coat, shiny) = (d.metal(), d.coat(), d.uniform(0.1, 0.4));
    let embossed = if d.coin(0.5) { d.log_uniform(0.02, 0.2) } else { 0.0 };
    let paper = d.noise(Spectrum::new(0.5, 8.0, 0.5));
    let height = d.each(|at, _, _| one[at] + two[at] + paper[at]);
    let relief = [d.slopes(&height, 0.005 + embossed), d.undulation(Spectrum::new(2.0, 2.0, 0.1), 0.005, 0.1)];
    d.finish(relief, |at| {
        let foil = foil * two[at];
        let diffuse = mixed(two[at], top, mixed(one[at], ink, ground));
        let roughness = mix(foil, shiny, mix(one[at], rough, other));
        (scaled(diffuse, 1.0 - foil), mixed(foil, metal, coat), roughness)
    })
}

/// Plaster, stone and foam: strong relief, speckles, dull to honed.
fn stucco(d: &mut Draw) -> Result<Maps<f32>> {
    let spectrum = Spectrum::new(d.uniform(0.9, 1.8), d.log_uniform(2.0, 16.0), d.uniform(0.1, 0.5));
    let rock = d.noise(spectrum);
    let (ridged, terraced) = (d.coin(0.4), d.coin(0.3));
    let height = d.each(|at, _, _| match (ridged, terraced) {
        (true, _) => -rock[at].abs(),
        (false, true) => step(rock[at], 0.0, 1.0),
        (false, false) => rock[at],
    });
    let speck = d.noise(Spectrum::new(0.1, 30.0, 0.5));
    let (edge, specks, ground) = (d.uniform(0.5, 3.0), d.any_color(), d.color(0.1, 0.9, 0.4));
    let (shaded, rough, uneven) = (d.uniform(-0.2, 0.3), d.uniform(0.3, 1.0), d.uniform(-0.08, 0.08));
    let (coat, rms) = (d.coat(), d.log_uniform(0.08, 0.7));
    let relief = d.slopes(&height, rms);
    d.finish([relief], |at| {
        let color = mixed(step(speck[at], edge, 0.5), specks, ground);
        (scaled(color, 1.0 + shaded * height[at].clamp(-2.0, 2.0)), coat, rough + uneven * height[at])
    })
}

/// Corrugated, ribbed, studded and knitted surfaces of metal, plastic or cloth.
fn ribbed(d: &mut Draw) -> Result<Maps<f32>> {
    let amount = d.uniform(0.0, 0.01);
    let [wx, wy] = d.warp(amount, 2.0);
    let (across, down) = (d.integer(3, 24), d.integer(3, 24));
    let kind = d.uniform(0.0, 1.0);
    let power = if kind < 0.35 { d.uniform(0.3, 1.2) } else { d.uniform(0.4, 2.0) };
    let height = d.each(|at, x, y| {
        let wave = (TAU * across * (x + wx[at])).sin();
        let rows = y + wy[at];
        if kind < 0.35 {
            wave.signum() * wave.abs().powf(power)
        } else if kind < 0.7 {
            (wave * (TAU * down * rows).sin()).max(0.0).powf(power)
        } else {
            (TAU * (down * rows + 0.35 * wave.abs())).sin() * wave.abs().sqrt()
        }
    });
    let metallic = d.coin(0.45);
    let grain = d.noise(Spectrum::new(0.8, 8.0, 0.5));
    let (specular, diffuse) = (d.metal_or_coat(metallic), if metallic { [0.0; 3] } else { d.any_color() });
    let (dark, rough) = (d.uniform(0.0, 0.3), d.uniform(0.15, 0.8));
    let (rms, fine) = (d.log_uniform(0.1, 0.7), d.log_uniform(0.01, 0.1));
    let relief = [d.slopes(&height, rms), d.slopes(&grain, fine)];
    d.finish(relief, |at| {
        let shade = 1.0 + 0.1 * grain[at] + dark * height[at].clamp(-1.0, 0.0);
        (scaled(diffuse, shade), specular, rough + 0.03 * grain[at])
    })
}
