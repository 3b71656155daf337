"""How near `acquire` comes, on photos of the printed page whose truth is known: the table of docs/capturing.md.

    .venv/bin/python python/tools/phone_proof.py [--size 3000 2000]

Photos are made by rays in numpy (`make_photos.py`), without EXIF data. Every row is the median and the largest error of its photos.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import svbrdf_gcn

sys.path.insert(0, str(Path(__file__).resolve().parent))

import make_photos  # noqa: E402
import png  # noqa: E402

# To the right and up of the lens, in mm.
BESIDE = (15.0, 8.0)
TONE = 0.035
ROOM = (0.25, 0.3, 0.35)


def rows(page, size):
    """Name, scene, shots and arguments of acquire."""
    plain = make_photos.Scene(page, 12.0, make_photos.Lens(), depth=0.5)
    beside = replace(plain, light_offset=BESIDE)
    nine, five = make_photos.around(9, size=size), make_photos.around(5, size=size)
    stated = {"depth": 0.5, "light_offset": BESIDE}
    yield "nine, flash 17 mm beside the lens, which is stated", beside, nine, stated
    yield "the same, where the flash is is found", beside, nine, {"depth": 0.5, "light_offset": "auto"}
    yield "the same, a telephone's tone curve", replace(beside, tone=TONE), nine, {"depth": 0.5, "light_offset": "auto"}
    equal = [replace(shot, exposure=1.0) for shot in nine]
    dark = replace(equal[3], flash=False)
    yield "the same, other light in the room, one photo without flash", replace(beside, tone=TONE, room=ROOM), equal, {**stated, "light_offset": "auto", "dark": dark}
    yield "five, flash at the lens", plain, five, {"depth": 0.5}
    yield "one, flash at the lens", plain, nine[:1], {"depth": 0.5}
    covered = page.copy()
    # The second tag along the top and the third down the right, in pixels of the page.
    for x, y in ((105 - 77 + 33.5, 15), (105 + 57, 15 + 67)):
        covered[int(12 * (y - 2)) : int(12 * (y + 22)), int(12 * (x - 2)) : int(12 * (x + 22))] = 0.3
    odd = [replace(shot) for shot in nine]
    odd[2].roll += np.pi
    odd[3].size = size[::-1]
    odd[4].blur = 12
    odd[5].exposure = 0.1
    yield "nine: two tags covered, one upside down, one upright, one blurred, one hardly exposed", replace(plain, page=covered), odd, {"depth": 0.5}


def measured(folder, scene, shots, arguments, seconds):
    arguments = dict(arguments)
    if "dark" in arguments:
        dark = folder / "dark.png"
        png.write(dark, make_photos.photograph(scene, arguments["dark"], 99))
        arguments["dark"] = dark
    paths = []
    for i, shot in enumerate(shots):
        paths.append(folder / f"{i}.png")
        png.write(paths[-1], make_photos.photograph(scene, shot, i))
    begun = time.perf_counter()
    acquisition = svbrdf_gcn.acquire(paths, size=512, **arguments)
    seconds.append(time.perf_counter() - begun)
    return acquisition, make_photos.compare(acquisition.capture, acquisition.report, scene, shots)


def figure(values, factor, unit, digits):
    return f"{factor * np.median(values):.{digits}f} ({factor * max(values):.{digits}f}) {unit}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--size", type=int, nargs=2, default=(3000, 2000))
    parser.add_argument("--rows", type=int, nargs="*", help="only these, counted from 0")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        subprocess.run([sys.executable, "-m", "svbrdf_gcn", "sheet", "-o", folder / "sheet.pdf"], check=True)
        page = make_photos.page(folder / "sheet.pdf")
        print("| photos | camera position, of the distance | corners at 512 x 512 | light, up to a common factor | albedo, RMS | flash, tone |\n|---|---|---|---|---|---|")
        seconds = []
        for i, (name, scene, shots, how) in enumerate(rows(page, tuple(arguments.size))):
            if arguments.rows and i not in arguments.rows:
                continue
            acquisition, errors = measured(folder, scene, shots, how, seconds)
            lens = acquisition.report["lenses"][0]
            cells = [
                figure(errors["position"], 100, "%", 2),
                figure(errors["corner"], 1, "pixels", 2),
                figure(errors["light"], 100, "%", 1),
                figure(errors["albedo"], 100, "%", 1),
                f"{np.round(lens['light_offset'], 1).tolist()}, {np.round(lens['tone'], 3).tolist()}",
            ]
            print(f"| {name} | " + " | ".join(cells) + " |", flush=True)
            for out in acquisition.report["left_out"]:
                print(f"  left out: {json.dumps(out)}")
        print(f"acquire took {max(seconds):.1f} s at most; peak memory of the process {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")


if __name__ == "__main__":
    main()
