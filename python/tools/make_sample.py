"""Makes the sample captures: photos of three procedural materials, path-traced by Blender's Cycles, and their true maps.

    python3.11 -m venv .venv && .venv/bin/pip install bpy==5.0.1 numpy
    .venv/bin/python python/tools/make_sample.py samples

writes `samples/tiles` (nine 256 x 256 photos of glazed tiles), `samples/brushed` (nine 128 x 128 photos of brushed steel) and `samples/lambert`
(five 64 x 64 photos of a matt surface of known albedo), each with `capture.json` and, in `truth/`, the maps that were rendered. Needs bpy 5.0.1, which is for Python 3.11, and no GPU.
The same versions give the same files; every seed and sample count is written below.

The scene's unit is the centimetre. Each photo is a perspective picture by a hand-held camera with a point light beside the lens; like a
real capture it is rectified to the patch: every output pixel averages the linear photo over the square that the pixel covers on the
sample. The pictures are stored as integers: radiance above 1 is lost, as in a camera.
"""

import argparse
import json
import math
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

import png
import sample_material
from sample_material import PATCH_SIZE

# Light: a white diffuse patch facing it at 15 cm has a radiance of about 0.9.
LIGHT_INTENSITY = (640.0, 620.0, 590.0)
# Brushed steel under it would be white where it shines.
DIM_LIGHT_INTENSITY = tuple(intensity / 4 for intensity in LIGHT_INTENSITY)
LIGHT_RADIUS = 0.05
# Cycles: samples per pixel of the perspective photo; a rectified pixel collects those of some fifty pixels.
SAMPLES = 4
SEED = 1
# Points per side and output pixel at which the perspective photo is read when it is rectified.
RECTIFY_POINTS = 8


@dataclass
class Pose:
    """Where the camera stood (cm), where the lens pointed on the sample (cm), how it was rolled, and where the light was."""

    camera: tuple
    aim: tuple
    roll_deg: float
    light_angle_deg: float
    light_offset: float = 1.2

    @property
    def light(self):
        angle = math.radians(self.light_angle_deg)
        x, y, z = self.camera
        offset = self.light_offset
        return (round(x + offset * math.cos(angle), 3), round(y + offset * math.sin(angle), 3), z)


# Distances are 2.5 to 3.8 half widths of the patch, lateral offsets up to 1.2. The last two are meant to be kept out of a fit.
TILE_POSES = [
    Pose((0.4, -0.3, 15.5), (0.1, 0.0), 4, 20),
    Pose((-4.2, 3.6, 14.2), (-0.2, 0.2), -12, 75),
    Pose((4.8, 2.9, 13.4), (0.2, 0.1), 9, 160),
    Pose((3.7, -4.6, 16.0), (0.2, -0.2), 21, 250),
    Pose((-5.2, -3.3, 14.8), (-0.3, 0.0), -7, 310),
    Pose((0.9, 5.7, 17.5), (0.0, 0.3), 15, 40),
    Pose((-5.9, 0.6, 12.9), (-0.3, 0.1), -18, 200),
    Pose((2.1, -1.9, 18.6), (0.0, -0.1), 3, 120),
    Pose((5.4, -0.8, 14.0), (0.3, 0.0), -5, 345),
]
LAMBERT_POSES = [
    Pose((0.0, 0.0, 15.0), (0.0, 0.0), 0, 0, 0.0),
    Pose((-4.0, 3.0, 14.0), (0.0, 0.0), 10, 90),
    Pose((4.5, 2.0, 15.5), (0.0, 0.0), -15, 180, 3.0),
    Pose((2.0, -5.0, 18.0), (0.0, 0.0), 25, 270),
    Pose((-5.5, -2.0, 16.0), (0.0, 0.0), -5, 45, 5.0),
]


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="folder that receives tiles/, brushed/ and lambert/")
    parser.add_argument("--only", nargs="*", choices=("tiles", "brushed", "lambert"), default=("tiles", "brushed", "lambert"))
    options = parser.parse_args()
    folder, started = options.folder, time.perf_counter()
    if "tiles" in options.only:
        make_capture(folder / "tiles", sample_material.tiles(256), TILE_POSES, LIGHT_INTENSITY, "srgb", np.uint8, frame=2048)
    if "brushed" in options.only:
        make_capture(folder / "brushed", sample_material.brushed(128), TILE_POSES, DIM_LIGHT_INTENSITY, "srgb", np.uint8, frame=1024)
    if "lambert" in options.only:
        make_capture(folder / "lambert", sample_material.lambertian(64), LAMBERT_POSES, LIGHT_INTENSITY, "linear", np.uint16, frame=512)
    print(f"done in {time.perf_counter() - started:.0f} s")


def make_capture(folder, maps, poses, light_intensity, transfer, dtype, frame):
    """Render, rectify and write one capture with its true maps; `frame` is the side of the perspective photos in pixels."""
    (folder / "truth").mkdir(parents=True, exist_ok=True)
    write_truth(folder / "truth", maps)
    build_scene(maps, light_intensity, frame)
    size = maps.normal.shape[0]
    photos = []
    for index, pose in enumerate(poses):
        started = time.perf_counter()
        to_world = camera_frame(pose)
        half_tangent = field_of_view(pose.camera, to_world)
        photo = take_photo(pose, to_world, half_tangent)
        linear = rectify(photo, pose.camera, to_world, half_tangent, size)
        name = f"{index:02}.png"
        png.write(folder / name, quantised(encode(linear, transfer), dtype))
        photos.append({"file": name, "camera": list(pose.camera), "light": list(pose.light)})
        print(f"{folder / name}: {time.perf_counter() - started:.1f} s, {100 * (linear >= 1).any(-1).mean():.2f} % of pixels saturated")
    capture = {
        "format": "svbrdf-gcn capture",
        "version": 1,
        "unit": "cm",
        "patch_size": PATCH_SIZE,
        "transfer": transfer,
        "light_intensity": list(light_intensity),
        "white_level": None,
        "notes": f"Path-traced with Blender {bpy.app.version_string}, Cycles, by python/tools/make_sample.py; the true maps are in truth/.",
    }
    write_json(folder / "capture.json", capture, "photos", photos)


def write_json(path, head, name, members):
    """Write the object `head` with a last field `name`, a list or an object whose members take a line each."""
    lines = [f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in head.items()]
    if isinstance(members, dict):
        entries, (opening, closing) = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in members.items()], "{}"
    else:
        entries, (opening, closing) = [json.dumps(value) for value in members], "[]"
    body = ",\n".join(f"    {entry}" for entry in entries)
    lines.append(f"  {json.dumps(name)}: {opening}\n{body}\n  {closing}")
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n")


def write_truth(folder, maps):
    """The maps as a material folder of 16-bit files, all linear, normals as (n + 1) / 2 with +y up."""
    files = {
        "diffuse": maps.diffuse_albedo,
        "specular": maps.specular_albedo,
        "roughness": maps.roughness,
        "normal": (maps.normal + 1) / 2,
    }
    if maps.tangent is not None:
        # Files have one channel or three.
        files["roughness"] = np.concatenate([maps.roughness, 0 * maps.roughness[..., :1]], -1)
        files["tangent"] = (maps.tangent + 1) / 2
    lobe = "isotropic" if maps.tangent is None else "anisotropic"
    for name, values in files.items():
        png.write(folder / f"{name}.png", quantised(values, np.uint16))
    material = {"format": "svbrdf-gcn material", "version": 1, "patch_size": PATCH_SIZE, "unit": "cm", "lobe": lobe}
    write_json(folder / "material.json", material, "maps", {name: {"file": f"{name}.png", "transfer": "linear"} for name in files})


def direct_light_scene(samples, light_intensity, light_radius):
    """An empty scene with a camera and a point light; black surroundings, direct light only."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.image_settings.color_mode = "RGB"
    scene.render.use_compositing = scene.render.use_sequencer = False
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples, cycles.seed = samples, SEED
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.light_sampling_threshold = 0.0
    cycles.max_bounces = 0
    cycles.pixel_filter_type = "BOX"
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0

    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    light = bpy.data.objects.new("light", bpy.data.lights.new("light", "POINT"))
    scene.collection.objects.link(light)
    # Blender gives the power of a point light in W, spread over all directions: the intensity in W/sr is power / (4 pi).
    peak = max(light_intensity)
    light.data.energy = 4 * math.pi * peak
    light.data.color = [channel / peak for channel in light_intensity]
    light.data.shadow_soft_size = light_radius
    light.data.use_soft_falloff = False
    return scene


def build_scene(maps, light_intensity, frame):
    """A plane with the material under a camera and a light."""
    scene = direct_light_scene(SAMPLES, light_intensity, LIGHT_RADIUS)
    scene.render.resolution_x = scene.render.resolution_y = frame
    # The plane reaches beyond the patch, where the pattern repeats, so that photos show no edge.
    reach = 1.5 * PATCH_SIZE
    mesh = bpy.data.meshes.new("sample")
    corners = [(-reach, -reach), (reach, -reach), (reach, reach), (-reach, reach)]
    mesh.from_pydata([(x, y, 0.0) for x, y in corners], [], [(0, 1, 2, 3)])
    uv = mesh.uv_layers.new(name="UVMap")
    for loop, (x, y) in zip(uv.data, corners):
        loop.uv = (x / PATCH_SIZE + 0.5, y / PATCH_SIZE + 0.5)
    mesh.materials.append(principled_material(maps))
    scene.collection.objects.link(bpy.data.objects.new("sample", mesh))


def principled_material(maps):
    """Principled BSDF fed by the maps: no coat, sheen, transmission or multiple scattering, normals exactly as given."""
    material = bpy.data.materials.new("sample")
    material.use_nodes = True
    material.cycles.use_bump_map_correction = False
    nodes, links = material.node_tree.nodes, material.node_tree.links
    principled = nodes["Principled BSDF"]
    principled.distribution = "GGX"
    principled.inputs["IOR"].default_value = 1.5

    def texture(name, values):
        node = nodes.new("ShaderNodeTexImage")
        node.image = data_image(name, values)
        node.interpolation = "Closest"
        return node.outputs["Color"]

    links.new(texture("base color", maps.base_color), principled.inputs["Base Color"])
    links.new(texture("metallic", maps.metallic), principled.inputs["Metallic"])
    if maps.tangent is None:
        roughness = maps.roughness
    else:
        # Cycles: alpha is roughness^2 / aspect along its tangent and roughness^2 aspect across, aspect^2 = 1 - 0.9 anisotropic. It is wide along its tangent, so that is our bitangent.
        along, across = maps.roughness[..., :1], maps.roughness[..., 1:]
        roughness = np.sqrt(along * across)
        links.new(texture("anisotropic", (1 - (along / across) ** 2) / 0.9), principled.inputs["Anisotropic"])
        links.new(texture("tangent", np.cross(maps.normal, maps.tangent)), principled.inputs["Tangent"])
    links.new(texture("roughness", roughness), principled.inputs["Roughness"])
    # An index of 1.5 reflects 0.04 at level 0.5; the level scales it linearly.
    links.new(texture("specular level", maps.dielectric_f0 / 0.08), principled.inputs["Specular IOR Level"])
    normal_map = nodes.new("ShaderNodeNormalMap")
    normal_map.uv_map = "UVMap"
    links.new(texture("normal", (maps.normal + 1) / 2), normal_map.inputs["Color"])
    links.new(normal_map.outputs["Normal"], principled.inputs["Normal"])
    return material


def data_image(name, values):
    """A float image that Blender uses as it is; its rows go from the bottom up."""
    height, width, channels = values.shape
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = values[::-1]
    image = bpy.data.images.new(name, width, height, alpha=False, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set(rgba.ravel())
    image.update()
    return image


def camera_frame(pose):
    """Columns: the camera's right, up and backward axes in the world, float64."""
    backward = np.subtract(pose.camera, (*pose.aim, 0.0))
    backward /= np.linalg.norm(backward)
    right = np.cross([0.0, 1.0, 0.0], backward)
    right /= np.linalg.norm(right)
    up = np.cross(backward, right)
    roll = math.radians(pose.roll_deg)
    return np.stack(
        [math.cos(roll) * right + math.sin(roll) * up, math.cos(roll) * up - math.sin(roll) * right, backward], axis=1
    )


def field_of_view(camera, to_world):
    """Tangent of half the field of view that just shows the patch with a margin of 3 %."""
    half = PATCH_SIZE / 2
    corners = np.array([(x, y, 0.0) for x in (-half, half) for y in (-half, half)])
    x, y = project(corners, camera, to_world)
    return 1.03 * max(np.abs(x).max(), np.abs(y).max())


def project(points, camera, to_world):
    """Tangents of the angles to the right and up at which the camera sees world points, shape (..., 3)."""
    seen = (points - np.asarray(camera)) @ to_world
    return seen[..., 0] / -seen[..., 2], seen[..., 1] / -seen[..., 2]


def take_photo(pose, to_world, half_tangent):
    """The perspective photo from `pose.camera` under a light at `pose.light`, (H, W, 3) float32 linear radiance, row 0 at the top."""
    scene = bpy.context.scene
    camera, light = scene.camera, bpy.data.objects["light"]
    camera.data.sensor_fit = "HORIZONTAL"
    camera.data.angle = 2 * math.atan(half_tangent)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = to_world, pose.camera
    camera.matrix_world = Matrix(matrix.tolist())
    light.location = pose.light
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder) / "photo.exr")
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        image.colorspace_settings.name = "Non-Color"
        width, height = image.size
        rgba = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(rgba)
        bpy.data.images.remove(image)
    return rgba.reshape(height, width, 4)[::-1, :, :3]


def rectify(photo, camera, to_world, half_tangent, size):
    """The photo resampled to the patch: each of size x size pixels is the mean over its square on the sample, in linear light."""
    frame = photo.shape[0]
    across = ((np.arange(size * RECTIFY_POINTS) + 0.5) / (size * RECTIFY_POINTS) - 0.5) * PATCH_SIZE
    rows = []
    for strip in np.split(-across, size):
        points = np.stack([*np.meshgrid(across, strip), np.zeros((RECTIFY_POINTS, across.size))], -1)
        right, up = project(points, camera, to_world)
        # Continuous photo coordinates; the centre of pixel (i, j) is at (i + 0.5, j + 0.5).
        column, row = (right / half_tangent + 1) / 2 * frame, (1 - up / half_tangent) / 2 * frame
        values = bilinear(photo, row, column)
        rows.append(values.reshape(RECTIFY_POINTS, size, RECTIFY_POINTS, 3).mean((0, 2)))
    return np.stack(rows)


def bilinear(photo, row, column):
    row, column = row - 0.5, column - 0.5
    i, j = np.floor(row).astype(int), np.floor(column).astype(int)
    a, b = (row - i)[..., None], (column - j)[..., None]
    top = photo[i, j] * (1 - b) + photo[i, j + 1] * b
    bottom = photo[i + 1, j] * (1 - b) + photo[i + 1, j + 1] * b
    return top * (1 - a) + bottom * a


def encode(linear, transfer):
    """Stored values of linear ones: `linear`, or the curve of IEC 61966-2-1 for `srgb`."""
    linear = np.maximum(linear, 0)
    if transfer == "linear":
        return linear
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def quantised(values, dtype):
    """Integers of the whole range for values in [0, 1]; what is outside is cut off."""
    top = np.iinfo(dtype).max
    return np.round(np.clip(values, 0, 1) * top).astype(dtype)


if __name__ == "__main__":
    main()
