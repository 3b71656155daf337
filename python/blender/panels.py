# SPDX-License-Identifier: GPL-3.0-or-later
"""The same panel in the shader editor and in the image editor."""

from pathlib import Path

import bpy

from . import corners, material


class SVBRDF_GCN_UL_photos(bpy.types.UIList):
    """A photo a line."""

    def draw_item(self, _context, layout, _data, item, _icon, _active_data, _active_property, _index=0, _filter=0):
        layout.prop(item, "image", text="")


def draw_fit(layout, context):
    """Photos, options, the button or the progress, and what was lost."""
    settings = context.scene.svbrdf_gcn
    layout.use_property_split = True
    layout.use_property_decorate = False
    column = layout.column()
    column.enabled = not settings.running
    column.prop(settings, "source", expand=True)
    if settings.source == "FOLDER":
        column.prop(settings, "folder")
    elif settings.source == "FILES":
        draw_files(column, settings)
    else:
        draw_photos(column, settings)
    column.prop(settings, "name")
    column.prop(settings, "size")
    column.prop(settings, "preset")
    if settings.running:
        layout.progress(factor=settings.progress, text=settings.status)
        layout.operator("svbrdf_gcn.cancel", icon="CANCEL")
        return
    layout.operator("svbrdf_gcn.fit_material", icon="MATERIAL")
    if settings.status:
        layout.label(text=settings.status, icon="CHECKMARK")
    for line in settings.remarks.splitlines():
        layout.label(text=line, icon="INFO")


def draw_files(column, settings):
    count = len(settings.photo_files)
    column.operator("svbrdf_gcn.choose_photos", icon="FILE_FOLDER", text=f"{count} Photos" if count > 1 else "Choose Photos")
    if count == 1:
        column.prop(settings.photo_files[0], "path")
    if count < 2:
        return
    column.prop(settings, "reference")
    if settings.reference == "CORNERS":
        column.prop(settings, "patch_width")
        column.prop(settings, "light_offset")
        for file in settings.photo_files:
            column.label(text=Path(file.path).name, icon="CHECKMARK" if corners.known(file) else "QUESTION")
        column.operator("svbrdf_gcn.pick_corners", icon="EYEDROPPER")
        return
    column.prop(settings, "frame_width" if settings.reference == "FRAME" else "window")
    for name in ("printed_bar", "depth", "find_light_offset"):
        column.prop(settings, name)
    if not settings.find_light_offset:
        column.prop(settings, "light_offset")
    for name in ("dark", "paper_white"):
        column.prop(settings, name)


def draw_photos(column, settings):
    row = column.row()
    row.template_list("SVBRDF_GCN_UL_photos", "", settings, "photos", settings, "active_photo", rows=3)
    buttons = row.column(align=True)
    buttons.operator("svbrdf_gcn.add_photos", icon="ADD", text="")
    buttons.operator("svbrdf_gcn.add_open_image", icon="IMAGE_DATA", text="")
    buttons.operator("svbrdf_gcn.remove_photo", icon="REMOVE", text="")
    column.prop(settings, "collocated")
    if 0 <= settings.active_photo < len(settings.photos):
        photo = settings.photos[settings.active_photo]
        column.prop(photo, "camera_position")
        if not settings.collocated:
            column.prop(photo, "light_position")
    column.prop(settings, "patch_size")
    column.prop(settings, "light_intensity")


def draw_options(layout, context):
    """What most users leave alone."""
    settings = context.scene.svbrdf_gcn
    layout.use_property_split = True
    layout.use_property_decorate = False
    layout.enabled = not settings.running
    for name in (
        "views", "transfer", "color_space", "ignore_profiles", "method", "reflectance", "refine", "level", "weights", "latent_steps", "adapter_steps", "direct_steps", "finish_steps", "early_stop",
        "max_memory", "seed", "threads",
    ):
        layout.prop(settings, name)


class FitPanel:
    bl_label = "Material from Photos"
    bl_category = "Material from Photos"
    bl_region_type = "UI"

    def draw(self, context):
        draw_fit(self.layout, context)
        active = context.view_layer.objects.active
        if active is not None and material.fitted_group(active.active_material) is not None:
            self.layout.operator("svbrdf_gcn.export_material", icon="EXPORT")


class OptionsPanel:
    bl_label = "Options"
    bl_category = "Material from Photos"
    bl_region_type = "UI"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        draw_options(self.layout, context)


def shader_editor(context):
    return context.space_data.tree_type == "ShaderNodeTree"


class SVBRDF_GCN_PT_shader(FitPanel, bpy.types.Panel):
    bl_space_type = "NODE_EDITOR"

    @classmethod
    def poll(cls, context):
        return shader_editor(context)


class SVBRDF_GCN_PT_shader_options(OptionsPanel, bpy.types.Panel):
    bl_space_type = "NODE_EDITOR"
    bl_parent_id = "SVBRDF_GCN_PT_shader"

    @classmethod
    def poll(cls, context):
        return shader_editor(context)


class SVBRDF_GCN_PT_image(FitPanel, bpy.types.Panel):
    bl_space_type = "IMAGE_EDITOR"


class SVBRDF_GCN_PT_image_options(OptionsPanel, bpy.types.Panel):
    bl_space_type = "IMAGE_EDITOR"
    bl_parent_id = "SVBRDF_GCN_PT_image"


CLASSES = (
    SVBRDF_GCN_UL_photos,
    SVBRDF_GCN_PT_shader,
    SVBRDF_GCN_PT_shader_options,
    SVBRDF_GCN_PT_image,
    SVBRDF_GCN_PT_image_options,
)

register, unregister = bpy.utils.register_classes_factory(CLASSES)
