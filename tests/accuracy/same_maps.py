#!/usr/bin/env python3
"""Whether two builds of the command line fit the same maps, to the bit: same_maps.py OLD NEW [CAPTURE]

For changes that must not change a result. Draft and balanced, one, four and seven photos of the capture (samples/tiles), with the default
weights and without a network, two threads.
"""

import itertools
import pathlib
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]


def fit(binary, capture, views, arguments, folder):
    """The maps that a binary fits: the content of each file, by its name."""
    command = [binary, "fit", capture, "--views", ",".join(map(str, range(views))), "-o", folder, "--threads", "2", "--format", "exr", "-q", *arguments]
    subprocess.run(command, check=True)
    return {path.name: path.read_bytes() for path in sorted(pathlib.Path(folder).glob("*.exr"))}


def main():
    if len(sys.argv) not in (3, 4):
        sys.exit(__doc__)
    old, new = (str(pathlib.Path(path).resolve()) for path in sys.argv[1:3])
    capture = sys.argv[3] if len(sys.argv) == 4 else str(ROOT / "samples" / "tiles")
    weights = str(ROOT / "core" / "weights" / "default.safetensors")
    ways = {"network": ["--weights", weights], "direct": ["--method", "direct"]}
    differing = 0
    for (name, arguments), preset, views in itertools.product(ways.items(), ("draft", "balanced"), (1, 4, 7)):
        with tempfile.TemporaryDirectory() as folder:
            maps = [fit(binary, capture, views, [*arguments, "--preset", preset], f"{folder}/{i}") for i, binary in enumerate((old, new))]
        unequal = [path for path in maps[0] if maps[0][path] != maps[1].get(path)]
        differing += bool(unequal or len(maps[0]) != len(maps[1]) or not maps[0])
        print(f"{name} {preset} {views} photos: {len(maps[0])} files, {'equal' if not unequal else 'differing: ' + ', '.join(unequal)}", flush=True)
    sys.exit(differing > 0)


if __name__ == "__main__":
    main()
