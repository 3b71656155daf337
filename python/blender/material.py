# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps to a node group around the Principled BSDF, and back.

The group holds the maps as they were fitted; a few math nodes turn them into what the Principled BSDF takes:

- Specular IOR Level and Specular Tint carry the RGB reflectance at normal incidence F0: level = max(F0) / 0.08 at an IOR of 1.5,
  tint = F0 / max(F0). A level above 1 is meant; Cycles and EEVEE take it. So metals need no Metallic, which stays 0.
- Both models dim the diffuse part by what the surface reflects: ours each channel by 1 - F0, the Principled BSDF all by about
  1 - max(F0). Base Color is the diffuse albedo times (1 - F0) / (1 - max(F0)), at most 1.
- Two roughnesses become Roughness, Anisotropic and the Tangent: alpha = roughness^2 along and across, of which the Principled BSDF
  makes alpha / aspect and alpha * aspect with aspect^2 = 1 - 0.9 anisotropic.
"""

import bpy
import numpy as np

import svbrdf_gcn

from . import images

IOR = 1.5
# Reflectance at normal incidence of that index, twice: what a level of 1 means.
LEVEL_ONE = 2 * ((IOR - 1) / (IOR + 1)) ** 2
# 1 - max(F0) is not taken below this.
LEAST_REST = 0.02
PATCH_SIZE = "svbrdf_gcn_patch_size"
UNIT = "svbrdf_gcn_unit"
MAPS = ("diffuse_albedo", "specular_albedo", "roughness", "normal", "tangent")


def build(material, name):
    """A Blender material `name` whose only node beside the output is a group made of the maps of `material`."""
    group = node_group(material, name)
    result = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0, 0):
        result.use_nodes = True
    # The maps were fitted with their normals as they are; Cycles would bend them and darken what faces away.
    if hasattr(result, "cycles"):
        result.cycles.use_bump_map_correction = False
    nodes, links = result.node_tree.nodes, result.node_tree.links
    nodes.clear()
    node = nodes.new("ShaderNodeGroup")
    node.node_tree = group
    node.width = 240
    output = nodes.new("ShaderNodeOutputMaterial")
    output.location = (300, 0)
    links.new(node.outputs["BSDF"], output.inputs["Surface"])
    return result


def node_group(material, name):
    """The group: textures of the maps, the math of this module's description, a Principled BSDF."""
    tree = bpy.data.node_groups.new(name, "ShaderNodeTree")
    tree[PATCH_SIZE] = material.patch_size
    if material.unit is not None:
        tree[UNIT] = material.unit
    tree.interface.new_socket("BSDF", in_out="OUTPUT", socket_type="NodeSocketShader")
    graph = Graph(tree)
    principled = graph.node("ShaderNodeBsdfPrincipled", 600, 200)
    principled.distribution = "GGX"
    principled.inputs["IOR"].default_value = IOR
    principled.inputs["Metallic"].default_value = 0.0
    output = graph.node("NodeGroupOutput", 900, 200)
    graph.link(principled.outputs["BSDF"], output.inputs["BSDF"])

    def texture(kind, values, color_spaces, y):
        node = graph.node("ShaderNodeTexImage", -700, y)
        node.name = node.label = kind
        node.image = images.write(f"{name} {kind}", values, color_spaces)
        return node.outputs["Color"]

    diffuse = texture("diffuse_albedo", material.diffuse_albedo, images.LINEAR, 500)
    specular = texture("specular_albedo", material.specular_albedo, images.LINEAR, 200)
    roughness = texture("roughness", material.roughness, images.DATA, -100)
    normal = texture("normal", encode_vector(material.normal), images.DATA, -400)

    channels = graph.node("ShaderNodeSeparateColor", -400, 200)
    graph.link(specular, channels.inputs["Color"])
    red, green, blue = (channels.outputs[channel] for channel in ("Red", "Green", "Blue"))
    strongest = graph.math("MAXIMUM", graph.math("MAXIMUM", red, green), blue)
    graph.link(graph.math("DIVIDE", strongest, LEVEL_ONE), principled.inputs["Specular IOR Level"])
    inverse = graph.math("DIVIDE", 1.0, graph.math("MAXIMUM", strongest, 1e-6))
    graph.link(graph.vector("SCALE", specular, inverse), principled.inputs["Specular Tint"])
    rest = graph.math("MAXIMUM", graph.math("SUBTRACT", 1.0, strongest), LEAST_REST)
    passed = graph.vector("MULTIPLY", diffuse, graph.vector("SUBTRACT", (1.0, 1.0, 1.0), specular))
    base_color = graph.vector("SCALE", passed, graph.math("DIVIDE", 1.0, rest))
    graph.link(graph.vector("MINIMUM", base_color, (1.0, 1.0, 1.0)), principled.inputs["Base Color"])

    graph.link(graph.normal_map(normal), principled.inputs["Normal"])
    if material.tangent is None:
        graph.link(roughness, principled.inputs["Roughness"])
    else:
        tangent = texture("tangent", encode_vector(material.tangent), images.DATA, -700)
        graph.anisotropic(roughness, tangent, principled)
    return tree


class Graph:
    """Nodes and links of a tree, written in a line each."""

    def __init__(self, tree):
        self.tree = tree

    def node(self, kind, x, y):
        node = self.tree.nodes.new(kind)
        node.location = (x, y)
        return node

    def link(self, source, socket):
        self.tree.links.new(source, socket)

    def _operation(self, kind, operation, values, output):
        node = self.node(kind, -100, -200)
        node.operation = operation
        for socket, value in values:
            if isinstance(value, bpy.types.NodeSocket):
                self.link(value, node.inputs[socket])
            else:
                node.inputs[socket].default_value = value
        return node.outputs[output]

    def math(self, operation, a, b):
        """A Math node of two scalars."""
        return self._operation("ShaderNodeMath", operation, ((0, a), (1, b)), "Value")

    def vector(self, operation, a, b):
        """A Vector Math node of two vectors, or of a vector and a factor."""
        return self._operation("ShaderNodeVectorMath", operation, ((0, a), ("Scale" if operation == "SCALE" else 1, b)), "Vector")

    def normal_map(self, color):
        """A vector of the tangent space, stored as (v + 1) / 2, in the space of the object."""
        node = self.node("ShaderNodeNormalMap", 300, -400)
        self.link(color, node.inputs["Color"])
        return node.outputs["Normal"]

    def anisotropic(self, roughness, tangent, principled):
        """Two roughnesses and a tangent to the Principled BSDF's sockets."""
        channels = self.node("ShaderNodeSeparateColor", -400, -100)
        self.link(roughness, channels.inputs["Color"])
        along, across = channels.outputs["Red"], channels.outputs["Green"]
        mean = self.math("POWER", self.math("MULTIPLY", along, across), 0.5)
        self.link(mean, principled.inputs["Roughness"])
        longer, shorter = self.math("MAXIMUM", along, across), self.math("MINIMUM", along, across)
        ratio = self.math("DIVIDE", shorter, self.math("MAXIMUM", longer, 1e-6))
        # alpha is the square of the roughness, so the ratio of the alphas, aspect^2, is the square of the ratio of the roughnesses.
        aspect2 = self.math("MULTIPLY", ratio, ratio)
        share = self.math("DIVIDE", self.math("SUBTRACT", 1.0, aspect2), 0.9)
        self.link(self.math("MINIMUM", share, 1.0), principled.inputs["Anisotropic"])
        # The Principled BSDF stretches along its tangent: where ours is the shorter axis, a quarter turn.
        turned = self.math("MULTIPLY", self.math("GREATER_THAN", across, along), 0.25)
        self.link(turned, principled.inputs["Anisotropic Rotation"])
        self.link(self.normal_map(tangent), principled.inputs["Tangent"])


def encode_vector(vectors):
    """Unit vectors as (v + 1) / 2."""
    return (vectors + 1) / 2


def losses(material):
    """What the Principled BSDF cannot hold of these maps, as sentences for the user."""
    rest = np.maximum(1 - material.specular_albedo.max(axis=-1, keepdims=True), LEAST_REST)
    passed = material.diffuse_albedo * (1 - material.specular_albedo)
    excess = np.maximum(passed - rest, 0).max(axis=-1)
    found = []
    if (excess > 1e-3).any():
        share = 100 * (excess > 1e-3).mean()
        found.append(f"Diffuse light lowered by up to {excess.max():.3f} in {share:.0f} % of pixels: beside so strong a highlight a Base Color cannot hold it")
    if material.tangent is not None:
        ratio = material.roughness.min(axis=-1) / np.maximum(material.roughness.max(axis=-1), 1e-6)
        weakened = ratio**2 < 0.1
        if weakened.any():
            found.append(f"Anisotropy weakened in {100 * weakened.mean():.0f} % of pixels: the roughnesses differ by more than a factor of 3.2")
    found.append("At grazing angles the Principled BSDF dims the diffuse part as its highlight grows; the fitted model does not")
    return found


def fitted_group(material):
    """The node group that `node_group` made, in a Blender material; None if there is none."""
    if material is None or material.node_tree is None:
        return None
    for node in material.node_tree.nodes:
        if node.type == "GROUP" and node.node_tree is not None and PATCH_SIZE in node.node_tree:
            return node.node_tree
    return None


def read_back(tree):
    """The `svbrdf_gcn.Material` whose maps a group holds."""
    maps = {}
    for kind in MAPS:
        node = tree.nodes.get(kind)
        if node is not None:
            maps[kind] = images.read(node.image)
    for kind in ("normal", "tangent"):
        if kind in maps:
            maps[kind] = 2 * maps[kind] - 1
    anisotropic = "tangent" in maps
    maps["roughness"] = maps["roughness"][..., :2] if anisotropic else maps["roughness"][..., 0]
    return svbrdf_gcn.Material(patch_size=tree[PATCH_SIZE], unit=tree.get(UNIT), **maps)
