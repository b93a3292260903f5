"""Stages that leave a small result at once, in the place of the real ones: a preload of Dask workers.

What befalls them is said by empty files in the case folder: `fail-mesh-p2` (an error that was foreseen),
`fault-mesh-p2` (one that was not), `wait-mesh-p2` (the first process that gets there stays for long, its
number in `at-mesh-p2`), `crash-mesh-p2` (every process that gets there is killed). Every beginning and end of
a stage is a line of `log.txt` there.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from limbcli.case import Case, Site
from limbcli.errors import MeshError
from limbcli.provenance.chain_inputs import noted
from limbcli.results import open_stage, read_result

FILES = {"report": "report.html", "build-feb": "model.feb"}
STAGES = ("segment", "mesh", "build-feb", "run", "fit", "report")
OPTIONS = ("FitOptions", "MeshRequest", "RunOptions", "SegmentOptions", "TissueOptions")
EARLIER = {"mesh": "segment", "build-feb": "mesh", "run": "build-feb", "fit": "run"}


@dataclass(frozen=True)
class Options:
    """Of any stage."""

    templates: Path | None = None
    solver: str = "auto"
    febio: Path | None = None


def in_one_place(case: Case, sites: Sequence[Site], *, out: Path) -> list[list[Site]]:
    """All of them, unless the case has a file `apart`."""
    return [[each] for each in sites] if (case.folder / "apart").exists() else [list(sites)]


def reported(case: Path, word: str, label: str) -> None:
    handle = os.open(case / "log.txt", os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(handle, f"{word} {label} {os.getpid()}\n".encode())
    os.close(handle)


WAIT_S = 900.0  # longer than any test waits for a batch to end


def befalls(case: Path, label: str) -> None:
    name = label.replace(" ", "-")
    if (case / f"wait-{name}").exists() and not (case / f"at-{name}").exists():
        (case / f"at-{name}.new").write_text(str(os.getpid()))
        (case / f"at-{name}.new").rename(case / f"at-{name}")
        time.sleep(WAIT_S)
    if (case / f"pause-{name}").exists():
        time.sleep(3.0)
    if (case / f"crash-{name}").exists():
        os.kill(os.getpid(), signal.SIGKILL)
    if (case / f"fail-{name}").exists():
        raise MeshError("no skin under the probe", where=label, fix="move it")
    if (case / f"fault-{name}").exists():
        raise RuntimeError("of all things")


def quick(stage: str) -> Any:
    def work(case: Case, *, out: Path, sites: Any = (None,), progress: Any, **_: Any) -> None:
        for site in sites:
            label = f"{stage} {site}" if site else stage
            progress.event("stage", name=stage, site=site)
            reported(case.folder, "begin", label)
            with open_stage(out, stage, subject=case.subject, site=site) as writer:
                writer.file("half", "half.txt").write_text("the first half")
                befalls(case.folder, label)
                name = "page" if stage == "report" else "text"
                writer.file(name, FILES.get(stage, "a.txt")).write_text(f"whole {label}")
                writer.data["threads"] = os.environ.get("OMP_NUM_THREADS")
                assert noted(case, writer).probe
                if stage in EARLIER:
                    before = read_result(out, EARLIER[stage], site=None if stage == "mesh" else site)
                    writer.used_result(before, files=["text"])
            reported(case.folder, "end", label)

    return work


def dask_setup(worker: Any) -> None:
    """Called by Dask before the worker takes work."""
    for stage in STAGES:
        name = stage.replace("-", "_")
        own = {name: quick(stage), "edited_labels": lambda out: None}
        options = dict.fromkeys(OPTIONS, Options)
        sys.modules[f"limbcli.stages.{name}"] = SimpleNamespace(**own, **options)  # type: ignore[assignment]
    sys.modules["limbcli.stages.diagnose"] = SimpleNamespace(  # type: ignore[assignment]
        diagnose=quick("diagnose"), places=in_one_place, DiagnoseOptions=Options
    )
