"""The pack, and what comes out of it: batches against the renderer and the network's input in PyTorch."""

import zipfile

import pytest
from conftest import NEEDED

torch = pytest.importorskip("torch", reason=NEEDED)

import fixture  # noqa: E402

from svbrdf_gcn.training import TrainingData, configuration, pack  # noqa: E402
from svbrdf_gcn.training.data import Batches, open_data, tensors  # noqa: E402
from svbrdf_gcn.training.maps import GAMMA, unit  # noqa: E402
from svbrdf_gcn.training.render import encode_radiance, pixel_positions, render  # noqa: E402

SETTINGS = {"seed": 1, "photos": [1, 1, 1], "procedural": 0.5, "groups": 3, "per_group": 2, "refresh": 1, "size": 48, "captures": "any", "directions": True, "views": 3}
CPU = torch.device("cpu")


def decode_srgb(code):
    return torch.where(code <= 0.04045, code / 12.92, ((code.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4)


def between(values):
    """Means of four neighbours: whole materials are sampled between their pixels."""
    return sum(values.roll((-down, -right), (-2, -1)) for down in (0, 1) for right in (0, 1)) / 4


def test_a_pack_gives_the_materials_back(library, packed):
    data = TrainingData(packed, **SETTINGS)
    assert data.materials == 6 and len(data.held_out) == 2
    batch = tensors(data.validation("near", 1, 48, 0, 2, 1), CPU)
    for name, material in zip(data.held_out, batch["maps"]):
        base = torch.from_numpy(pack.resized(library / name / "basecolor.png", 48, "RGB") / 255.0).permute(2, 0, 1)
        linear = between(decode_srgb(base) ** (1 / GAMMA)) ** GAMMA
        metal = "metal" in name
        assert (material[7 if metal else 0 : 10 if metal else 3] - linear).abs().mean() < 0.02
        assert (material[0 if metal else 7 : 3 if metal else 10] - (0 if metal else 0.04)).abs().max() < 0.01
        normal = torch.from_numpy(pack.resized(library / name / "normal.png", 48, "RGB") / 127.5 - 1).permute(2, 0, 1)
        assert (material[3:6] - unit(between(normal))).abs().mean() < 0.02


def test_packing_is_repeatable_and_obeys_a_list(library, packed, tmp_path):
    held = TrainingData(packed, **SETTINGS).held_out
    names = tmp_path / "names.txt"
    names.write_text("\n".join(held))
    again = tmp_path / "again.zip"
    pack.main([str(library), "-o", str(again), "--size", "48", "--quality", "98", "--validation", str(names)])
    with zipfile.ZipFile(packed) as a, zipfile.ZipFile(again) as b:
        assert a.namelist() == b.namelist() and all(a.read(name) == b.read(name) for name in a.namelist())
    names.write_text("nobody")
    with pytest.raises(SystemExit, match="nobody"):
        pack.main([str(library), "-o", str(again), "--validation", str(names)])


@pytest.mark.parametrize("captures", ["near", "paper"])
def test_a_perfect_camera_sees_what_the_renderer_says(packed, captures):
    data = TrainingData(packed, **SETTINGS)
    batch = tensors(data.validation(captures, 4, 32, 0, 2, 1), CPU)
    inputs, (camera, light, intensity) = batch["inputs"], batch["shots"].unbind(2)
    radiance = render(batch["maps"], pixel_positions(32, 32)[None], camera, light, intensity)
    photos = encode_radiance(radiance).clamp(0, 1)
    # The photos have 8 bits.
    assert (inputs[:, :, :3] - photos).abs().max() < 0.51 / 255
    assert torch.equal(inputs[:, :, 6], (inputs[:, :, :3].amax(2) >= 1).float())
    assert 0.1 < photos.mean() < 0.9 and photos.std() > 0.02


@pytest.mark.parametrize("captures", ["any", "near", "real", "paper"])
def test_the_network_s_input_is_that_of_the_fixture_s_code(packed, captures):
    """Stated geometry and photos give all planes, also of tiles, whose frame the shots are in."""
    data = TrainingData(packed, **{**SETTINGS, "captures": captures})
    for batch in (data.batch(3, 4, 24), data.validation(captures, 3, 24, 0, 2, 1)):
        batch = tensors(batch, CPU)
        inputs, shots = batch["inputs"].double(), batch["shots"].double()
        expected = fixture.network_input(inputs[:, :, :3], inputs[:, :, 6:7], *shots.unbind(2))
        assert (inputs[:, :, 7:] - expected[:, :, 7:]).abs().max() < 1e-4
        # Ratios of codes that are kept in single precision.
        assert (inputs[:, :, 3:6] - expected[:, :, 3:6]).abs().max() < 1e-3
        assert (batch["maps"][:, 3:6].norm(dim=1) - 1).abs().max() < 2e-3


def test_photos_with_all_defects_are_near_what_the_renderer_says(packed):
    data = TrainingData(packed, **SETTINGS)
    errors = []
    for step in range(4):
        batch = tensors(data.batch(step, 8, 32), CPU)
        radiance = render(batch["maps"], pixel_positions(32, 32)[None], *batch["shots"].unbind(2))
        error = (encode_radiance(radiance).clamp(0, 1) - batch["inputs"][:, :, :3]).square().mean((1, 2, 3, 4)).sqrt()
        errors.append(error)
    errors = torch.cat(errors)
    assert errors.median() < 0.08 and errors.min() > 0.001


def test_without_directions_the_planes_are_empty(packed):
    data = TrainingData(packed, **{**SETTINGS, "directions": False})
    full = TrainingData(packed, **SETTINGS)
    blind, seeing = data.batch(0, 2, 24), full.batch(0, 2, 24)
    assert not blind["inputs"][:, :, 3:6].any() and not blind["inputs"][:, :, 7:].any()
    assert (blind["inputs"][:, :, :3] == seeing["inputs"][:, :, :3]).all() and (blind["maps"] == seeing["maps"]).all()


def test_batches_come_in_any_order_and_ahead(config_file):
    config = configuration.load(config_file)
    data, batches = open_data(config), Batches(open_data(config), CPU)
    large, small = config["phase"]
    for step, phase in ((0, large), (1, large), (2, small), (7, small), (1, large)):
        batch = batches.take(step, phase)
        expected = data.batch(step, phase["batch"], phase["size"])
        assert all(torch.equal(batch[name], torch.from_numpy(expected[name])) for name in expected)
        # Their own memory: torch may write there.
        batch["inputs"].zero_()


def test_maps_show_what_was_made(packed):
    maps = torch.from_numpy(TrainingData.procedural(1, 1, 64))
    # Brushed metal: no diffuse albedo, bright specular one.
    assert maps.shape == (10, 64, 64) and maps[:3].max() == 0 and (maps[7:] ** (1 / GAMMA)).mean() > 0.4
