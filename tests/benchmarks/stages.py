"""Time and memory of every stage against voxels and elements, each as a user would call it.

    python tests/benchmarks/stages.py [--case CASE] [--sizes 4,2.5] [--elements tet4,tet10]

Without --case a synthetic subject is made. Each stage is a process of its own; wall and processor time
and the peak of its memory are the operating system's. Prints a table.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Cost:
    """wall_s, processor_s, peak_gb of one process and its children."""

    wall_s: float
    processor_s: float
    peak_gb: float


def measured(arguments: list[str]) -> Cost:
    """Run `limbcli` with these arguments.

    Raises
    ------
    SystemExit
        If the command fails, with what it printed.
    """
    begun = time.perf_counter()
    with tempfile.TemporaryFile() as output:
        child = subprocess.Popen([sys.executable, "-m", "limbcli", *arguments], stdout=output, stderr=output)
        _, status, usage = os.wait4(child.pid, 0)
        if status:
            output.seek(0)
            sys.exit(f"limbcli {' '.join(arguments)}:\n{output.read().decode()}")
    wall = time.perf_counter() - begun
    return Cost(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**20)


def size_of(out: Path, stage: str, site: str) -> str:
    """Voxels of the image, or elements of the mesh, that the stage worked on."""
    if stage == "segment":
        image = json.loads((out / "segment" / "segment.json").read_text())["data"]["image"]
        return f"{image['matrix'][0] * image['matrix'][1] * image['n_slices']:,} voxels"
    quality = json.loads((out / "mesh" / site / "mesh.json").read_text())["data"]["quality"]
    return f"{quality['n_cells']:,} cells"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--case", type=Path)
    parser.add_argument("--site", default="p1")
    parser.add_argument("--sizes", default="4,2.5")
    parser.add_argument("--elements", default="tet4,tet10")
    options = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with tempfile.TemporaryDirectory() as folder:
        case, out = options.case, Path(folder) / "out"
        if case is None:
            case = Path(folder) / "subject"
            measured(["phantom", str(case), "--seed", "7", "--max-force-n", "10", "-q"])
        print(f"{'stage':12s} {'size':>20s} {'element':8s} {'wall s':>8s} {'CPU s':>8s} {'peak GB':>8s}")

        def line(stage: str, *more: str, element: str = "") -> None:
            cost = measured([stage, str(case), "--out", str(out), "-q", *more])
            print(
                f"{stage:12s} {size_of(out, stage, options.site):>20s} {element:8s} {cost.wall_s:8.1f} "
                f"{cost.processor_s:8.1f} {cost.peak_gb:8.2f}",
                flush=True,
            )

        line("segment")
        site = ["--site", options.site]
        for element in options.elements.split(","):
            for size in options.sizes.split(","):
                line("mesh", *site, "--element", element, "--size-mm", size, element=element)
                line("build-feb", *site, element=element)
                line("run", *site, element=element)
                line("fit", *site, "--no-intervals", element=element)
                line("diagnose", *site, element=element)
        line("report")


if __name__ == "__main__":
    main()
