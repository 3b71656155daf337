"""Saves and exports that are killed, or whose system calls fail, at every call that changes the disk: what is left is all old or all new."""

import os
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest

from svbrdf_gcn import Material

# Calls of a Python that only starts are not among them.
CALLS = ("rename,renameat,renameat2", "write,pwrite64,writev", "fsync,fdatasync", "unlink,unlinkat")
SAVE = "import sys, svbrdf_gcn; svbrdf_gcn.Material.load(sys.argv[1]).save(sys.argv[2], format=sys.argv[3])"
EXPORT = "import sys, svbrdf_gcn; svbrdf_gcn.Material.load(sys.argv[1]).export(sys.argv[2], to=sys.argv[3])"
MOST = 40
EXIT_CANCELLED = 130


@pytest.fixture(scope="module")
def strace():
    path = shutil.which("strace")
    if path is None:
        pytest.skip("strace is not installed (tools/setup.sh does it)")
    tried = subprocess.run([path, "-f", "-o", os.devnull, "true"], capture_output=True, text=True, check=False)
    if tried.returncode != 0:
        pytest.skip(f"strace may not trace here: {tried.stderr.strip()}")
    return path


def material(seed):
    rng = np.random.default_rng(seed)
    normal = np.zeros((6, 6, 3)) + [0, 0, 1]
    return Material(rng.random((6, 6, 3)), rng.random((6, 6, 3)), rng.random((6, 6, 1)), normal, patch_size=1 + seed)


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def injections(strace, tmp_path, old, what, command):
    """Runs `command` on a copy of the folder `old` again and again, each time with another call that fails or kills, and yields what is left."""
    out, trace = tmp_path / "out", tmp_path / "trace"
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    for calls in CALLS:
        for when in range(1, MOST):
            shutil.rmtree(out, ignore_errors=True)
            shutil.copytree(old, out)
            options = ["-f", "-o", str(trace), "-e", f"trace={calls}", "-e", f"inject={calls}:{what}:when={when}"]
            done = subprocess.run([strace, *options, *command(out)], env=environment, capture_output=True, check=False)
            # What kills is not marked in the trace, and other signals by their arrival.
            if done.returncode != -signal.SIGKILL and not any(mark in trace.read_text() for mark in ("INJECTED", "--- SIGINT")):
                assert done.returncode == 0 and when > 1, f"{calls}: no call to fail: {done.stderr}"
                break
            yield f"{calls} {when}", out, done.returncode
        else:
            pytest.fail(f"{calls}: more than {MOST} calls")


@pytest.mark.parametrize("what", ["signal=SIGKILL", "error=EIO"])
def test_a_save_leaves_the_whole_old_or_the_whole_new_material(strace, tmp_path, what):
    old, new = tmp_path / "old", tmp_path / "new"
    material(1).save(old, format="exr")
    material(2).save(new, format="tiff")
    saved = {1: content(old), 2: content(new)}
    sizes = set()
    for where, out, code in injections(
        strace, tmp_path, old, what, lambda out: [sys.executable, "-c", SAVE, str(new), str(out), "tiff"]
    ):
        loaded = Material.load(out)
        assert loaded.warnings == [], where
        which = int(loaded.patch_size) - 1
        sizes.add(which)
        # Nothing is left of the dead run, but for an old file that could not be removed.
        left = content(out)
        if what == "error=EIO" and where.startswith("unlink") and code == 0:
            left = {name: left[name] for name in saved[which]}
        assert left == saved[which], f"{where}: {sorted(left)}"
    assert sizes == {1, 2}


def test_an_export_leaves_the_whole_old_or_the_whole_new_one(strace, tmp_path):
    maps, old = tmp_path / "maps", tmp_path / "old"
    material(2).save(maps)
    material(1).export(old, to="gltf")
    was = content(old)
    Material.load(maps).export(tmp_path / "new", to="gltf")
    for where, out, _ in injections(
        strace, tmp_path, old, "signal=SIGKILL", lambda out: [sys.executable, "-c", EXPORT, str(maps), str(out), "gltf"]
    ):
        left = content(out)
        if ".svbrdf-gcn-save.json" not in left:
            assert {name: left[name] for name in was} in (was, content(tmp_path / "new")), where
        # Whoever exports here next finishes what was begun, and clears away the rest.
        Material.load(maps).export(out, to="gltf")
        assert content(out) == content(tmp_path / "new"), where


def test_an_interrupted_export_is_given_up_or_completed(strace, tmp_path):
    maps, old, new = tmp_path / "maps", tmp_path / "old", tmp_path / "new"
    material(2).save(maps)
    material(1).export(old, to="gltf")
    Material.load(maps).export(new, to="gltf")
    was, will_be = content(old), content(new)
    codes = set()
    for where, out, code in injections(
        strace,
        tmp_path,
        old,
        "signal=SIGINT",
        lambda out: [sys.executable, "-m", "svbrdf_gcn", "export", str(maps), "--to", "gltf", "-o", str(out)],
    ):
        assert content(out) == {EXIT_CANCELLED: was, 0: will_be}[code], where
        codes.add(code)
    assert codes == {EXIT_CANCELLED, 0}
