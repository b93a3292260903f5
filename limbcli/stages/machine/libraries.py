"""System libraries needed by packages with compiled parts, and the Debian packages that provide them.

Each package is tried in a separate process, because a missing library or an unsupported processor can
terminate a process without an error message.
"""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

DEBIAN: Mapping[str, str] = {
    "libGL.so.1": "libgl1", "libGLX.so.0": "libglx0", "libGLdispatch.so.0": "libglvnd0",
    "libOpenGL.so.0": "libopengl0", "libEGL.so.1": "libegl1", "libGLU.so.1": "libglu1-mesa",
    "libX11.so.6": "libx11-6", "libXext.so.6": "libxext6", "libXrender.so.1": "libxrender1",
    "libXau.so.6": "libxau6", "libXdmcp.so.6": "libxdmcp6", "libSM.so.6": "libsm6", "libICE.so.6": "libice6",
    "libxcb.so.1": "libxcb1", "libxkbcommon.so.0": "libxkbcommon0", "libbsd.so.0": "libbsd0",
    "libmd.so.0": "libmd0", "libglib-2.0.so.0": "libglib2.0-0", "libgthread-2.0.so.0": "libglib2.0-0",
    "libdbus-1.so.3": "libdbus-1-3", "libfontconfig.so.1": "libfontconfig1",
    "libfreetype.so.6": "libfreetype6", "libpng16.so.16": "libpng16-16", "libexpat.so.1": "libexpat1",
    "libgomp.so.1": "libgomp1", "libgmp.so.10": "libgmp10", "libffi.so.8": "libffi8",
    "libp11-kit.so.0": "libp11-kit0", "libgpg-error.so.0": "libgpg-error0", "libcom_err.so.2": "libcom-err2",
    "libz.so.1": "zlib1g", "libstdc++.so.6": "libstdc++6", "libgcc_s.so.1": "libgcc-s1",
}  # fmt: skip
"""The package of Debian 12 (and contemporary Ubuntu) that contains each library."""

_TIME_LIMIT_S = 60.0
_LIBRARY = re.compile(r"(lib[\w.+-]+\.so(?:\.\d+)*)")
# Minimal code for each package that exercises what limbcli uses of it.
TRIALS: Mapping[str, str] = {
    "pymeshlab": """
import numpy as np, pymeshlab
meshes = pymeshlab.MeshSet(verbose=False)
corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
meshes.add_mesh(pymeshlab.Mesh(corners, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.int32)))
meshes.meshing_isotropic_explicit_remeshing(iterations=1, targetlen=pymeshlab.PureValue(0.5))
assert meshes.current_mesh().face_number() > 4
""",
    "tetgen": """
import numpy as np, tetgen
corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
tetgen.TetGen(corners, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])).tetrahedralize()
""",
    "manifold3d": "import manifold3d; assert manifold3d.Manifold.cube().volume() == 1.0",
    "matplotlib": """
import io, matplotlib
matplotlib.use("Agg")
from matplotlib.figure import Figure
stream = io.BytesIO()
figure = Figure(); figure.text(0.5, 0.5, "f"); figure.savefig(stream, format="png")
assert stream.getvalue()[:4] == b"\\x89PNG"
""",
}
PURPOSES = {
    "pymeshlab": "surfaces",
    "tetgen": "volume meshes",
    "manifold3d": "cutting of solids",
    "matplotlib": "rendering of pictures",
}


@dataclass(frozen=True)
class LibraryTrial:
    """Whether a package works on this machine; if not, the reason and the missing libraries."""

    package: str
    works: bool
    why: str = ""
    missing: tuple[str, ...] = ()


def start(package: str) -> subprocess.Popen[str]:
    """Start a trial; several can run in parallel."""
    return subprocess.Popen(
        [sys.executable, "-c", TRIALS[package]],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip


def end(package: str, process: subprocess.Popen[str]) -> LibraryTrial:
    """Wait for a trial and return its outcome; it is stopped if it exceeds the time limit."""
    try:
        output, _ = process.communicate(timeout=_TIME_LIMIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        return LibraryTrial(package, False, f"it did not answer within {_TIME_LIMIT_S:g} s")
    if process.returncode == 0:
        return LibraryTrial(package, True)
    last = next((line for line in reversed(output.splitlines()) if line.strip()), "")
    why = last or f"it ended with status {process.returncode} and no message"
    named = _LIBRARY.findall(why) if "cannot open shared object" in why else []
    return LibraryTrial(package, False, why, tuple(dict.fromkeys([*named, *missing_libraries(package)])))


def missing_libraries(package: str) -> tuple[str, ...]:
    """Names of the libraries that the package's compiled parts need but the system lacks."""
    spec = importlib.util.find_spec(package)
    if spec is None or spec.origin is None or shutil.which("ldd") is None:
        return ()
    whole = Path(spec.origin).parent if spec.submodule_search_locations else None
    found = whole.rglob("*.so*") if whole else [Path(spec.origin)]
    parts = sorted(str(path) for path in found if path.is_file() and ".so" in path.suffixes)
    if not parts:
        return ()
    try:
        output = subprocess.run(
            ["ldd", *parts], capture_output=True, text=True, timeout=_TIME_LIMIT_S, check=False
        ).stdout
    except (OSError, subprocess.TimeoutExpired):
        return ()
    return not_found(output)


def not_found(output: str) -> tuple[str, ...]:
    """The libraries that `ldd` did not find.

    >>> not_found("/a.so:\\n\\tlibGL.so.1 => not found\\n\\tlibc.so.6 => /lib/libc.so.6 (0x00007f)\\n")
    ('libGL.so.1',)
    """
    lines = (line.strip() for line in output.splitlines())
    return tuple(sorted({line.split(" => ")[0] for line in lines if line.endswith("=> not found")}))


def remedy(libraries: tuple[str, ...]) -> str:
    """The command that installs them on Debian and Ubuntu, and what to look for on other systems.

    >>> remedy(("libGL.so.1", "libodd.so.2"))
    'apt-get install libgl1; and the package of your system that holds libodd.so.2'
    """
    known = sorted({DEBIAN[each] for each in libraries if each in DEBIAN})
    others = [each for each in libraries if each not in DEBIAN]
    words = [f"apt-get install {' '.join(known)}"] if known else []
    if others:
        words.append(f"the package of your system that holds {', '.join(others)}")
    return "; and ".join(words)
