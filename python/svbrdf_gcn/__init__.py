"""Materials (SVBRDF maps) from flash photos.

>>> import svbrdf_gcn
>>> material = svbrdf_gcn.fit_material("samples/tiles", size=32, preset="draft")
>>> material.diffuse_albedo.shape
(32, 32, 3)

Images are float32 arrays of shape (height, width, channels), row 0 at the top, linear. Positions are in the unit of the
capture: the sample lies centred in the plane z = 0, x to the right, y up, z towards the camera.
"""

from . import errors, metrics
from ._svbrdf_gcn import (
    Acquisition,
    CancelToken,
    Capture,
    Material,
    Model,
    Principled,
    Progress,
    __version__,
    acquire,
    fit_material,
)
from .errors import (
    ArgumentError,
    BrokenFileError,
    Cancelled,
    FormatError,
    NonFiniteError,
    ShapeError,
    SvbrdfError,
    WeightsError,
)

__all__ = [
    "Acquisition",
    "ArgumentError",
    "BrokenFileError",
    "CancelToken",
    "Cancelled",
    "Capture",
    "FormatError",
    "Material",
    "Model",
    "NonFiniteError",
    "Principled",
    "Progress",
    "ShapeError",
    "SvbrdfError",
    "WeightsError",
    "__version__",
    "acquire",
    "errors",
    "fit_material",
    "metrics",
]
