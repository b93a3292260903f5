"""Read OFF surfaces: points and polygons, with or without normals, colours and texture coordinates.

Format: Geomview manual, "OFF: a Polyhedra Format" (OFF, COFF, NOFF, CNOFF, STOFF, 4OFF as text). Each point
and each face stands on a line of its own, as all programs write it; what follows them there is left out.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from limbcli.model import Array, IntArray

_KEYWORD = re.compile(r"(ST)?C?N?(4)?(n)?OFF(\s+BINARY)?\b")


def read_off(path: Path) -> tuple[Array, list[IntArray]]:
    """Points (n, 3) as in the file, and its polygons by their number of corners.

    Raises OSError if it is not an OFF file as text, has more than three dimensions, or ends early.
    """
    content = path.read_bytes().decode("latin-1")
    lines = [line for each in content.splitlines() if (line := each.partition("#")[0].strip())]
    keyword = _KEYWORD.match(lines[0]) if lines else None
    if keyword is None:
        raise OSError("it does not begin with OFF")
    if keyword[3] or keyword[4]:
        raise OSError(f"its form {keyword[0]} is not read, only OFF as text in three dimensions")
    lines[0] = lines[0][keyword.end() :].strip()
    words = [line.split() for line in lines if line]
    n_points, n_faces = int(words[0][0]), int(words[0][1])
    if min(n_points, n_faces) < 0 or len(words) < 1 + n_points + n_faces:
        raise OSError("it ends before all that its header tells of, or several points share a line")
    n = 4 if keyword[2] else 3
    points = np.array([each[:n] for each in words[1 : 1 + n_points]] or np.zeros((0, n)), np.float64)
    if keyword[2]:
        points = points[:, :3] / points[:, 3:]
    polygons: dict[int, list[list[str]]] = {}
    for row in words[1 + n_points : 1 + n_points + n_faces]:
        count = int(row[0])
        if len(row) < 1 + count:
            raise OSError(f"a face has fewer corners than the {count} that it states")
        if count > 2:
            polygons.setdefault(count, []).append(row[1 : 1 + count])
    return points, [np.array(each, np.int64) for each in polygons.values()]
