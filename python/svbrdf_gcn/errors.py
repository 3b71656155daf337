"""What functions of this package raise besides ``OSError`` and ``MemoryError``.

Every class has the built-in exception that fits as a second base, so ``except ValueError`` works as well as
``except SvbrdfError``. Messages name the argument and both values.

>>> import svbrdf_gcn
>>> try:
...     svbrdf_gcn.fit_material("samples/tiles", preset="fast")
... except ValueError as error:
...     print(type(error).__name__, error)
ArgumentError preset: expected draft, balanced or high, got 'fast'
"""

__all__ = [
    "ArgumentError",
    "BrokenFileError",
    "Cancelled",
    "FormatError",
    "NonFiniteError",
    "ShapeError",
    "SvbrdfError",
    "WeightsError",
]


class SvbrdfError(Exception):
    """Base of all of these."""


class ArgumentError(SvbrdfError, ValueError):
    """A value out of its range, or arguments that contradict each other."""


class ShapeError(SvbrdfError, ValueError):
    """Shapes that do not fit."""


class FormatError(SvbrdfError, TypeError):
    """A data type, file format or colour space that is not read."""


class WeightsError(SvbrdfError, ValueError):
    """A weights file that is corrupt, of another version, or of another model."""


class BrokenFileError(SvbrdfError, OSError):
    """A file that is truncated or damaged, or a folder in place of a file.

    ``filename`` names it and ``strerror`` says what is wrong; ``errno`` is None, for the system had no objection.
    """

    def __str__(self):
        return f"{self.strerror}: {self.filename!r}"


class NonFiniteError(SvbrdfError, ArithmeticError):
    """NaN or infinity in the loss or the maps."""


class Cancelled(SvbrdfError):
    """A cancel token asked to stop; nothing is wrong."""
