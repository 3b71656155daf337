"""The renderer against the expected values of the shading model, and against the project's own conventions."""

import math
from pathlib import Path

import pytest
from conftest import NEEDED

torch = pytest.importorskip("torch", reason=NEEDED)

import fixture  # noqa: E402

from svbrdf_gcn.training import render, store  # noqa: E402
from svbrdf_gcn.training.maps import decode_maps, encode_maps, join  # noqa: E402

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures"


@pytest.fixture(scope="module")
def points():
    return store.load(FIXTURES / "brdf" / "isotropic.safetensors")[0]


def picture(values):
    """(P, C) as a picture (1, C, P, 1)."""
    return values.T[None, :, :, None]


def shaded(points, dtype=torch.float64, rows=slice(None)):
    """Radiance (P, 3) of points, each with its own camera, and the leaves that gradients are asked for."""
    leaves = {name: points[name][rows].to(dtype).requires_grad_() for name in ("diffuse", "normal", "roughness", "specular")}
    maps = join(*(picture(leaves[name]) for name in ("diffuse", "normal", "roughness", "specular")))

    def per_point(name):
        return picture(points[name][rows].to(dtype))[:, None]

    position = per_point("position")
    to_light = per_point("light") - position
    view, light = render.unit(per_point("camera") - position), render.unit(to_light)
    irradiance = per_point("power") / (to_light * to_light).sum(-3, keepdim=True)
    return render.shade(maps, view, light, render.unit(view + light), irradiance)[0, 0, :, :, 0].T, leaves


def test_radiance_matches_the_fixtures(points):
    radiance, _ = shaded(points)
    scale = points["radiance"].abs().amax(1, keepdim=True).clamp_min(1e-300)
    # The hardest points are lobes of alpha 1e-6: the half vector's last bit is 1e-10 of such a lobe.
    assert ((radiance - points["radiance"]).abs() / scale).max() < 1e-8
    dark = points["radiance"].amax(1) == 0
    assert dark.any() and (radiance[dark] == 0).all()


def test_gradients_match_the_fixtures(points):
    radiance, leaves = shaded(points)
    (radiance * points["weight"]).sum().backward()
    size = (points["radiance"] * points["weight"]).abs().sum(1, keepdim=True)
    alpha = points["roughness"] ** 2
    for name, factor in (("diffuse", 1), ("specular", 1), ("roughness", 1 / points["roughness"]), ("normal", 1 / alpha)):
        expected = points[f"grad_{name}"]
        scale = torch.maximum(expected.abs().amax(1, keepdim=True), size * factor).clamp_min(1e-300)
        assert ((leaves[name].grad - expected).abs() / scale).max() < 1e-7, name


def test_single_precision_is_near_for_the_roughness_of_training(points):
    rows = points["roughness"][:, 0] >= 0.047
    radiance, leaves = shaded(points, torch.float32, rows)
    expected = points["radiance"][rows]
    scale = expected.abs().amax(1, keepdim=True).clamp_min(1e-30)
    error = ((radiance.double() - expected).abs() / scale).amax(1)
    assert error.max() < 2e-3
    radiance.sum().backward()
    assert all(torch.isfinite(leaf.grad).all() for leaf in leaves.values())


def test_white_paper_reads_one():
    maps = join(*(torch.tensor(v, dtype=torch.float32).view(1, -1, 1, 1) for v in ([1.0] * 3, [0.0, 0, 1], [1.0], [0.0] * 3)))
    place = torch.tensor([[[0.0, 0.0, 2.0]]])
    position = render.pixel_positions(1, 1)[None]
    photo = render.render(maps, position, place, place, torch.full((1, 1, 3), 4 * math.pi))
    assert (photo - 1).abs().max() < 3e-4


def test_slopes_to_the_left_are_bright_under_light_from_the_left():
    normal = torch.tensor([[-0.5, 0, 0.866], [0.5, 0, 0.866], [0, 0.5, 0.866], [0, -0.5, 0.866]]).T.view(1, 3, 2, 2)
    ones = torch.ones(1, 1, 2, 2)
    maps = join(0.5 * ones.expand(1, 3, 2, 2), normal, ones, 0.04 * ones.expand(1, 3, 2, 2))
    position = torch.zeros(1, 3, 2, 2)
    eye = torch.tensor([[[0.0, 0.0, 5.0]] * 2])
    light = torch.tensor([[[-4.0, 0.0, 3.0], [0.0, 4.0, 3.0]]])
    left, top = render.render(maps, position, eye, light, torch.full((1, 2, 3), 50.0))[0, :, 0].flatten(1)
    assert left[0] > left[2] > left[1]
    assert top[2] > top[0] > top[3]


def test_first_row_is_at_positive_y():
    position = render.pixel_positions(4, 8)
    assert position[1, 0, 0] == 0.75 / 2 and position[0, 0, 0] == -0.875 and position[2].abs().max() == 0


def test_maps_survive_encoding():
    rng = torch.Generator().manual_seed(1)
    normal = render.unit(torch.randn(2, 3, 5, 5, generator=rng).abs() + torch.tensor([0.0, 0.0, 0.5]).view(3, 1, 1))
    albedo = torch.rand(2, 6, 5, 5, generator=rng)
    maps = join(albedo[:, :3], normal, 0.1 + 0.9 * torch.rand(2, 1, 5, 5, generator=rng), albedo[:, 3:])
    assert (decode_maps(encode_maps(maps), -0.5) - maps).abs().max() < 1e-4
    wild = decode_maps(3 * torch.randn(2, 9, 5, 5, generator=rng), -0.5)
    assert (wild[:, 3:6].norm(dim=1) - 1).abs().max() < 1e-3
    assert wild[:, 6].min() >= 0.047 and wild.abs().max() <= 1


def test_encodings_join_smoothly():
    x = torch.tensor([0.5e-6, 1e-6, 0.999, 1.0, 1.001, 50.0], dtype=torch.float64, requires_grad=True)
    values = render.compress_radiance(x)
    y = values.detach()
    assert (y[1:] > y[:-1]).all()
    assert abs(float(y[3]) - 1) < 1e-12 and abs(float(y[4] - y[2]) / 0.002 - 1 / 2.2) < 1e-3
    values.sum().backward()
    assert torch.isfinite(x.grad).all()


def test_network_input_shows_a_matt_surface_its_albedo():
    size = 8
    ones = torch.ones(1, 1, size, size)
    flat = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand(1, 3, size, size)
    maps = join(0.25 * ones.expand(1, 3, size, size), flat, ones, 0 * ones.expand(1, 3, size, size))
    camera = torch.tensor([[[0.3, -0.2, 2.5], [0.9, 0.6, 2.1], [-1.0, 0.1, 3.0]]])
    light = torch.tensor([[[0.3, -0.2, 2.5], [-0.7, 0.8, 2.9], [1.1, -0.4, 2.2]]])
    power = torch.full((1, 3, 3), 12.0)
    radiance = render.render(maps, render.pixel_positions(size, size)[None], camera, light, power)
    # Without specular reflection what is left above d / pi is 2^-14 of a lobe of roughness 1.
    inputs = fixture.network_input(render.encode_radiance(radiance), torch.zeros(1, 3, 1, size, size), camera, light, power)
    assert inputs.shape == (1, 3, 13, size, size)
    assert (inputs[:, :, 3:6] - 0.25 ** (1 / 2.2)).abs().max() < 0.02
    assert (inputs[:, :, 7:10].norm(dim=2) - 1).abs().max() < 1e-5 and (inputs[:, :, 10:].norm(dim=2) - 1).abs().max() < 1e-5
