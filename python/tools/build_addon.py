#!/usr/bin/env python3
"""Packs the Blender extension: the modules of python/blender, a manifest that names the version, and the wheel exactly as it was built.

    python python/tools/build_addon.py dist/svbrdf_gcn-0.1.0-cp311-abi3-linux_x86_64.whl -o dist

writes `dist/svbrdf_gcn_blender-0.1.0-linux_x64.zip`. Needs Python 3.11 and nothing else.
"""

import argparse
import sys
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "python" / "blender"

# Blender's names for the platforms of wheels, by what the wheel's platform tag holds.
PLATFORMS = {
    ("linux", "x86_64"): "linux-x64",
    ("macosx", "arm64"): "macos-arm64",
    ("macosx", "x86_64"): "macos-x64",
    ("win", "amd64"): "windows-x64",
    ("win", "arm64"): "windows-arm64",
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("wheel", type=Path)
    parser.add_argument("-o", "--out", type=Path, default=Path("dist"), help="folder that receives the extension")
    arguments = parser.parse_args()
    print(build(arguments.wheel, arguments.out))


def build(wheel, out):
    """Write the extension with `wheel` into the folder `out`; returns its path."""
    platform = platform_of(wheel)
    version = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["package"]["version"]
    if wheel.name.split("-")[1] != version:
        sys.exit(f"{wheel.name}: expected version {version}, got {wheel.name.split('-')[1]}")
    out.mkdir(parents=True, exist_ok=True)
    target = out / f"svbrdf_gcn_blender-{version}-{platform.replace('-', '_')}.zip"
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("blender_manifest.toml", manifest(version, wheel.name, platform))
        for path in sorted([*SOURCE.glob("*.py"), SOURCE / "LICENSE"]):
            archive.write(path, path.name)
        archive.write(wheel, f"wheels/{wheel.name}")
    return target


def platform_of(wheel):
    tag = wheel.stem.split("-")[-1].lower()
    for (system, machine), name in PLATFORMS.items():
        if system in tag and machine in tag:
            return name
    sys.exit(f"{wheel.name}: expected a wheel for one of {', '.join(PLATFORMS.values())}, got the platform tag {tag}")


def manifest(version, wheel, platform):
    """The manifest with what only a build knows, before its first table."""
    head, bracket, tables = (SOURCE / "blender_manifest.toml").read_text().partition("\n[")
    lines = [line for line in head.splitlines() if not line.startswith("#")]
    lines += [f'version = "{version}"', f'platforms = ["{platform}"]', f'wheels = ["./wheels/{wheel}"]', ""]
    return "\n".join(lines) + bracket + tables


if __name__ == "__main__":
    main()
