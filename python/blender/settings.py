# SPDX-License-Identifier: GPL-3.0-or-later
"""What the user chooses, kept in the scene as `scene.svbrdf_gcn`. Fit options have the names of the command line and of Python."""

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)


class SVBRDF_GCN_PG_photo(bpy.types.PropertyGroup):
    """A photo among Blender's images, and where it was taken from."""

    image: PointerProperty(name="Image", type=bpy.types.Image)
    camera_position: FloatVectorProperty(
        name="Camera", description="Where the lens was: x right, y up, z out of the surface, from its centre", default=(0, 0, 1)
    )
    light_position: FloatVectorProperty(name="Light", description="Where the light was, as for the camera", default=(0, 0, 1))


class SVBRDF_GCN_PG_file(bpy.types.PropertyGroup):
    """A photo that is read from its file."""

    path: StringProperty(name="Photo", subtype="FILE_PATH")
    corners: FloatVectorProperty(
        name="Corners",
        description="x and y of the patch's upper left, upper right, lower right and lower left corner, in pixels of the photo as viewers show it; all 0: not known",
        size=8,
        min=0,
    )


class SVBRDF_GCN_PG_settings(bpy.types.PropertyGroup):
    """Photos, options and the state of the running fit."""

    source: EnumProperty(
        name="Photos",
        description="Where the photos are",
        items=[
            ("FILES", "Files", "Photos of a printed sheet around the sample; or one photo taken from straight above with the flash"),
            ("FOLDER", "Folder", "A capture folder: photos with their positions; or one photo taken from straight above with the flash"),
            ("IMAGES", "Images", "Images of this file, with positions entered here"),
        ],
        default="FOLDER",
    )
    photo_files: CollectionProperty(type=SVBRDF_GCN_PG_file)
    reference: EnumProperty(
        name="Reference",
        description="What tells where the photos were taken from",
        items=[
            ("SHEET", "Sheet", "The printed sheet around the sample"),
            ("FRAME", "Other Frame", "The frame of svbrdf-diff-renderer"),
            ("CORNERS", "Corners", "The corners of a square patch of known width, clicked in every photo"),
        ],
    )
    window: FloatProperty(name="Window (mm)", description="Width of the window of the printed sheet", default=100, min=20, max=1000)
    frame_width: FloatProperty(
        name="Frame Width (mm)", description="Width of the frame of svbrdf-diff-renderer, from outer edge to outer edge", default=170, min=20, max=1000
    )
    patch_width: FloatProperty(name="Width (mm)", description="Width of the square patch whose corners are known", default=100, min=1, max=100000)
    printed_bar: FloatProperty(name="Printed Bar (mm)", description="Length of the sheet's bar of 100 mm as it was printed", default=100, min=50, max=200)
    depth: FloatProperty(name="Depth (mm)", description="How far the sample lies below the sheet's face; negative above it", default=0)
    find_light_offset: BoolProperty(name="Find Flash", description="Find from the paper where the flash is beside the lens", default=False)
    light_offset: FloatVectorProperty(
        name="Flash (mm)",
        description="Where the flash is, seen from the lens: to the right and up in photos as they were taken, before they were turned upright",
        size=2,
        default=(0, 0),
    )
    dark: StringProperty(
        name="Without Flash", description="A photo of the sheet without flash, exposed as the others: what it shows is subtracted", subtype="FILE_PATH"
    )
    paper_white: FloatProperty(name="Paper", description="Diffuse albedo of the paper", default=0.8, min=0.01, max=1)
    folder: StringProperty(
        name="Capture", description="Capture folder, its JSON file, or one photo", subtype="FILE_PATH"
    )
    photos: CollectionProperty(type=SVBRDF_GCN_PG_photo)
    active_photo: IntProperty()
    collocated: BoolProperty(name="Light at Camera", description="The flash sits beside the lens", default=True)
    patch_size: FloatProperty(
        name="Patch Width", description="Width of the photographed patch, in the unit of the positions", default=1.0, min=1e-6
    )
    light_intensity: FloatVectorProperty(
        name="Light Intensity",
        description="Radiant intensity of the light: photo value of a white diffuse patch facing it, times squared distance, times pi",
        default=(1, 1, 1),
        min=0,
    )
    name: StringProperty(name="Name", description="Name of the material; empty: that of the capture")
    views: StringProperty(name="Views", description="Photos to take, counted from 0: 0,2,5; empty: all")
    size: IntProperty(
        name="Size", description="Longer side of the maps in pixels; larger photos are resampled, 0 keeps their size", default=0, min=0
    )
    transfer: EnumProperty(
        name="Transfer",
        description="Transfer function of the photos",
        items=[
            ("AUTO", "As Stated", "What the capture or the image says"),
            ("gamma2.2", "Gamma 2.2", ""),
            ("srgb", "sRGB", ""),
            ("linear", "Linear", ""),
        ],
    )
    color_space: EnumProperty(
        name="Color Space",
        description="Primaries of linear photos",
        items=[("AUTO", "As Stated", "What the capture or the image says, else Rec.709"), ("rec709", "Rec.709", ""), ("acescg", "ACEScg", "")],
    )
    ignore_profiles: BoolProperty(
        name="Ignore Profiles", description="Read photos of a folder as if their files held no colour profiles", default=False
    )
    preset: EnumProperty(
        name="Preset",
        description="How much time to spend",
        items=[("draft", "Draft", "A first look"), ("balanced", "Balanced", ""), ("high", "High", "Until nothing is gained any more")],
        default="balanced",
    )
    method: EnumProperty(
        name="Method",
        description="How to get from photos to maps",
        items=[
            ("auto", "Auto", "Network"),
            ("network", "Network", "The built-in network, or that of the weights given"),
            ("direct", "Direct", "Without a network"),
        ],
    )
    reflectance: EnumProperty(
        name="Reflectance",
        description="What the surface is made of",
        items=[
            ("auto", "Auto", "The simplest that predicts photos left out as well as the others do"),
            ("diffuse", "Diffuse", "No specular reflection"),
            ("dielectric", "Dielectric", "Specular albedo near 4 %"),
            ("isotropic", "Isotropic", "Any specular albedo, metals too"),
            ("anisotropic", "Anisotropic", "Two roughnesses and a tangent: brushed metal, satin, hair"),
        ],
    )
    refine: EnumProperty(
        name="Refine",
        description="What of the capture's statements may be corrected",
        items=[
            ("auto", "Auto", "What predicts photos left out better"),
            ("none", "None", "The stated light exactly"),
            ("light", "Light", "A factor on the light of each photo"),
            ("all", "All", "That, and the position of camera and light"),
        ],
    )
    level: BoolProperty(name="Level", description="Take the tilt of the whole surface out, so that tiles of it make a plane", default=True)
    weights: StringProperty(name="Weights", description="Other weights than those built in (safetensors)", subtype="FILE_PATH")
    latent_steps: IntProperty(name="Latent Steps", description="Steps on the latent code; -1: the preset's", default=-1, min=-1)
    adapter_steps: IntProperty(name="Adapter Steps", description="Steps on the adapters; -1: the preset's", default=-1, min=-1)
    direct_steps: IntProperty(name="Direct Steps", description="Steps on the maps; -1: the preset's", default=-1, min=-1)
    finish_steps: IntProperty(name="Finish Steps", description="Steps of the per-pixel finish; -1: the preset's", default=-1, min=-1)
    early_stop: BoolProperty(name="Early Stop", description="Stop a stage when its loss has flattened", default=True)
    max_memory: FloatProperty(
        name="Memory (GB)", description="Most memory a fit may use; 0: three quarters of what is free", default=0, min=0
    )
    seed: IntProperty(name="Seed", description="The same seed and number of threads give the same maps", default=0, min=0)
    threads: IntProperty(name="Threads", description="0: all", default=0, min=0)

    # The running fit, for the panels.
    running: BoolProperty(options={"SKIP_SAVE", "HIDDEN"})
    progress: FloatProperty(options={"SKIP_SAVE", "HIDDEN"}, subtype="FACTOR", min=0, max=1)
    status: StringProperty(options={"SKIP_SAVE", "HIDDEN"})
    remarks: StringProperty(options={"SKIP_SAVE", "HIDDEN"})


CLASSES = (SVBRDF_GCN_PG_photo, SVBRDF_GCN_PG_file, SVBRDF_GCN_PG_settings)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.svbrdf_gcn = PointerProperty(type=SVBRDF_GCN_PG_settings)


def unregister():
    del bpy.types.Scene.svbrdf_gcn
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
