"""One file per format of surfaces: points and polygons as the file holds them, in its own frame and unit.

`limbcli.surface_formats.triangle_files` chooses among them.
"""
