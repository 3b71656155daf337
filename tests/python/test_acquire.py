"""The printed sheet is true to scale, and photos of it, made by rays in numpy, become the capture they were taken as."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import svbrdf_gcn

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "python" / "tools"))

import make_photos  # noqa: E402
import png  # noqa: E402

pypdfium2 = pytest.importorskip("pypdfium2", reason="in tests/python/requirements.txt")


def command(*arguments, code=0):
    run = subprocess.run([sys.executable, "-m", "svbrdf_gcn", *map(str, arguments)], capture_output=True, text=True, check=False)
    assert run.returncode == code, run.stderr
    return run


@pytest.fixture(scope="module")
def sheet(tmp_path_factory):
    path = tmp_path_factory.mktemp("sheet") / "sheet.pdf"
    command("sheet", "-o", path)
    return path


@pytest.fixture(scope="module")
def page(sheet):
    return make_photos.page(sheet, finer=2)


@pytest.mark.parametrize(("paper", "size"), [("a4", (210.0, 297.0)), ("letter", (215.9, 279.4)), ("a3", (297.0, 420.0))])
def test_the_sheet_is_true_to_scale(tmp_path, paper, size):
    path = tmp_path / "sheet.pdf"
    command("sheet", "-o", path, "--paper", paper, "--window", "10cm")
    page = pypdfium2.PdfDocument(str(path))[0]
    assert np.allclose(np.array(page.get_size()) * 25.4 / 72, size, atol=0.01)
    per_mm = 20
    picture = page.render(scale=per_mm * 25.4 / 72, grayscale=True).to_numpy().squeeze()
    black = picture < 64
    middle = size[0] / 2
    # The first tag: its outer corner, its border, its side of 20 mm.
    rows = np.nonzero(black[: 30 * per_mm].any(1))[0]
    assert rows[0] / per_mm == pytest.approx(15.0, abs=0.1)
    row = black[int((15 + 1.25) * per_mm)]
    starts = np.nonzero(np.diff(row.astype(int)) == 1)[0] / per_mm
    ends = np.nonzero(np.diff(row.astype(int)) == -1)[0] / per_mm
    assert len(starts) == 5
    assert np.allclose(ends - starts, 20.0, atol=0.1)
    assert np.allclose(starts, middle - 77 + 33.5 * np.arange(5), atol=0.1)
    # The bar: the longest run of black in any row below the tags.
    below = black[int(175 * per_mm) :]
    longest = max(np.diff(np.flatnonzero(np.diff(np.pad(line.astype(int), 1)))).max(initial=0) for line in below)
    assert longest / per_mm == pytest.approx(100.0, abs=0.1)


def test_svg_and_errors(tmp_path):
    command("sheet", "-o", tmp_path / "sheet.svg", "--window", "80mm")
    text = (tmp_path / "sheet.svg").read_text()
    assert 'width="210mm" height="297mm"' in text and text.count("<path") > 40
    for arguments, said in [
        (("-o", tmp_path / "sheet.png"), "written are .pdf and .svg"),
        (("-o", tmp_path / "sheet.pdf", "--window", "300mm"), "expected at most"),
        (("-o", tmp_path / "sheet.pdf", "--window", "1mm"), "expected 20 mm to 1000 mm, got 1 mm"),
        (("-o", tmp_path / "sheet.pdf", "--window", "wide"), "expected a length in mm, cm, m or in"),
    ]:
        run = command("sheet", *arguments, code=3 if "png" in str(arguments[1]) else 2)
        assert said in run.stderr
    assert not (tmp_path / "sheet.pdf").exists()


def acquired(folder, scene, shots, *arguments):
    photos = []
    for i, shot in enumerate(shots):
        photos.append(folder / f"{i}.png")
        make_photos.png.write(photos[-1], make_photos.photograph(scene, shot, i, samples=2))
    out = folder / "capture"
    report = json.loads(command("acquire", *photos, "-o", out, "--json", "--size", 256, *arguments).stdout)["report"]
    return photos, svbrdf_gcn.Capture.open(out), report


def test_photos_become_their_capture(tmp_path, page):
    scene = make_photos.Scene(page, 12.0, make_photos.Lens(), depth=1.0, light_offset=(12.0, 5.0))
    shots = make_photos.around(6, size=(900, 600))
    # One upside down, one upright, one blurred.
    shots[2].roll += np.pi
    shots[3].size = (600, 900)
    shots[4].blur = 7
    photos, capture, report = acquired(tmp_path, scene, shots, "--depth", "1mm", "--light-offset", "12,5")
    assert [photo["tags"] for photo in report["photos"]] == [16] * 6 and not report["left_out"]
    errors = make_photos.compare(capture, report, [scene] * len(shots), shots)
    assert np.median(errors["position"]) < 0.002 and max(errors["position"]) < 0.01, errors
    assert np.median(errors["corner"]) < 0.3, errors
    assert np.median(errors["light"]) < 0.02 and max(errors["light"]) < 0.05, errors
    assert any("4.png: is blurred" in warning for warning in report["warnings"]), report["warnings"]
    assert capture.unit == "mm" and capture.patch_size == pytest.approx(96)
    # The same in Python, and its files.
    acquisition = svbrdf_gcn.acquire(iter(photos), depth=1, light_offset=(12, 5), size=256)
    assert acquisition.report == report and repr(acquisition) == "<svbrdf_gcn.Acquisition: 6 photos, 0 left out>"
    assert np.array_equal(acquisition.capture.camera_positions, capture.camera_positions)
    acquisition.save(tmp_path / "python")
    picture = np.round(255 * acquisition.contact_sheet)
    # The outlines of 96 tags and six samples.
    for color, least in (((64, 242, 102), 2000), ((255, 158, 26), 2000)):
        assert (np.abs(picture - color).max(-1) < 3).sum() > least
    assert [missing["camera"][2] > 150 for missing in report["missing"]].count(False) == 0
    for name in ("capture.json", "00.exr", "contact-sheet.png"):
        assert (tmp_path / "python" / name).read_bytes() == (tmp_path / "capture" / name).read_bytes()


def corners_in(scene, shot):
    """The corners of the patch in a photo, as near as a hand clicks in one of 3000 pixels."""
    half = make_photos.WINDOW / 2 * 0.96
    points = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]]) - shot.camera
    seen = points @ make_photos.axes(shot).T
    return 0.3 * np.round(scene.lens.pixels(seen[:, :2] / seen[:, 2:], shot.size) / 0.3)


def test_corners_tell_where_photos_without_a_sheet_were_taken(tmp_path, page):
    """No EXIF data: the focal length comes from the corners."""
    scene = make_photos.Scene(np.full_like(page[:8, :8], 0.3), 12.0, make_photos.Lens(radial=(0.02, -0.02)), vignetting=False, beam=0.0)
    shots = make_photos.around(5, size=(900, 600))
    for shot in shots:
        shot.exposure = 0.5
    corners = [corners_in(scene, shot) for shot in shots]
    photos = [tmp_path / f"{i}.png" for i in range(len(shots))]
    for i, shot in enumerate(shots):
        png.write(photos[i], make_photos.photograph(scene, shot, i, samples=2))
    acquisition = svbrdf_gcn.acquire(photos, corners=corners, patch_width=96, size=256)
    report, capture = acquisition.report, acquisition.capture
    errors = make_photos.compare(capture, report, [scene] * len(shots), shots)
    assert max(errors["position"]) < 0.01, errors
    assert capture.patch_size == 96 and capture.unit == "mm" and not report["left_out"]
    # One light for all, under which 99 % of the albedos are at most 0.9: the pattern's brightest is known.
    brightest = np.percentile(make_photos.pattern(*np.meshgrid(np.linspace(-48, 48, 256), np.linspace(48, -48, 256))).max(-1), 99)
    light = np.array(capture.light_intensity)
    assert np.ptp(light) == 0 and light[0, 0] == pytest.approx(0.5 * scene.intensity[0] * brightest / 0.9, rel=0.05)
    said = " | ".join(report["assumptions"])
    for words in ("a flat square", "from the corners of all photos", "no EXIF data", "the flash is at the lens", "as bright in every photo"):
        assert words in said, said
    # The same by the command line, and its file of corners; the verdict names what is assumed.
    numbers = [",".join(map(str, one.ravel())) for one in corners]
    flags = [word for one in numbers for word in ("--corners", one)]
    run = command("acquire", *photos, "-o", tmp_path / "flags", "--json", "--size", 256, "--patch-width", "9.6cm", *flags)
    assert json.loads(run.stdout)["report"] == report and "assumed: the patch is a flat square" in run.stderr
    (tmp_path / "corners.json").write_text(json.dumps({f"{i}.png": one.tolist() for i, one in enumerate(corners)}))
    run = command("fit", photos[0], "-o", tmp_path / "fit", "--json", "--size", 32, "--preset", "draft", "--patch-width", 96, "--corners", tmp_path / "corners.json")
    reasons = {reason["code"]: reason["text"] for reason in json.loads(run.stdout)["report"]["reasons"]}
    assert "a usual one: no EXIF data tell it" in reasons["assumed"] and (tmp_path / "fit" / "capture" / "capture.json").exists()
    # What is wrong is named.
    for arguments, said in [
        (("--corners", "1,2,3"), "expected eight numbers"),
        (("--corners", numbers[0]), "expected those of each of the 2 photos, got those of 1"),
        (("--corners", tmp_path / "corners.json", "--depth", "1mm"), "cannot be used with"),
        (("--corners", numbers[0], "--corners", ",".join(map(str, corners[1][::-1].ravel()))), "of photo 1: expected x,y of the upper left corner"),
        (("--corners", tmp_path / "corners.json", "--light-offset", "auto"), "without a sheet it cannot be found"),
    ]:
        assert said in command("acquire", *photos[:2], "-o", tmp_path / "no", "--patch-width", 96, *arguments, code=2).stderr
    assert "1.jpg" in command("acquire", tmp_path / "1.jpg", "-o", tmp_path / "no", "--patch-width", 96, "--corners", tmp_path / "corners.json", code=2).stderr
    assert "is for photos" in command("fit", tmp_path / "flags", "-o", tmp_path / "no", "--patch-width", 96, "--corners", numbers[0], code=2).stderr
    for option, value in (("--depth", "1mm"), ("--window", "80mm"), ("--light-offset", "auto"), ("--paper-white", "0.9"), ("--dark", photos[0])):
        assert f"{option[2:]}: is for photos" in command("fit", tmp_path / "flags", "-o", tmp_path / "no", option, value, code=2).stderr


def test_path_traced_photos_of_a_telephone():
    """JPEG, EXIF data that are 5 % off, one photo upright, a tone curve that is not sRGB's. Measured: 0.06 %, 1.0 %, and the flash 2.7 mm off."""
    phone = ROOT / "samples" / "phone"
    truth = json.loads((phone / "truth.json").read_text())
    acquisition = svbrdf_gcn.acquire(sorted(phone.glob("*.jpg")), depth=truth["depth"], light_offset="auto", size=256)
    assert len(acquisition.report["photos"]) == 5
    up = np.array([0, 0, truth["depth"]])
    cameras = np.array([photo["camera"] for photo in truth["photos"]]) + up
    lights = np.array([photo["light"] for photo in truth["photos"]]) + up
    distance = np.linalg.norm(cameras, axis=-1)
    assert (np.linalg.norm(acquisition.capture.camera_positions - cameras, axis=-1) < 0.001 * distance).all()
    assert (np.linalg.norm(acquisition.capture.light_positions - lights, axis=-1) < 4.0).all()
    exposures = np.array([photo["exposure"] for photo in truth["photos"]])
    gains = acquisition.capture.light_intensity / (exposures[:, None] * np.array(truth["light_intensity"]))
    assert np.abs(gains / np.median(gains, 0) - 1).max() < 0.02, gains
    assert max(photo["paper_error"] for photo in acquisition.report["photos"]) < 0.01
    assert acquisition.report["lenses"][0]["focal_length_from_exif"] < 0.97 * acquisition.report["lenses"][0]["focal_length"]


def test_a_telephones_curve_flash_and_room_are_found(tmp_path, page):
    scene = make_photos.Scene(page, 12.0, make_photos.Lens(), light_offset=(14.0, 4.0), tone=0.035, room=(0.25, 0.3, 0.35))
    shots = make_photos.around(5, size=(900, 600))
    without = tmp_path / "dark.png"
    make_photos.png.write(without, make_photos.photograph(scene, replace(shots[1], exposure=1.0, flash=False), samples=2))
    for shot in shots:
        shot.exposure = 1.0
    arguments = ("--light-offset", "auto", "--dark", without)
    _, capture, report = acquired(tmp_path, scene, shots, *arguments)
    assert len(report["photos"]) == 5 and not report["warnings"], report["warnings"]
    lens = report["lenses"][0]
    assert np.allclose(lens["light_offset"], (14, 4), atol=2), lens
    errors = make_photos.compare(capture, report, [scene] * len(shots), shots)
    assert max(errors["light"]) < 0.03 and np.median(errors["albedo"]) < 0.12, (errors, lens)
    # Without all that: what is wrong is said, and more is wrong.
    report = svbrdf_gcn.acquire([tmp_path / f"{i}.png" for i in range(5)], size=256).report
    assert any("do not come from the flash" in warning for warning in report["warnings"]), report
    with pytest.raises(svbrdf_gcn.ArgumentError, match="dark: .*sky.png: 0 of the sheet's 16 tags"):
        png.write(tmp_path / "sky.png", np.full((60, 80, 3), 90, np.uint8))
        svbrdf_gcn.acquire([tmp_path / "0.png"], dark=tmp_path / "sky.png")


def test_a_photo_whose_flash_did_not_fire_is_left_out(tmp_path, page):
    """No EXIF data say so, but the paper does: light of the room falls off in another way."""
    scene = make_photos.Scene(page, 12.0, make_photos.Lens(), room=(0.05, 0.05, 0.05))
    shots = make_photos.around(4, size=(900, 600))
    shots[2] = replace(shots[2], flash=False)
    _, _, report = acquired(tmp_path, scene, shots)
    assert [out["photo"] for out in report["left_out"]] == ["2.png"] and "the flash did not fire" in report["left_out"][0]["reason"], report
    assert len(report["photos"]) == 3


def test_arguments_of_acquire_are_named(tmp_path):
    for arguments, error, said in [
        ({"photos": "0.png"}, svbrdf_gcn.FormatError, "photos: expected paths, got '0.png'"),
        ({"photos": [1]}, svbrdf_gcn.FormatError, "photos: expected paths"),
        ({"photos": [], "window": 1}, svbrdf_gcn.ArgumentError, "window: expected 20 mm to 1000 mm, got 1"),
        ({"photos": [], "window": 90, "frame_width": 90}, svbrdf_gcn.ArgumentError, "frame_width: is the other sheet's"),
        ({"photos": [], "printed_bar": 9.8}, svbrdf_gcn.ArgumentError, "printed_bar: expected the printed length of 100 mm, 50 mm to 200 mm, got 9.8 mm"),
        ({"photos": [], "light_offset": [1, 2, 3]}, svbrdf_gcn.ArgumentError, "light_offset: expected two numbers or 'auto', got .*: 3 of them"),
        ({"photos": [], "light_offset": "left"}, svbrdf_gcn.FormatError, "light_offset: expected two numbers or 'auto', got 'left'"),
        ({"photos": [], "paper_white": 2}, svbrdf_gcn.ArgumentError, "paper_white: expected an albedo above 0 and at most 1, got 2"),
        ({"photos": [tmp_path / "none.png"]}, FileNotFoundError, "none.png"),
        ({"photos": [], "corners": [[1, 2, 3]], "patch_width": 9}, svbrdf_gcn.ShapeError, r"corners: expected shape \(N, 4, 2\) or \(N, 8\), got \(1, 3\)"),
        ({"photos": [], "corners": [[0, 0, 9, 0, 9, 9, 0, 9]]}, svbrdf_gcn.ArgumentError, "patch_width: expected the width"),
        ({"photos": [], "patch_width": 96}, svbrdf_gcn.ArgumentError, "patch_width: is for photos whose corners are given: .* got 96"),
        ({"photos": [], "corners": [[0, 0, 9, 0, 9, 9, 0, 9]], "patch_width": 9, "window": 90}, svbrdf_gcn.ArgumentError, "window: is for photos of a sheet: .* got 90"),
    ]:
        with pytest.raises(error, match=said):
            svbrdf_gcn.acquire(**arguments)
    token = svbrdf_gcn.CancelToken()
    token.cancel()
    with pytest.raises(svbrdf_gcn.Cancelled):
        svbrdf_gcn.acquire([ROOT / "samples" / "tiles" / "00.png"], cancel=token)


def test_photos_that_cannot_be_used_are_named(tmp_path, page):
    scene = make_photos.Scene(page, 12.0, make_photos.Lens())
    photo = make_photos.photograph(scene, make_photos.around(2, size=(900, 700))[0], samples=2)
    pictures = {
        "good": photo,
        "mirrored": photo[:, ::-1],
        "empty": np.full((60, 80, 3), 90, np.uint8),
        "black": np.zeros((60, 80, 3), np.uint8),
        "tiny": photo[:5, :7],
        "bright": np.where(photo > 60, 255, photo).astype(np.uint8),
    }
    for name, picture in pictures.items():
        png.write(tmp_path / f"{name}.png", np.ascontiguousarray(picture))
    paths = [tmp_path / f"{name}.png" for name in pictures]
    report = json.loads(command("acquire", *paths, "-o", tmp_path / "out", "--json").stdout)["report"]
    reasons = {entry["photo"]: entry["reason"] for entry in report["left_out"]}
    assert [entry["photo"] for entry in report["photos"]] == ["good.png"]
    assert "mirror" in reasons["mirrored.png"] and "overexposed" in reasons["bright.png"]
    for name in ("empty", "black", "tiny"):
        assert "0 of the sheet's 16 tags" in reasons[f"{name}.png"]
    run = command("acquire", *paths[1:], "-o", tmp_path / "none", code=2)
    assert "none can be used" in run.stderr and "svbrdf-gcn sheet" in run.stderr
    assert not (tmp_path / "none").exists()
    # A capture that somebody wrote is not replaced.
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "capture.json").write_text('{"format": "svbrdf-gcn capture", "version": 1, "photos": []}')
    assert "not made by acquire" in command("acquire", paths[0], "-o", tmp_path / "own", code=2).stderr
