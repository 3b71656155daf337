"""Procedural materials: what photographed libraries lack - glossy, metallic, strongly bumped surfaces.

Every kind makes a batch of periodic materials at once on the device of its random numbers. All lengths are in pixels of the texture;
relief is given as the root mean square of its slope, so that no material is flatter or steeper than was drawn.
"""

import math

import torch

from maps import join, normal_from_slopes

# Reflectance at normal incidence, linear RGB: gold, copper, aluminium, iron, silver, titanium, chromium, brass, nickel, bronze.
METALS = (
    (1.0, 0.77, 0.34), (0.95, 0.64, 0.54), (0.91, 0.92, 0.92), (0.56, 0.57, 0.58), (0.97, 0.96, 0.92),
    (0.54, 0.5, 0.45), (0.55, 0.56, 0.56), (0.89, 0.79, 0.43), (0.66, 0.61, 0.53), (0.71, 0.51, 0.29),
)  # fmt: skip

# Most Voronoi cells along a side.
CELLS_MAX = 64


class Draw:
    """Random values and fields for `count` textures of `size` pixels a side, from one generator."""

    def __init__(self, generator, count, size):
        self.generator, self.count, self.size = generator, count, size
        self.device = generator.device

    def uniform(self, low, high, channels=1):
        values = torch.rand(self.count, channels, 1, 1, generator=self.generator, device=self.device)
        return low + (high - low) * values

    def log_uniform(self, low, high, channels=1):
        return torch.exp(self.uniform(math.log(low), math.log(high), channels))

    def integer(self, low, high):
        return self.uniform(low, high + 1 - 1e-4).floor()

    def coin(self, probability):
        return self.uniform(0, 1) < probability

    def grid(self):
        """Pixel coordinates in [0, 1), x to the right and y downwards."""
        ticks = torch.arange(self.size, device=self.device) / self.size
        shape = (self.count, 1, self.size, self.size)
        return ticks.expand(shape), ticks[:, None].expand(shape)

    def noise(self, falloff=None, coarse=2.0, fine=0.5, stretch=1.0, angle=0.0):
        """Periodic Gaussian noise with mean 0 and deviation 1: amplitude f^-falloff between `coarse` periods per texture and `fine` per pixel.

        `stretch` > 1 draws it out along `angle` (radians, counter-clockwise from x).
        """
        falloff = self.uniform(0.8, 1.8) if falloff is None else falloff
        white = torch.randn(self.count, 1, self.size, self.size, generator=self.generator, device=self.device)
        fx = torch.fft.rfftfreq(self.size, device=self.device)
        fy = -torch.fft.fftfreq(self.size, device=self.device)[:, None]
        angle = torch.as_tensor(angle, device=self.device)
        along, across = torch.cos(angle) * fx + torch.sin(angle) * fy, torch.cos(angle) * fy - torch.sin(angle) * fx
        frequency = ((along * stretch) ** 2 + across**2).sqrt()
        low = torch.as_tensor(coarse / self.size, device=self.device)
        amplitude = torch.where(frequency > 0, (frequency + low) ** -falloff, torch.zeros_like(frequency))
        amplitude = amplitude * torch.exp(-((frequency / torch.as_tensor(fine, device=self.device)) ** 4)) * (1 - torch.exp(-((frequency / low) ** 2)))
        field = torch.fft.irfft2(torch.fft.rfft2(white) * amplitude, s=(self.size, self.size))
        return field / field.std((-2, -1), keepdim=True).clamp_min(1e-6)

    def warp(self, amount, coarse=2.0):
        """Smooth displacements in units of the texture, x and y."""
        return tuple(amount * self.noise(2.5, coarse, 0.1) for _ in range(2))

    def cells(self, x, y, across, down, jitter=1.0):
        """Voronoi cells around one jittered point in each field of an `across` x `down` grid, at most `CELLS_MAX` either way.

        Returns distances to the nearest and second nearest point (in fields), the vector from the nearest, and three random values per cell.
        """
        table = torch.rand(self.count, 5, CELLS_MAX**2, generator=self.generator, device=self.device)
        u, v = x * across, y * down
        near = torch.full_like(u, 9.0)
        second, dx, dy = near.clone(), torch.zeros_like(u), torch.zeros_like(u)
        pick = torch.zeros(u.shape, dtype=torch.long, device=self.device)
        for j in (-1, 0, 1):
            for i in (-1, 0, 1):
                column, row = u.floor() + i, v.floor() + j
                cell = (row.remainder(down) * CELLS_MAX + column.remainder(across)).long()
                flat = cell.flatten(2).expand(-1, 2, -1)
                offset = torch.gather(table[:, :2], 2, flat).reshape(self.count, 2, *u.shape[-2:])
                ox, oy = (0.5 + jitter * (offset[:, k : k + 1] - 0.5) for k in (0, 1))
                ex, ey = u - column - ox, v - row - oy
                distance = (ex * ex + ey * ey).sqrt()
                closer = distance < near
                second = torch.where(closer, near, torch.minimum(second, distance))
                near = torch.where(closer, distance, near)
                dx, dy, pick = torch.where(closer, ex, dx), torch.where(closer, ey, dy), torch.where(closer, cell, pick)
        values = torch.gather(table[:, 2:], 2, pick.flatten(2).expand(-1, 3, -1)).reshape(self.count, 3, *u.shape[-2:])
        return near, second, (dx, dy), values

    def color(self, low=0.02, high=0.9, saturation=0.9):
        """Linear RGB albedos of any hue."""
        hue = self.uniform(0, 1) + torch.tensor([0, 1 / 3, 2 / 3], device=self.device).view(1, 3, 1, 1)
        tint = (0.5 + 0.5 * torch.cos(2 * math.pi * hue)) ** self.uniform(0.5, 2)
        return self.uniform(low**0.5, high**0.5) ** 2 * (1 - self.uniform(0, saturation) * (1 - tint))

    def metal(self):
        """F0 of a metal; one in six is a coloured coating."""
        table = torch.tensor(METALS, device=self.device)
        index = torch.randint(len(METALS), (self.count,), generator=self.generator, device=self.device)
        pure = table[index].view(-1, 3, 1, 1) * self.uniform(0.75, 1.0)
        return torch.where(self.coin(0.17), self.color(0.3, 0.9), pure)

    def coat(self):
        """F0 of a dielectric."""
        return torch.where(self.coin(0.55), self.uniform(0.03, 0.055), self.log_uniform(0.02, 0.4)).expand(-1, 3, -1, -1)

    def roughness(self, low, high):
        return self.uniform(low, high)


def slopes(height, rms):
    """Slopes (to the right and upwards) of periodic height, scaled to the root mean square `rms` and limited to 3."""
    x = (height.roll(-1, -1) - height.roll(1, -1)) / 2
    y = (height.roll(1, -2) - height.roll(-1, -2)) / 2
    scale = rms / (x * x + y * y).mean((-2, -1), keepdim=True).sqrt().clamp_min(1e-6)
    return (x * scale).clamp(-3, 3), (y * scale).clamp(-3, 3)


def step(values, edge, width):
    """From 0 to 1 across `edge`, smoothly over `width`."""
    t = ((values - edge) / width + 0.5).clamp(0, 1)
    return t * t * (3 - 2 * t)


def mix(mask, a, b):
    return b + mask * (a - b)


def finish(draw, diffuse, specular, roughness, *reliefs):
    """Maps of a material with one slope field or several."""
    x, y = (sum(relief[axis] for relief in reliefs) for axis in (0, 1))
    size = (draw.count, -1, draw.size, draw.size)
    normal = normal_from_slopes(x.expand(size), y.expand(size))
    parts = diffuse.clamp(0, 0.95), normal, roughness.clamp(0.07, 1), specular.clamp(0.005, 1)
    return join(*(part.expand(size) for part in parts))


def painted(d):
    """Glossy or satin paint with orange peel, dust and faint stains."""
    stain = d.noise()
    diffuse = d.color() * (1 + d.uniform(0, 0.15) * stain)
    rough = d.roughness(0.1, 0.6) + d.uniform(0, 0.06) * d.noise()
    peel = slopes(d.noise(1.0, d.log_uniform(8, 40), d.uniform(0.03, 0.15)), d.log_uniform(0.005, 0.15))
    return finish(d, diffuse, d.coat(), rough, peel)


def brushed(d):
    """Metal brushed in one direction."""
    angle = torch.where(d.coin(0.6), torch.zeros_like(d.uniform(0, 1)), d.uniform(0, math.pi))
    streaks = d.noise(0.4, 2.0, 0.5, d.log_uniform(15, 60), angle)
    specular = d.metal() * (1 + d.uniform(0, 0.1) * streaks)
    rough = d.roughness(0.15, 0.5) + d.uniform(0.01, 0.06) * streaks + d.uniform(0, 0.05) * d.noise()
    return finish(d, torch.zeros_like(specular), specular, rough, slopes(streaks, d.log_uniform(0.02, 0.15)))


def hammered(d):
    """Metal or glaze with dents."""
    x, y = d.grid()
    count = d.integer(5, 24)
    near, second, _, values = d.cells(x, y, count, count, 0.8)
    dents = torch.where(d.coin(0.5), near.square(), -((second - near).clamp_max(0.5)))
    relief = slopes(dents + d.uniform(0, 0.05) * d.noise(), d.log_uniform(0.08, 0.5))
    metallic = d.coin(0.7).float()
    color = d.metal()
    specular = mix(metallic, color * (0.9 + 0.1 * values[:, :1]), d.coat())
    rough = d.roughness(0.12, 0.45) + d.uniform(0, 0.1) * d.noise()
    return finish(d, (1 - metallic) * d.color(), specular, rough, relief)


def rusted(d):
    """Metal, polished to cast, with dull oxide patches."""
    patches = step(d.noise(d.uniform(1.2, 2.0)), d.uniform(-1, 2.5), d.uniform(0.1, 1.0))
    grain = d.noise(0.5, 16)
    specular = mix(patches, d.coat(), d.metal())
    rust = torch.where(d.coin(0.6), d.color(0.05, 0.3, 0.5) * torch.tensor([1.0, 0.55, 0.3], device=d.device).view(1, 3, 1, 1), d.color())
    diffuse = patches * rust * (1 + 0.25 * grain).clamp_min(0.2)
    rough = mix(patches, d.roughness(0.5, 0.95), d.roughness(0.1, 0.55)) + 0.03 * grain
    height = patches * d.uniform(-0.5, 1.5) * (1 + 0.4 * grain) + d.uniform(0, 0.2) * d.noise()
    return finish(d, diffuse, specular, rough, slopes(height, d.log_uniform(0.04, 0.35)))


def chipped(d):
    """Paint that has come off metal, primer or wood in places."""
    field = d.noise(d.uniform(1.0, 1.7))
    paint = step(field, d.uniform(-1.6, 0.3), d.uniform(0.02, 0.15))
    metallic = d.coin(0.75).float()
    under_diffuse = (1 - metallic) * d.color(0.05, 0.5)
    grain = d.noise(0.7, 8, 0.5, d.log_uniform(1, 20))
    specular = mix(paint, d.coat(), mix(metallic, d.metal(), d.coat()))
    diffuse = mix(paint, d.color() * (1 + 0.05 * grain), under_diffuse * (1 + 0.2 * grain))
    rough = mix(paint, d.roughness(0.12, 0.6), d.roughness(0.2, 0.7) + 0.06 * grain)
    relief = slopes(paint, d.log_uniform(0.05, 0.3)), slopes(grain, (1 - paint) * d.log_uniform(0.02, 0.2) + 0.01)
    return finish(d, diffuse, specular, rough, *relief)


def scratched(d):
    """Polished metal, plastic or lacquer with scratches and smears."""
    strokes = [d.noise(0.1, 2, 0.5, d.log_uniform(20, 80), d.uniform(0, math.pi)) for _ in range(3)]
    lines = torch.stack([step(stroke, d.uniform(2.2, 3.2), 0.8) for stroke in strokes]).amax(0)
    metallic = d.coin(0.5).float()
    smear = d.noise(1.5)
    specular = mix(metallic, d.metal(), d.coat())
    diffuse = (1 - metallic) * d.color() * (1 + d.uniform(0, 1.0) * lines)
    rough = d.roughness(0.08, 0.35) + d.uniform(0, 0.06) * smear + d.uniform(0.05, 0.4) * lines
    relief = slopes(-lines, d.log_uniform(0.02, 0.12)), slopes(d.noise(1.5, 2, 0.1), d.log_uniform(0.005, 0.08))
    return finish(d, diffuse, specular, rough, *relief)


def flakes(d):
    """Metallic paint, glitter, mica: small flakes, each with its own normal."""
    x, y = d.grid()
    count = d.integer(24, 64)
    near, _, _, values = d.cells(x, y, count, count)
    share = step(values[:, 2:], d.uniform(0, 0.8), 0.05) * step(-near, -d.uniform(0.3, 0.9), 0.2)
    tilt = d.log_uniform(0.03, 0.5) * share
    flake = torch.where(d.coin(0.7), d.metal(), d.color(0.2, 0.8))
    specular = mix(share * d.uniform(0.3, 1), flake, d.coat())
    diffuse = d.color(0.02, 0.6) * (1 - share * 0.8)
    rough = mix(share, d.roughness(0.1, 0.4), d.roughness(0.15, 0.6))
    sparkle = tilt * (values[:, :1] * 2 - 1), tilt * (values[:, 1:2] * 2 - 1)
    return finish(d, diffuse, specular, rough, sparkle, slopes(d.noise(1.5, 4, 0.1), d.log_uniform(0.005, 0.1)))


def woven(d):
    """Plain, twill and basket weaves of yarns."""
    x, y = d.grid()
    wx, wy = d.warp(d.uniform(0, 0.006))
    across, down = d.integer(3, 16) * 4, d.integer(3, 16) * 4
    u, v = (x + wx) * across, (y + wy) * down
    crossing = u.floor() + v.floor()
    top = torch.where(d.coin(0.5), crossing.remainder(2) < 1, crossing.remainder(4) < 2).float()
    warp_yarn = torch.cos(2 * math.pi * (u - u.floor() - 0.5)) * 0.5 + 0.5
    weft_yarn = torch.cos(2 * math.pi * (v - v.floor() - 0.5)) * 0.5 + 0.5
    bulge_v, bulge_u = torch.cos(math.pi * (v - v.floor() - 0.5)), torch.cos(math.pi * (u - u.floor() - 0.5))
    height = torch.maximum(top * warp_yarn.sqrt() * (0.6 + 0.4 * bulge_v), (1 - top) * weft_yarn.sqrt() * (0.6 + 0.4 * bulge_u))
    fibre = d.noise(0.2, 20)
    first = d.color()
    color = torch.where(d.coin(0.5), first, mix(top, first, d.color()))
    diffuse = color * (0.35 + 0.65 * height) * (1 + 0.15 * fibre)
    silky = d.coin(0.4).float()
    tint = first.clamp_min(0.05) / first.amax(1, keepdim=True).clamp_min(0.05)
    specular = mix(silky, d.uniform(0.04, 0.35) * mix(d.uniform(0, 1), tint, torch.ones_like(tint)), d.coat())
    rough = mix(silky, d.roughness(0.25, 0.55), d.roughness(0.5, 1.0)) + 0.05 * fibre
    return finish(d, diffuse, specular, rough, slopes(height + 0.05 * fibre, d.log_uniform(0.1, 0.6)))


def leather(d):
    """Grained skin: cells of two sizes with creases between, dull to patent."""
    x, y = d.grid()
    wx, wy = d.warp(d.uniform(0, 0.02), 4.0)
    count = d.integer(10, 40)
    near, second, _, values = d.cells(x + wx, y + wy, count, (count * d.uniform(0.6, 1)).floor().clamp_min(4))
    crease = step(second - near, d.uniform(0.0, 0.12), d.uniform(0.15, 0.5))
    small = d.noise(0.8, count * 2, 0.4)
    fold = d.noise(2.0, 2.0, 0.1)
    height = crease * (0.8 + 0.2 * values[:, :1]) + d.uniform(0, 0.15) * small
    worn = d.uniform(0, 0.6)
    diffuse = d.color(0.02, 0.5) * (1 - worn * (1 - crease)) * (1 + 0.06 * small + 0.06 * fold)
    rough = d.roughness(0.2, 0.65) + d.uniform(-0.1, 0.15) * (1 - crease) + 0.02 * small
    relief = slopes(height, d.log_uniform(0.08, 0.45)), slopes(fold, d.log_uniform(0.01, 0.12))
    return finish(d, diffuse, d.coat(), rough, *relief)


def tiled(d):
    """Glazed tiles, bricks and panels with grout, each a little tilted."""
    x, y = d.grid()
    across, down = d.integer(2, 10), d.integer(1, 5) * 2
    v = y * down
    u = x * across + torch.where(d.coin(0.5), 0.5 * v.floor().remainder(2), torch.zeros_like(v))
    fu, fv = u - u.floor(), v - v.floor()
    cell = (v.floor() * 16 + u.floor().remainder(across)).long()
    table = torch.rand(d.count, 4, 256, generator=d.generator, device=d.device)
    values = torch.gather(table, 2, cell.flatten(2).expand(-1, 4, -1)).reshape(d.count, 4, d.size, d.size)
    border = torch.minimum(torch.minimum(fu, 1 - fu) / across, torch.minimum(fv, 1 - fv) / down)
    gap = d.log_uniform(0.003, 0.015)
    tile = step(border, gap, gap * d.uniform(0.5, 1.5))
    grain = d.noise()
    two = torch.where(values[:, 3:] < d.uniform(0, 0.7), d.color(), d.color())
    glaze = two * (1 + d.uniform(0, 0.5) * (values[:, :1] - 0.5)) * (1 + d.uniform(0, 0.15) * grain)
    grout = d.color(0.1, 0.6, 0.3) * (1 + 0.2 * d.noise(0.5, 16))
    metallic = d.coin(0.15).float()
    specular = mix(tile, mix(metallic, d.metal(), d.coat()), torch.full_like(glaze, 0.04))
    rough = mix(tile, d.roughness(0.08, 0.6) + d.uniform(0, 0.1) * (values[:, :1] - 0.5), d.roughness(0.6, 0.95))
    lean = d.uniform(0, 0.06) * tile
    tilt = lean * (values[:, 1:2] - 0.5), lean * (values[:, 2:3] - 0.5)
    relief = slopes(tile, d.log_uniform(0.08, 0.4)), slopes(grain, d.log_uniform(0.005, 0.12)), tilt
    return finish(d, mix(tile, (1 - metallic) * glaze, grout), specular, rough, *relief)


def grained(d):
    """Wood: rings drawn out along the grain, raw to varnished."""
    x, y = d.grid()
    wx, _ = d.warp(d.uniform(0.005, 0.06), 2.0)
    lines = torch.cos(2 * math.pi * (d.integer(3, 20) * (x + wx) + 0.3 * d.noise(1.5, 2, 0.3, 8.0, math.pi / 2)))
    pores = d.noise(0.2, 4, 0.5, d.log_uniform(10, 40), math.pi / 2)
    holes = step(pores, d.uniform(0.8, 2), 0.6)
    light = d.color(0.1, 0.6, 0.3) * torch.tensor([1.0, 0.7, 0.42], device=d.device).view(1, 3, 1, 1) ** d.uniform(0.3, 1.6)
    diffuse = light * (1 - d.uniform(0.1, 0.5) * (0.5 + 0.5 * lines)) * (1 - d.uniform(0, 0.5) * holes) * (1 + 0.05 * pores)
    rough = d.roughness(0.15, 0.8) + d.uniform(0, 0.08) * lines + d.uniform(0, 0.2) * holes
    relief = slopes(-holes + 0.1 * lines, d.log_uniform(0.02, 0.25)), slopes(d.noise(1.5, 2, 0.1), d.log_uniform(0.005, 0.05))
    return finish(d, diffuse, d.coat(), rough, *relief)


def printed(d):
    """Prints: areas of flat colour under one gloss, or inks, varnish and foil that differ in it."""
    x, y = d.grid()
    wx, wy = d.warp(d.uniform(0, 0.05))
    kind = d.uniform(0, 1)
    stripes = torch.sin(2 * math.pi * (d.integer(0, 8) * (x + wx) + d.integer(1, 8) * (y + wy)))
    checks = torch.sin(2 * math.pi * d.integer(1, 8) * (x + wx)) * torch.sin(2 * math.pi * d.integer(1, 8) * (y + wy))
    count = d.integer(3, 12)
    near, _, _, values = d.cells(x + wx, y + wy, count, count)
    blobs = torch.where(d.coin(0.5), d.uniform(0.2, 0.5) - near, values[:, :1] - 0.5)
    field = torch.where(kind < 0.25, stripes, torch.where(kind < 0.5, checks, torch.where(kind < 0.75, blobs, d.noise(1.5, 3, 0.2))))
    second = d.noise(1.8, 3, 0.2)
    one, two = step(field, 0.0, 0.03), step(second, d.uniform(0, 1.5), 0.05)
    diffuse = mix(two, d.color(), mix(one, d.color(), d.color()))
    foil = d.coin(0.3).float() * two
    differ = d.coin(0.6).float()
    rough = d.roughness(0.12, 0.7)
    rough = mix(one, rough, mix(differ, d.roughness(0.1, 0.9), rough))
    specular = mix(foil, d.metal(), d.coat())
    emboss = d.coin(0.5).float()
    relief = slopes(one + two + d.noise(0.5, 8), 0.005 + emboss * d.log_uniform(0.02, 0.2)), slopes(d.noise(2.0, 2, 0.1), d.log_uniform(0.005, 0.1))
    return finish(d, diffuse * (1 - foil), specular, mix(foil, d.roughness(0.1, 0.4), rough), *relief)


def stucco(d):
    """Plaster, stone and foam: strong relief, speckles, dull to honed."""
    falloff = d.uniform(0.9, 1.8)
    rock = d.noise(falloff, d.log_uniform(2, 16), d.uniform(0.1, 0.5))
    height = torch.where(d.coin(0.4), -rock.abs(), torch.where(d.coin(0.3), step(rock, 0, 1.0), rock))
    speck = d.noise(0.1, 30)
    diffuse = mix(step(speck, d.uniform(0.5, 3), 0.5), d.color(), d.color(0.1, 0.9, 0.4)) * (1 + d.uniform(-0.2, 0.3) * height.clamp(-2, 2))
    rough = d.roughness(0.3, 1.0) + d.uniform(-0.08, 0.08) * height
    return finish(d, diffuse, d.coat(), rough, slopes(height, d.log_uniform(0.08, 0.7)))


def ribbed(d):
    """Corrugated, ribbed, studded and knitted surfaces of metal, plastic or cloth."""
    x, y = d.grid()
    wx, wy = d.warp(d.uniform(0, 0.01))
    a, b = d.integer(3, 24), d.integer(3, 24)
    wave = torch.sin(2 * math.pi * a * (x + wx))
    ribs = torch.sign(wave) * wave.abs() ** d.uniform(0.3, 1.2)
    studs = (torch.sin(2 * math.pi * a * (x + wx)) * torch.sin(2 * math.pi * b * (y + wy))).clamp_min(0) ** d.uniform(0.4, 2)
    knit = torch.sin(2 * math.pi * (b * (y + wy) + 0.35 * torch.sin(2 * math.pi * a * (x + wx)).abs())) * wave.abs().sqrt()
    kind = d.uniform(0, 1)
    height = torch.where(kind < 0.35, ribs, torch.where(kind < 0.7, studs, knit))
    metallic = d.coin(0.45).float()
    grain = d.noise(0.8, 8)
    specular = mix(metallic, d.metal(), d.coat())
    diffuse = (1 - metallic) * d.color() * (1 + 0.1 * grain + d.uniform(0, 0.3) * height.clamp(-1, 0))
    rough = d.roughness(0.15, 0.8) + 0.03 * grain
    return finish(d, diffuse, specular, rough, slopes(height, d.log_uniform(0.1, 0.7)), slopes(grain, d.log_uniform(0.01, 0.1)))


KINDS = (painted, brushed, hammered, rusted, chipped, scratched, flakes, woven, leather, tiled, grained, printed, stucco, ribbed)


def group(seed, number, count, size, device):
    """Maps (count, 10, size, size) of group `number`, of one kind; kinds take turns. The same numbers give the same maps."""
    generator = torch.Generator(device)
    generator.manual_seed(seed * 1_000_003 + number + 500_000_000)
    return KINDS[number % len(KINDS)](Draw(generator, count, size))
