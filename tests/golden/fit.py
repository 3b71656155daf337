"""The fit of compare.py in Python: fit.py CAPTURE OUT FORMAT"""

import sys

import svbrdf_gcn

capture, out, image_format = sys.argv[1:]
material = svbrdf_gcn.fit_material(capture, size=48, views=[6, 0, 2, 4], preset="draft", seed=7, threads=2)
material.save(out, format=image_format)
