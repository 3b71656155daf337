"""Path-traces a printed sheet with glazed tiles in its window, by Blender's Cycles: linear pictures of a pinhole camera.

    python render_sheet.py JOB.json

`make_phone.py` writes the job and runs this with Blender's Python: `page` (a .npy of the diffuse albedo of the page), `pixels_per_mm`, `center` (the middle
of the window on the page, in mm), `window`, `depth`, `light_radius`, and `shots`: each with `axes` (right, down, forward), `camera`, `light`, `half_width` (the tangent of half
the field of view), `size` and `out` (a .npy of (H, W, 3) float32, for a light of intensity 1 in front of paper).
"""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np

import make_sample
import sample_material

SAMPLES = 6
# What paper and toner reflect at normal incidence, and how roughly.
PAPER_F0, PAPER_ROUGHNESS = 0.02, 0.65
MM_PER_TILE_UNIT = 10.0


def plane(name, corners, uvs, material):
    """Quadrilaterals, each of four corners with their texture coordinates."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([corner for quad in corners for corner in quad], [], [tuple(range(4 * i, 4 * i + 4)) for i in range(len(corners))])
    layer = mesh.uv_layers.new(name="UVMap")
    for loop, uv in zip(layer.data, [uv for quad in uvs for uv in quad]):
        loop.uv = uv
    mesh.materials.append(material)
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, mesh))


def paper_material(albedo):
    material = bpy.data.materials.new("paper")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    principled = nodes["Principled BSDF"]
    principled.distribution = "GGX"
    principled.inputs["Roughness"].default_value = PAPER_ROUGHNESS
    principled.inputs["Specular IOR Level"].default_value = PAPER_F0 / 0.08
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = make_sample.data_image("page", np.repeat(albedo, 3, -1))
    links.new(texture.outputs["Color"], principled.inputs["Base Color"])
    return material


def build(job):
    scene = make_sample.direct_light_scene(SAMPLES, (1.0, 1.0, 1.0), job["light_radius"])
    scene.camera.data.clip_end = 1e5
    albedo = np.load(job["page"])
    height, width = (side / job["pixels_per_mm"] for side in albedo.shape[:2])
    left, top = -job["center"][0], job["center"][1]
    half = job["window"] / 2
    # The page around its window: above, below, left and right of it.
    spans = [
        (left, left + width, half, top),
        (left, left + width, top - height, -half),
        (left, -half, -half, half),
        (half, left + width, -half, half),
    ]
    corners = [[(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)] for x0, x1, y0, y1 in spans]
    uvs = [[((x - left) / width, (y - top + height) / height) for x, y, _ in quad] for quad in corners]
    plane("page", corners, uvs, paper_material(albedo))
    reach, tile = 1.2 * half, MM_PER_TILE_UNIT * sample_material.PATCH_SIZE
    quad = [(-reach, -reach, -job["depth"]), (reach, -reach, -job["depth"]), (reach, reach, -job["depth"]), (-reach, reach, -job["depth"])]
    plane("tiles", [quad], [[(x / tile + 0.5, y / tile + 0.5) for x, y, _ in quad]], make_sample.principled_material(sample_material.tiles(512)))
    # What the page lies on.
    table = bpy.data.materials.new("table")
    table.use_nodes = True
    table.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.25, 0.2, 0.16, 1)
    table.node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value = 0.8
    far = 1000.0
    ground = [(-far, -far, -2 - job["depth"]), (far, -far, -2 - job["depth"]), (far, far, -2 - job["depth"]), (-far, far, -2 - job["depth"])]
    plane("table", [ground], [[(0, 0)] * 4], table)


def render(shot):
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = shot["size"]
    right, down, forward = np.array(shot["axes"])
    pose = SimpleNamespace(camera=shot["camera"], light=shot["light"])
    np.save(shot["out"], make_sample.take_photo(pose, np.stack([right, -down, -forward], 1), shot["half_width"]))


def main():
    job = json.loads(Path(sys.argv[1]).read_text())
    build(job)
    for shot in job["shots"]:
        render(shot)


if __name__ == "__main__":
    main()
