"""The Python package: photos in, maps out, errors, threads, signals."""

import gc
import itertools
import json
import os
import signal
import struct
import subprocess
import sys
import threading
import time
import zlib
from pathlib import Path

import numpy as np
import pytest

import svbrdf_gcn
from svbrdf_gcn import (
    ArgumentError,
    Cancelled,
    CancelToken,
    Capture,
    FormatError,
    Material,
    Model,
    ShapeError,
    SvbrdfError,
    WeightsError,
    fit_material,
    metrics,
)

ROOT = Path(__file__).resolve().parents[2]
TILES = ROOT / "samples" / "tiles"
MAPS = ("diffuse_albedo", "specular_albedo", "roughness", "normal")
# Small and short, and the same for every fit here.
QUICK = {"preset": "draft", "method": "direct", "direct_steps": 10, "threads": 1, "seed": 7}
SETUP = {"patch_size": 10.0, "light_intensity": 1500.0, "transfer": "linear"}


@pytest.fixture(scope="module")
def tiles():
    return Capture.open(TILES, size=32)


@pytest.fixture(scope="module")
def fitted(tiles):
    return fit_material(tiles, **QUICK)


def bits(material):
    return [getattr(material, name).tobytes() for name in MAPS]


def as_arrays(capture):
    """The arguments that describe a capture photo by photo."""
    return {
        "camera_positions": capture.camera_positions,
        "light_positions": capture.light_positions,
        "light_intensity": capture.light_intensity,
        "patch_size": capture.patch_size,
        "transfer": "linear",
    }


def two_photos(dtype=np.float32):
    values = np.linspace(0, 1, 2 * 6 * 8 * 3).reshape(2, 6, 8, 3)
    scale = {"u": lambda: np.iinfo(dtype).max, "f": lambda: 1}[np.dtype(dtype).kind]()
    return (values * scale).astype(dtype)


CAMERAS = np.array([[-3.0, 0, 20], [3, 0, 20]])


def capture_of(photos, **changes):
    return Capture(photos, **{"camera_positions": CAMERAS, **SETUP, **changes})


# Photos in.


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float16", "float32", "float64", ">u2", ">f4", ">f8"])
def test_photos_of_every_type(dtype):
    photos = two_photos(dtype)
    capture = capture_of(photos)
    scale = np.iinfo(dtype).max if np.dtype(dtype).kind == "u" else 1
    for got, given in zip(capture.photos, photos, strict=True):
        np.testing.assert_allclose(got, given.astype(np.float64) / scale, rtol=1e-6, atol=1e-7)


def layouts():
    photos = two_photos()
    read_only = photos.copy()
    read_only.flags.writeable = False
    wide = np.zeros((2, 6, 16, 4), np.float32)
    wide[:, :, ::2, :3] = photos
    unaligned = np.zeros(photos.nbytes + 1, np.uint8)[1:].view(np.float32).reshape(photos.shape)
    unaligned[...] = photos
    return {
        "packed": photos,
        "fortran": np.asfortranarray(photos),
        "bottom-up": photos[:, ::-1].copy()[:, ::-1],
        "BGR": photos[..., ::-1].copy()[..., ::-1],
        "read-only": read_only,
        "strided": wide[:, :, ::2, :3],
        "unaligned": unaligned,
        "list": list(photos),
        "tuple": tuple(photos),
        "nested lists": photos.astype(np.float64),
    }


@pytest.mark.parametrize("layout", layouts())
def test_photos_of_every_layout(layout):
    expected = two_photos()
    capture = capture_of(layouts()[layout])
    assert len(capture) == 2 and (capture.width, capture.height) == (8, 6)
    for got, given in zip(capture.photos, expected, strict=True):
        np.testing.assert_array_equal(got, given)


def test_photos_are_copied():
    photos = two_photos()
    capture = capture_of(photos)
    photos[:] = 0
    np.testing.assert_array_equal(capture.photos[1], two_photos()[1])


def test_grey_photos_and_alpha():
    grey = two_photos()[..., 0]
    np.testing.assert_array_equal(capture_of(list(grey)).photos[0], np.repeat(grey[0][:, :, None], 3, axis=2))
    with_alpha = np.concatenate([two_photos(), np.zeros((2, 6, 8, 1), np.float32)], axis=-1)
    capture = capture_of(with_alpha)
    np.testing.assert_array_equal(capture.photos[0], two_photos()[0])
    assert any("alpha ignored" in warning for warning in capture.warnings)


HUGE = np.broadcast_to(np.zeros((), np.uint8), (2, 1 << 20, 1 << 20, 3))


@pytest.mark.parametrize(
    ("photos", "error", "said"),
    [
        (None, FormatError, r"photos: expected an array of shape .*got None"),
        (1.5, FormatError, r"photos: expected an array of shape .*got 1.5 \(float\)"),
        (two_photos()[0], ShapeError, r"photos: expected shape \(N, H, W, 3\), got \(6, 8, 3\)"),
        ([None, None], ShapeError, r"photos\[0\]: .*got \(\)"),
        (two_photos()[..., :0], ShapeError, r"photos\[0\]: .*got \(6, 8, 0\)"),
        (two_photos()[:, :0], ShapeError, r"photos\[0\]: .*got \(0, 8, 3\)"),
        (np.zeros((2, 6, 8, 5)), ShapeError, r"photos\[0\]: .*got \(6, 8, 5\)"),
        ([two_photos()[0], two_photos()[0, :4]], ShapeError, r"photos\[1\]: expected 8 x 6 .*got 8 x 4"),
        ([], ShapeError, r"camera_positions: expected shape \(0, 3\), got \(2, 3\)"),
        (HUGE, ShapeError, r"photos\[0\]: expected at most 1073741824 bytes .*got \(1048576, 1048576, 3\)"),
        (two_photos().astype(np.int32), FormatError, r"photos\[0\]: expected uint8, .*got int32"),
        (two_photos() > 0.5, FormatError, "got bool"),
        (two_photos().astype(complex), FormatError, "got complex128"),
        (two_photos() * np.array([1, np.nan, 1], np.float32), ArgumentError, r"photos\[0\]: pixel value NaN in row 0"),
        (two_photos().astype(np.float64) * 1e300, ArgumentError, r"photos\[0\]: pixel value inf"),
        ([two_photos()[0], "photo.png"], FormatError, "photos: expected only paths or only arrays, got both"),
        (["no.png", "photo.png"], FileNotFoundError, "no.png"),
    ],
)
def test_bad_photos_are_refused(photos, error, said):
    with pytest.raises(error, match=said):
        capture_of(photos)


@pytest.mark.parametrize(
    ("changes", "error", "said"),
    [
        ({"camera_positions": CAMERAS[:1]}, ShapeError, r"camera_positions: expected shape \(2, 3\), got \(1, 3\)"),
        ({"camera_positions": -CAMERAS}, ArgumentError, r"photos\[0\]: camera .* behind the sample"),
        ({"camera_positions": CAMERAS * np.nan}, ArgumentError, "not finite"),
        ({"camera_positions": "here"}, ValueError, "could not convert"),
        ({"light_positions": [0, 0, 1]}, ShapeError, r"light_positions: expected shape \(2, 3\), got \(3,\)"),
        ({"light_intensity": -1}, ArgumentError, "light_intensity must be finite, not negative"),
        ({"light_intensity": [1, 2]}, ShapeError, r"light_intensity: expected shape \(\), \(3,\) or \(2, 3\), got \(2,\)"),
        ({"patch_size": 0}, ArgumentError, "patch_size: expected a finite number above 0, got 0"),
        ({"color_space": "rec2020"}, ArgumentError, "color_space: expected rec709 or acescg, got 'rec2020'"),
        ({"transfer": "rec709"}, ArgumentError, "transfer: expected srgb, gamma2.2 or linear, got 'rec709'"),
        ({"white_level": -1}, ArgumentError, "white_level: .*got -1"),
        ({"size": 0}, ArgumentError, "size: .*got 0"),
        ({"size": -5}, ArgumentError, "size: expected an integer of 0 or more, got -5"),
        ({"size": 2**64}, ArgumentError, "size: expected a smaller integer"),
        ({"size": 1.5}, TypeError, "size"),
        ({"views": [0, 2]}, ArgumentError, "views: photo 2 of a capture of 2 photos"),
        ({"views": []}, ArgumentError, "views: expected at least one photo"),
    ],
)
def test_bad_descriptions_are_refused(changes, error, said):
    with pytest.raises(error, match=said):
        capture_of(two_photos(), **changes)


def test_what_photos_need_and_captures_bring(tiles):
    needed = {"camera_positions": CAMERAS, **SETUP}
    for name in needed:
        given = {key: value for key, value in needed.items() if key != name}
        with pytest.raises(ArgumentError, match=f"^{name}: expected .* got None"):
            fit_material(two_photos(), **given)
    for source in (tiles, TILES):
        for name, value in {**needed, "light_positions": CAMERAS, "white_level": 1.0, "color_space": "acescg"}.items():
            if source is TILES and name in ("transfer", "color_space", "light_intensity"):
                continue
            with pytest.raises(ArgumentError, match=f"^{name}: the capture brings its own"):
                fit_material(source, **{name: value})
    with pytest.raises(ArgumentError, match="^size: the capture brings its own"):
        fit_material(tiles, size=16)


def test_one_photo_alone_is_a_capture(tmp_path):
    photo = TILES / "04.png"
    material = fit_material(photo, size=32, preset="draft")
    assumed, reasons = material.report["assumed"], {reason["code"] for reason in material.report["reasons"]}
    assert assumed["light_is_chosen"] and not assumed["field_of_view_is_from_exif"]
    assert "assumed" in reasons and any("one photo without a capture" in warning for warning in material.report["warnings"])
    assert np.percentile(material.diffuse_albedo.max(-1), 99) == pytest.approx(0.9, abs=0.1)
    stated = fit_material(photo, size=32, preset="draft", light_intensity=[20, 10, 5])
    assert stated.report["assumed"]["light_intensity"] == [20, 10, 5] and not stated.report["assumed"]["light_is_chosen"]
    with pytest.raises(ShapeError, match="^light_intensity: expected shape"):
        fit_material(photo, light_intensity=[1, 2])


def test_image_files_are_photos(tiles):
    capture = Capture.open(TILES, size=32)
    described = {**as_arrays(capture), "transfer": capture.transfer}
    files = [TILES / name for name in capture.names]
    again = Capture(files, size=32, **described)
    assert again.names == capture.names
    np.testing.assert_array_equal(again.photos, capture.photos)


FORK = """
import multiprocessing, sys, svbrdf_gcn
def work(size):
    capture = svbrdf_gcn.Capture.open("samples/lambert", size=size)
    return svbrdf_gcn.fit_material(capture, preset="draft", direct_steps=1, finish_steps=0).width
work(16)
with multiprocessing.get_context("fork").Pool(2) as pool:
    print(pool.map_async(work, [16, 16, 16]).get(60))
"""


def test_children_by_fork_read_and_fit_too():
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", FORK], capture_output=True, text=True, timeout=120)
    assert done.stdout.strip() == "[16, 16, 16]", done.stderr


def test_a_named_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "capture.json")
    with pytest.raises(OSError, match="named pipe"):
        svbrdf_gcn.Capture.open(tmp_path / "capture.json")


def test_a_capture_tells_what_it_holds(tiles):
    stated = json.loads((TILES / "capture.json").read_text())
    np.testing.assert_array_equal(tiles.camera_positions, [photo["camera"] for photo in stated["photos"]])
    assert tiles.names == [photo["file"] for photo in stated["photos"]]
    assert (tiles.patch_size, tiles.transfer, tiles.unit) == (stated["patch_size"], stated["transfer"], stated["unit"])
    assert tiles.select([8, 1]).names == [tiles.names[8], tiles.names[1]]
    with pytest.raises(ArgumentError, match="views: photo 9"):
        tiles.select([9])
    with pytest.raises(ArgumentError, match="views: .*-1"):
        tiles.select([-1])


# Fits.


def test_every_way_to_give_photos_gives_the_same_bits(tiles, fitted):
    photos = np.stack(tiles.photos)
    assert bits(fit_material(str(TILES), size=32, **QUICK)) == bits(fitted)
    # What was saturated in the files is not known of linear arrays, so these are compared with one another.
    first = fit_material(photos, **as_arrays(tiles), **QUICK)
    assert bits(fit_material(list(photos.astype(np.float64)), **as_arrays(tiles), **QUICK)) == bits(first)
    assert bits(fit_material(Capture(photos, **as_arrays(tiles)), **QUICK)) == bits(first)


def test_maps_are_in_range_and_fit_the_photos(tiles, fitted):
    for name in ("diffuse_albedo", "specular_albedo", "roughness"):
        values = getattr(fitted, name)
        assert values.dtype == np.float32 and values.min() >= 0 and values.max() <= 1
    np.testing.assert_allclose(np.linalg.norm(fitted.normal, axis=-1), 1, atol=1e-5)
    assert fitted.tangent is None
    errors = [
        metrics.photo_rmse(fitted.render(camera, light, intensity), photo)
        for camera, light, intensity, photo in zip(
            tiles.camera_positions, tiles.light_positions, tiles.light_intensity, tiles.photos, strict=True
        )
    ]
    np.testing.assert_allclose(errors, fitted.report["photo_errors"], rtol=1e-6)
    mean = np.mean(tiles.photos, axis=0)
    assert np.mean(errors) < 0.6 * np.mean([metrics.photo_rmse(mean, photo) for photo in tiles.photos])


def test_a_verdict_goes_with_the_material(tiles, fitted, tmp_path):
    report = fitted.report
    assert fitted.verdict == report["verdict"] and fitted.verdict in ("good", "usable", "poor")
    assert 0 < report["material_error"] <= report["expected_error"] and not report["estimated"]
    fitted.save(tmp_path)
    assert Material.load(tmp_path).verdict == fitted.verdict
    assert Material.load(tmp_path).report["reasons"] == report["reasons"]
    assert Material.load(TILES / "truth").verdict is None


def test_a_photo_that_contradicts_is_left_out_and_named(tiles):
    photos = list(tiles.photos)
    photos[1] = np.zeros_like(photos[1])
    known = {name: getattr(tiles, name) for name in ("camera_positions", "light_positions", "light_intensity", "patch_size")}
    fitted = fit_material(Capture(photos, transfer="linear", **known), **QUICK)
    assert fitted.report["photos_left_out"] == ["photos[1]"] and fitted.verdict != "good"
    assert [reason["text"] for reason in fitted.report["reasons"] if reason["code"] == "photos_contradict"]
    assert any(warning.startswith("photos[1]: contradicts") for warning in fitted.warnings)
    assert len(fitted.report["photo_errors"]) == len(photos)


def test_deviations_go_with_the_material(tiles, tmp_path):
    network = fit_material(tiles.select([0, 1, 2]), method="network", direct_steps=2, finish_steps=2)
    names = [f"{name}_deviation" for name in ("diffuse_albedo", "specular_albedo", "roughness", "normal")]
    assert all(getattr(network, name).shape == (*network.normal.shape[:2], 1) for name in names)
    assert all(0 < getattr(network, name).min() for name in names)
    network.save(tmp_path, format="tiff")
    loaded = Material.load(tmp_path)
    for name in names:
        np.testing.assert_array_equal(getattr(loaded, name), getattr(network, name))
    without = fit_material(tiles, **QUICK | {"method": "direct"})
    assert all(getattr(without, name) is None for name in names)


def test_maps_are_views_that_keep_the_material_alive(tiles):
    material = fit_material(tiles, **QUICK)
    view, copy = material.normal, material.normal.copy()
    assert not view.flags.writeable and not view.flags.owndata
    assert view.ctypes.data == material.normal.ctypes.data
    with pytest.raises(ValueError, match="read-only"):
        view[0, 0, 0] = 1
    with pytest.raises(ValueError, match="WRITEABLE"):
        view.flags.writeable = True
    part = view[3:5, ::2]
    del material, view
    gc.collect()
    # What is freed is soon used for something else.
    noise = [np.full(copy.shape, -7, np.float32) for _ in range(50)]
    np.testing.assert_array_equal(part, copy[3:5, ::2])
    assert len(noise) == 50


def test_photos_of_a_capture_are_read_only_views():
    photo = capture_of(two_photos()).photos[0]
    assert not photo.flags.writeable
    gc.collect()
    np.testing.assert_array_equal(photo, two_photos()[0])


def test_bad_options_are_named(tiles):
    for options, error, said in [
        ({"preset": "fast"}, ArgumentError, "preset: expected draft, balanced or high, got 'fast'"),
        ({"method": "magic"}, ArgumentError, "method: expected auto, network or direct, got 'magic'"),
        ({"threads": 0}, ArgumentError, "threads: expected 1 to 1024, got 0"),
        ({"seed": -1}, ArgumentError, "seed: expected an integer of 0 or more, got -1"),
        ({"direct_steps": "many"}, FormatError, r"direct_steps: expected an integer, got 'many' \(str\)"),
        ({"preset": 3}, FormatError, r"preset: expected a string, got 3 \(int\)"),
        ({"seed": 1.5}, FormatError, r"seed: expected an integer, got 1.5 \(float\)"),
        ({"early_stop": "no"}, FormatError, r"early_stop: expected True or False, got 'no' \(str\)"),
        ({"max_memory": 1000}, MemoryError, "max_memory: .*allowed are 1000"),
        ({"progress": 5}, FormatError, r"progress: expected something to call, got 5 \(int\)"),
        ({"cancel": True}, FormatError, r"cancel: expected a CancelToken, got True \(bool\)"),
        ({"weights": 3}, FormatError, r"weights: expected a Model or a path \(str or os.PathLike\), got 3 \(int\)"),
        ({"weights": TILES / "00.png"}, WeightsError, "weights: "),
        ({"weights": "no.safetensors"}, FileNotFoundError, "no.safetensors"),
    ]:
        with pytest.raises(error, match=said):
            fit_material(tiles, **options)
    with pytest.raises(TypeError, match="positional"):
        fit_material(tiles, CAMERAS)


def test_errors_have_two_bases():
    for error, base in [
        (ArgumentError, ValueError),
        (ShapeError, ValueError),
        (FormatError, TypeError),
        (WeightsError, ValueError),
        (svbrdf_gcn.NonFiniteError, ArithmeticError),
        (Cancelled, Exception),
    ]:
        assert issubclass(error, SvbrdfError) and issubclass(error, base)


def test_system_errors_say_which_file(tmp_path):
    with pytest.raises(FileNotFoundError) as caught:
        Capture.open(tmp_path / "none")
    assert caught.value.errno == 2 and caught.value.filename == str(tmp_path / "none")
    with pytest.raises(NotADirectoryError) as caught:
        Material.load(TILES / "truth").save(TILES / "00.png" / "x")
    assert caught.value.filename == str(TILES / "00.png" / "x")
    broken = tmp_path / "broken.png"
    broken.write_bytes((TILES / "00.png").read_bytes()[:5000])
    with pytest.raises(svbrdf_gcn.BrokenFileError) as caught:
        capture_of([broken, broken])
    error = caught.value
    assert isinstance(error, OSError) and error.errno is None and error.filename == str(broken)
    assert error.strerror and str(error) == f"{error.strerror}: {str(broken)!r}"
    (tmp_path / "literature").mkdir()
    (tmp_path / "literature" / "camera_pos.txt").write_text("0,0,9")
    with pytest.raises(FileNotFoundError, match="light_pos.txt, image_size.txt, light_power.txt") as caught:
        Capture.open(tmp_path / "literature")
    assert caught.value.errno == 2


def test_wrong_types_are_named():
    truth = Material.load(TILES / "truth")
    setup = {"camera_positions": CAMERAS[:2], "patch_size": 10, "light_intensity": 1500, "transfer": "srgb"}
    photos = two_photos()
    for call, said in [
        (lambda: Capture.open(TILES, size="32"), r"size: expected an integer, got '32' \(str\)"),
        (lambda: Capture.open(TILES, views="0,1"), r"views: expected integers, got '0,1' \(str\)"),
        (lambda: Capture.open(TILES, views=[0, 1.5]), r"views: expected integers, got \[0, 1.5\] \(list\)"),
        (lambda: Capture.open(TILES, views=3), r"views: expected integers, got 3 \(int\)"),
        (lambda: Capture.open(3), r"path: expected a path \(str or os.PathLike\), got 3 \(int\)"),
        (lambda: Capture(3, **setup), r"photos: expected an array .* got 3 \(int\)"),
        (lambda: Capture("photos", **setup), r"photos: expected an array .* got 'photos' \(str\)"),
        (lambda: Capture(photos, **{**setup, "patch_size": "10"}), r"patch_size: expected a number, got '10' \(str\)"),
        (lambda: Capture(photos, **{**setup, "light_intensity": {}}), r"light_intensity: expected numbers, got {} \(dict\)"),
        (lambda: fit_material(3), r"photos: expected an array .* got 3 \(int\)"),
        (lambda: truth.export("x", to=3), r"to: expected a string, got 3 \(int\)"),
        (lambda: truth.render(CAMERAS[0], CAMERAS[0], size="8"), r"size: expected an integer, got '8' \(str\)"),
        (lambda: metrics.map_errors(truth, 3), r"truth: expected a Material, got 3 \(int\)"),
    ]:
        with pytest.raises(FormatError, match=said):
            call()
    for wrong, said in [
        ([[0, 0, "x"], [0, 0, 9]], "camera_positions: expected numbers, got .*could not convert"),
        ([[0, 0, 9], [0, 9]], "camera_positions: expected numbers, got .*inhomogeneous"),
    ]:
        with pytest.raises(ArgumentError, match=said):
            Capture(photos, **{**setup, "camera_positions": wrong})
    with pytest.raises(ZeroDivisionError):
        Capture.open(TILES, views=(1 // i for i in (1, 0)))


def test_generators_are_taken_wherever_lists_are():
    photos = two_photos()
    setup = {"patch_size": 10, "transfer": "srgb"}
    listed = Capture(photos, camera_positions=CAMERAS[:2], light_intensity=[1, 2, 3], **setup)
    streamed = Capture(
        (photo for photo in photos),
        camera_positions=(camera for camera in CAMERAS[:2]),
        light_intensity=iter([1, 2, 3]),
        views=(view for view in (0, 1)),
        **setup,
    )
    for a, b in zip(listed.photos, streamed.photos):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(listed.camera_positions, streamed.camera_positions)
    np.testing.assert_array_equal(listed.light_intensity, streamed.light_intensity)
    assert len(listed.select(iter([1]))) == 1
    names = Capture((TILES / f"0{i}.png" for i in range(2)), camera_positions=CAMERAS[:2], light_intensity=1, **setup).names
    assert names == ["00.png", "01.png"]
    with pytest.raises(ArgumentError, match="views: expected integers, got count.*more than"):
        listed.select(itertools.count())


def test_what_is_still_encoded_is_refused():
    codes = [np.full((4, 4, 3), 200.0), np.full((4, 4, 3), 255.0)]
    with pytest.raises(ArgumentError, match=r"photos\[[01]\]: expected floats of which 1 is white in srgb, at most 8, got up to 2\d\d"):
        capture_of(codes, transfer="srgb")
    grey, flat = np.full((4, 4, 3), 0.5), np.zeros((4, 4, 3)) + [0, 0, 1]
    for maps, said in [
        ((grey * 255, grey, grey[..., 0], flat), "diffuse_albedo: expected linear values from 0 to 1, got 127.5"),
        ((grey, grey - 1, grey[..., 0], flat), "specular_albedo: expected .*got -0.5"),
        ((grey, grey, 3 * grey[..., 0], flat), "roughness: expected .*got 1.5"),
        ((grey, grey, grey[..., 0], (flat + 1) / 2), "normal: expected vectors of length 1, got .*1.225.*2 n - 1"),
    ]:
        with pytest.raises(ArgumentError, match=said):
            Material(*maps, patch_size=1)


def test_photos_judge_only_materials_of_their_patch():
    capture = Capture.open(TILES, size=64, views=[0, 1])
    truth = Material.load(TILES / "truth")
    maps = [getattr(truth, name)[::4, ::4] for name in MAPS]
    errors = metrics.photo_errors(Material(*maps, patch_size=10, unit="cm"), capture)
    assert len(errors) == 2 and capture.unit == "cm"
    assert metrics.photo_errors(Material(*maps, patch_size=100, unit="mm"), capture) == errors
    assert metrics.photo_errors(Material(*maps, patch_size=10), capture) == errors
    for patch_size, unit, said in [(10, "mm", "10 mm"), (0.3, None, r"0.3 \(no unit stated\)"), (9.7, "cm", "9.7 cm")]:
        with pytest.raises(ArgumentError, match=f"patch_size: the capture's patch is 10 cm wide, the material's {said}"):
            metrics.photo_errors(Material(*maps, patch_size=patch_size, unit=unit), capture)
    with pytest.raises(ArgumentError, match="camera: .*behind the sample"):
        truth.render([0, 0, -9], [0, 0, 9])


# Stopping.


@pytest.mark.parametrize("at", [0.0, 0.5, 1.0])
def test_cancel_at_the_start_in_the_middle_and_at_the_end(tiles, fitted, at):
    token = CancelToken()
    seen = []

    def cancel(progress):
        seen.append(progress)
        if progress.step >= at * progress.steps:
            token.cancel()

    # Steps long enough for a report each.
    options = {**QUICK, "direct_steps": 400, "early_stop": False}
    if at == 0:
        token.cancel()
    if at < 1:
        with pytest.raises(Cancelled):
            fit_material(tiles, progress=cancel, cancel=token, **options)
    else:
        # When the last step is reported all work is done, or still to be seen through: either is right.
        try:
            fit_material(tiles, progress=cancel, cancel=token, **options)
        except Cancelled:
            pass
    assert token.cancelled
    if at == 0.5:
        assert seen[-1].step < 400
    assert bits(fit_material(tiles, **QUICK)) == bits(fitted)


def test_what_photos_need_is_known_before_they_are_decoded(tmp_path):
    folder = large_capture(tmp_path, 12000, 3)
    assert (folder / "large.png").stat().st_size < 150_000
    for read in (Capture.open, fit_material):
        begun = time.monotonic()
        with pytest.raises(MemoryError, match=r"max_memory: reading 3 photos of 12000 x 12000 pixels needs about 6\d{9} bytes, allowed are 4294967296: take"):
            read(folder, max_memory="4G")
        assert time.monotonic() - begun < 1
    with pytest.raises(MemoryError, match="max_memory: reading 2 photos of 512 x 512 pixels .* allowed are 5242880"):
        Capture(np.zeros((2, 512, 512, 3), np.uint8), camera_positions=[[0, 0, 9]] * 2, patch_size=1, light_intensity=9, transfer="srgb", max_memory="5M")
    for wrong, error, said in [
        ("2 GB", ArgumentError, "max_memory: expected bytes such as 4000000000, 500M"),
        (-1, ArgumentError, "max_memory: expected an integer of 0 or more, got -1"),
        (1.5, FormatError, "max_memory: expected an integer or a text such as '2G', got 1.5"),
    ]:
        with pytest.raises(error, match=said):
            Capture.open(TILES, max_memory=wrong)


def test_cancel_stops_the_reading_of_photos():
    token = CancelToken()
    photos, scene = np.zeros((2, 8, 8, 3), np.uint8), {"camera_positions": [[0, 0, 9]] * 2, "patch_size": 1, "light_intensity": 9}
    assert len(Capture.open(TILES, size=8, cancel=token)) == 9
    assert len(Capture(photos, **scene, transfer="srgb", cancel=token)) == 2
    token.cancel()
    for read in (
        lambda: Capture.open(TILES, size=8, cancel=token),
        lambda: Capture(photos, **scene, transfer="srgb", cancel=token),
        lambda: fit_material(TILES, size=8, cancel=token, direct_steps=2),
        lambda: fit_material(photos, **scene, transfer="srgb", cancel=token, direct_steps=2),
    ):
        with pytest.raises(Cancelled):
            read()
    with pytest.raises(FormatError, match="cancel: expected a CancelToken, got 3"):
        Capture.open(TILES, cancel=3)


def test_cancel_from_another_thread(tiles):
    token, started = CancelToken(), threading.Event()
    stopper = threading.Thread(target=lambda: (started.wait(30), token.cancel()))
    stopper.start()
    with pytest.raises(Cancelled):
        fit_material(tiles, direct_steps=10**7, early_stop=False, progress=lambda _: started.set(), cancel=token)
    stopper.join()


def test_other_threads_run_during_a_fit(tiles):
    counts, token = [], CancelToken()

    def count():
        for number in range(200):
            counts.append(number)
            time.sleep(0.001)
        token.cancel()

    counter = threading.Thread(target=count)
    counter.start()
    with pytest.raises(Cancelled):
        fit_material(tiles, direct_steps=10**7, early_stop=False, cancel=token)
    counter.join()
    assert len(counts) == 200


def test_two_fits_at_once(tiles, fitted):
    results = [None, None]

    def run(index):
        results[index] = fit_material(tiles, **QUICK)

    threads = [threading.Thread(target=run, args=(index,)) for index in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert bits(results[0]) == bits(results[1]) == bits(fitted)


def test_progress_is_reported_in_order(tiles):
    seen = []
    fit_material(tiles, progress=seen.append, **QUICK)
    steps = [(report.stage, report.step) for report in seen]
    assert steps == sorted(steps) and steps[-1] == ("direct", 10)
    assert seen[-1].steps == 10 and seen[-1].loss > 0


def test_reports_come_at_most_every_50_ms(tiles):
    times = []
    fit_material(tiles, **{**QUICK, "direct_steps": 300, "early_stop": False}, progress=lambda p: times.append((time.monotonic(), p)))
    within = [now for now, report in times if report.step < report.steps]
    assert all(after - before > 0.049 for before, after in zip(within, within[1:]))


class Odd(Exception):
    """An exception of the caller's own."""


def test_what_a_callback_raises_comes_out_unchanged(tiles, fitted):
    raised = Odd("mine")

    def fail(_):
        raise raised

    with pytest.raises(Odd) as caught:
        fit_material(tiles, progress=fail, **QUICK)
    assert caught.value is raised
    assert bits(fit_material(tiles, **QUICK)) == bits(fitted)


def test_a_callback_may_fit(tiles, fitted):
    inner = []

    def fit(_):
        if not inner:
            inner.append(fit_material(tiles, **QUICK))

    assert bits(fit_material(tiles, progress=fit, **QUICK)) == bits(fitted) == bits(inner[0])


def test_control_c_stops_a_fit():
    program = """
import signal, svbrdf_gcn, sys
# Shells start background jobs with SIGINT ignored, which children inherit.
signal.signal(signal.SIGINT, signal.default_int_handler)
said = []
def say(progress):
    if not said:
        said.append(print("running", flush=True))
try:
    svbrdf_gcn.fit_material(sys.argv[1], size=32, direct_steps=10**7, early_stop=False, progress=say)
except KeyboardInterrupt:
    print("interrupted", flush=True)
    svbrdf_gcn.fit_material(sys.argv[1], size=16, direct_steps=2)
    print("again", flush=True)
"""
    command = [sys.executable, "-c", program, str(TILES)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "running\n"
        process.send_signal(signal.SIGINT)
        try:
            rest, _ = process.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    assert rest == "interrupted\nagain\n" and process.returncode == 0


def test_control_c_stops_the_reading_of_photos(tmp_path):
    program = """
import signal, svbrdf_gcn, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
token = svbrdf_gcn.CancelToken()
print("reading", flush=True)
try:
    svbrdf_gcn.Capture.open(sys.argv[1], size=16, cancel=token)
except KeyboardInterrupt:
    print("interrupted", token.cancelled, flush=True)
"""
    command = [sys.executable, "-c", program, str(large_capture(tmp_path, 6000, 60))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "reading\n"
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        try:
            rest, _ = process.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    assert rest == "interrupted False\n" and process.returncode == 0


# Networks.

# Random weights for one and for two photos.
WEIGHTS = ROOT / "fuzz" / "seeds" / "weights" / "two_networks.safetensors"
SHORT = {"weights": WEIGHTS, "latent_steps": 2, "adapter_steps": 5, "threads": 1}


def test_weights_by_path_and_loaded(tiles, tmp_path):
    model = Model.load(WEIGHTS)
    assert model.photos == [1, 2] and "random" in model.license
    by_path = fit_material(tiles, **SHORT)
    assert by_path.report["method"] == "network"
    assert [stage["stage"] for stage in by_path.report["stages"]] == ["latent", "adapters"]
    assert [stage["steps"] for stage in by_path.report["stages"]] == [2, 5]
    assert bits(fit_material(tiles, **{**SHORT, "weights": model})) == bits(by_path)
    assert fit_material(tiles, method="direct", **{**SHORT, "direct_steps": 2}).report["method"] == "direct"
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(WEIGHTS.read_bytes()[:-100])
    with pytest.raises(WeightsError):
        Model.load(broken)


def test_one_model_for_two_fits_at_once(tiles):
    model, results = Model.load(WEIGHTS), {}

    def run(index):
        results[index] = bits(fit_material(tiles, **{**SHORT, "weights": model}))

    threads = [threading.Thread(target=run, args=(index,)) for index in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results[0] == results[1]


@pytest.mark.parametrize("stage", ["latent", "adapters"])
def test_cancel_in_a_stage_of_the_network(tiles, stage):
    token, seen = CancelToken(), []

    def cancel(progress):
        seen.append(progress.stage)
        if progress.stage == stage:
            token.cancel()

    steps = {"latent_steps": 1, "adapter_steps": 1, f"{stage}_steps".replace("adapters", "adapter"): 10**6}
    with pytest.raises(Cancelled):
        fit_material(tiles, progress=cancel, cancel=token, early_stop=False, **{**SHORT, **steps})
    assert seen[-1] == stage


# Materials.


def test_saved_maps_are_those_of_the_command_line(tmp_path):
    options = ["--size", "32", "--views", "0,1,2", "--preset", "draft", "--threads", "2", "--seed", "3", "--quiet"]
    material = fit_material(TILES, size=32, views=[0, 1, 2], preset="draft", threads=2, seed=3)
    for format in ("exr", "png16", "tiff"):
        by_command, by_python = tmp_path / f"command-{format}", tmp_path / f"python-{format}"
        command = [sys.executable, "-m", "svbrdf_gcn", "fit", str(TILES), "-o", str(by_command), "--format", format, *options]
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
        material.save(by_python, format=format)
        names = {path.name for path in by_command.iterdir()} - {"preview.png"}
        assert names == {path.name for path in by_python.iterdir()} and len(names) == 9
        for name in names - {"material.json"}:
            assert (by_command / name).read_bytes() == (by_python / name).read_bytes(), name
        described = [json.loads((folder / "material.json").read_text()) for folder in (by_command, by_python)]
        for description in described:
            description["report"].pop("seconds")
            for stage in description["report"]["stages"]:
                stage.pop("seconds")
        assert described[0] == described[1]


def test_the_command_line_is_a_module(tmp_path):
    run = lambda *arguments: subprocess.run(  # noqa: E731
        [sys.executable, "-m", "svbrdf_gcn", *arguments], capture_output=True, text=True, check=False
    )
    version = run("--version")
    assert (version.returncode, version.stdout) == (0, f"svbrdf-gcn {svbrdf_gcn.__version__}\n")
    missing = run("fit", str(tmp_path / "none"), "-o", str(tmp_path / "out"))
    assert missing.returncode == 3 and "none" in missing.stderr


def test_materials_load_what_they_save(fitted, tmp_path):
    fitted.save(tmp_path, format="tiff")
    again = Material.load(tmp_path)
    # Normals and albedos are limited once more, which may change the last bit.
    for name in MAPS:
        np.testing.assert_allclose(getattr(again, name), getattr(fitted, name), atol=3e-7)
    assert again.report == fitted.report and again.warnings == fitted.warnings
    assert again.unit == fitted.unit == json.loads((TILES / "capture.json").read_text())["unit"]
    with pytest.raises(FormatError, match="encoding must be stated"):
        Material.load(TILES)
    with pytest.raises(ArgumentError, match="format: expected exr, png16 or tiff, got 'jpg'"):
        fitted.save(tmp_path, format="jpg")
    with pytest.raises(ArgumentError, match="encoding: expected .*got 'other'"):
        Material.load(TILES, encoding="other")


def test_a_changed_map_is_said_and_files_of_others_are_spared(fitted, tmp_path):
    fitted.save(tmp_path)
    with (tmp_path / "normal.exr").open("ab") as file:
        file.write(b"\0")
    changed, *rest = Material.load(tmp_path).warnings
    assert "normal.exr" in changed and "changed since" in changed and rest == fitted.warnings
    with pytest.raises(ArgumentError, match="normal.png: .*another folder"):
        (tmp_path / "normal.png").write_text("mine")
        fitted.export(tmp_path, to="principled")
    with pytest.raises(ArgumentError, match="diffuse.tif: svbrdf-gcn did not write"):
        (tmp_path / "diffuse.tif").write_text("mine")
        fitted.save(tmp_path, format="tiff")
    assert (tmp_path / "diffuse.tif").read_text() == (tmp_path / "normal.png").read_text() == "mine"


def test_materials_from_arrays():
    rng = np.random.default_rng(1)
    normal = np.zeros((5, 7, 3)) + [0, 0, 1]
    tangent = np.zeros((5, 7, 3)) + [1, 0, 0]
    material = Material(
        rng.random((5, 7, 3)), rng.random((5, 7, 3)), rng.random((5, 7, 2)), normal, tangent, patch_size=2, unit="in"
    )
    assert (material.patch_size, material.unit) == (2, "in")
    np.testing.assert_array_equal(material.tangent, tangent)
    assert material.report == {} and material.warnings == [] and material.roughness.shape == (5, 7, 2)
    photo = material.render([0, 0, 4], [1, 0, 4])
    assert photo.shape == (5, 7, 3) and photo.flags.writeable and photo.flags.owndata
    # Radiance is linear in the intensity of the light.
    twice = material.render([0, 0, 4], [1, 0, 4], [2 * np.pi * 17, np.pi * 17, 0])
    np.testing.assert_allclose(twice, photo * np.array([2, 1, 0]), rtol=1e-6)
    grey = rng.random((5, 7, 3))
    for arguments, error, said in [
        ((grey, grey, grey[..., 0], normal[:4]), ShapeError, "expected shape"),
        ((grey, grey, grey, normal), ShapeError, "roughness"),
        ((grey * np.nan, grey, grey[..., 0], normal), ArgumentError, "diffuse_albedo"),
        ((grey.astype(np.uint8), grey, grey[..., 0], normal), FormatError, "diffuse_albedo: .*got uint8"),
    ]:
        with pytest.raises(error, match=said):
            Material(*arguments, patch_size=1)


def test_a_white_matt_patch_is_white_under_the_default_light():
    white, flat = np.ones((5, 5, 3)), np.zeros((5, 5, 3)) + [0, 0, 1]
    material = Material(white, 0 * white, white[..., :1], flat, patch_size=0.01)
    np.testing.assert_allclose(material.render([0, 0, 3], [0, 0, 3])[2, 2], 1, rtol=1e-3)
    with pytest.raises(ShapeError, match=r"camera: expected shape \(3,\), got \(2,\)"):
        material.render([0, 1], [0, 0, 1])
    with pytest.raises(ArgumentError, match="light"):
        material.render([0, 0, 1], [0, 0, np.inf])


def test_notebooks_show_a_picture(fitted):
    png = fitted._repr_png_()
    assert png[:8] == b"\x89PNG\r\n\x1a\n" and len(png) > 10_000


def test_metrics():
    truth = Material.load(TILES / "truth")
    other = Material(
        truth.diffuse_albedo[::-1], truth.specular_albedo, truth.roughness, truth.normal, patch_size=truth.patch_size
    )
    errors = metrics.map_errors(other, truth)
    difference = np.asarray(other.diffuse_albedo, np.float64) - truth.diffuse_albedo
    assert errors["diffuse"]["linear"] == pytest.approx(np.sqrt(np.mean(difference**2)), rel=1e-6)
    assert errors["roughness"] == {"linear": 0.0, "gamma22": 0.0}
    assert errors["normal"] < 1e-6 and errors["normal_angle_deg"] < 1e-3
    with pytest.raises(ShapeError, match=r"normal: expected shape \(64, 64, 3\), got \(256, 256, 3\)"):
        metrics.map_errors(truth, Material.load(ROOT / "samples" / "lambert" / "truth"))
    with pytest.raises(ShapeError, match="rendering"):
        metrics.photo_rmse(np.zeros((4, 4, 3)), np.zeros((4, 5, 3)))
    with pytest.raises(FormatError, match="photo: expected linear values as floats, got uint8"):
        metrics.photo_rmse(np.zeros((4, 4, 3)), np.zeros((4, 4, 3), np.uint8))


# Rows of the matrix from ACEScg to linear Rec. 709 (Bradford between the whites), as colour science packages have it.
ACESCG_TO_REC709 = [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]]


def test_photos_and_light_in_acescg():
    photos = two_photos()
    capture = capture_of(photos, color_space="acescg", light_intensity=[1500.0, 1000.0, 500.0])
    for got, given in zip(capture.photos, photos, strict=True):
        np.testing.assert_allclose(got, given @ np.transpose(ACESCG_TO_REC709), atol=2e-5)
    expected = np.array(ACESCG_TO_REC709) @ [1500.0, 1000.0, 500.0]
    np.testing.assert_allclose(capture.light_intensity[0], expected, rtol=1e-4)


def png(path, size, color_type, rows, *chunks):
    """A PNG of 8 bits and `size` x `size` pixels, whose `rows` begin with the byte of their filter, with `chunks` before its pixels."""

    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    header = struct.pack(">IIBBBBB", size, size, 8, color_type, 0, 0, 0)
    chunks = [(b"IHDR", header), *chunks, (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*entry) for entry in chunks))
    return path


def png_in_display_p3(path):
    """A PNG of one pixel, (0, 250, 0), that states Display P3 in a cICP chunk."""
    return png(path, 1, 2, bytes([0, 0, 250, 0]), (b"cICP", bytes([12, 13, 0, 1])))


def large_capture(folder, size, count):
    """A capture of `count` photos of `size` x `size` pixels in few bytes: they are one file."""
    png(folder / "large.png", size, 0, bytes((1 + size) * size))
    photo = {"file": "large.png", "camera": [0, 0, 9]}
    capture = {"format": "svbrdf-gcn capture", "version": 1, "patch_size": 1, "transfer": "srgb", "light_intensity": 9, "photos": [photo] * count}
    (folder / "capture.json").write_text(json.dumps(capture))
    return folder


def test_colors_that_files_state_count_unless_ignored(tmp_path):
    photos = [png_in_display_p3(tmp_path / f"{i}.png") for i in range(2)]
    converted = capture_of(photos, transfer="srgb")
    assert converted.photos[0][0, 0, 0] < -0.1, "a green that Rec. 709 has not"
    assert "Rec. 709" in converted.warnings[0]
    ignored = capture_of(photos, transfer="srgb", ignore_profiles=True)
    assert ignored.photos[0][0, 0, 0] == 0
    assert ignored.warnings == []
    assert capture_of(photos, transfer="srgb", color_space="rec709").photos[0][0, 0, 0] == 0


def test_albedos_are_saved_in_acescg(fitted, tmp_path):
    fitted.save(tmp_path, format="tiff", color_space="acescg")
    description = json.loads((tmp_path / "material.json").read_text())
    assert description["maps"]["diffuse"]["color_space"] == "acescg"
    np.testing.assert_allclose(Material.load(tmp_path).diffuse_albedo, fitted.diffuse_albedo, atol=1e-6)
    with pytest.raises(ArgumentError, match="color_space: expected rec709 or acescg, got 'srgb'"):
        fitted.save(tmp_path, color_space="srgb")


@pytest.mark.parametrize("target", ["materialx", "gltf", "principled", "unreal"])
def test_exports_are_those_of_the_command_line(fitted, tmp_path, target):
    fitted.save(tmp_path / "maps", format="tiff")
    again = Material.load(tmp_path / "maps")
    report = again.export(tmp_path / "python", to=target, name="Tiles")
    command = [sys.executable, "-m", "svbrdf_gcn", "export", str(tmp_path / "maps"), "--to", target, "--name", "Tiles", "-o"]
    subprocess.run([*command, str(tmp_path / "command")], check=True, stdout=subprocess.DEVNULL)
    names = {path.name for path in (tmp_path / "python").iterdir()}
    assert names == {path.name for path in (tmp_path / "command").iterdir()}
    assert names == {entry["file"] for entry in report["files"]} | {"export.json"}
    for name in names:
        assert (tmp_path / "python" / name).read_bytes() == (tmp_path / "command" / name).read_bytes(), name
    for arguments, said in [
        ({"to": "maya"}, "to: expected materialx, gltf, principled or unreal, got 'maya'"),
        ({"to": target, "name": "1 wall"}, "name: .*1 wall"),
        ({"to": target, "normals": "up"}, "normals: expected opengl or directx, got 'up'"),
    ]:
        with pytest.raises(ArgumentError, match=said):
            again.export(tmp_path / "none", **arguments)
        assert not (tmp_path / "none").exists()


def test_a_level_material_makes_a_plane(fitted, tmp_path):
    assert fitted.report["tilt"] == pytest.approx(list(fitted.tilt))
    level = fitted.leveled()
    assert level.report == fitted.report and max(map(abs, level.tilt)) < 1e-6
    slopes = fitted.normal[..., :2] / fitted.normal[..., 2:]
    np.testing.assert_allclose(level.normal[..., :2] / level.normal[..., 2:], slopes - fitted.tilt, atol=1e-5)
    assert fitted.export(tmp_path / "level", to="unreal")["tilt_removed"] == pytest.approx(list(fitted.tilt))
    assert "tilt_removed" not in fitted.export(tmp_path / "as-it-is", to="unreal", level=False)


def test_principled_maps_reflect_what_the_material_does(fitted):
    principled = fitted.principled()
    # Diffuse reflectance at normal incidence: (1 - metallic) base (1 - the coat's); the coat's is 0.08 level tint for IOR 1.5, which brighter coats exceed.
    brightest = (principled.specular_level * principled.specular_tint).max()
    assert principled.ior == pytest.approx(1.5) or (principled.ior > 1.5 and brightest == pytest.approx(1, abs=1e-3))
    coat = 2 * ((principled.ior - 1) / (principled.ior + 1)) ** 2 * principled.specular_level * principled.specular_tint
    metallic, base = principled.metallic, principled.base_color
    specular = metallic * base + (1 - metallic) * coat
    diffuse = (1 - metallic) * base * (1 - coat.max(axis=-1, keepdims=True))
    for got, expected, loss in [
        (specular, fitted.specular_albedo, principled.loss["specular"]),
        (diffuse, fitted.diffuse_albedo * (1 - fitted.specular_albedo), principled.loss["diffuse"]),
    ]:
        assert np.abs(got - expected).max() <= loss["max"] + 1e-4
    assert principled.anisotropic is None and not base.flags.writeable
    np.testing.assert_allclose(principled.normal, fitted.normal, atol=1e-6)


def test_principled_maps_of_an_anisotropic_material():
    grey, flat = np.full((4, 4, 3), 0.3), np.zeros((4, 4, 3)) + [0, 0, 1]
    roughness = np.zeros((4, 4, 2)) + [0.3, 0.6]
    material = Material(grey, 0.1 * grey, roughness, flat, np.zeros((4, 4, 3)) + [1, 0, 0], patch_size=1)
    principled = material.principled()
    np.testing.assert_allclose(principled.roughness, np.sqrt(0.3 * 0.6), rtol=1e-5)
    # Blender: alpha along and across are r^2 times and over sqrt(1 - 0.9 a); four times apart here.
    np.testing.assert_allclose(1 - 0.9 * principled.anisotropic, 0.25, rtol=1e-4)
    assert principled.anisotropic_rotation.shape == (4, 4, 1)


def test_the_version_of_numpy_is_the_one_meant():
    assert np.__version__.startswith(os.environ.get("SVBRDF_GCN_NUMPY", "2."))


def test_the_version_is_that_of_the_workspace():
    manifest = (ROOT / "Cargo.toml").read_text()
    assert f'\nversion = "{svbrdf_gcn.__version__}"\n' in manifest
