"""Installs the built extension into a Blender of its own (the `bpy` module) and enables it."""

import os
import sys
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# Must be set before bpy is imported: nothing of this user's Blender is read or changed.
_home = tempfile.TemporaryDirectory(prefix="svbrdf_gcn_blender_")
os.environ["BLENDER_USER_RESOURCES"] = _home.name
sys.path.insert(0, str(ROOT / "python" / "tools"))

import bpy  # noqa: E402

import build_addon  # noqa: E402

MODULE = "bl_ext.user_default.svbrdf_gcn"


@pytest.fixture(scope="session")
def addon_zip(tmp_path_factory):
    wheel = os.environ.get("SVBRDF_GCN_WHEEL")
    if not wheel:
        pytest.fail("SVBRDF_GCN_WHEEL: expected the path of a built wheel, got nothing (run this through `make blender-test`)")
    return build_addon.build(Path(wheel), tmp_path_factory.mktemp("addon"))


@pytest.fixture(scope="session")
def addon(addon_zip):
    """The enabled extension's module."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert bpy.ops.extensions.package_install_files(
        filepath=str(addon_zip), repo="user_default", enable_on_install=True
    ) == {"FINISHED"}
    assert MODULE in bpy.context.preferences.addons
    return sys.modules[MODULE]


@pytest.fixture
def scene(addon):
    """An empty file with a mesh object, the scene's settings pointed at the sample capture."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    if MODULE not in bpy.context.preferences.addons:
        bpy.ops.preferences.addon_enable(module=MODULE)
    mesh = bpy.data.meshes.new("patch")
    mesh.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
    layer = mesh.uv_layers.new(name="UVMap")
    for loop, uv in zip(layer.data, [(0, 0), (1, 0), (1, 1), (0, 1)]):
        loop.uv = uv
    patch = bpy.data.objects.new("patch", mesh)
    bpy.context.scene.collection.objects.link(patch)
    bpy.context.view_layer.objects.active = patch
    settings = bpy.context.scene.svbrdf_gcn
    settings.folder = str(ROOT / "samples" / "tiles")
    settings.size = 24
    settings.preset = "draft"
    settings.views = "0,1,2,3"
    settings.threads = 2
    return bpy.context.scene
