"""Run volume meshers in a separate process, so that a crash or a runaway does no harm.

`python -m limbcli.meshing.mesher_process MESHER FOLDER PARENT` reads FOLDER/in.npz and writes FOLDER/out.npz
or FOLDER/error.txt; it is killed when PARENT, the process that started it, ends.
"""

from __future__ import annotations

import errno
import importlib.util
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from limbcli.errors import MeshError, ToolError
from limbcli.files.temporary_folders import end_with_parent, scratch_folder
from limbcli.model import Array, IntArray

_NO_ROOM = 75  # exit status of the process if the disk is full; no mesher uses it
_FIX = "use another size (--size-mm), or repair the surfaces"


def in_process(
    mesher: str, points: Array, faces: IntArray, options: dict[str, Any], *, time_limit_s: float
) -> tuple[Array, IntArray]:
    """Nodes (n, 3) and tetrahedra (m, 4) from a closed surface; a mesher that was killed is run once more.

    Raises MeshError if the mesher refuses the surface, crashes, or runs out of time; ToolError if the mesher
    is not installed; OSError if the temporary folder is full.
    """
    with scratch_folder() as folder:
        np.savez(folder / "in.npz", points=points, faces=faces, options=json.dumps(options))
        command = [sys.executable, "-m", __name__, mesher, str(folder), str(os.getpid())]
        status = _run(mesher, command, folder, time_limit_s)
        # Not the mesher's fault; falling back to another method would silently produce another mesh.
        if status == -getattr(signal, "SIGKILL", 9):
            status = _run(mesher, command, folder, time_limit_s)
        message = folder / "error.txt"
        if message.is_file():
            kind, _, text = message.read_text().partition("\n")
            if kind == "ImportError":
                raise ToolError(
                    f"{mesher} is not installed ({text})", where="volume mesh", fix=f"pip install {mesher}"
                )
            raise MeshError(f"{mesher} rejected the surface: {text}", where="volume mesh", fix=_FIX)
        if status == _NO_ROOM:  # as above: another method would need more space, or produce another mesh
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))
        if status or not (folder / "out.npz").is_file():
            raise MeshError(f"{mesher} crashed (status {status})", where="volume mesh", fix=_FIX)
        with np.load(folder / "out.npz") as out:
            return out["nodes"].astype(float), out["cells"].astype(np.int64)


def _run(mesher: str, command: list[str], folder: Path, time_limit_s: float) -> int:
    """Exit status of the mesher; if negative, the signal that ended it."""
    try:
        return subprocess.run(
            command, capture_output=True, timeout=time_limit_s, check=False, cwd=folder, env=_environment()
        ).returncode
    except subprocess.TimeoutExpired as error:
        raise MeshError(
            f"{mesher} ran out of time ({time_limit_s:g} s)", where="volume mesh", fix=_FIX
        ) from error


def _environment() -> dict[str, str]:
    """Our environment, with this package first on the path (the mesher runs in a temporary folder)."""
    package = str(Path(__file__).resolve().parents[2])
    path = os.environ.get("PYTHONPATH")
    return {**os.environ, "PYTHONPATH": f"{package}{os.pathsep}{path}" if path else package}


def _tetgen(points: Array, faces: IntArray, options: dict[str, Any]) -> tuple[Array, IntArray]:
    """options : those of `tetrahedralize`; "holes" (n, 3): a point in each void"""
    import tetgen

    maker = tetgen.TetGen(points, faces.astype(np.int32))
    for each in options.pop("holes", ()):
        maker.add_hole(each)
    out = maker.tetrahedralize(
        nobisect=True, quiet=True, nowarning=True, nomergefacet=True, opt_max_flip_level=9, opt_scheme=7,
        opt_iterations=5, **options,
    )  # fmt: skip
    return np.array(out[0], float), np.array(out[1], np.int64)


def _pytetwild(points: Array, faces: IntArray, options: dict[str, Any]) -> tuple[Array, IntArray]:
    """options : those of `pytetwild.tetrahedralize`; "sizes" (n, 4): x, y, z and the edge length there"""
    from scipy.spatial import Delaunay

    if importlib.util.find_spec("pyvista") is None:
        # pytetwild (0.4) does not need pyvista here, but imports it.
        sys.modules["pyvista"] = ModuleType("pyvista")
    import pytetwild

    sizes = np.array(options.pop("sizes", ()), float)
    if len(sizes):
        grid = Delaunay(sizes[:, :3])
        options |= {"bg_vertices": sizes[:, :3], "bg_tets": grid.simplices, "bg_values": sizes[:, 3]}
    nodes, cells = pytetwild.tetrahedralize(points, faces.astype(np.int32), **options)[:2]
    return np.array(nodes, float), np.array(cells, np.int64)


MESHERS = {"tetgen": _tetgen, "pytetwild": _pytetwild}


def main(mesher: str, folder: Path) -> None:
    """Run one mesher on the folder's input."""
    with np.load(folder / "in.npz") as given:
        points, faces, options = given["points"], given["faces"], json.loads(str(given["options"]))
    try:
        nodes, cells = MESHERS[mesher](points, faces, options)
    except ImportError as error:
        (folder / "error.txt").write_text(f"ImportError\n{error}")
    except (RuntimeError, ValueError, MemoryError) as error:
        (folder / "error.txt").write_text(f"{type(error).__name__}\n{error}")
    else:
        try:
            np.savez(folder / "out.npz", nodes=nodes, cells=cells)
        except OSError as error:
            sys.exit(_NO_ROOM if error.errno in (errno.ENOSPC, errno.EDQUOT) else 1)


if __name__ == "__main__":
    end_with_parent(int(sys.argv[3]))
    main(sys.argv[1], Path(sys.argv[2]))
