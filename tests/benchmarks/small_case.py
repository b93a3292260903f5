"""The smallest case that every command can work on, a limb of two prisms, and how to call them on it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import meshio

from tests.stages.test_mesh import CASE, prism

COMMANDS = {
    "segment": (),
    "mesh": ("--size-mm", "5", "--far-size-mm", "12"),
    "build-feb": (),
    "run": ("--solver", "reference"),
    "fit": ("--solver", "reference"),
    "diagnose": ("--effects", "force-zero", "--no-interventions", "--size-mm", "6"),
    "report": (),
    "batch": ("--solver", "reference"),
}
_LEVELS = ((0.0, 0.0, 1.6), (1.0, 1.0, 1.7), (2.0, 1.9, 1.9), (4.0, 3.0, 2.1))
_MARK = "LIMBCLI_BENCHMARK"  # in the environment of all that is started, and so of what they start


def write_case(folder: Path, *, subject: str = "S1", softer: float = 1.0) -> Path:
    """A limb of radius 30 mm with one bone and one site, measured at four levels.

    softer : factor on the depths, so that cases differ
    """
    folder.mkdir(parents=True)
    for name, body in (("skin", prism(30.0, -60, 60)), ("tibia", prism(9.0, -70, 70, x=4.0))):
        mesh = meshio.Mesh(body.points, [("triangle", body.faces.astype("int32"))])
        mesh.write(folder / f"{name}.ply")
    rows = [f"{force},{softer * depth:.4f},{speed},0.1,100" for force, depth, speed in _LEVELS]
    head = "force_n,depth_mm,swe_mean_m_per_s,swe_sd_m_per_s,swe_pixels"
    (folder / "levels.csv").write_text("\n".join([head, *rows]) + "\n")
    start, first, _ = CASE.replace('id = "S1"', f'id = "{subject}"').split("[[site]]")
    noise = "[site.noise]\nforce_n = 0.1\ndepth_mm = 0.2\n"
    (folder / "case.toml").write_text(f"{start}[[site]]{first}{noise}")
    return folder


def start(words: list[str], *, scratch: Path, mark: str, log: Path) -> subprocess.Popen[bytes]:
    """`limbcli` with these words; its temporary files go to `scratch`, what it says to `log`."""
    scratch.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, "TMPDIR": str(scratch), _MARK: mark, "OMP_NUM_THREADS": "1"}
    environment |= {"OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    with log.open("ab") as stream:
        return subprocess.Popen(
            [sys.executable, "-m", "limbcli", *words],
            env=environment, stdout=stream, stderr=stream, stdin=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip


def family(mark: str) -> dict[int, int]:
    """Processes started with this mark and their descendants, also orphans: resident memory (bytes) by id."""
    sought, found = f"{_MARK}={mark}\0".encode(), {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            if sought in (entry / "environ").read_bytes() + b"\0":
                pages = int((entry / "statm").read_text().split()[1])
                if pages:  # none: it has ended, and its parent has not looked yet
                    found[int(entry.name)] = pages * os.sysconf("SC_PAGE_SIZE")
        except (OSError, IndexError):  # ended meanwhile, or another user's
            continue
    return found
