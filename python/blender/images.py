# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels in and out of Blender's images, whose rows go from the bottom up and whose values are RGBA in one flat list."""

import bpy
import numpy as np

# What Blender calls the working space of an untouched configuration. Where a configuration has no such space, the scene's role stands in.
LINEAR = ("Linear Rec.709", "scene_linear")
DATA = ("Non-Color",)


def read(image):
    """Pixels of an image as they are stored.

    Returns
    -------
    pixels : ndarray, shape (H, W, 3), row 0 at the top
        uint8 for 8-bit images, encoded as stored; float32 for others, linear.
    """
    width, height = image.size
    if width == 0 or height == 0:
        raise ValueError(f"{image.name}: the image has no pixels (is its file missing?)")
    flat = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(flat)
    pixels = flat.reshape(height, width, image.channels)[::-1]
    if image.channels < 3:
        pixels = np.repeat(pixels[..., :1], 3, axis=-1)
    pixels = pixels[..., :3]
    if image.is_float:
        return np.ascontiguousarray(pixels)
    return np.round(pixels * 255).astype(np.uint8)


def write(name, values, color_spaces):
    """A packed float image that holds `values` of shape (H, W) or (H, W, 1 to 3); replaces an image that this function made under that name."""
    values = values if values.ndim == 3 else values[..., None]
    image = bpy.data.images.new(name, values.shape[1], values.shape[0], alpha=False, float_buffer=True)
    set_color_space(image, color_spaces)
    fill(image, values)
    image.pack()
    return image


def show(name, values):
    """An image to look at for a while, of linear `values` of shape (H, W, 3)."""
    image = bpy.data.images.new(name, values.shape[1], values.shape[0], alpha=False)
    linear = np.clip(values, 0, 1)
    fill(image, np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055))
    return image


def fill(image, values):
    """Give the image `values` of shape (H, W, 1 to 3), as it stores them."""
    height, width, channels = values.shape
    rgba = np.ones((height, width, 4), np.float32)
    if channels == 1:
        rgba[..., :3] = values[::-1]
    else:
        rgba[..., 2] = 0
        rgba[..., :channels] = values[::-1]
    image.pixels.foreach_set(rgba.ravel())
    image.update()


def set_color_space(image, names):
    """Give the image the first of these colour spaces that this Blender's configuration has."""
    for name in names:
        try:
            image.colorspace_settings.name = name
            return
        except TypeError:
            continue
    raise ValueError(f"{image.name}: the colour configuration has none of the spaces {', '.join(names)}")
