"""How far a rendering is from a photo, and maps from the true ones."""

from ._svbrdf_gcn import map_errors, photo_errors, photo_rmse

__all__ = ["map_errors", "photo_errors", "photo_rmse"]
