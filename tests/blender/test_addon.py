"""The extension in the real Blender: installed, used through its operators, its pictures compared."""

import math
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from conftest import MODULE, ROOT


def run(**keywords):
    return bpy.ops.svbrdf_gcn.fit_material("EXEC_DEFAULT", **keywords)


def fitted(scene):
    """The active object's node group."""
    from bl_ext.user_default.svbrdf_gcn import material

    return material.fitted_group(bpy.context.view_layer.objects.active.active_material)


def maps_of(tree):
    from bl_ext.user_default.svbrdf_gcn import material

    return material.read_back(tree)


def expected(**changes):
    """The same fit through Python."""
    import svbrdf_gcn

    capture = svbrdf_gcn.Capture.open(ROOT / "samples" / "tiles", size=24, views=[0, 1, 2, 3])
    return svbrdf_gcn.fit_material(capture, **{"preset": "draft", "threads": 2, **changes})


def test_blenders_own_tool_accepts_the_package(addon_zip):
    tool = Path(bpy.utils.resource_path("LOCAL")) / "scripts/addons_core/bl_pkg/cli/blender_ext.py"
    checked = subprocess.run([sys.executable, tool, "validate", addon_zip], capture_output=True, text=True)
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_the_operator_gives_what_python_gives(scene):
    assert run() == {"FINISHED"}
    tree = fitted(scene)
    got, want = maps_of(tree), expected().leveled()
    for name in ("diffuse_albedo", "specular_albedo", "roughness"):
        np.testing.assert_array_equal(getattr(got, name), getattr(want, name), err_msg=name)
    # Stored as (n + 1) / 2 and made unit again: a rounding or two.
    np.testing.assert_allclose(got.normal, want.normal, atol=4e-7)
    assert (got.patch_size, got.unit) == (want.patch_size, want.unit)
    assert bpy.context.view_layer.objects.active.active_material.name == "tiles"
    images = {node.name: node.image for node in tree.nodes if node.type == "TEX_IMAGE"}
    assert set(images) == {"diffuse_albedo", "specular_albedo", "roughness", "normal"}
    assert all(image.packed_file and image.is_float for image in images.values())
    assert images["normal"].colorspace_settings.name == images["roughness"].colorspace_settings.name == "Non-Color"
    assert images["diffuse_albedo"].colorspace_settings.name == "Linear Rec.709"
    principled = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    linked = {socket.name for socket in principled.inputs if socket.is_linked}
    assert linked == {"Base Color", "Specular IOR Level", "Specular Tint", "Roughness", "Normal"}
    settings = scene.svbrdf_gcn
    assert not settings.running and settings.status.endswith(("good", "usable", "poor")) and "Principled" in settings.remarks


def test_it_survives_saving_and_loading(scene, tmp_path):
    assert run() == {"FINISHED"}
    before = maps_of(fitted(scene))
    path = str(tmp_path / "file.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    after = maps_of(fitted(bpy.context.scene))
    np.testing.assert_array_equal(before.diffuse_albedo, after.diffuse_albedo)
    np.testing.assert_array_equal(before.roughness, after.roughness)


def test_images_of_the_file_give_what_the_folder_gives(scene):
    import svbrdf_gcn

    capture = svbrdf_gcn.Capture.open(ROOT / "samples" / "tiles", views=[0, 1, 2, 3])
    settings = scene.svbrdf_gcn
    settings.source, settings.views, settings.collocated = "IMAGES", "", False
    settings.patch_size = capture.patch_size
    settings.light_intensity = capture.light_intensity[0]
    for view in range(4):
        photo = settings.photos.add()
        photo.image = bpy.data.images.load(str(ROOT / "samples" / "tiles" / f"{view:02}.png"))
        photo.camera_position, photo.light_position = capture.camera_positions[view], capture.light_positions[view]
    assert run() == {"FINISHED"}
    got, want = maps_of(fitted(scene)), expected()
    # Blender keeps positions in single precision; a fit of 100 steps carries that along.
    np.testing.assert_allclose(got.diffuse_albedo, want.diffuse_albedo, atol=2e-3)
    np.testing.assert_allclose(got.roughness, want.roughness, atol=2e-3)


def choose(count):
    phone = ROOT / "samples" / "phone"
    files = [{"name": f"{i + 1}.jpg"} for i in range(count)]
    assert bpy.ops.svbrdf_gcn.choose_photos("EXEC_DEFAULT", directory=str(phone), files=files) == {"FINISHED"}
    bpy.context.scene.svbrdf_gcn.source, bpy.context.scene.svbrdf_gcn.views = "FILES", ""
    return [phone / f"{i + 1}.jpg" for i in range(count)]


def test_photos_of_a_sheet_give_what_python_gives(scene, operators):
    import svbrdf_gcn

    photos = choose(3)
    settings = scene.svbrdf_gcn
    settings.depth, settings.light_offset = 1, (14, 4)
    modal = Modal(operators, bpy.context)
    seen = set()
    while (state := modal.send("TIMER")) == {"PASS_THROUGH"}:
        seen.add(settings.status.split(" ")[0])
        time.sleep(0.002)
    assert state == {"FINISHED"}, modal.reports
    assert "acquire" in seen, seen
    capture = svbrdf_gcn.acquire(photos, depth=1, light_offset=(14, 4), size=24).capture
    want = svbrdf_gcn.fit_material(capture, preset="draft", threads=2)
    got = maps_of(fitted(scene))
    # Blender keeps the paper's albedo in single precision.
    np.testing.assert_allclose(got.diffuse_albedo, want.diffuse_albedo, atol=1e-3)
    assert (got.patch_size, got.unit) == (96, "mm")
    assert bpy.context.view_layer.objects.active.active_material.name == "phone"


def test_the_making_of_a_capture_is_stopped(scene, operators):
    choose(5)
    modal = Modal(operators, bpy.context)
    assert modal.send("ESC") == {"PASS_THROUGH"}
    assert modal.until_done() == {"CANCELLED"} and modal.reports[-1] == ("INFO", "Fit cancelled")
    settings = scene.svbrdf_gcn
    settings.reference = "FRAME"
    with pytest.raises(RuntimeError, match="0 of the sheet's 16 tags"):
        run()
    settings.views = "0"
    with pytest.raises(RuntimeError, match="views: is for captures"):
        run()


# Of the window in the sample's first photos: x and y from the upper left on clockwise.
CORNERS = [[(517, 311), (947, 285), (973, 718), (538, 743)], [(555, 285), (974, 304), (948, 734), (571, 669)]]


class Editor:
    """An image editor of 600 x 400 pixels at (100, 50) that shows the picture whole, and the operator in it."""

    WIDTH, HEIGHT = 600, 400

    def __init__(self, corners):
        self.cls = corners.SVBRDF_GCN_OT_pick_corners
        view = SimpleNamespace(region_to_view=lambda x, y: (x / self.WIDTH, y / self.HEIGHT))
        window = SimpleNamespace(type="WINDOW", x=100, y=50, width=self.WIDTH, height=self.HEIGHT, view2d=view)
        self.said, self.reports = [], []
        area = SimpleNamespace(type="IMAGE_EDITOR", regions=[SimpleNamespace(type="HEADER", x=100, y=450, width=600, height=26), window], header_text_set=self.said.append, tag_redraw=lambda: None)
        self.context = SimpleNamespace(
            scene=bpy.context.scene,
            area=area,
            space_data=SimpleNamespace(image=None, show_region_ui=True),
            window_manager=SimpleNamespace(modal_handler_add=lambda operator: None),
        )

    def report(self, kind, text):
        self.reports.append((min(kind), text))

    def __getattr__(self, name):
        """The operator's other methods."""
        return lambda *arguments: getattr(self.cls, name)(self, *arguments)

    def invoke(self):
        return self.cls.invoke(self, self.context, None)

    def click(self, u, v):
        """At a share of the picture's width from the left and of its height from the top."""
        return self.send("LEFTMOUSE", round(u * self.WIDTH, 3), round((1 - v) * self.HEIGHT, 3))

    def send(self, kind, x=0, y=0, value="PRESS"):
        return self.cls.modal(self, self.context, SimpleNamespace(type=kind, value=value, mouse_x=100 + x, mouse_y=50 + y))


@pytest.fixture
def corners(addon, monkeypatch):
    from bl_ext.user_default.svbrdf_gcn import corners

    # Needs a window.
    monkeypatch.setattr(corners, "show_whole", lambda area, region: None)
    return corners


def test_corners_are_clicked(scene, corners):
    choose(2)
    before = len(bpy.data.images)
    editor = Editor(corners)
    assert editor.invoke() == {"RUNNING_MODAL"}
    assert editor.context.space_data.image.name == "1.jpg" and "1.jpg (1 of 2): click the upper left" in editor.said[-1]
    assert editor.send("WHEELUPMOUSE") == {"PASS_THROUGH"} and editor.send("LEFTMOUSE", -30, 10) == {"PASS_THROUGH"}
    editor.click(0.9, 0.9)
    assert "upper right" in editor.said[-1]
    editor.send("BACK_SPACE")
    assert "upper left" in editor.said[-1]
    for photo in CORNERS:
        for x, y in photo:
            state = editor.click(x / 1500, y / 1000)
    assert state == {"FINISHED"} and editor.said[-1] is None
    assert editor.context.space_data == SimpleNamespace(image=None, show_region_ui=True)
    files = scene.svbrdf_gcn.photo_files
    np.testing.assert_allclose([np.reshape(file.corners, (4, 2)) for file in files], CORNERS, atol=0.01)
    assert len(bpy.data.images) == before, "what was shown is gone"
    # Again, and left after the first photo.
    editor = Editor(corners)
    editor.invoke()
    for x, y in [(10, 10), (90, 10), (90, 90), (10, 90)]:
        editor.click(x / 1500, y / 1000)
    editor.click(0.5, 0.5)
    assert editor.send("ESC") == {"CANCELLED"} and len(bpy.data.images) == before
    assert list(files[0].corners) == [10, 10, 90, 10, 90, 90, 10, 90]
    np.testing.assert_allclose(np.reshape(files[1].corners, (4, 2)), CORNERS[1], atol=0.01)
    # An undo takes the picture away.
    editor = Editor(corners)
    editor.invoke()
    bpy.data.images.remove(editor.photo.image)
    assert editor.click(0.5, 0.5) == {"CANCELLED"} and editor.said[-1] is None


def test_a_photo_is_shown_as_it_is(scene, corners, tmp_path):
    photo = corners.Photo(ROOT / "samples" / "phone" / "1.jpg")
    own = bpy.data.images.load(str(ROOT / "samples" / "phone" / "1.jpg"))
    assert tuple(photo.image.size) == tuple(own.size) == photo.size == (1500, 1000)
    shown, loaded = (np.array(image.pixels[:]).reshape(1000, 1500, 4) for image in (photo.image, own))
    # Two decoders of JPEG.
    assert np.abs(shown - loaded).mean() < 2 / 255
    assert photo.pixel(0, 1) == (0, 0) and photo.pixel(*photo.place(40, 30)) == pytest.approx((40, 30))
    # 2500 x 1251, shown at half the size: half a pixel below is not shown.
    large = bpy.data.images.new("large", 2500, 1251)
    large.filepath_raw, large.file_format = str(tmp_path / "large.png"), "PNG"
    large.save()
    photo = corners.Photo(tmp_path / "large.png")
    assert tuple(photo.image.size) == (1250, 625) and photo.size == (2500, 1251)
    assert photo.pixel(1, 0) == (2500, 1250) and photo.pixel(0.5, 1) == (1250, 0)


def test_photos_with_corners_give_what_python_gives(scene, corners):
    import svbrdf_gcn

    photos = choose(2)
    settings = scene.svbrdf_gcn
    settings.reference, settings.patch_width, settings.light_offset = "CORNERS", 96, (14, 4)
    with pytest.raises(RuntimeError, match="corners: expected four for every photo, got none for 1.jpg, 2.jpg; press Pick Corners"):
        run()
    for file, known in zip(settings.photo_files, CORNERS):
        file.corners = np.ravel(known)
    assert run() == {"FINISHED"}
    capture = svbrdf_gcn.acquire(photos, corners=CORNERS, patch_width=96, light_offset=(14, 4), size=24).capture
    want = svbrdf_gcn.fit_material(capture, preset="draft", threads=2)
    np.testing.assert_allclose(maps_of(fitted(scene)).diffuse_albedo, want.diffuse_albedo, atol=1e-3)


def test_one_photo_needs_no_sheet(scene):
    choose(1)
    assert run() == {"FINISHED"}
    assert fitted(scene) is not None and bpy.context.view_layer.objects.active.active_material.name == "1"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"source": "FILES"}, "photos: expected photos of a printed sheet"),
        ({"folder": ""}, "folder: expected"),
        ({"folder": "/nowhere/at/all"}, "/nowhere/at/all"),
        ({"views": "0,x"}, "views: expected"),
        ({"views": "77"}, "77"),
        ({"weights": "/nowhere.safetensors"}, "/nowhere.safetensors"),
        ({"source": "IMAGES"}, "photos: expected"),
    ],
)
def test_what_is_wrong_is_said(scene, change, message):
    for name, value in change.items():
        setattr(scene.svbrdf_gcn, name, value)
    before = len(bpy.data.materials), len(bpy.data.images), len(bpy.data.node_groups)
    with pytest.raises(RuntimeError, match=message):
        run()
    assert (len(bpy.data.materials), len(bpy.data.images), len(bpy.data.node_groups)) == before
    assert not scene.svbrdf_gcn.running
    # And the next one runs.
    for name in change:
        scene.svbrdf_gcn.property_unset(name)
    scene.svbrdf_gcn.folder = str(ROOT / "samples" / "tiles")
    scene.svbrdf_gcn.views = "0"
    assert run() == {"FINISHED"}


class Modal:
    """The modal operator's methods with a made-up self: Blender sends no timer events without a window."""

    def __init__(self, operators, context):
        self.cls = operators.SVBRDF_GCN_OT_fit_material
        self.session = operators.Session(context)
        self.timer = None
        self.reports = []
        self.context = SimpleNamespace(
            view_layer=context.view_layer,
            scene=context.scene,
            window_manager=SimpleNamespace(event_timer_remove=lambda timer: self.reports.append(("TIMER", "removed")), windows=()),
        )

    def report(self, kind, text):
        self.reports.append((min(kind), text))

    def take_in(self, context, session):
        return self.cls.take_in(self, context, session)

    def finish(self, context):
        return self.cls.finish(self, context)

    def send(self, kind):
        return self.cls.modal(self, self.context, SimpleNamespace(type=kind))

    def until_done(self, seconds=60):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            state = self.send("TIMER")
            if state != {"PASS_THROUGH"}:
                return state
            time.sleep(0.01)
        raise AssertionError("the job did not end")


@pytest.fixture
def operators(addon):
    from bl_ext.user_default.svbrdf_gcn import operators

    return operators


def test_the_modal_loop_shows_progress_and_ends(scene, operators):
    scene.svbrdf_gcn.direct_steps = 500
    modal = Modal(operators, bpy.context)
    assert scene.svbrdf_gcn.running and not bpy.ops.svbrdf_gcn.fit_material.poll()
    assert modal.send("MOUSEMOVE") == {"PASS_THROUGH"}
    seen = set()
    while (state := modal.send("TIMER")) == {"PASS_THROUGH"}:
        seen.add(scene.svbrdf_gcn.status)
        time.sleep(0.002)
    assert state == {"FINISHED"}
    assert any(status.startswith("direct ") and "loss" in status for status in seen), seen
    assert modal.reports[0] == ("TIMER", "removed") and modal.reports[-1] == ("INFO", "Fitted tiles")
    np.testing.assert_array_equal(maps_of(fitted(scene)).roughness, expected(direct_steps=500).roughness)


def test_escape_stops_it_and_another_fit_follows(scene, operators):
    scene.svbrdf_gcn.direct_steps = 1_000_000
    modal = Modal(operators, bpy.context)
    while not scene.svbrdf_gcn.status.startswith("direct"):
        assert modal.send("TIMER") == {"PASS_THROUGH"}
        time.sleep(0.01)
    assert modal.send("ESC") == {"PASS_THROUGH"}
    begun = time.monotonic()
    assert modal.until_done() == {"CANCELLED"}
    assert time.monotonic() - begun < 5
    assert modal.reports[-1] == ("INFO", "Fit cancelled") and not scene.svbrdf_gcn.running
    assert len(bpy.data.materials) == 0
    scene.svbrdf_gcn.direct_steps = 5
    assert Modal(operators, bpy.context).until_done() == {"FINISHED"}


def test_two_fits_at_once_are_refused(scene, operators):
    modal = Modal(operators, bpy.context)
    with pytest.raises(RuntimeError, match="running already"):
        operators.Session(bpy.context)
    modal.send("ESC")
    modal.until_done()


@pytest.mark.parametrize("target", ["maps", "materialx", "gltf", "principled", "unreal"])
def test_export(scene, tmp_path, target):
    # The second one is called tiles.001.
    assert run() == run() == {"FINISHED"}
    assert bpy.ops.svbrdf_gcn.export_material("EXEC_DEFAULT", directory=str(tmp_path), to=target) == {"FINISHED"}
    assert len(list(tmp_path.iterdir())) > 3


def test_tiles_make_a_plane_unless_not_asked_for(scene):
    from bl_ext.user_default.svbrdf_gcn import material

    tilts = []
    for level in (False, True):
        scene.svbrdf_gcn.level = level
        assert run() == {"FINISHED"}
        active = bpy.context.view_layer.objects.active.active_material
        tilts.append(material.read_back(material.fitted_group(active)).tilt)
    leaning, level = (max(map(abs, tilt)) for tilt in tilts)
    assert level < 1e-3 < leaning


def test_export_needs_a_fitted_material(scene):
    assert not bpy.ops.svbrdf_gcn.export_material.poll()


def test_disabled_and_enabled_again(scene):
    assert bpy.ops.preferences.addon_disable(module=MODULE) == {"FINISHED"}
    assert not hasattr(bpy.types.Scene, "svbrdf_gcn")
    assert bpy.ops.preferences.addon_enable(module=MODULE) == {"FINISHED"}
    assert hasattr(bpy.types.Scene, "svbrdf_gcn")


# Cycles against our renderer.

CAMERA, LIGHT, INTENSITY = (1.5, -2.0, 15.0), (-1.0, 2.5, 14.0), (640.0, 620.0, 590.0)


def cycles(surface, size, patch_size):
    """Linear radiance that Cycles sees on the patch from CAMERA, shape (size, size, 3), row 0 at the top: baked, so pixels are the map's."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.max_bounces = 16, 0
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.cycles.light_sampling_threshold = 0.0
    patch = bpy.context.view_layer.objects.active
    patch.scale = [patch_size / 2] * 3
    patch.active_material = surface
    patch.select_set(True)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    light = bpy.data.objects.new("light", bpy.data.lights.new("light", "POINT"))
    for thing, place in ((camera, CAMERA), (light, LIGHT)):
        scene.collection.objects.link(thing)
        thing.location = place
    scene.camera = camera
    peak = max(INTENSITY)
    light.data.energy = 4 * math.pi * peak
    light.data.color = [channel / peak for channel in INTENSITY]
    light.data.shadow_soft_size = 0.0
    light.data.use_soft_falloff = False
    target = bpy.data.images.new("bake", size, size, float_buffer=True, alpha=False)
    target.colorspace_settings.name = "Non-Color"
    node = surface.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = target
    surface.node_tree.nodes.active = node
    scene.render.bake.view_from = "ACTIVE_CAMERA"
    scene.render.bake.margin = 0
    assert bpy.ops.object.bake(type="COMBINED") == {"FINISHED"}
    pixels = np.empty(size * size * 4, np.float32)
    target.pixels.foreach_get(pixels)
    return pixels.reshape(size, size, 4)[::-1, :, :3]


def compare(scene, material):
    """Relative difference of Cycles and our renderer, per pixel: (Cycles - ours) / ours, mean over channels."""
    from bl_ext.user_default.svbrdf_gcn import material as nodes

    size = material.width
    surface = nodes.build(material, "test")
    # A baked pixel collects from all over its square: without this it would see its neighbours.
    for node in nodes.fitted_group(surface).nodes:
        if node.type == "TEX_IMAGE":
            node.interpolation = "Closest"
    got = cycles(surface, size, material.patch_size)
    want = material.render(camera=CAMERA, light=LIGHT, light_intensity=INTENSITY)
    return (got / want - 1).mean(-1)


def uniform(size=32, tilt=(0.0, 0.0), diffuse=(0.5, 0.3, 0.2), specular=(0.0, 0.0, 0.0), roughness=0.5, **more):
    import svbrdf_gcn

    def plane(values):
        return np.broadcast_to(np.float32(values), (size, size, len(values)))

    normal = np.array([*tilt, 1.0])
    return svbrdf_gcn.Material(
        diffuse_albedo=plane(diffuse),
        specular_albedo=plane(specular),
        roughness=np.full((size, size), roughness, np.float32),
        normal=plane(normal / np.linalg.norm(normal)),
        patch_size=10.0,
        **more,
    )


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.3, 0.0), (0.0, 0.3)])
def test_a_lambertian_material_looks_the_same_in_cycles(scene, tilt):
    """A tilt to +x and to +y, because a flipped axis would go unseen on a flat patch. Measured: 0.4 %, the noise of the bake."""
    assert np.abs(compare(scene, uniform(tilt=tilt))).max() < 0.02


# The difference that is left is the masking: ours is Schlick's approximation (k = alpha / 2), Cycles' is Smith's.
@pytest.mark.parametrize(
    ("surface", "most"),
    [
        # Metal: only the lobe. Measured: -0.1 to 2.5 %.
        ({"diffuse": (0, 0, 0), "specular": (0.9, 0.6, 0.3), "roughness": 0.45}, 0.04),
        # Dielectric. Both models dim the diffuse part by what the surface reflects. Measured: 0.5 %.
        ({"specular": (0.04, 0.04, 0.04), "roughness": 0.4}, 0.015),
        # A narrow lobe changes within a pixel. Measured: -1.7 to 3.5 %.
        ({"specular": (0.04, 0.04, 0.04), "roughness": 0.2}, 0.05),
        # Coloured, strong, with a diffuse part. Measured: -0.5 to 1.2 %.
        ({"specular": (0.6, 0.1, 0.02), "diffuse": (0.1, 0.3, 0.4), "roughness": 0.35}, 0.025),
        # Leaning by 28 degrees. Measured: -2.1 to 0.8 %.
        ({"specular": (0.04, 0.04, 0.04), "roughness": 0.4, "tilt": (0.5, 0.2)}, 0.035),
    ],
)
def test_a_glossy_material_in_cycles(scene, surface, most):
    assert np.abs(compare(scene, uniform(**surface))).max() < most


@pytest.mark.parametrize("roughness", [(0.5, 0.3), (0.3, 0.5)])
def test_an_anisotropic_material_in_cycles(scene, roughness):
    """Brushed at 40 degrees, either way round. Measured: -1.1 to 1.8 %."""
    import svbrdf_gcn

    plain = uniform(diffuse=(0.2, 0.2, 0.2), specular=(0.3, 0.3, 0.3))
    tangent = np.broadcast_to(np.float32([math.cos(0.7), math.sin(0.7), 0]), plain.normal.shape)
    brushed = svbrdf_gcn.Material(
        plain.diffuse_albedo,
        plain.specular_albedo,
        np.broadcast_to(np.float32(roughness), (*plain.normal.shape[:2], 2)),
        plain.normal,
        tangent,
        patch_size=plain.patch_size,
    )
    assert np.abs(compare(scene, brushed)).max() < 0.03


def test_the_fitted_sample_in_cycles(scene):
    """The fitted tiles: a pattern, so that a flipped or shifted texture would show."""
    assert run() == {"FINISHED"}
    difference = np.abs(compare(scene, maps_of(fitted(scene))))
    assert np.median(difference) < 0.02
    assert np.mean(difference < 0.1) > 0.97
