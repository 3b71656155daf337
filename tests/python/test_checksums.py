"""Checksums of weights files, as the importer, the trainer and the tool that adds them write them."""

import json
import shutil
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

import svbrdf_gcn

ROOT = Path(__file__).parents[2]
TOOL = ROOT / "python" / "svbrdf_gcn" / "training" / "checksums.py"
sys.path.insert(0, str(TOOL.parent))

import checksums  # noqa: E402

OLD = ROOT / "fuzz" / "seeds" / "weights" / "two_networks.safetensors"


def tool(*files):
    return subprocess.run([sys.executable, TOOL, *files], capture_output=True, text=True)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "weights.safetensors"
    shutil.copy(OLD, path)
    done = tool(path)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return path


def test_they_are_added_and_nothing_else_changes(file):
    (old, new) = (checksums.read(path) for path in (OLD, file))
    assert old[0] == new[0] and bytes(old[3]) == bytes(new[3])
    assert {key: new[1][key] for key in old[1]} == {**old[1], "version": "2"}
    sums = json.loads(new[1]["checksums"])
    name = next(iter(new[2]))
    assert sums["tensors"][name] == f"{zlib.crc32(new[2][name]):08x}" and set(sums["tensors"]) == set(new[2])
    assert "as they were written" in tool(file).stdout
    # The package takes both.
    assert svbrdf_gcn.Model.load(file).photos == svbrdf_gcn.Model.load(OLD).photos


def test_flipped_bits_are_found(file):
    content = file.read_bytes()
    for place in range(8, len(content), len(content) // 65):
        damaged = bytearray(content)
        damaged[place] ^= 1 << place % 8
        file.write_bytes(damaged)
        with pytest.raises(svbrdf_gcn.WeightsError):
            svbrdf_gcn.Model.load(file)
        done = tool(file)
        assert done.returncode == 1 and str(file) in done.stderr and done.stdout == "", place
        assert file.read_bytes() == damaged


def test_what_is_no_weights_file_is_named(tmp_path):
    for content in (b"", b"12345678{}", (1 << 60).to_bytes(8, "little") + b"{}"):
        (tmp_path / "no.safetensors").write_bytes(content)
        done = tool(tmp_path / "no.safetensors")
        assert done.returncode == 1 and "no.safetensors: not a safetensors file" in done.stderr, done.stderr
        assert done.stderr.count("\n") == 1
