"""Estimated and measured peak memory of whole fits at large sizes, as a table for docs/performance.md: memory.py svbrdf-gcn [--sizes 1024,2048] [--photos 4].

The photos are those of samples/tiles, enlarged. Steps are few: memory does not depend on how many there are.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "python" / "tools"))

import png  # noqa: E402

TILES = ROOT / "samples" / "tiles"
USAGE = Path(__file__).with_name("usage.py")
# Rounds of the direct stage begin at 50 steps each.
STEPS = ["--direct-steps", "100", "--finish-steps", "1"]
ALLOWED = (1.0, 1.3)


def enlarged(folder, side, count):
    """A capture of `count` photos of `side` x `side` pixels."""
    capture = json.loads((TILES / "capture.json").read_text())
    capture["photos"] = [dict(photo) for photo in capture["photos"][:count]]
    for photo in capture["photos"]:
        pixels = png.read(TILES / photo["file"])
        factor = -(-side // pixels.shape[0])
        photo["file"] = f"{Path(photo['file']).stem}.png"
        png.write(folder / photo["file"], pixels.repeat(factor, 0).repeat(factor, 1)[:side, :side])
    (folder / "capture.json").write_text(json.dumps(capture))
    return folder


def measure(binary, side, count, method):
    """Estimated and measured bytes at the peak of a fit."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        capture = enlarged(folder, side, count)
        fit = [binary, "fit", capture, "-o", folder / "out", "--method", method, *STEPS, "--quiet"]
        subprocess.run([sys.executable, USAGE, folder / "usage.json", *map(str, fit)], check=True)
        usage = json.loads((folder / "usage.json").read_text())
        if usage["code"] != 0:
            raise SystemExit(f"{side} x {side}, {count} photos: exit code {usage['code']}")
        report = json.loads((folder / "out" / "material.json").read_text())["report"]
        return report["memory_estimate"], usage["memory"]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("binary")
    parser.add_argument("--sizes", default="1024,2048")
    parser.add_argument("--photos", type=int, default=4)
    arguments = parser.parse_args()
    print("| pixels | photos | method | estimate | peak | ratio |\n|---|---|---|---|---|---|")
    wrong = 0
    for side in map(int, arguments.sizes.split(",")):
        for method in ("network", "direct"):
            estimate, peak = measure(arguments.binary, side, arguments.photos, method)
            ratio = estimate / peak
            wrong += not ALLOWED[0] <= ratio <= ALLOWED[1]
            print(f"| {side} x {side} | {arguments.photos} | {method} | {estimate / 1e9:.2f} GB | {peak / 1e9:.2f} GB | {ratio:.2f} |", flush=True)
    if wrong:
        raise SystemExit(f"{wrong} estimates are not {ALLOWED[0]} to {ALLOWED[1]} times the peak")


if __name__ == "__main__":
    main()
