# SPDX-License-Identifier: GPL-3.0-or-later
"""The corners of a patch, clicked in the image editor: one photo after the other, each as viewers show it."""

from pathlib import Path

import bpy
import numpy as np

import svbrdf_gcn

from . import images

NAMES = ("upper left", "upper right", "lower right", "lower left")
# Longest side of the picture that is shown; larger photos are shown smaller.
SHOWN = 2048
# Size and colour of what is drawn over the picture.
CROSS = 9
COLOR = (1.0, 0.35, 0.05, 1.0)


def known(file):
    """Whether the corners of this photo were given."""
    return any(file.corners)


class Photo:
    """A photo in the image editor. It is read as a fit reads it: turned as its EXIF data say, which Blender does not do."""

    def __init__(self, path):
        pixels = svbrdf_gcn.Capture.open(path).photos[0]
        self.size = (pixels.shape[1], pixels.shape[0])
        factor = max(1, -(-max(self.size) // SHOWN))
        height, width = (side // factor for side in pixels.shape[:2])
        small = pixels[: height * factor, : width * factor].reshape(height, factor, width, factor, 3).mean((1, 3))
        # What is cut off at the right and at the bottom.
        self.shown = (width * factor, height * factor)
        # By its name: an undo exchanges what lies behind references.
        self.name = images.show(Path(path).name, small).name

    @property
    def image(self):
        """What is shown; None if an undo took it away."""
        return bpy.data.images.get(self.name)

    def pixel(self, u, v):
        """From the image editor's coordinates, which grow to the right and up from the lower left corner, to pixels from the upper left one."""
        return (u * self.shown[0], (1 - v) * self.shown[1])

    def place(self, x, y):
        """The way back."""
        return (x / self.shown[0], 1 - y / self.shown[1])

    def holds(self, x, y):
        return 0 <= x <= self.size[0] and 0 <= y <= self.size[1]

    def remove(self):
        if self.image is not None:
            bpy.data.images.remove(self.image)


class SVBRDF_GCN_OT_pick_corners(bpy.types.Operator):
    """Click the corners of the square patch in every photo, from the upper left one on clockwise"""

    bl_idname = "svbrdf_gcn.pick_corners"
    bl_label = "Pick Corners"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        if context.area is None or context.area.type != "IMAGE_EDITOR":
            cls.poll_message_set("Corners are picked in an image editor")
            return False
        settings = context.scene.svbrdf_gcn
        return bool(settings.photo_files) and not settings.running

    def invoke(self, context, _event):
        files = context.scene.svbrdf_gcn.photo_files
        self.area = context.area
        self.space = context.space_data
        self.region = next(region for region in context.area.regions if region.type == "WINDOW")
        self.before = self.space.image.name if self.space.image else None, self.space.show_region_ui
        self.photo = self.handler = None
        # Those that have none first; where all have some, all anew.
        missing = [i for i, file in enumerate(files) if not known(file)]
        self.waiting = missing or list(range(len(files)))
        # The sidebar covers a part of the picture.
        self.space.show_region_ui = False
        if not self.next_photo(files):
            return self.finish({"CANCELLED"})
        self.handler = bpy.types.SpaceImageEditor.draw_handler_add(draw, (self,), "WINDOW", "POST_PIXEL")
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def next_photo(self, files):
        """Show the next photo that waits; whether it can be read."""
        self.index = self.waiting.pop(0)
        self.clicked = []
        try:
            old, self.photo = self.photo, Photo(bpy.path.abspath(files[self.index].path))
        except (svbrdf_gcn.SvbrdfError, OSError, MemoryError) as error:
            self.report({"ERROR"}, str(error))
            return False
        self.space.image = self.photo.image
        if old is not None:
            old.remove()
        show_whole(self.area, self.region)
        self.title = f"{Path(files[self.index].path).name} ({self.index + 1} of {len(files)})"
        self.say()
        return True

    def say(self):
        self.area.header_text_set(
            f"{self.title}: click the {NAMES[len(self.clicked)]} corner of the patch. "
            "Backspace takes the last one back, Esc ends"
        )
        self.area.tag_redraw()

    def modal(self, context, event):
        if event.value != "PRESS":
            return {"PASS_THROUGH"}
        files = context.scene.svbrdf_gcn.photo_files
        if event.type == "ESC" or self.area.type != "IMAGE_EDITOR" or self.photo.image is None or self.index >= len(files):
            return self.finish({"CANCELLED"})
        if event.type == "BACK_SPACE" and self.clicked:
            self.clicked.pop()
            self.say()
            return {"RUNNING_MODAL"}
        under = [region.type for region in self.area.regions if holds(region, event)]
        if event.type != "LEFTMOUSE" or under != ["WINDOW"]:
            return {"PASS_THROUGH"}
        corner = self.photo.pixel(*self.region.view2d.region_to_view(event.mouse_x - self.region.x, event.mouse_y - self.region.y))
        if not self.photo.holds(*corner):
            return {"RUNNING_MODAL"}
        self.clicked.append(corner)
        if len(self.clicked) < len(NAMES):
            self.say()
            return {"RUNNING_MODAL"}
        files[self.index].corners = [value for corner in self.clicked for value in corner]
        if not self.waiting:
            return self.finish({"FINISHED"})
        return {"RUNNING_MODAL"} if self.next_photo(files) else self.finish({"CANCELLED"})

    def cancel(self, _context):
        """Blender ends the operator because a file is opened, say, and the editor with it."""
        self.forget()

    def finish(self, state):
        """The way out: the editor is as it was."""
        image, self.space.show_region_ui = self.before
        self.space.image = bpy.data.images.get(image) if image else None
        self.area.header_text_set(None)
        self.area.tag_redraw()
        self.forget()
        return state

    def forget(self):
        """Leave nothing behind."""
        if self.handler is not None:
            bpy.types.SpaceImageEditor.draw_handler_remove(self.handler, "WINDOW")
            self.handler = None
        if self.photo is not None:
            self.photo.remove()
            self.photo = None


def holds(region, event):
    """Whether the pointer is over this part of the editor."""
    return 0 <= event.mouse_x - region.x < region.width and 0 <= event.mouse_y - region.y < region.height


def show_whole(area, region):
    """Zoom such that the picture fills the editor."""
    with bpy.context.temp_override(area=area, region=region):
        bpy.ops.image.view_all(fit_view=True)


def draw(operator):
    """Crosses at the corners clicked so far, and lines between them."""
    # Only where there is a window.
    import gpu
    from gpu_extras.batch import batch_for_shader

    if operator.photo is None or bpy.context.region != operator.region:
        return
    to_region = operator.region.view2d.view_to_region
    corners = [to_region(*operator.photo.place(*corner), clip=False) for corner in operator.clicked]
    crosses = [
        end for x, y in corners for end in ((x - CROSS, y), (x + CROSS, y), (x, y - CROSS), (x, y + CROSS))
    ]
    sides = [end for pair in zip(corners, corners[1:]) for end in pair]
    if not crosses:
        return
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    shader.uniform_float("color", COLOR)
    batch_for_shader(shader, "LINES", {"pos": crosses + sides}).draw(shader)


CLASSES = (SVBRDF_GCN_OT_pick_corners,)


register, unregister = bpy.utils.register_classes_factory(CLASSES)
