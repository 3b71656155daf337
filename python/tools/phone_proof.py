"""How near `acquire` comes, on photos whose truth is known: the tables of docs/capturing.md.

    .venv/bin/python python/tools/phone_proof.py [--size 3000 2000] [--binary target/release/svbrdf-gcn]

Photos of the printed page are made by rays in numpy (`make_photos.py`), without EXIF data but where a row says so. Every figure is the median of its photos and, in brackets, the largest. Photos
of a glossy sample are path-traced (`make_phone.py`): their maps are compared with those of the same photos where positions and light are true. Needs what `make setup` installs.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

import svbrdf_gcn

sys.path.insert(0, str(Path(__file__).resolve().parent))

import make_phone  # noqa: E402
import make_photos  # noqa: E402
import png  # noqa: E402
import sample_check  # noqa: E402
import sample_material  # noqa: E402

# To the right and up of the lens, in mm.
BESIDE = (15.0, 8.0)
TONE = 0.035
ROOM = (0.25, 0.3, 0.35)
# Photos of the path-traced sample that a fit uses; the others are the unseen views.
USED = [0, 1, 2, 3, 4]
# What acquire makes of photos of a telephone today, and how large these are made.
MEGAPIXELS_12, ENLARGED = (4032, 3024), 3


def rows(page, size):
    """Name, a scene for each shot, shots, arguments of acquire, and whether photos are JPEG with EXIF data."""
    plain = make_photos.Scene(page, 12.0, make_photos.Lens(), depth=0.5)
    beside = replace(plain, light_offset=BESIDE)
    nine, five = make_photos.around(9, size=size), make_photos.around(5, size=size)
    stated, found = {"depth": 0.5, "light_offset": BESIDE}, {"depth": 0.5, "light_offset": "auto"}
    yield "nine, flash 17 mm beside the lens, which is stated", [beside] * 9, nine, stated, False
    yield "the same, where the flash is has to be found", [beside] * 9, nine, found, False
    curved = replace(beside, tone=TONE)
    yield "the same, a telephone's tone curve", [curved] * 9, nine, found, False
    equal = [replace(shot, exposure=1.0) for shot in nine]
    dark = replace(equal[3], flash=False)
    yield "the same, other light in the room, one photo without flash", [replace(curved, room=ROOM)] * 9, equal, {**found, "dark": dark}, False
    yield "five, flash at the lens", [plain] * 5, five, {"depth": 0.5}, False
    yield "one, flash at the lens", [plain], nine[:1], {"depth": 0.5}, False
    covered = page.copy()
    # The second tag along the top and the third down the right, in pixels of the page.
    for x, y in ((105 - 77 + 33.5, 15), (105 + 57, 15 + 67)):
        covered[int(12 * (y - 2)) : int(12 * (y + 22)), int(12 * (x - 2)) : int(12 * (x + 22))] = 0.3
    odd = [replace(shot) for shot in nine]
    odd[2].roll += np.pi
    odd[3].size = size[::-1]
    odd[4].blur = 12
    odd[5].exposure = 0.1
    yield "nine: two tags covered, one upside down, one upright, one blurred, one hardly exposed", [replace(plain, page=covered)] * 9, odd, {"depth": 0.5}, False
    near = replace(plain, lens=make_photos.Lens(1.15, (0.02, -0.03)))
    zoomed = [plain] * 5 + [near] * 4
    # Farther away, so that the sheet is in the picture.
    shots = nine[:5] + [replace(shot, camera=tuple(1.45 * np.array(shot.camera)), exposure=2.0) for shot in nine[5:]]
    yield "nine with two zoom settings, EXIF data 5 % off", zoomed, shots, {"depth": 0.5}, True
    yield "the same without EXIF data", zoomed, shots, {"depth": 0.5}, False
    gloom = replace(plain, room=(0.05, 0.05, 0.05))
    yield "five of which the flash of one did not fire, a dim room", [gloom] * 5, [replace(shot, flash=i != 2) for i, shot in enumerate(five)], {"depth": 0.5}, False


def photos_of(folder, scenes, shots, jpeg, samples):
    paths = []
    for i, (scene, shot) in enumerate(zip(scenes, shots)):
        pixels = make_photos.photograph(scene, shot, i, samples)
        paths.append(folder / f"{i}.{'jpg' if jpeg else 'png'}")
        if jpeg:
            # On a frame of 35 mm film, whose diagonal is 43.27 mm.
            diagonal = np.hypot(*shot.size) / max(shot.size)
            make_phone.write_jpeg(paths[-1], pixels, exposure=shot.exposure, focal_length_35mm=round(0.95 * scene.lens.focal_length * 43.27 / diagonal))
        else:
            png.write(paths[-1], pixels)
    return paths


def measured(folder, scenes, shots, arguments, jpeg, samples):
    arguments = dict(arguments)
    if "dark" in arguments:
        dark = folder / "dark.png"
        png.write(dark, make_photos.photograph(scenes[0], arguments["dark"], 99, samples))
        arguments["dark"] = dark
    acquisition = svbrdf_gcn.acquire(photos_of(folder, scenes, shots, jpeg, samples), size=512, **arguments)
    return acquisition, make_photos.compare(acquisition.capture, acquisition.report, scenes, shots)


def figure(values, factor, unit, digits):
    return f"{factor * np.median(values):.{digits}f} ({factor * max(values):.{digits}f}) {unit}"


def table(folder, page, arguments):
    print("| photos | camera position, of the distance | corners at 512 x 512 | light, up to a common factor | fall-off, RMS | albedo, RMS | flash, tone |\n|---|---|---|---|---|---|---|")
    for i, (name, scenes, shots, how, jpeg) in enumerate(rows(page, tuple(arguments.size))):
        if arguments.rows and i not in arguments.rows:
            continue
        acquisition, errors = measured(folder, scenes, shots, how, jpeg, arguments.samples)
        lens = acquisition.report["lenses"][0]
        cells = [
            figure(errors["position"], 100, "%", 2),
            figure(errors["corner"], 1, "pixels", 2),
            figure(errors["light"], 100, "%", 1),
            figure(errors["fall_off"], 100, "%", 1),
            figure(errors["albedo"], 100, "%", 1),
            f"{np.round(lens['light_offset'], 1).tolist()}, {np.round(lens['tone'], 3).tolist()}",
        ]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)
        for said in acquisition.report["warnings"]:
            print(f"  {said}")


def traced(arguments):
    """Maps and unseen views of path-traced photos, acquired and with true positions and light."""
    with tempfile.TemporaryDirectory() as folder:
        photos, linear = (Path(arguments.traced or folder) / name for name in ("photos", "linear"))
        if not (linear / "capture.json").exists():
            maker = [sys.executable, make_phone.__file__, photos, "--pdf", arguments.pdf, "--count", "7", "--finer", "1.25", "--linear", linear]
            subprocess.run([*map(str, maker), *(["--blender", arguments.blender] if arguments.blender else [])], check=True, stdout=subprocess.DEVNULL)
        perfect = svbrdf_gcn.Capture.open(linear, size=arguments.maps)
        truth = json.loads((photos / "truth.json").read_text())
        paths = sorted(photos.glob("*.jpg"))
        print("\n| positions and light | diffuse | specular | roughness | normal | unseen views |\n|---|---|---|---|---|---|")
        ways = {"true, linear photos": svbrdf_gcn.Capture.open(linear, size=arguments.maps, views=USED)}
        for name, offset in (("acquired, flash stated", tuple(truth["light_offset"])), ("acquired, flash found", "auto")):
            ways[name] = svbrdf_gcn.acquire([paths[i] for i in USED], depth=truth["depth"], light_offset=offset, size=arguments.maps).capture
        for name, capture in ways.items():
            material = svbrdf_gcn.fit_material(capture, seed=0)
            errors = [f"{value:.4f}" for value in map_errors(material)]
            print(f"| {name} | " + " | ".join(errors) + f" | {unseen(material, perfect):.4f} |", flush=True)


def map_errors(material):
    """RMSE of the maps against those that were path-traced."""
    side = material.diffuse_albedo.shape[0]
    # The window is one repeat of the pattern; the patch is its middle.
    fine = sample_material.tiles(25 * side // 4)
    cut = (25 * side // 4 - 6 * side) // 2

    def true(values):
        middle = values[cut : cut + 6 * side, cut : cut + 6 * side]
        return middle.reshape(side, 6, side, 6, -1).mean((1, 3))

    pairs = [(material.diffuse_albedo, fine.diffuse_albedo), (material.specular_albedo, fine.specular_albedo)]
    pairs += [(np.atleast_3d(material.roughness), fine.roughness), (material.normal, fine.normal)]
    return [sample_check.rmse(found, true(values)) for found, values in pairs]


def unseen(material, capture):
    """RMSE of the views that no fit used, in gamma 2.2."""
    views = [i for i in range(len(capture.photos)) if i not in USED]
    rendered = [material.render(capture.camera_positions[i], capture.light_positions[i], capture.light_intensity[i]) for i in views]
    return float(np.mean([sample_check.rmse(sample_check.gamma(one), sample_check.gamma(capture.photos[i])) for one, i in zip(rendered, views)]))


def twelve_megapixels(folder, page, binary):
    """Time and memory of nine large photos: small ones, enlarged, with noise of their own."""
    size = tuple(side // ENLARGED for side in MEGAPIXELS_12)
    scene = make_photos.Scene(page, 12.0, make_photos.Lens(), depth=0.5)
    paths = []
    for i, shot in enumerate(make_photos.around(9, size=size)):
        small = make_photos.photograph(scene, shot, i, samples=2)
        spec = oiio.ImageSpec(size[0], size[1], 3, "uint8")
        buffer = oiio.ImageBuf(spec)
        buffer.set_pixels(oiio.ROI(0, size[0], 0, size[1], 0, 1, 0, 3), small)
        large = oiio.ImageBufAlgo.resize(buffer, roi=oiio.ROI(0, MEGAPIXELS_12[0], 0, MEGAPIXELS_12[1], 0, 1, 0, 3)).get_pixels("float") * 255
        noise = np.random.default_rng(i).standard_normal(large.shape, np.float32)
        paths.append(folder / f"large{i}.jpg")
        make_phone.write_jpeg(paths[-1], np.clip(np.round(large + 2 * noise), 0, 255).astype(np.uint8), exposure=shot.exposure)
    begun, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    program = [binary] if binary else [sys.executable, "-m", "svbrdf_gcn"]
    subprocess.run([*program, "acquire", *paths, "-o", folder / "large", "--depth", "0.5mm", "--quiet"], check=True)
    seconds, used = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"\nnine photos of {np.prod(MEGAPIXELS_12) / 1e6:.0f} megapixels: {seconds:.1f} s on {os.cpu_count()} cores, {used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime:.1f} s of processors, peak memory {used.ru_maxrss / 1e6:.2f} GB")


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--size", type=int, nargs=2, default=(1500, 1000))
    parser.add_argument("--samples", type=int, default=2, help="points along a side of a pixel")
    parser.add_argument("--rows", type=int, nargs="*", help="only these of the first table, counted from 0")
    parser.add_argument("--maps", type=int, default=128, help="pixels along a side of fitted maps")
    parser.add_argument("--traced", help="folder with photos and linear as make_phone.py writes them, instead of path-tracing them")
    parser.add_argument("--blender", help="a Python that has bpy")
    parser.add_argument("--binary", help="the command line whose time is taken; the Python package's if not given")
    parser.add_argument("--only", nargs="*", choices=("table", "maps", "large"), default=("table", "maps", "large"))
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        arguments.pdf = folder / "sheet.pdf"
        subprocess.run([sys.executable, "-m", "svbrdf_gcn", "sheet", "-o", arguments.pdf], check=True)
        page = make_photos.page(arguments.pdf)
        # Of all programs that are waited for, the largest counts: that of the large photos comes first.
        if "large" in arguments.only:
            twelve_megapixels(folder, page, arguments.binary)
        if "table" in arguments.only:
            table(folder, page, arguments)
        if "maps" in arguments.only:
            traced(arguments)


if __name__ == "__main__":
    main()
