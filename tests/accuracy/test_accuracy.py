"""The measuring scripts themselves: renderer, pictures, errors."""

import json
import pickle
import sys
from pathlib import Path

import fitting
import lpips_alex
import metrics
import numpy as np
import plots
import pytest
import report
import scenes
from shading import Maps, gamma22, pixel_positions, render, unit

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures"


def tensors(path):
    """The float64 tensors of a safetensors file."""
    data = path.read_bytes()
    start = 8 + int.from_bytes(data[:8], "little")
    header = json.loads(data[8:start])
    assert all(entry["dtype"] == "F64" for name, entry in header.items() if name != "__metadata__")
    return {
        name: np.frombuffer(data[start:][slice(*entry["data_offsets"])]).reshape(entry["shape"])
        for name, entry in header.items()
        if name != "__metadata__"
    }


def maps(seed=1, size=24):
    rng = np.random.default_rng(seed)
    normal = unit(np.concatenate([rng.normal(0, 0.2, (size, size, 2)), np.ones((size, size, 1))], -1))
    return Maps(rng.uniform(size=(size, size, 3)), normal, rng.uniform(0.2, 1, (size, size, 1)), rng.uniform(0, 0.3, (size, size, 3)))


def test_shares_within_a_deviation():
    truth = maps()
    rng = np.random.default_rng(2)
    spread = {"diffuse": 0.01, "normal": 0.02, "roughness": 0.03, "specular": 0.04}
    fitted = Maps(*(getattr(truth, kind) + rng.normal(0, spread[kind], getattr(truth, kind).shape) for kind in ("diffuse", "normal", "roughness", "specular")))
    deviations = {kind: np.full((24, 24, 1), value * (2**0.5 if kind == "normal" else 1)) for kind, value in spread.items()}
    shares = metrics.covered(fitted, deviations, truth)
    for letter, expected in zip("DNRS", (0.61, 0.63, 0.68, 0.61), strict=True):
        assert abs(shares[letter] - expected) < 0.06, (letter, shares)


@pytest.mark.parametrize("lobe", ["isotropic", "anisotropic"])
def test_renderer_gives_the_expected_radiance(lobe):
    points = tensors(FIXTURES / "brdf" / f"{lobe}.safetensors")
    if lobe == "anisotropic":
        points["roughness"] = np.sqrt(points["alpha"])
    names = ("diffuse", "normal", "roughness", "specular") + (("tangent",) if lobe == "anisotropic" else ())
    for i in range(len(points["radiance"])):
        # A map of one pixel lies at the origin: the point moves there.
        one = Maps(*(points[name][i].reshape(1, 1, -1) for name in names))
        camera, light = (points[name][i] - points["position"][i] for name in ("camera", "light"))
        found = render(one, camera, light, points["power"][i], 1.0)[0, 0]
        expected = points["radiance"][i]
        assert np.abs(found - expected).max() <= 1e-6 * max(np.abs(expected).max(), 1e-9), i


def test_pixels_lie_where_the_conventions_say():
    place = pixel_positions(2, 4, 8.0)
    assert place[0, 0].tolist() == [-3, 1, 0] and place[1, 3].tolist() == [3, -1, 0]


def test_a_white_patch_reads_one_at_the_centre():
    white = Maps(np.ones((1, 1, 3)), np.array([[[0.0, 0.0, 1.0]]]), np.ones((1, 1, 1)), np.zeros((1, 1, 3)))
    first = scenes.positions()[0][0]
    radiance = render(white, first, first, scenes.INTENSITY, scenes.PATCH_SIZE)
    # What is above 1 is the specular lobe's Fresnel term, tiny at normal incidence.
    assert np.allclose(radiance, 1, atol=2e-2)


def test_the_truth_has_no_error():
    true = maps(size=64)
    views = metrics.Views(scenes.synthetic_tests(true)[:2])
    assert views.errors(true, scenes.PATCH_SIZE) == {"ren": 0, "lpips": 0, "flip": 0, "each": [0, 0]}
    assert set(metrics.map_errors(true, true).values()) == {0.0}


def test_errors_are_those_of_their_definitions():
    true = maps()
    turned = Maps(true.diffuse, true.normal @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]), true.roughness, true.specular)
    flat = Maps(true.diffuse + 0.1, np.broadcast_to([0.0, 0.6, 0.8], true.normal.shape), true.roughness, true.specular)
    up = Maps(true.diffuse, np.broadcast_to([0.0, 0.0, 1.0], true.normal.shape), true.roughness, true.specular)
    errors = metrics.map_errors(flat, up)
    assert errors["D"] == pytest.approx(0.1) and errors["R"] == errors["S"] == 0
    assert errors["angle"] == pytest.approx(np.degrees(np.arcsin(0.6)))
    assert errors["N"] == pytest.approx(np.sqrt((0.3**2 + 0.1**2) / 3))
    expected = np.sqrt(np.mean((gamma22(true.diffuse + 0.1) - gamma22(true.diffuse)) ** 2))
    assert errors["D22"] == pytest.approx(expected)
    assert metrics.map_errors(turned, true)["angle"] > 5


def test_convolution_and_pooling():
    rng = np.random.default_rng(0)
    x, kernel, bias = rng.normal(size=(7, 8, 2)), rng.normal(size=(3, 3, 2, 4)), rng.normal(size=4)
    found = lpips_alex.convolve(x, kernel, bias, 2, 1)
    padded = np.pad(x, ((1, 1), (1, 1), (0, 0)))
    for i, j in np.ndindex(found.shape[:2]):
        expected = np.einsum("hwi,hwio->o", padded[2 * i : 2 * i + 3, 2 * j : 2 * j + 3], kernel) + bias
        assert np.allclose(found[i, j], expected)
    assert lpips_alex.pool(x)[1, 2].tolist() == x[2:5, 4:7].max((0, 1)).tolist()


def test_lpips_grows_with_the_difference():
    rng = np.random.default_rng(0)
    picture, noise = np.full((64, 64, 3), 0.5), rng.normal(size=(64, 64, 3))
    first = lpips_alex.features(picture)
    near, far = (lpips_alex.distance(lpips_alex.features(np.clip(picture + s * noise, 0, 1)), first) for s in (0.05, 0.2))
    assert 0 < near < far


def test_weights_that_hold_more_than_arrays_are_refused(tmp_path):
    (tmp_path / "bad").write_bytes(pickle.dumps(Path("x")))
    with open(tmp_path / "bad", "rb") as file, pytest.raises(pickle.UnpicklingError, match="got pathlib"):
        lpips_alex._Arrays(file).load()


def test_usage_is_that_of_the_program():
    ballast = np.ones(100 << 17)  # 100 MiB of ours are not the program's
    code = "import sys; b = bytearray(50 << 20); b[::4096] = b[::4096]; print('out'); sys.exit(int(sys.argv[1]))"
    printed, seconds, memory = fitting.run([sys.executable, "-I", "-S", "-c", code, "0"])
    assert ballast.nbytes > memory > 50 << 20
    assert printed == "out\n" and 0 < seconds < 60
    with pytest.raises(RuntimeError, match="exit code 3"):
        fitting.run([sys.executable, "-I", "-S", "-c", code, "3"])


def test_capture_folder_holds_what_was_rendered(tmp_path):
    true = maps()
    scenes.write_capture(tmp_path, true)
    cameras = scenes.positions()[0]
    shown = scenes.picture(tmp_path / "03.png")
    expected = gamma22(render(true, cameras[3], cameras[3], scenes.INTENSITY, scenes.PATCH_SIZE))
    assert np.abs(shown - expected).max() <= 0.5 / 255 + 1e-9
    lines = (tmp_path / "camera_pos.txt").read_text().splitlines()
    assert np.allclose([[float(v) for v in line.split(",")] for line in lines], cameras, atol=1e-6)


def test_figures_are_judged():
    assert report.verdict(0.030, 0.032) == "met"
    assert report.verdict(0.048, 0.032) == "missed by 50 %"
    assert [report.three(v) for v in (0.0314, 1.234, None)] == [".031", "1.23", "–"]


def test_the_network_has_to_beat_direct(monkeypatch):
    monkeypatch.setattr(scenes, "names", lambda kind: ["one", "two"])
    errors = dict.fromkeys(report.ERRORS, 0.05)
    measured = {
        (variant, "maps", name, 4): {"errors": errors | {"ren": ren}}
        for variant, ren in (("balanced", 0.04), (report.BASELINE, 0.05))
        for name in ("one", "two")
    }
    labels = {"balanced": "balanced", report.BASELINE: "direct"}
    table = report.targets(report.Figures(measured), "balanced", labels)
    assert "| maps, 4 photos, re-rendering | must | .045 | .040 | met |" in table
    assert "| maps, 4 photos, re-rendering | goal | .032 | .040 | missed by 25 % |" in table
    assert "| maps, 4 photos, re-rendering: better than `direct` | must | below .050 | .040 | met |" in table
    assert "captures" not in table
    del measured["balanced", "maps", "two", 4]
    assert "balanced" not in report.targets(report.Figures(measured), "balanced", labels)


def test_plots_are_written(tmp_path):
    plots.trade(tmp_path / "a.png", [("t", "e", [("x", 1.0, 0.1), ("y", 10.0, 0.05)], [("line", 0.03)])])
    plots.photos(tmp_path / "b.png", [("t", [("x", (1, 4), (0.1, 0.05), False)])])
    assert (tmp_path / "a.png").stat().st_size > 1000 and (tmp_path / "b.png").stat().st_size > 1000
