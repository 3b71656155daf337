"""Pack, procedural materials, augmentation, captures."""

import math
import zipfile

import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: the trainer is not tested; see docs/training.md")

import augment  # noqa: E402
import camera  # noqa: E402
import library as bank  # noqa: E402
import pack  # noqa: E402
import procedural  # noqa: E402
import render  # noqa: E402
from maps import join, unit  # noqa: E402


def is_material(maps):
    assert torch.isfinite(maps).all()
    assert (maps[:, 3:6].norm(dim=1) - 1).abs().max() < 2e-3
    assert maps[:, 5].min() > 0
    for part in (maps[:, :3], maps[:, 6:]):
        assert part.min() >= 0 and part.max() <= 1


def smooth_material(size, seed=1):
    """Periodic maps with a few waves in every plane."""
    rng = torch.Generator().manual_seed(seed)
    draw = procedural.Draw(rng, 1, size)
    waves = torch.cat([draw.noise(3.0, 1.0, 0.02) for _ in range(9)], 1).clamp(-2, 2)
    normal = unit(torch.cat([0.2 * waves[:, :2], torch.ones(1, 1, size, size)], 1))
    return join(0.4 + 0.15 * waves[:, 2:5], normal, 0.5 + 0.1 * waves[:, 5:6], 0.3 + 0.1 * waves[:, 6:9])


def test_a_pack_gives_the_materials_back(library, packed):
    names, planes = bank.open_pack(packed, validation=False)
    held, _ = bank.open_pack(packed, validation=True)
    assert len(names) == 6 and len(held) == 2 and not set(names) & set(held)
    maps = bank.from_planes(planes)
    is_material(maps)
    for name, material in zip(names, maps):
        base = torch.from_numpy(pack.resized(library / name / "basecolor.png", 48, "RGB") / 255.0).permute(2, 0, 1)
        linear = bank.decode_srgb(base)
        metal = "metal" in name
        assert (material[7 if metal else 0 : 10 if metal else 3] - linear).abs().mean() < 0.02
        assert (material[0 if metal else 7 : 3 if metal else 10] - (0 if metal else 0.04)).abs().max() < 0.01
        normal = torch.from_numpy(pack.resized(library / name / "normal.png", 48, "RGB") / 127.5 - 1).permute(2, 0, 1)
        assert (material[3:6] - unit(normal)).abs().mean() < 0.02


def test_packing_is_repeatable_and_obeys_a_list(library, packed, tmp_path):
    held, _ = bank.open_pack(packed, validation=True)
    names = tmp_path / "names.txt"
    names.write_text("\n".join(held))
    again = tmp_path / "again.zip"
    pack.main([str(library), "-o", str(again), "--size", "48", "--quality", "98", "--validation", str(names)])
    with zipfile.ZipFile(packed) as a, zipfile.ZipFile(again) as b:
        assert a.namelist() == b.namelist() and all(a.read(name) == b.read(name) for name in a.namelist())
    names.write_text("nobody")
    with pytest.raises(SystemExit, match="nobody"):
        pack.main([str(library), "-o", str(again), "--validation", str(names)])


@pytest.mark.parametrize("number", range(len(procedural.KINDS)))
def test_procedural_materials_are_materials_with_contents(number):
    maps = procedural.group(3, number, 3, 64, torch.device("cpu"))
    is_material(maps)
    assert torch.equal(maps, procedural.group(3, number, 3, 64, torch.device("cpu")))
    # No two alike, none flat.
    assert (maps[0] - maps[1]).abs().mean() > 1e-3
    assert (maps[:, 3:5].std((2, 3)).amax(1) > 1e-3).all()


def test_the_pool_depends_on_the_step_alone():
    def fresh():
        return bank.ProceduralPool(7, 3, 2, 2, 32, torch.device("cpu"))

    going = fresh()
    for step in range(9):
        going.levels(step)
    for a, b in zip(going.levels(9), fresh().levels(9)):
        assert torch.equal(a, b)
    assert not torch.equal(going.levels(9)[0], fresh().levels(0)[0])


@pytest.mark.parametrize("quarter", [0, 1, 2, 3])
@pytest.mark.parametrize("flip", [1.0, -1.0])
def test_turned_crops_look_as_under_a_turned_camera(quarter, flip):
    """A turned (mirrored) material under camera and light turned (mirrored) with it gives the turned (mirrored) photo."""
    size = 32
    levels = [bank.to_planes(smooth_material(size))]

    def crop(angle, mirror):
        values = [torch.tensor([value]) for value in (1.0, angle, mirror)]
        return bank.sample_crops(levels, torch.tensor([0]), size, values[0], values[1], torch.full((1, 2), 0.5 + 0.5 / size), values[2])

    angle = quarter * math.pi / 2
    turned = crop(angle, flip)
    place = torch.tensor([[[0.7, 0.4, 2.2]]])
    light = torch.tensor([[[-0.9, 1.1, 2.6]]])
    matrix = torch.tensor([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
    matrix = torch.diag(torch.tensor([flip, 1, 1])) @ matrix
    position = render.pixel_positions(size, size)[None]
    power = torch.full((1, 1, 3), 20.0)
    photo = render.render(crop(0.0, 1.0), position, place, light, power)[0, 0]
    expected = torch.rot90(photo, quarter, (1, 2))
    expected = expected.flip(2) if flip < 0 else expected
    got = render.render(turned, position, place @ matrix.T, light @ matrix.T, power)[0, 0]
    # Rows and columns at the seam are interpolated across it.
    inner = slice(2, -2)
    assert (got - expected)[:, inner, inner].abs().max() < 0.02 * expected.max()
    assert (photo - expected).abs().max() > 0.1 * expected.max() or (quarter == 0 and flip > 0)


def test_crops_turn_normals_by_any_angle():
    size, angle = 64, 0.7
    planes = bank.to_planes(smooth_material(size))
    values = [torch.tensor([value]) for value in (1.0, angle, 1.0)]
    crop = bank.sample_crops([planes], torch.tensor([0]), size, values[0], values[1], torch.full((1, 2), 0.5), values[2])
    is_material(crop)
    # Around the centre the crop's normal is the bank's, turned.
    there = bank.from_planes(planes)[0, 3:6, size // 2 - 1 : size // 2 + 2, size // 2 - 1 : size // 2 + 2].mean((1, 2))
    here = crop[0, 3:6, size // 2 - 1 : size // 2 + 1, size // 2 - 1 : size // 2 + 1].mean((1, 2))
    turned = torch.stack([math.cos(angle) * there[0] - math.sin(angle) * there[1], math.sin(angle) * there[0] + math.cos(angle) * there[1]])
    assert there[:2].norm() > 0.02 and (here[:2] - turned).norm() < 0.15 * there[:2].norm()


def test_augmented_materials_are_materials():
    rng = torch.Generator().manual_seed(8)
    maps = torch.cat([procedural.group(1, number, 4, 48, torch.device("cpu")) for number in range(6)])
    varied = augment.augmented(maps, rng)
    is_material(varied)
    assert varied[:, 6].min() >= 0.069
    changed = (varied - maps).abs().flatten(1).mean(1)
    assert (changed > 0.01).float().mean() > 0.8


def test_strengthened_normals_are_steeper_in_the_same_direction():
    maps = smooth_material(48).expand(64, -1, -1, -1)
    dice = augment.Dice(torch.Generator().manual_seed(3), 64, "cpu")
    varied = augment.rebump(maps, dice)
    ratio = varied[:, 3:5].norm(dim=1).mean((1, 2)) / maps[:, 3:5].norm(dim=1).mean((1, 2))
    assert ratio.min() < 0.6 and ratio.max() > 1.6
    along = (varied[:, 3:5] * maps[:, 3:5]).sum((1, 2, 3))
    assert (along > 0).all()


@pytest.mark.parametrize(("family", "low", "high", "reach"), [("near", 2, 3, 1.2), ("real", 3, 9, 2.4)])
def test_geometry_keeps_to_its_ranges(family, low, high, reach):
    rng = torch.Generator().manual_seed(9)
    geometry = camera.draw_geometry(rng, 400, 3, 4, 4, "cpu", family)
    height = geometry.camera[..., 2]
    assert height.min() > 0.9 * low - 1e-4 and height.max() < 1.1 * high + 1e-3
    assert geometry.camera[..., :2].norm(dim=-1).max() <= reach + 1e-4
    together = (geometry.camera == geometry.light).all(-1).all(-1)
    assert 0.4 < together.float().mean() < 0.7
    distance2 = (geometry.light**2).sum(-1)
    white = (geometry.light[..., 2] / distance2**1.5 * geometry.intensity[..., 0] / math.pi).mean(1)
    assert white.min() > 0.39 and white.max() < 1.61
    spans = geometry.position[:, 0].amax((1, 2)) - geometry.position[:, 0].amin((1, 2))
    assert (spans > 1.49).float().mean() > 0.3 and spans.min() < 0.3 and geometry.position.abs().max() <= 1


def test_a_tilted_sample_has_tilted_normals():
    ones = torch.ones(200, 1, 4, 4)
    flat = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand(200, 3, 4, 4)
    maps, rise = camera.tilted(join(ones.expand(200, 3, 4, 4), flat, ones, ones.expand(200, 3, 4, 4)), torch.Generator().manual_seed(2))
    normal = maps[:, 3:6, 0, 0]
    lean = torch.rad2deg(torch.acos(normal[:, 2].clamp(-1, 1)))
    assert lean.max() <= 9.01 and (lean > 3).float().mean() > 0.2 and (lean < 0.1).float().mean() > 0.2
    # The surface's slope and its normal say the same.
    assert (rise + normal[:, :2] / normal[:, 2:]).abs().max() < 1e-4


def test_photos_are_those_of_a_camera():
    maps = torch.cat([procedural.group(2, number, 2, 32, torch.device("cpu")) for number in range(8)])
    rng, noise_rng = torch.Generator().manual_seed(1), torch.Generator().manual_seed(2)
    geometry = camera.draw_geometry(rng, 16, 4, 32, 32, "cpu")
    shots = camera.photograph(maps, geometry, rng, noise_rng)
    assert shots.photos.shape == (16, 4, 3, 32, 32) and shots.saturated.shape == (16, 4, 1, 32, 32)
    codes = shots.photos * 255
    assert (codes - codes.round()).abs().max() < 1e-3 and shots.photos.min() >= 0 and shots.photos.max() <= 1
    full = (shots.photos == 1).any(2)
    assert (shots.saturated[:, :, 0] > 0)[full].all()
    exact = ((shots.saturated[:, :, 0] > 0) == full).all(1).all(1).all(1)
    assert 0.4 < exact.float().mean() < 1
    assert 0 < shots.saturated.mean() < 0.5
    is_material(shots.maps)
    # What the camera saw is the material under about the stated geometry.
    perfect, _ = camera.clean_photos(shots.maps, geometry)
    error = (perfect - shots.photos).square().mean((1, 2, 3, 4)).sqrt()
    assert error.median() < 0.08 and error.min() > 0.001
