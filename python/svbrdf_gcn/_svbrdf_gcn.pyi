"""
The compiled part of ``svbrdf_gcn``.
"""

from _typeshed import SupportsGetItem
from collections.abc import Callable, Iterable
from numpy import float32, float64
from numpy.typing import ArrayLike, NDArray
from os import PathLike
from typing import Any, Final, SupportsFloat, SupportsIndex, final

__all__ = ["__version__", "Acquisition", "CancelToken", "Capture", "Material", "Model", "Principled", "Progress", "TrainingData", "acquire", "command_line", "fit_material", "map_errors", "photo_errors", "photo_rmse"]

__version__: Final[str]

@final
class Acquisition:
    """
    A capture made of raw photos, and how it came about; see ``acquire``.

    Examples
    --------
    >>> acquisition = svbrdf_gcn.acquire(photos, light_offset=(12, 0))  # doctest: +SKIP
    >>> acquisition  # doctest: +SKIP
    <svbrdf_gcn.Acquisition: 9 photos, 0 left out>
    >>> material = svbrdf_gcn.fit_material(acquisition.capture)  # doctest: +SKIP
    """
    def __repr__(self, /) -> str: ...
    @property
    def capture(self, /) -> Capture:
        """
        The rectified photos with their positions, in millimetres.
        """
    @property
    def contact_sheet(self, /) -> NDArray[float32]:
        """
        A picture of it in sRGB from 0 to 1, float32 of shape (H, W, 3): photos with tags and sample drawn in, rectified patches, where cameras stood, what is missing.
        """
    @property
    def report(self, /) -> dict[str, Any]:
        """
        What was found: ``photos``, those ``left_out`` with the reason, ``lenses``, ``warnings``.
        """
    def save(self, /, folder: str | PathLike[str]) -> None:
        """
        Write the capture to a folder: ``capture.json``, the rectified photos as OpenEXR, for each with saturated pixels a PNG that says which, and ``contact-sheet.png``.

        Parameters
        ----------
        folder : str or os.PathLike
            Made if it is not there.

        Raises
        ------
        ArgumentError
            If that would replace files that are not ours.
        OSError
            If it cannot be written.

        Examples
        --------
        >>> acquisition = svbrdf_gcn.acquire(photos, depth=1)  # doctest: +SKIP
        >>> acquisition.save("leather")  # doctest: +SKIP
        """

@final
class CancelToken:
    """
    Stops a fit, or the reading of photos, from any thread.

    A token that was cancelled stays so; take a new one for the next run.

    Examples
    --------
    >>> token = svbrdf_gcn.CancelToken()
    >>> token.cancel()
    >>> try:
    ...     svbrdf_gcn.fit_material("samples/tiles", size=32, cancel=token)
    ... except svbrdf_gcn.Cancelled:
    ...     print("stopped")
    stopped
    """
    def __new__(cls, /) -> CancelToken: ...
    def __repr__(self, /) -> str: ...
    def cancel(self, /) -> None:
        """
        Ask every fit and every reading that was given this token to stop; they raise ``Cancelled``.

        Examples
        --------
        >>> token = svbrdf_gcn.CancelToken()
        >>> token.cancel()
        >>> token.cancelled
        True
        """
    @property
    def cancelled(self, /) -> bool:
        """
        Whether ``cancel`` was called.
        """

@final
class Capture:
    """
    Photos of one nearly flat sample, and where camera and light stood for each.

    The sample lies centred in the plane z = 0, x to the right, y up, z towards the camera. Positions and `patch_size` share
    one length unit.

    Parameters
    ----------
    photos : array of shape (N, H, W, 3), or an iterable of N arrays of shape (H, W, 3) or of N paths of image files
        uint8 and uint16 stand for values from 0 to 1, floats for themselves. Grey photos and photos with alpha (which is
        ignored) are taken as well. Arrays may have any layout; they are copied.
    camera_positions : array_like of shape (N, 3)
        Position of the camera for each photo.
    patch_size : float
        Width of the patch that the photos show.
    light_intensity : float, or array_like of shape (3,) or (N, 3)
        A white matt patch at distance r from the light has the radiance ``light_intensity / (pi * r**2)``, where 1 is the
        photos' full value.
    transfer : {"srgb", "gamma2.2", "linear"}
        How stored values relate to linear radiance.
    light_positions : array_like of shape (N, 3), optional
        Position of the light for each photo; the camera's if not given.
    white_level : float, optional
        Stored value from which on floats are saturated. Integers are at their largest value.
    size : int, optional
        Longer side in pixels; larger photos are resampled by area, smaller ones are never enlarged.
    views : iterable of int, optional
        The photos to take, counted from 0.
    color_space : {"rec709", "acescg"}, optional
        Colour space of linear photos and of `light_intensity`, Rec. 709 if not given. Everything is computed in Rec. 709.
    ignore_profiles : bool, default False
        Read image files as if they held no colour profiles. Without it their colours are converted where `color_space` is not given.
    cancel : CancelToken, optional
        Stops the reading from any thread. So does Ctrl-C, with ``KeyboardInterrupt``.
    max_memory : int or str, optional
        Most bytes the run may use, such as ``4000000000`` or ``"2G"``; three quarters of the free memory if not given. Arrays that are given are not counted.

    Raises
    ------
    ArgumentError
        For positions that are not in front of the sample, NaN, and other values out of range.
    ShapeError
        For arrays of another shape, and photos that differ in size.
    FormatError
        For arrays of other types, and files of other formats.
    OSError
        For files that cannot be read.
    MemoryError
        If the photos need more than `max_memory`, before any is decoded.
    Cancelled
        If `cancel` was cancelled.

    Examples
    --------
    >>> import numpy as np
    >>> photos = np.full((2, 4, 6, 3), 128, np.uint8)
    >>> cameras = [[-3, 0, 20], [3, 0, 20]]
    >>> svbrdf_gcn.Capture(photos, camera_positions=cameras, patch_size=10, light_intensity=1200, transfer="srgb")
    <svbrdf_gcn.Capture: 2 photos of 6 x 4 pixels, patch 10 wide, transfer srgb>
    """
    def __len__(self, /) -> int: ...
    def __new__(cls, /, photos: ArrayLike | Iterable[ArrayLike | str | PathLike[str]], *, camera_positions: ArrayLike, patch_size: SupportsFloat | SupportsIndex, light_intensity: ArrayLike, transfer: str, light_positions: ArrayLike | None = None, white_level: SupportsFloat | SupportsIndex | None = None, size: SupportsIndex | None = None, views: Iterable[SupportsIndex] | None = None, color_space: str | None = None, ignore_profiles: bool = ..., cancel: CancelToken | None = None, max_memory: SupportsIndex | str | None = None) -> Capture: ...
    def __repr__(self, /) -> str: ...
    @property
    def camera_positions(self, /) -> NDArray[float64]:
        """
        Positions of the camera, shape (N, 3).
        """
    @property
    def height(self, /) -> int:
        """
        Rows of every photo.
        """
    @property
    def light_intensity(self, /) -> NDArray[float64]:
        """
        Intensities of the light, shape (N, 3), in photo units times length squared.
        """
    @property
    def light_positions(self, /) -> NDArray[float64]:
        """
        Positions of the light, shape (N, 3).
        """
    @property
    def names(self, /) -> list[str]:
        """
        Names of the photos: their files', or ``photos[0]`` and so on.
        """
    @staticmethod
    def open(path: str | PathLike[str], *, size: SupportsIndex | None = None, views: Iterable[SupportsIndex] | None = None, transfer: str | None = None, color_space: str | None = None, ignore_profiles: bool = ..., cancel: CancelToken | None = None, max_memory: SupportsIndex | str | None = None) -> Capture:
        """
        Read a capture: its folder or its JSON file, or one photo taken from straight above with the flash.

        ``docs/captures.md`` describes the layouts, and what is assumed of one photo alone.

        Parameters
        ----------
        path : str or os.PathLike
            Folder, ``capture.json``, JSON file of svbrdf-diff-renderer, or image file.
        size : int, optional
            Longer side in pixels; larger photos are resampled by area, smaller ones are never enlarged.
        views : iterable of int, optional
            The photos to take, counted from 0; no others are opened.
        transfer : {"srgb", "gamma2.2", "linear"}, optional
            Replaces what the capture states.
        color_space : {"rec709", "acescg"}, optional
            Replaces what the capture states for linear photos.
        ignore_profiles : bool, default False
            Read photos as if their files held no colour profiles.
        cancel : CancelToken, optional
            Stops the reading from any thread. So does Ctrl-C, with ``KeyboardInterrupt``.
        max_memory : int or str, optional
            Most bytes the run may use, such as ``4000000000`` or ``"2G"``; three quarters of the free memory if not given.

        Returns
        -------
        Capture

        Raises
        ------
        OSError, ArgumentError, ShapeError, FormatError, MemoryError, Cancelled
            As the constructor.

        Examples
        --------
        >>> svbrdf_gcn.Capture.open("samples/tiles", size=64, views=[0, 4])
        <svbrdf_gcn.Capture: 2 photos of 64 x 64 pixels, patch 10 wide, transfer srgb>
        """
    @property
    def patch_size(self, /) -> float:
        """
        Width of the patch.
        """
    @property
    def photos(self, /) -> list[NDArray[float32]]:
        """
        The photos: linear RGB, read-only arrays of shape (H, W, 3).
        """
    def select(self, /, views: Iterable[SupportsIndex]) -> Capture:
        """
        The capture with only some of its photos.

        Parameters
        ----------
        views : iterable of int
            The photos to keep, counted from 0, in this order.

        Returns
        -------
        Capture

        Raises
        ------
        ArgumentError
            If there is none, one is named twice, or one does not exist.

        Examples
        --------
        >>> capture = svbrdf_gcn.Capture.open("samples/tiles", size=32)
        >>> len(capture), len(capture.select([0, 8]))
        (9, 2)
        """
    @property
    def transfer(self, /) -> str:
        """
        The transfer function that the photos were decoded with.
        """
    @property
    def unit(self, /) -> str | None:
        """
        Name of the length unit, where the capture states it.
        """
    @property
    def warnings(self, /) -> list[str]:
        """
        What a user should know about how the capture was read.
        """
    @property
    def width(self, /) -> int:
        """
        Columns of every photo.
        """

@final
class Material:
    """
    The maps of a material.

    ``fit_material`` and ``Material.load`` make materials; the constructor takes maps of your own, which are copied.

    Parameters
    ----------
    diffuse_albedo : ndarray of float, shape (H, W, 3), linear, 0 to 1
    specular_albedo : ndarray of float, shape (H, W, 3), linear, 0 to 1
        Reflectance at normal incidence (F0).
    roughness : ndarray of float, shape (H, W, 1) or (H, W), 0 to 1
        Perceptual roughness; shape (H, W, 2) along tangent and bitangent of an anisotropic material.
    normal : ndarray of float, shape (H, W, 3), -1 to 1
        Unit vectors, +x right, +y up, +z out of the surface.
    tangent : ndarray of float, shape (H, W, 3), -1 to 1, optional
        Unit vectors; for anisotropic materials only.
    patch_size : float
        Width of the maps in the unit of the positions given to `render`.
    unit : str, optional
        Name of that unit: mm, cm, m, in, or one of your own.

    Raises
    ------
    ShapeError
        If the maps differ in size.
    FormatError
        If they are not floats.
    ArgumentError
        If a value is not finite, an albedo or roughness outside 0 to 1 by more than 0.001 (values of 0 to 255), a normal's or tangent's length off by
        more than a tenth (a map that is still encoded), or `patch_size` not above 0.

    Examples
    --------
    >>> import numpy as np
    >>> grey, flat = np.full((4, 6, 3), 0.5), np.zeros((4, 6, 3)) + [0, 0, 1]
    >>> svbrdf_gcn.Material(grey, 0.08 * grey, grey[:, :, :1], flat, patch_size=10)
    <svbrdf_gcn.Material: 6 x 4 pixels, isotropic, patch 10 wide>
    """
    def __new__(cls, /, diffuse_albedo: ArrayLike, specular_albedo: ArrayLike, roughness: ArrayLike, normal: ArrayLike, tangent: ArrayLike | None = None, *, patch_size: SupportsFloat | SupportsIndex, unit: str | None = None) -> Material: ...
    def __repr__(self, /) -> str: ...
    def _repr_png_(self, /) -> bytes:
        """
        The maps side by side and a view under a light at the upper left, for notebooks.
        """
    @property
    def diffuse_albedo(self, /) -> NDArray[float32]:
        """
        Diffuse albedo: linear RGB from 0 to 1, a read-only array of shape (H, W, 3).
        """
    @property
    def diffuse_albedo_deviation(self, /) -> NDArray[float32] | None:
        """
        Standard deviation of the diffuse albedo (linear, root mean square over colours), a read-only array of shape (H, W, 1); None if not known.

        How often the truth lies within one such deviation is measured in ``docs/accuracy.md``.
        """
    def export(self, /, folder: str | PathLike[str], *, to: str, name: str = ..., normals: str | None = None, level: bool = ...) -> dict[str, Any]:
        """
        Write the material for another program.

        ``docs/exports.md`` describes the files.

        Parameters
        ----------
        folder : str or os.PathLike
            Made if it is not there.
        to : {"materialx", "gltf", "principled", "unreal"}
            MaterialX with an OpenPBR surface, glTF with KHR_materials_specular, maps for Blender's Principled BSDF, or
            maps for Unreal.
        name : str, default "material"
            What the material is called: letters, digits and underscores, a letter first.
        normals : {"opengl", "directx"}, optional
            Whether green points up or down; what the program expects if not given.
        level : bool, default True
            Take the tilt of the whole surface out of its normals, so that tiles of it make a plane.

        Returns
        -------
        dict
            The files written, and what the program cannot hold of the material; also in ``export.json``.

        Raises
        ------
        ArgumentError
            For another program or name, normals that the program does not take, and a file in the folder that no export wrote or that another
            export uses.
        OSError
            If a file cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> material = svbrdf_gcn.Material.load("samples/lambert/truth")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     report = material.export(folder, to="unreal", name="Wall")
        >>> report["target"], report["normals"]
        ('unreal', 'directx')
        """
    @property
    def height(self, /) -> int:
        """
        Rows of the maps.
        """
    def leveled(self, /) -> Material:
        """
        The material lying flat.

        A sample that did not lie flat in its capture leans. Without its `tilt`, tiles of the material make a plane.

        Returns
        -------
        Material
            With the report and the deviations of this one.

        Examples
        --------
        >>> level = svbrdf_gcn.Material.load("samples/tiles/truth").leveled()
        >>> max(abs(slope) for slope in level.tilt) < 1e-6
        True
        """
    @staticmethod
    def load(path: str | PathLike[str], *, encoding: str | None = None, patch_size: SupportsFloat | SupportsIndex | None = None, unit: str | None = None) -> Material:
        """
        Read a material: a folder with a ``material.json``, or maps of another program.

        Parameters
        ----------
        path : str or os.PathLike
            Folder, or, with an `encoding` that has them, image of several maps side by side.
        encoding : {"deschaintre2018", "deep-inverse-rendering", "materialgan", "svbrdf-diff-renderer"}, optional
            How maps without a ``material.json`` are stored; ``docs/materials.md`` describes these.
        patch_size : float, optional
            Width of maps without a ``material.json``; 1 if not given.
        unit : str, optional
            Unit of that width.

        Returns
        -------
        Material

        Raises
        ------
        OSError
            For files that are missing or broken.
        FormatError
            For maps whose encoding is not stated.
        ArgumentError, ShapeError
            For values out of range, and maps that differ in size.

        Examples
        --------
        >>> svbrdf_gcn.Material.load("samples/tiles/truth")
        <svbrdf_gcn.Material: 256 x 256 pixels, isotropic, patch 10 wide>
        """
    @property
    def normal(self, /) -> NDArray[float32]:
        """
        Unit normals, +x right, +y up, +z out of the surface: a read-only array of shape (H, W, 3).
        """
    @property
    def normal_deviation(self, /) -> NDArray[float32] | None:
        """
        Standard deviation of the normal, about an angle in radians: a read-only array of shape (H, W, 1); None if not known.
        """
    @property
    def patch_size(self, /) -> float:
        """
        Width of the maps in the unit of the capture.
        """
    def principled(self, /) -> Principled:
        """
        The material as Blender's Principled BSDF has it.

        Returns
        -------
        Principled

        Examples
        --------
        >>> principled = svbrdf_gcn.Material.load("samples/lambert/truth").principled()
        >>> principled.base_color.shape, principled.metallic.shape
        ((64, 64, 3), (64, 64, 1))
        """
    def render(self, /, camera: ArrayLike, light: ArrayLike, light_intensity: ArrayLike | None = None, *, size: SupportsIndex | None = None) -> NDArray[float32]:
        """
        Photo of the material under one camera and one light.

        The same forward model the fit uses.

        Parameters
        ----------
        camera : array_like of shape (3,)
            Position of the camera, in the unit of `patch_size`.
        light : array_like of shape (3,)
            Position of the light.
        light_intensity : float or array_like of shape (3,), optional
            A white matt patch at distance r has the radiance ``light_intensity / (pi * r**2)``. If not given, such a patch is
            white (1) at the centre.
        size : int, optional
            Longer side in pixels; maps are resampled by area, never enlarged.

        Returns
        -------
        ndarray of float32, shape (H, W, 3), linear RGB

        Raises
        ------
        ArgumentError
            For values that are not finite, camera or light not in front of the surface (z above 0), and a negative intensity.
        ShapeError
            For positions of another shape.

        Examples
        --------
        >>> material = svbrdf_gcn.Material.load("samples/tiles/truth")
        >>> photo = material.render([0, 0, 20], [-5, 5, 18], size=64)
        >>> photo.shape, photo.dtype.name
        ((64, 64, 3), 'float32')
        """
    @property
    def report(self, /) -> dict[str, Any]:
        """
        What the fit did (settings, stages, losses, errors of the photos, seconds); empty if there was none.
        """
    @property
    def roughness(self, /) -> NDArray[float32]:
        """
        Perceptual roughness from 0 to 1: a read-only array of shape (H, W, 1), or (H, W, 2) if anisotropic.
        """
    @property
    def roughness_deviation(self, /) -> NDArray[float32] | None:
        """
        Standard deviation of the roughness, a read-only array of shape (H, W, 1); None if not known.
        """
    def save(self, /, folder: str | PathLike[str], *, format: str = ..., color_space: str = ...) -> None:
        """
        Write the maps and ``material.json`` to a folder, which is made if it is not there.

        The files are those of the command line; ``docs/materials.md`` describes them. A material that is there is replaced as a whole, or, if the
        call fails, left as it was.

        Parameters
        ----------
        folder : str or os.PathLike
        format : {"exr", "png16", "tiff"}, default "exr"
            OpenEXR with half floats, PNG with 16 bits, or TIFF with single floats.
        color_space : {"rec709", "acescg"}, default "rec709"
            Colour space of the albedos written.

        Raises
        ------
        ArgumentError
            If a file of one of these names is there that svbrdf-gcn did not write.
        OSError
            If a file cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> material = svbrdf_gcn.Material.load("samples/tiles/truth")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     material.save(folder, format="tiff")
        ...     svbrdf_gcn.Material.load(folder)
        <svbrdf_gcn.Material: 256 x 256 pixels, isotropic, patch 10 wide>
        """
    @property
    def specular_albedo(self, /) -> NDArray[float32]:
        """
        Specular albedo (reflectance at normal incidence, F0): linear RGB from 0 to 1, a read-only array of shape (H, W, 3).
        """
    @property
    def specular_albedo_deviation(self, /) -> NDArray[float32] | None:
        """
        Standard deviation of the specular albedo (linear, root mean square over colours), a read-only array of shape (H, W, 1); None if not known.
        """
    @property
    def tangent(self, /) -> NDArray[float32] | None:
        """
        Unit tangents of an anisotropic material, a read-only array of shape (H, W, 3); else None.
        """
    @property
    def tilt(self, /) -> tuple[float, float]:
        """
        How the surface leans as a whole: the mean slopes of its normals towards +x and +y.
        """
    @property
    def unit(self, /) -> str | None:
        """
        Name of the unit of `patch_size`; None if it is not known.
        """
    @property
    def verdict(self, /) -> str | None:
        """
        What may be expected of the maps: "good", "usable" or "poor"; None if there was no fit. ``report["reasons"]`` says why it is not better and what
        to do, ``report["expected_error"]`` by how much a new photo would be missed.
        """
    @property
    def warnings(self, /) -> list[str]:
        """
        What a user should know: of loaded maps those that have changed since they were saved; of capture and fit.
        """
    @property
    def width(self, /) -> int:
        """
        Columns of the maps.
        """

@final
class Model:
    """
    Trained weights.

    Immutable: load them once and give them to as many fits as you like, from any thread.

    Examples
    --------
    >>> svbrdf_gcn.Model.load("no-such-file.safetensors")
    Traceback (most recent call last):
    FileNotFoundError: [Errno 2] No such file or directory: 'no-such-file.safetensors'
    """
    def __repr__(self, /) -> str: ...
    @staticmethod
    def embedded() -> Model:
        """
        The default network, which is part of the package and which a fit without ``weights`` takes.

        Returns
        -------
        Model

        Examples
        --------
        >>> svbrdf_gcn.Model.embedded().license
        'CC0-1.0'
        """
    @property
    def license(self, /) -> str:
        """
        The licence of the weights.
        """
    @staticmethod
    def load(path: str | PathLike[str]) -> Model:
        """
        Read a weights file.

        Parameters
        ----------
        path : str or os.PathLike
            A safetensors file; ``docs/weights.md`` tells where weights come from.

        Returns
        -------
        Model

        Raises
        ------
        OSError
            If the file cannot be read.
        WeightsError
            If it is damaged, of another version or of another model.

        Examples
        --------
        >>> try:
        ...     svbrdf_gcn.Model.load("README.md")
        ... except svbrdf_gcn.WeightsError as error:
        ...     print("not a weights file")
        not a weights file
        """
    @property
    def photos(self, /) -> list[int]:
        """
        The numbers of photos that there is a network for; a fit takes the one for the most photos it has. ``[1]`` for a photo graph,
        which takes any number of photos from one up.
        """

@final
class Principled:
    """
    The maps of a metallic surface under a dielectric coat that reflects, at normal incidence, what a material does.

    The sockets of Blender's Principled BSDF; ``Material.principled`` makes it. Arrays are read-only views, as those of ``Material``.

    Examples
    --------
    >>> principled = svbrdf_gcn.Material.load("samples/tiles/truth").principled()
    >>> sorted(principled.loss)
    ['diffuse', 'specular']
    """
    @property
    def anisotropic(self, /) -> NDArray[float32] | None:
        """
        Anisotropic, from 0 to 1, shape (H, W, 1); None for an isotropic material.
        """
    @property
    def anisotropic_rotation(self, /) -> NDArray[float32] | None:
        """
        Anisotropic Rotation: turns of the direction of the greater roughness, counter-clockwise from +x, shape (H, W, 1).
        """
    @property
    def base_color(self, /) -> NDArray[float32]:
        """
        Base Color: linear RGB from 0 to 1, shape (H, W, 3).
        """
    @property
    def ior(self, /) -> float:
        """
        IOR of the whole material.
        """
    @property
    def loss(self, /) -> dict[str, Any]:
        """
        How far diffuse and specular reflectance at normal incidence are from the material's: mean and max of each.
        """
    @property
    def metallic(self, /) -> NDArray[float32]:
        """
        Metallic, from 0 to 1, shape (H, W, 1).
        """
    @property
    def normal(self, /) -> NDArray[float32]:
        """
        Unit normals, +x right, +y up, +z out of the surface, shape (H, W, 3).
        """
    @property
    def roughness(self, /) -> NDArray[float32]:
        """
        Roughness, from 0 to 1, shape (H, W, 1).
        """
    @property
    def specular_level(self, /) -> NDArray[float32]:
        """
        Specular IOR Level, from 0 to 1, shape (H, W, 1).
        """
    @property
    def specular_tint(self, /) -> NDArray[float32]:
        """
        Specular Tint: linear RGB from 0 to 1, shape (H, W, 3).
        """

@final
class Progress:
    """
    Where a fit, or ``acquire``, stands; what the ``progress`` callback is given.

    Examples
    --------
    >>> seen = []
    >>> material = svbrdf_gcn.fit_material("samples/tiles", size=32, method="direct", direct_steps=5, progress=seen.append)
    >>> seen[-1].stage, seen[-1].step, seen[-1].steps
    ('direct', 5, 5)
    """
    def __repr__(self, /) -> str: ...
    @property
    def loss(self, /) -> float | None:
        """
        The loss before the last step, where the stage has one.
        """
    @property
    def stage(self, /) -> str:
        """
        The part that runs: ``acquire``; of a fit ``encode``, ``latent``, ``adapters``, ``direct`` or ``finish``.
        """
    @property
    def step(self, /) -> int:
        """
        Steps of the stage that are done.
        """
    @property
    def steps(self, /) -> int:
        """
        Steps that the stage takes at most.
        """

@final
class TrainingData:
    """
    Materials to train on, and captures of them as a network sees them; see docs/training.md.

    What a step sees follows from `seed` and the step's number alone. Any thread may ask; one at a time is served, while other Python threads run.

    Parameters
    ----------
    library : str or os.PathLike
        A pack of materials (``python -m svbrdf_gcn.training.pack``) or a folder of material folders.
    seed : int
        Of everything random.
    photos : iterable of float
        How often a batch has 1, 2, 3 ... photos, relatively.
    procedural : float
        Share of procedural materials in a batch, from 0 to 1.
    groups, per_group, refresh : int
        There are ``groups * per_group`` procedural materials; every `refresh` steps `per_group` of the oldest are replaced.
    size : int
        Side of a procedural material in pixels.
    captures : str
        ``"any"``: near and far with every defect; ``"near"``: a perfect camera; ``"real"``: far with every defect; ``"paper"``: as the synthetic literature.
    directions : bool
        Whether the network is shown where camera and light stood. Otherwise the planes that follow from positions are 0.
    views : int
        Renderings per capture that a loss compares.
    threads : int, optional
        All processors if not given.

    Raises
    ------
    ArgumentError
        For values out of range, and for materials that cannot be used.
    OSError
        If the library cannot be read.
    MemoryError
        If there is no room for it.

    Examples
    --------
    >>> from svbrdf_gcn.training import TrainingData  # doctest: +SKIP
    >>> data = TrainingData("data/materials.zip", seed=1, photos=[1, 1, 0, 2], procedural=0.45, groups=28, per_group=4,
    ...                     refresh=12, size=256, captures="any", directions=True, views=5)  # doctest: +SKIP
    >>> data.batch(0, count=4, size=96)["maps"].shape  # doctest: +SKIP
    (4, 10, 96, 96)
    """
    KINDS: Final[int]
    """
    How many kinds of procedural materials there are.
    """
    def __new__(cls, /, library: str | PathLike[str], *, seed: SupportsIndex, photos: Iterable[SupportsFloat | SupportsIndex], procedural: SupportsFloat | SupportsIndex, groups: SupportsIndex, per_group: SupportsIndex, refresh: SupportsIndex, size: SupportsIndex, captures: str, directions: bool, views: SupportsIndex, threads: SupportsIndex | None = None) -> TrainingData: ...
    def batch(self, /, step: SupportsIndex, count: SupportsIndex, size: SupportsIndex) -> dict[str, NDArray[float32]]:
        """
        What step `step` sees.

        Parameters
        ----------
        step : int
            From 0 on; the same number gives the same arrays.
        count : int
            Captures.
        size : int
            Side of their crops in pixels.

        Returns
        -------
        dict of str to ndarray
            Float32 arrays of the caller's own. A crop covers x and y from -1 to 1. ``inputs`` (count, photos, 13, size, size), what the network sees of every
            photo: the photo in gamma 2.2, 3; its ratio to a white surface in gamma 2.2, 3; saturation, 1; direction to the light, 3; half vector, 3.
            ``maps`` (count, 10, size, size): the true diffuse albedo, normal, roughness and specular albedo. ``shots`` (count, photos, 3, 3):
            camera, light and light intensity of every photo as stated; ``views`` (count, views, 3, 3): those of the renderings that a loss compares.

        Raises
        ------
        ArgumentError
            For a size or count out of range.
        MemoryError
            If there is no room.

        Examples
        --------
        >>> batch = data.batch(0, count=4, size=96)  # doctest: +SKIP
        """
    @property
    def facts(self, /) -> dict[str, Any]:
        """
        What the photographed materials are, and under which licences, as a weights file says it.
        """
    @property
    def held_out(self, /) -> list[str]:
        """
        Names of the materials held out, in the order of ``validation``.
        """
    @property
    def materials(self, /) -> int:
        """
        How many photographed materials there are to train on.
        """
    @staticmethod
    def procedural(seed: SupportsIndex, number: SupportsIndex, size: SupportsIndex) -> NDArray[float32]:
        """
        Maps of a procedural material, float32 of shape (10, size, size).

        Parameters
        ----------
        seed, number : int
            The same give the same material; ``TrainingData.KINDS`` kinds take turns.
        size : int
            Side in pixels.

        Returns
        -------
        ndarray
            Diffuse albedo 3, normal 3, roughness 1, specular albedo 3.

        Raises
        ------
        ArgumentError
            If `size` is out of its range.

        Examples
        --------
        >>> leather = TrainingData.procedural(1, number=8, size=128)  # doctest: +SKIP
        """
    def validation(self, /, captures: str, photos: SupportsIndex, size: SupportsIndex, first: SupportsIndex, count: SupportsIndex, views: SupportsIndex) -> dict[str, NDArray[float32]]:
        """
        Captures of held-out materials, whole and upright, always the same.

        Parameters
        ----------
        captures : str
            ``"near"``, ``"real"``, ``"paper"`` or ``"any"``, as for ``TrainingData``.
        photos : int
            Photos of each capture.
        size : int
            Side of a material in pixels.
        first, count : int
            Which of the materials held out.
        views : int
            Renderings that scores compare, the same for every material.

        Returns
        -------
        dict of str to ndarray
            As ``batch``.

        Raises
        ------
        ArgumentError
            For values out of range.
        MemoryError
            If there is no room.

        Examples
        --------
        >>> four = data.validation("real", photos=4, size=128, first=0, count=4, views=20)  # doctest: +SKIP
        """

def acquire(photos: Iterable[str | PathLike[str]], *, window: SupportsFloat | SupportsIndex | None = None, frame_width: SupportsFloat | SupportsIndex | None = None, printed_bar: SupportsFloat | SupportsIndex | None = None, depth: SupportsFloat | SupportsIndex = ..., size: SupportsIndex | None = None, light_offset: Iterable[SupportsFloat | SupportsIndex] | str | None = None, dark: str | PathLike[str] | None = None, paper_white: SupportsFloat | SupportsIndex = ..., corners: ArrayLike | None = None, patch_width: SupportsFloat | SupportsIndex | None = None, max_memory: SupportsIndex | str | None = None, progress: Callable[[Progress], object] | None = None, cancel: CancelToken | None = None) -> Acquisition:
    """
    Make a capture of photos that show the sample in the window of a printed sheet (``svbrdf-gcn sheet``, docs/capturing.md), or of which the patch's corners are known.

    Lengths are in millimetres. Photos that cannot be used are left out and named in the report with the reason.

    Parameters
    ----------
    photos : iterable of str or os.PathLike
        The photos' files.
    window : float, optional
        Width of the window of our own sheet; 100 if not given.
    frame_width : float, optional
        The photos show the frame of svbrdf-diff-renderer instead, this wide from outer edge to outer edge.
    printed_bar : float, optional
        Length of the sheet's bar of 100 mm as it was printed.
    depth : float, default 0
        How far the sample lies below the sheet's face.
    size : int, optional
        Side of the rectified photos in pixels, 16 to 16384; 1024 if not given. They are never finer than the photos.
    light_offset : iterable of float or "auto", optional
        Where the flash is, seen from the lens: to the right and up in photos as they were taken, before they were turned upright. At the lens if not given;
        found from the paper if ``"auto"``.
    dark : str or os.PathLike, optional
        A photo of the sheet without flash, exposed as the others: what it shows is subtracted.
    paper_white : float, default 0.8
        Diffuse albedo of the paper.
    corners : array_like of shape (N, 4, 2) or (N, 8), optional
        There is no sheet: for each photo the upper left, upper right, lower right and lower left corner of the sample's square patch, x and y in pixels of
        the photo as viewers show it. What is assumed then is in the report (``assumptions``).
    patch_width : float, optional
        Width of the patch whose corners are given.
    max_memory : int or str, optional
        Most bytes the work may use, such as ``4000000000`` or ``"2G"``; three quarters of the free memory if not given.
    progress : callable, optional
        Called on this thread with a ``Progress`` at most every 50 ms, and at the end. What it raises stops the work and comes out unchanged.
    cancel : CancelToken, optional
        Stops the work from any thread. So does Ctrl-C, with ``KeyboardInterrupt``.

    Returns
    -------
    Acquisition
        Its `capture` is what ``fit_material`` takes.

    Raises
    ------
    ArgumentError
        For options out of range, and if no photo can be used.
    OSError, FormatError
        For photos that cannot be read.
    MemoryError
        If the photos need more than `max_memory`.
    Cancelled
        If `cancel` was cancelled.

    Examples
    --------
    >>> try:
    ...     svbrdf_gcn.acquire(["samples/tiles/00.png"])
    ... except svbrdf_gcn.ArgumentError as error:
    ...     print("none can be used" in str(error))
    True
    """

def command_line(arguments: SupportsGetItem[int, str]) -> int:
    """
    Run the command line with `arguments`, the program's name first, and return its exit code.

    It takes over SIGINT: meant for a process of its own.
    """

def fit_material(capture_or_photos: Capture | str | PathLike[str] | ArrayLike | Iterable[ArrayLike | str | PathLike[str]], *, camera_positions: ArrayLike | None = None, light_positions: ArrayLike | None = None, patch_size: SupportsFloat | SupportsIndex | None = None, light_intensity: ArrayLike | None = None, transfer: str | None = None, color_space: str | None = None, ignore_profiles: bool = ..., size: SupportsIndex | None = None, views: Iterable[SupportsIndex] | None = None, white_level: SupportsFloat | SupportsIndex | None = None, preset: str = ..., method: str = ..., reflectance: str = ..., refine: str = ..., weights: Model | str | PathLike[str] | None = None, latent_steps: SupportsIndex | None = None, adapter_steps: SupportsIndex | None = None, direct_steps: SupportsIndex | None = None, finish_steps: SupportsIndex | None = None, max_memory: SupportsIndex | str | None = None, seed: SupportsIndex = ..., threads: SupportsIndex | None = None, early_stop: bool | None = None, progress: Callable[[Progress], object] | None = None, cancel: CancelToken | None = None) -> Material:
    """
    Recover the material that photos show.

    Other Python threads run meanwhile. Ctrl-C stops the fit with ``KeyboardInterrupt``.

    Parameters
    ----------
    capture_or_photos : Capture, path of a capture, array of shape (N, H, W, 3), or iterable of arrays or image paths
        A ``Capture``, or a path that ``Capture.open`` takes, brings its own positions; photos as arrays or image paths need
        `camera_positions`, `patch_size`, `light_intensity` and `transfer`, described at ``Capture``. The path of one photo, taken
        from straight above with the flash, is enough too: what is assumed then is among ``report["warnings"]``.
    camera_positions, light_positions, patch_size, white_level : optional
        See ``Capture``.
    light_intensity : optional
        See ``Capture``. With a path it replaces what the capture states, or what is chosen for one photo.
    transfer, color_space, ignore_profiles, size, views : optional
        See ``Capture`` and ``Capture.open``.
    preset : {"draft", "balanced", "high"}, default "balanced"
        How much time to spend.
    method : {"auto", "network", "direct"}, default "auto"
        How to get from photos to maps; auto: network.
    reflectance : {"auto", "diffuse", "dielectric", "isotropic", "anisotropic"}, default "auto"
        What the surface is taken to be made of; auto: the simplest that predicts photos left out as well as the others do. All maps come
        out in any case. A network of the paper's form takes ``"auto"`` alone.
    refine : {"auto", "none", "light", "all"}, default "auto"
        What of the capture's statements may be corrected: the light of each photo, or that and its position; auto: what predicts photos left out better.
    weights : Model, str or os.PathLike, optional
        Other weights than those built in.
    latent_steps, adapter_steps, direct_steps, finish_steps : int, optional
        Steps on the latent code, the adapters, the maps themselves, the per-pixel finish, instead of the preset's.
    max_memory : int or str, optional
        Most bytes the run may use, from the reading of photos on, such as ``4000000000`` or ``"2G"``; three quarters of the free memory if not given.
    seed : int, default 0
        Seed of everything random. The same seed and thread count give the same bits on the same processor.
    threads : int, optional
        Threads; all if not given.
    early_stop : bool, optional
        Stop a stage when its loss has flattened; on if not given.
    progress : callable, optional
        Called on this thread with a ``Progress`` at most every 50 ms, and at the end of a stage. What it raises stops the
        fit and comes out unchanged; what it returns is not looked at.
    cancel : CancelToken, optional
        Stops the fit, and the reading of photos before it, from any thread.

    Returns
    -------
    Material
        The maps; its `report` tells how they came about.

    Raises
    ------
    ArgumentError
        For options out of range, and arguments that are missing or given twice.
    ShapeError, FormatError, OSError
        For photos that cannot be read; see ``Capture``.
    WeightsError
        For weights that are broken, or need more photos.
    MemoryError
        If the run would need more than `max_memory`, before anything is computed.
    NonFiniteError
        If the loss is not finite from the start.
    Cancelled
        If `cancel` was cancelled.

    Examples
    --------
    >>> material = svbrdf_gcn.fit_material("samples/tiles", size=32, preset="draft", seed=7)
    >>> material.roughness.shape, material.report["method"]
    ((32, 32, 1), 'network')
    """

def map_errors(material: Material, truth: Material) -> dict[str, Any]:
    """
    Errors of a material's maps against the true ones.

    Parameters
    ----------
    material, truth : Material

    Returns
    -------
    dict
        ``diffuse``, ``specular`` and ``roughness``: RMSE of the ``linear`` and of the ``gamma22`` encoded values; ``normal``: RMSE
        of (n + 1) / 2; ``normal_angle_deg``: mean angle between the normals.

    Raises
    ------
    ShapeError
        If the maps differ in size.

    Examples
    --------
    >>> truth = svbrdf_gcn.Material.load("samples/tiles/truth")
    >>> svbrdf_gcn.metrics.map_errors(truth, truth)["diffuse"]
    {'gamma22': 0.0, 'linear': 0.0}
    """

def photo_errors(material: Material, capture: Capture) -> list[float]:
    """
    Errors of a material against the photos of a capture, as the literature has them.

    The material is rendered as each photo was taken; then ``photo_rmse``.

    Parameters
    ----------
    material : Material
        Of the size of the photos. It must show the same patch: widths in known units (mm, cm, m, in) are converted; where a unit is not
        stated the numbers must agree.
    capture : Capture

    Returns
    -------
    list of float
        One for each photo.

    Raises
    ------
    ArgumentError
        If the patches differ in width, or their units cannot be converted.
    ShapeError
        If the sizes differ.

    Examples
    --------
    >>> capture = svbrdf_gcn.Capture.open("samples/lambert", views=[0, 1])
    >>> truth = svbrdf_gcn.Material.load("samples/lambert/truth")
    >>> [error < 0.02 for error in svbrdf_gcn.metrics.photo_errors(truth, capture)]
    [True, True]
    """

def photo_rmse(rendering: ArrayLike, photo: ArrayLike) -> float:
    """
    Error of a re-rendered photo, as the literature has it.

    Root mean square over all values, encoded with gamma 2.2 and clamped to the range from 0 to 1.

    Parameters
    ----------
    rendering, photo : ndarray of float, shape (H, W, 3), linear RGB

    Returns
    -------
    float

    Raises
    ------
    ShapeError
        If the shapes differ.
    FormatError
        If the arrays are not floats.

    Examples
    --------
    >>> import numpy as np
    >>> round(svbrdf_gcn.metrics.photo_rmse(np.full((4, 4, 3), 0.25), np.zeros((4, 4, 3))), 4)
    0.5325
    """
