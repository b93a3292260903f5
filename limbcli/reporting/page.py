"""Render reportlets to one self-contained HTML file."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup, escape

from limbcli.config import templates_folder
from limbcli.drawing import data_file, save_figure
from limbcli.errors.file_system import in_utf8
from limbcli.files.template_rendering import COMPILED, TemplateFolders, filled, refuse_unused
from limbcli.reporting.figures.style import style
from limbcli.reporting.reportlet import Picture, Reportlet

_LARGE_BYTES = 200_000
_MOST_PIXELS = 2400  # largest width of an embedded picture; enough for a printed page
_TYPES = {".svg": "image/svg+xml", ".png": "image/png", ".jpg": "image/jpeg"}


@dataclass(frozen=True)
class Shown:
    """A picture as embedded in the page: a data URI and a description."""

    uri: str
    alt: str


def save_pictures(reportlets: Sequence[Reportlet], folder: Path) -> dict[str, Path]:
    """Save each picture as a file in `folder`; returns, by picture name, the file that the page shows.

    Drawings are saved as PNG and SVG with their data as CSV; pictures made by a stage are copied.
    """
    folder.mkdir(parents=True, exist_ok=True)
    shown: dict[str, Path] = {}
    for picture in (each for reportlet in reportlets for each in reportlet.pictures):
        shown[picture.name] = _save(picture, folder)
    return shown


def _save(picture: Picture, folder: Path) -> Path:
    png, svg = folder / f"{picture.name}.png", folder / f"{picture.name}.svg"
    if picture.figure is None:
        assert picture.source is not None
        copy = folder / f"{picture.name}{picture.source.suffix.lower()}"
        copy.write_bytes(picture.source.read_bytes())
        for beside in (picture.source.with_suffix(".svg"), data_file(picture.source)):
            if beside.is_file():
                name = beside.name.replace(picture.source.stem, picture.name, 1)
                (folder / name).write_bytes(beside.read_bytes())
        return copy
    with style():
        save_figure(picture.figure, png)
    return svg if picture.vector else png


def data_uri(path: Path) -> str:
    """The picture as a `data:` URI; a large PNG is converted to WebP (the file keeps all pixels)."""
    kind, content = _TYPES[path.suffix.lower()], path.read_bytes()
    if path.suffix.lower() == ".png" and len(content) > _LARGE_BYTES:
        packed = _as_webp(path)
        if len(packed) < len(content):
            kind, content = "image/webp", packed
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _as_webp(path: Path) -> bytes:
    from PIL import Image

    with Image.open(path) as image:
        small = image.convert("RGB")
    if small.width > _MOST_PIXELS:
        small = small.resize((_MOST_PIXELS, round(small.height * _MOST_PIXELS / small.width)))
    stream = io.BytesIO()
    small.save(stream, "WEBP", quality=88, method=4)
    return stream.getvalue()


def render(template: str, facts: Mapping[str, Any], *, templates: Path | None = None) -> str:
    """Render a template of `templates/report/` to text that can be encoded as UTF-8; the user's folder takes
    precedence.

    facts : what the template shows; "own": the provenance of the page

    Raises CaseError if a user template is faulty, uses an undefined variable, or is not used by any page;
    ToolError if the built-in templates are not found, or the user's folder does not exist.
    """
    folders = [templates_folder() / "report"]
    if templates is not None:
        folders.insert(0, templates_folder(templates) / "report")
    environment = jinja2.Environment(
        loader=TemplateFolders(folders),
        bytecode_cache=COMPILED,
        autoescape=jinja2.select_autoescape(["html", "j2"], default=True),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["symbols"] = symbols
    finished = facts.get("own", {}).get("finished_utc", "")
    made_on = finished.replace("T", " ").replace("Z", " UTC")
    text = filled(environment, template, {"made_on": made_on, **facts}, ours="templates/report")
    if templates is not None:
        refuse_unused(environment, folders[0], folders[-1])
    return in_utf8(text)


def symbols(text: str) -> Markup:
    """Escaped text with f_κ (also written f_kappa) set as a symbol.

    >>> str(symbols("f_kappa < 1"))
    'f<sub>κ</sub> &lt; 1'
    """
    safe = str(escape(text))
    for written in ("f_kappa", "f_κ"):
        safe = safe.replace(written, "f<sub>κ</sub>")
    return Markup(safe)


def embed(reportlets: Sequence[Reportlet], files: Mapping[str, Path]) -> dict[str, Shown]:
    """Data URIs of all pictures, by name."""
    pictures = [each for reportlet in reportlets for each in reportlet.pictures]
    return {each.name: Shown(data_uri(files[each.name]), each.alt) for each in pictures}
