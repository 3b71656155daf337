"""The fit of compare.py in Blender, through the extension's operators: fit_blender.py CAPTURE OUT FORMAT, with SVBRDF_GCN_WHEEL set to the built wheel."""

import os
import pathlib
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "python" / "tools"))

with tempfile.TemporaryDirectory() as home:
    os.environ["BLENDER_USER_RESOURCES"] = home

    import bpy

    import build_addon

    capture, out, image_format = sys.argv[1:]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    extension = build_addon.build(pathlib.Path(os.environ["SVBRDF_GCN_WHEEL"]), pathlib.Path(home))
    bpy.ops.extensions.package_install_files(filepath=str(extension), repo="user_default", enable_on_install=True)
    patch = bpy.data.objects.new("patch", bpy.data.meshes.new("patch"))
    bpy.context.scene.collection.objects.link(patch)
    bpy.context.view_layer.objects.active = patch

    settings = bpy.context.scene.svbrdf_gcn
    settings.folder, settings.size, settings.views = capture, 48, "6,0,2,4"
    settings.preset, settings.seed, settings.threads = "draft", 7, 2
    settings.level = False
    bpy.ops.svbrdf_gcn.fit_material()
    bpy.ops.svbrdf_gcn.export_material(directory=out, to="maps", format=image_format)
