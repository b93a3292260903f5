"""One file per format of surfaces: points and polygons as the file holds them, in its own frame and unit.

`limbcli.triangle_files` chooses among them.
"""
