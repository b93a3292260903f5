"""new: create a case folder to fill in, with a comment at every value and a place for every file."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from limbcli.case import CASE_FILE
from limbcli.case.json_schema import FILE as SCHEMA_FILE
from limbcli.case.json_schema import case_schema
from limbcli.case.schema import FILL_IN, plain_name, site_name
from limbcli.config import templates_folder
from limbcli.errors import CaseError
from limbcli.errors.file_system import file_system_errors
from limbcli.errors.pasted_commands import typed
from limbcli.files.atomic import atomic_folder
from limbcli.files.template_rendering import plain_text_templates
from limbcli.results import StageResult, provenance

MRI, LEVELS, README = "mri", "levels.csv", "README.md"


def new(folder: Path, *, sites: Sequence[str] = ("p1",)) -> StageResult:
    """Write a commented case folder whose values `limbcli check` asks for one by one.

    folder : must be absent or empty; existing files are never changed
    sites : names of the places that will be measured

    Raises CaseError if the folder is not empty, the path is a file, or a site's name is invalid.
    """
    names = _checked(sites)
    _refuse_used(folder)
    name = folder.resolve().name
    subject = FILL_IN if plain_name(name) else name
    texts = _texts(subject, names)

    def fill(target: Path) -> None:
        (target / MRI).mkdir()
        for path, text in texts.items():
            (target / path).parent.mkdir(exist_ok=True)
            with (target / path).open("x", encoding="utf-8") as stream:
                stream.write(text)

    with file_system_errors(folder):
        if folder.is_dir():
            _fill_empty(folder, fill)
        else:
            with atomic_folder(folder, is_new=True) as work:
                fill(work)
    return StageResult(
        stage="new",
        subject=subject,
        folder=folder,
        files={"case": CASE_FILE, "readme": README},
        data={"written": [*texts, f"{MRI}/"], "sites": list(names)},
        summary=(
            f"{CASE_FILE}: enter a value at every {FILL_IN!r}",
            f"{MRI}/: the DICOM files of one series",
            *(f"{site}/{LEVELS}: force and depth of every level" for site in names),
            f"{README}: where everything else goes; {SCHEMA_FILE}: for editors that complete keys",
            f"next: limbcli check {typed(folder)}",
        ),
        provenance=provenance(),
    )


def _checked(sites: Sequence[str]) -> tuple[str, ...]:
    for site in sites:
        taken = {
            MRI: "is reserved for the folder of the images",
            README: f"is {README}",
            CASE_FILE: f"is {CASE_FILE}",
            SCHEMA_FILE: f"is {SCHEMA_FILE}",
        }
        wrong = site_name(site) or taken.get(site)
        if wrong or list(sites).count(site) > 1:
            what = f"the site's name {wrong}" if wrong else f"two sites are named {site!r}"
            raise CaseError(what, where="--site", fix="give every site a unique short name, such as p1")
    return tuple(sites)


def _refuse_used(folder: Path) -> None:
    if not folder.exists() and not folder.is_symlink():
        return
    if folder.is_dir() and not any(folder.iterdir()):
        return
    what = f"{folder} holds something already" if folder.is_dir() else f"{folder} is a file"
    raise CaseError(what, where=str(folder), fix="give a folder that is empty or does not exist yet")


def _texts(subject: str, sites: tuple[str, ...]) -> dict[str, str]:
    """Every file's text by its path in the case folder; case.toml last."""
    environment = plain_text_templates(templates_folder() / "case")
    facts = {"schema": SCHEMA_FILE, "subject": subject, "sites": sites, "fill_in": FILL_IN}
    levels = environment.get_template(f"{LEVELS}.j2")
    return {
        README: environment.get_template(f"{README}.j2").render(facts),
        **{f"{site}/{LEVELS}": levels.render(site=site) for site in sites},
        SCHEMA_FILE: json.dumps(case_schema(), indent=1) + "\n",
        CASE_FILE: environment.get_template(f"{CASE_FILE}.j2").render(facts),
    }


def _fill_empty(folder: Path, fill: Callable[[Path], None]) -> None:
    """Fill an empty folder in place (a shell may be open in it); on an error remove what was written."""
    try:
        fill(folder)
    except BaseException:
        for each in folder.iterdir():
            shutil.rmtree(each) if each.is_dir() else each.unlink()
        raise
