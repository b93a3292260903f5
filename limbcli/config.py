"""Where things lie: the templates, the shared reference data, the output folder; and threads."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from limbcli.errors import CaseError, ToolError

PACKAGE = Path(__file__).resolve().parent
THREADS = "LIMBCLI_THREADS"  # in the environment: the most threads of one simulation


def templates_folder(override: Path | None = None) -> Path:
    """The folder with `feb/` and `report/` templates.

    The user's own folder first (files missing there are taken from ours), then
    the repository's `templates/`, then the copy that an installed wheel carries.

    Raises
    ------
    ToolError
        If the folder named, or every usual place, is absent, or holds no templates.
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
    """Output folder of a case where none is named: `out/<name of the case folder>` here.

    LIMBCLI_OUT names another folder than `out`; left empty, as by a variable of a script that is not set, it
    says nothing.
    """
    base = os.environ.get("LIMBCLI_OUT") or "out"
    return at_home(Path(base)) / case_folder.resolve().name


def at_home(path: Path) -> Path:
    """The path with the home folder for a leading `~`, which no shell has put in the place of.

    Raises
    ------
    CaseError
        If that person has no home folder here: the results would go to a folder named `~`.
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
    """So many threads, or as many as the environment allows, if those are fewer: LIMBCLI_THREADS, or, where
    it says nothing, OMP_NUM_THREADS (of nested levels the first), which is meant for all programs.

    A batch whose processes share the cores sets both for each of them.
    """
    values = (os.environ.get(name, "").split(",")[0].strip() for name in (THREADS, "OMP_NUM_THREADS"))
    allowed = next((int(each) for each in values if each.isdigit()), threads)
    return max(1, min(threads, allowed))


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Linear algebra of a few hundred numbers, thousands of times: BLAS with one thread, which more only make
    wait for each other. What shares work among threads of its own is not touched."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield
