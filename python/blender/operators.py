# SPDX-License-Identifier: GPL-3.0-or-later
"""Fit, cancel, export, and the lists of photos."""

import re
from pathlib import Path

import bpy
from bpy.props import CollectionProperty, EnumProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

import svbrdf_gcn

from . import corners, images, material
from .job import Job

# Seconds between looks at a running job.
INTERVAL = 0.1


def absolute(path):
    return bpy.path.abspath(path) if path else ""


def fit_options(settings):
    """The keyword arguments of `svbrdf_gcn.fit_material` that are options of the fit."""
    def steps(count):
        return None if count < 0 else count

    return {
        "preset": settings.preset,
        "method": settings.method,
        "reflectance": settings.reflectance,
        "refine": settings.refine,
        "weights": absolute(settings.weights) or None,
        "latent_steps": steps(settings.latent_steps),
        "adapter_steps": steps(settings.adapter_steps),
        "direct_steps": steps(settings.direct_steps),
        "finish_steps": steps(settings.finish_steps),
        "early_stop": settings.early_stop,
        "max_memory": round(settings.max_memory * 1e9) or None,
        "seed": settings.seed,
        "threads": settings.threads or None,
    }


def parse_views(text):
    """`0,2,5` as a list; None for nothing."""
    if not text.strip():
        return None
    try:
        return [int(view) for view in text.split(",")]
    except ValueError:
        raise ValueError(f"views: expected numbers like 0,2,5, got {text!r}") from None


def prepare(settings):
    """Read what belongs to Blender, and return the name of the capture and the work that is left, which belongs to any thread: it returns the fitted
    material, and what is to be said of its photos."""
    options = fit_options(settings)
    reading = {
        "size": settings.size or None,
        "views": parse_views(settings.views),
        "transfer": None if settings.transfer == "AUTO" else settings.transfer,
        "color_space": None if settings.color_space == "AUTO" else settings.color_space,
        "ignore_profiles": settings.ignore_profiles,
    }
    if settings.source == "FOLDER":
        folder = absolute(settings.folder)
        if not folder:
            raise ValueError("folder: expected a capture folder or a photo, got nothing")
        return opened(folder, reading, options)
    if settings.source == "FILES":
        paths = [absolute(file.path) for file in settings.photo_files]
        if not paths:
            raise ValueError("photos: expected photos of a printed sheet, or one photo, got none")
        return opened(paths[0], reading, options) if len(paths) == 1 else acquired(paths, settings, reading, options)

    photos = [photo for photo in settings.photos if photo.image is not None]
    if not photos:
        raise ValueError("photos: expected at least one image, got none")
    pixels = [images.read(photo.image) for photo in photos]
    if reading["transfer"] is None:
        kinds = {array.dtype.kind for array in pixels}
        if len(kinds) > 1:
            raise ValueError("photos: expected all 8-bit or all float, got both; set Transfer")
        reading["transfer"] = "linear" if kinds == {"f"} else "srgb"
    cameras = [tuple(photo.camera_position) for photo in photos]
    lights = cameras if settings.collocated else [tuple(photo.light_position) for photo in photos]
    scene = {"camera_positions": cameras, "light_positions": lights, "patch_size": settings.patch_size, "light_intensity": tuple(settings.light_intensity)}

    def fit_images(**control):
        return svbrdf_gcn.fit_material(pixels, **scene, **reading, **options, **control), []

    return Path(photos[0].image.name).stem, fit_images


def opened(path, reading, options):
    """`prepare` for a capture on disk, or one photo."""

    def fit_capture(**control):
        capture = svbrdf_gcn.Capture.open(path, **reading, max_memory=options["max_memory"], cancel=control["cancel"])
        return svbrdf_gcn.fit_material(capture, **options, **control), []

    place = Path(path)
    name = place.parent.name if place.suffix.lower() == ".json" else place.stem if place.is_file() else place.name
    return name or "Material", fit_capture


def acquired(paths, settings, reading, options):
    """`prepare` for photos of a printed sheet, or of a patch whose corners are known."""
    for name in ("views", "transfer", "color_space", "ignore_profiles"):
        if reading[name]:
            raise ValueError(f"{name}: is for captures; photos of a sheet are all taken, as their files say: expected nothing, got {reading[name]!r}")
    if settings.reference == "CORNERS":
        missing = [Path(file.path).name for file in settings.photo_files if not corners.known(file)]
        if missing:
            raise ValueError(f"corners: expected four for every photo, got none for {', '.join(missing)}; press Pick Corners in an image editor")
        reference = {"corners": [tuple(file.corners) for file in settings.photo_files], "patch_width": settings.patch_width, "light_offset": tuple(settings.light_offset)}
    else:
        reference = {"frame_width": settings.frame_width} if settings.reference == "FRAME" else {"window": settings.window}
        for name in ("printed_bar", "depth", "paper_white"):
            reference[name] = getattr(settings, name)
        reference["light_offset"] = "auto" if settings.find_light_offset else tuple(settings.light_offset)
        reference["dark"] = absolute(settings.dark) or None

    def fit_acquired(**control):
        acquisition = svbrdf_gcn.acquire(paths, **reference, size=reading["size"], max_memory=options["max_memory"], **control)
        return svbrdf_gcn.fit_material(acquisition.capture, **options, **control), acquisition.report["warnings"]

    return Path(paths[0]).parent.name or "Material", fit_acquired


class Session:
    """A fit from the button to the finished material. Everything here runs on the main thread."""

    def __init__(self, context):
        self.settings = context.scene.svbrdf_gcn
        if self.settings.running:
            raise RuntimeError("a fit is running already")
        name, work = prepare(self.settings)
        self.name = self.settings.name or name
        self.job = Job(work)
        self.settings.running = True
        self.settings.progress = 0.0
        self.settings.status = "Reading photos"
        self.settings.remarks = ""

    def look(self):
        """Show where the job stands; whether it goes on."""
        progress = self.job.progress
        if progress is not None:
            self.settings.progress = progress.step / max(progress.steps, 1)
            loss = "" if progress.loss is None else f", loss {progress.loss:.4g}"
            self.settings.status = f"{progress.stage} {progress.step}/{progress.steps}{loss}"
        return self.job.running

    def finish(self, context):
        """Take the result in: a material, assigned to the active object if that can hold one. Raises what the job raised."""
        try:
            fitted, warnings = self.job.result()
            result = material.build(fitted.leveled() if self.settings.level else fitted, self.name)
            lost = material.losses(fitted)
            reasons = [f"{reason['text']}; {reason['advice']}" for reason in fitted.report.get("reasons", [])]
            self.settings.remarks = "\n".join(warnings + reasons + lost)
            self.settings.status = f"{result.name}: {fitted.width} x {fitted.height}, {fitted.verdict}"
            active = context.view_layer.objects.active
            if active is not None and active.type == "MESH":
                active.active_material = result
            return result, warnings + list(fitted.warnings) + lost
        except BaseException:
            self.settings.status = ""
            raise
        finally:
            self.settings.running = False

    def cancel(self):
        self.job.cancel()


# The session of the modal operator, for the cancel button.
_session = None


class SVBRDF_GCN_OT_fit_material(bpy.types.Operator):
    """Fit material maps to a set of flash photos"""

    bl_idname = "svbrdf_gcn.fit_material"
    bl_label = "Fit Material"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        return not context.scene.svbrdf_gcn.running

    def execute(self, context):
        """The same work without a modal loop, for scripts and `blender --background`."""
        try:
            session = Session(context)
        except (ValueError, RuntimeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return self.take_in(context, session)

    def invoke(self, context, _event):
        global _session
        try:
            _session = Session(context)
        except (ValueError, RuntimeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.session = _session
        self.timer = context.window_manager.event_timer_add(INTERVAL, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC":
            self.session.cancel()
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        running = self.session.look()
        redraw(context)
        if running:
            return {"PASS_THROUGH"}
        return self.finish(context)

    def cancel(self, context):
        """Blender ends the operator, for example because a file is opened."""
        self.session.cancel()
        self.finish(context)

    def finish(self, context):
        """The one way out of the modal loop."""
        global _session
        context.window_manager.event_timer_remove(self.timer)
        _session = None
        result = self.take_in(context, self.session)
        redraw(context)
        return result

    def take_in(self, context, session):
        try:
            result, remarks = session.finish(context)
        except svbrdf_gcn.Cancelled:
            self.report({"INFO"}, "Fit cancelled")
            return {"CANCELLED"}
        except (svbrdf_gcn.SvbrdfError, OSError, MemoryError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for remark in remarks:
            self.report({"INFO"}, remark)
        self.report({"INFO"}, f"Fitted {result.name}")
        return {"FINISHED"}


def redraw(context):
    """The panels show the progress."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in {"NODE_EDITOR", "IMAGE_EDITOR"}:
                area.tag_redraw()


class SVBRDF_GCN_OT_cancel(bpy.types.Operator):
    """Stop the running fit"""

    bl_idname = "svbrdf_gcn.cancel"
    bl_label = "Cancel Fit"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, _context):
        return _session is not None

    def execute(self, _context):
        _session.cancel()
        return {"FINISHED"}


class SVBRDF_GCN_OT_export_material(bpy.types.Operator):
    """Write the active object's fitted material for another program"""

    bl_idname = "svbrdf_gcn.export_material"
    bl_label = "Export Material"
    bl_options = {"REGISTER"}

    directory: StringProperty(name="Folder", description="Folder to write to", subtype="DIR_PATH")
    to: EnumProperty(
        name="For",
        items=[
            ("maps", "Maps", "The maps as fitted, as the command line writes them"),
            ("materialx", "MaterialX", "OpenPBR surface"),
            ("gltf", "glTF", "With KHR_materials_specular"),
            ("principled", "Principled", "Base color, metallic, roughness, specular level and tint"),
            ("unreal", "Unreal", "Base color, packed occlusion-roughness-metallic, DirectX normals"),
        ],
    )
    format: EnumProperty(
        name="Format",
        description="File format of the maps; other targets have their own",
        items=[("exr", "OpenEXR", "Half floats"), ("png16", "PNG", "16 bits"), ("tiff", "TIFF", "Floats")],
    )
    normals: EnumProperty(
        name="Normals",
        items=[("AUTO", "As Usual", "What the target expects"), ("opengl", "OpenGL", "Green is up"), ("directx", "DirectX", "Green is down")],
    )

    @classmethod
    def poll(cls, context):
        active = context.view_layer.objects.active
        return active is not None and material.fitted_group(active.active_material) is not None

    def invoke(self, context, _event):
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        source = context.view_layer.objects.active.active_material
        folder = absolute(self.directory)
        if not folder:
            self.report({"ERROR"}, "directory: expected a folder, got nothing")
            return {"CANCELLED"}
        try:
            maps = material.read_back(material.fitted_group(source))
            if self.to == "maps":
                maps.save(folder, format=self.format)
            else:
                # Names of files and nodes; Blender numbers its materials with a dot.
                name = re.sub(r"[^A-Za-z0-9_]", "_", source.name)
                report = maps.export(folder, to=self.to, name=name, normals=None if self.normals == "AUTO" else self.normals, level=False)
                for remark in report["lost"]:
                    self.report({"INFO"}, remark)
        except (svbrdf_gcn.SvbrdfError, OSError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"Wrote {folder}")
        return {"FINISHED"}


PHOTOS = "*.png;*.jpg;*.jpeg;*.tif;*.tiff;*.exr"


class SVBRDF_GCN_OT_choose_photos(bpy.types.Operator, ImportHelper):
    """Choose photos of a printed sheet or of a patch whose corners can be clicked, or one photo taken from straight above with the flash"""

    bl_idname = "svbrdf_gcn.choose_photos"
    bl_label = "Choose Photos"
    bl_options = {"REGISTER", "UNDO"}

    filter_glob: StringProperty(default=PHOTOS, options={"HIDDEN"})
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})
    directory: StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})

    def execute(self, context):
        names = sorted(file.name for file in self.files if file.name)
        if not names:
            self.report({"ERROR"}, "photos: expected at least one file, got none")
            return {"CANCELLED"}
        chosen = context.scene.svbrdf_gcn.photo_files
        chosen.clear()
        for name in names:
            chosen.add().path = str(Path(self.directory) / name)
        return {"FINISHED"}


class SVBRDF_GCN_OT_add_photos(bpy.types.Operator, ImportHelper):
    """Add photos to the list, from files"""

    bl_idname = "svbrdf_gcn.add_photos"
    bl_label = "Add Photos"
    bl_options = {"REGISTER", "UNDO"}

    filter_glob: StringProperty(default=PHOTOS, options={"HIDDEN"})
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})
    directory: StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})

    def execute(self, context):
        for file in sorted(self.files, key=lambda file: file.name):
            try:
                image = bpy.data.images.load(str(Path(self.directory) / file.name), check_existing=True)
            except RuntimeError as error:
                self.report({"ERROR"}, str(error).strip())
                return {"CANCELLED"}
            add_photo(context.scene.svbrdf_gcn, image)
        return {"FINISHED"}


class SVBRDF_GCN_OT_add_open_image(bpy.types.Operator):
    """Add the image of this editor to the list of photos"""

    bl_idname = "svbrdf_gcn.add_open_image"
    bl_label = "Add This Image"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        return getattr(context.space_data, "image", None) is not None

    def execute(self, context):
        add_photo(context.scene.svbrdf_gcn, context.space_data.image)
        return {"FINISHED"}


class SVBRDF_GCN_OT_remove_photo(bpy.types.Operator):
    """Take the selected photo off the list"""

    bl_idname = "svbrdf_gcn.remove_photo"
    bl_label = "Remove Photo"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        settings = context.scene.svbrdf_gcn
        return 0 <= settings.active_photo < len(settings.photos)

    def execute(self, context):
        settings = context.scene.svbrdf_gcn
        settings.photos.remove(settings.active_photo)
        settings.active_photo = min(settings.active_photo, max(len(settings.photos) - 1, 0))
        return {"FINISHED"}


def add_photo(settings, image):
    photo = settings.photos.add()
    photo.image = image
    settings.active_photo = len(settings.photos) - 1


CLASSES = (
    SVBRDF_GCN_OT_fit_material,
    SVBRDF_GCN_OT_cancel,
    SVBRDF_GCN_OT_export_material,
    SVBRDF_GCN_OT_choose_photos,
    SVBRDF_GCN_OT_add_photos,
    SVBRDF_GCN_OT_add_open_image,
    SVBRDF_GCN_OT_remove_photo,
)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister():
    if _session is not None:
        _session.cancel()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
