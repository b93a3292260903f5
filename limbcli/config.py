"""Configuration: template and output folders, and the number of threads."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from limbcli.errors import CaseError, ToolError

PACKAGE = Path(__file__).resolve().parent
THREADS = "LIMBCLI_THREADS"  # environment variable: largest number of threads of one simulation


def templates_folder(override: Path | None = None) -> Path:
    """The folder with the `feb/` and `report/` templates.

    The user's own folder, if one is given (templates missing there are taken from limbcli's own), then the
    repository's `templates/`, then the copy in an installed wheel.

    Raises ToolError if the given folder, or every default location, does not exist or contains no templates.
    """
    if override is not None:
        if not override.is_dir():
            raise ToolError(
                f"the template folder {override} does not exist",
                where="--templates",
                fix="give a folder that contains feb/*.j2, or omit the option",
            )
        if not any((override / each).is_dir() for each in ("feb", "report")):
            raise ToolError(
                f"the template folder {override} contains neither feb/ nor report/",
                where="--templates",
                fix="put your templates into its subfolders feb/ (for the model file) or report/ (for the "
                "pages)",
            )
        return override
    for folder in (PACKAGE.parent / "templates", PACKAGE / "_templates"):
        if (folder / "feb").is_dir():
            return folder
    raise ToolError(
        "limbcli's templates are missing from this installation",
        where=str(PACKAGE),
        fix="install limbcli again: pip install --force-reinstall limbcli",
    )


def default_out(case_folder: Path) -> Path:
    """Default output folder of a case: `out/<name of the case folder>` in the working directory.

    LIMBCLI_OUT replaces `out`; an empty value, as from an unset variable in a script, is ignored.
    """
    base = os.environ.get("LIMBCLI_OUT") or "out"
    return at_home(Path(base)) / case_folder.resolve().name


def at_home(path: Path) -> Path:
    """The path with a leading `~` expanded to the home folder, in case the shell has not done it.

    Raises CaseError if the home folder is unknown: the results would otherwise go to a folder named `~`.
    """
    try:
        return path.expanduser()
    except RuntimeError as error:
        raise CaseError(
            f"cannot determine which folder {path.parts[0]} refers to",
            where=str(path),
            fix="give the whole path",
        ) from error


def at_most(threads: int) -> int:
    """The number of threads, limited by the environment to LIMBCLI_THREADS, or else OMP_NUM_THREADS.

    OMP_NUM_THREADS, which is meant for all programs, may list several nested levels; the first counts. A
    batch whose processes share the cores sets both variables for each of them.
    """
    values = (os.environ.get(name, "").split(",")[0].strip() for name in (THREADS, "OMP_NUM_THREADS"))
    allowed = next((int(each) for each in values if each.isdigit()), threads)
    return max(1, min(threads, allowed))


def cores() -> int:
    """Number of cores that the system lets this process use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def available_cores() -> int:
    """Number of cores that this process may use, within the limit set by a batch."""
    return at_most(cores())


def shares(n_runs: int, cores: int) -> tuple[int, int]:
    """(parallel processes, threads of each) for `n_runs` runs, in total never more than `cores`.

    >>> shares(3, 2), shares(1, 4), shares(3, 8), shares(0, 2)
    ((2, 1), (1, 4), (3, 2), (1, 2))
    """
    processes = max(min(n_runs, cores), 1)
    return processes, max(cores // processes, 1)


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Restrict BLAS to one thread inside the block.

    With a few hundred unknowns, solved thousands of times, more threads only wait for each other. Code with
    its own threads is not affected.
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield
