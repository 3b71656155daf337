# SPDX-License-Identifier: GPL-3.0-or-later
"""Material from flash photos: the Blender side of svbrdf_gcn.

The work is done by the `svbrdf_gcn` wheel that the extension brings along; the modules here translate:

- `settings`: what the user chooses, kept in the scene
- `job`: a fit on a thread of its own (knows nothing of Blender)
- `images`: pixels in and out of Blender's images
- `material`: maps to a node group around the Principled BSDF
- `corners`: a patch's corners, clicked in the image editor
- `operators`, `panels`: buttons
"""

from . import corners, operators, panels, settings

MODULES = (settings, operators, corners, panels)


def register():
    for module in MODULES:
        module.register()


def unregister():
    for module in reversed(MODULES):
        module.unregister()
