"""A `LimbModel` as a FEBio 4.0 model file, through the Jinja templates in `templates/feb/`."""

from __future__ import annotations

import gzip
import json
from numbers import Real
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from limbcli.config import templates_folder
from limbcli.errors import CaseError
from limbcli.feb.ids import against, amounts, element_maps, give_ids, has_formulas, node_maps, number, vector
from limbcli.feb.info import INFO_MARK
from limbcli.feb.read import EMPTY_NODE_SETS, EMPTY_SURFACES, IGNORED
from limbcli.feb.views import (
    block_rows,
    drive_groups,
    map_rows,
    material_views,
    node_rows,
    record_view,
    set_ids,
    step_views,
    surface_rows,
)
from limbcli.files.atomic import atomic_file
from limbcli.files.template_rendering import COMPILED, TemplateFolders, filled, refuse_unused
from limbcli.model import LimbModel
from limbcli.results import plain

_FOLDER = "feb"
MAIN_TEMPLATE = f"{_FOLDER}/model.feb.j2"
# FEBio's XML reader (XMLReader::GetChar) supports five named entities and no numeric ones, and also
# expands them in comments.
_ENTITIES = {"&#39;": "&apos;", "&#34;": "&quot;"}
_IN_COMMENTS = {"--": "-\\u002d", "&": "\\u0026", "<": "\\u003c", ">": "\\u003e"}
_NOT_WRITTEN = ("plot_variables", IGNORED)  # keys of `info` that do not belong into the comment


def write_feb(model: LimbModel, path: Path, templates: Path | None = None) -> Path:
    """Write a model file; `read_feb` restores the model exactly.

    Parameters
    ----------
    path : `.feb`, or `.feb.gz` for a compressed file
    templates : your own folder with `feb/*.j2`; templates missing there are taken from limbcli

    Numbers are written so that they parse to the same binary value (neo-Hookean and Holmes-Mow to round-off,
    because the file contains E and v). Ids run from 1 without gaps. `info` is stored as JSON in a comment.

    Raises
    ------
    CaseError
        If the model cannot be written (a value that is not finite, two maps with the same name, must-points
        that do not increase) or a user template is faulty.
    ToolError
        If the templates are missing.
    """
    content = encoded(render(model, templates=templates), path)
    with atomic_file(path) as partial:
        partial.write_bytes(gzip.compress(content, mtime=0) if path.suffix == ".gz" else content)
    return path


def encoded(text: str, path: Path) -> bytes:
    """A file's text in its encoding; CaseError, naming the file, if FEBio cannot read a character."""
    try:
        return text.encode("iso-8859-1")
    except UnicodeEncodeError as error:
        raise CaseError(
            f"FEBio cannot read the character {text[error.start]!r} in a name",
            where=str(path),
            fix="use plain letters in the names of parts, sets and materials",
        ) from error


def render(model: LimbModel, *, templates: Path | None = None) -> str:
    """Text of the model file."""
    environment = _environment(templates)
    text = filled(environment, MAIN_TEMPLATE, _context(model), ours="templates/feb")
    if templates is not None:
        refuse_unused(environment, templates / _FOLDER, templates_folder() / _FOLDER, below=f"{_FOLDER}/")
    for foreign, known in _ENTITIES.items():
        text = text.replace(foreign, known)
    return text


def _environment(templates: Path | None) -> jinja2.Environment:
    folders = [templates_folder(templates), templates_folder()]
    environment = jinja2.Environment(
        loader=TemplateFolders(folders),
        bytecode_cache=COMPILED,
        undefined=jinja2.StrictUndefined,
        autoescape=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {
        "number": number, "vector": vector, "amounts": amounts, "against": against, "formulas": has_formulas,
    }  # fmt: skip
    environment.tests["float_like"] = lambda value: isinstance(value, Real)
    return environment


def _context(model: LimbModel) -> dict[str, Any]:
    """Variables of the templates."""
    ids = give_ids(model)
    return {
        "model": model,
        "module": "biphasic" if any(m.law == "biphasic" for m in model.materials.values()) else "solid",
        "info": _info(model),
        "steps": step_views(model, ids),
        "materials": material_views(model, ids),
        "drives": drive_groups(model.drives),
        "curves": ids.all_curves,
        "curve_ids": ids.curves,
        "records": [record_view(each, ids) for each in model.records],
        "plot_variables": list(model.info.get("plot_variables", ())),
        **_mesh_context(model),
    }


def _mesh_context(model: LimbModel) -> dict[str, Any]:
    mesh = model.mesh
    return {
        "nodes": node_rows(mesh.points),
        "blocks": block_rows(mesh.blocks),
        "node_sets": [
            {"name": name, "ids": set_ids(each)} for name, each in mesh.node_sets.items() if len(each)
        ],
        "surfaces": [
            {"name": name, "rows": surface_rows(each)}
            for name, each in mesh.surfaces.items()
            if each.n_facets  # FEBio confuses an empty <Surface> with its neighbour
        ],
        "element_maps": [
            {
                "name": name,
                "block": each.block,
                "vector": each.values.ndim == 2,
                "rows": map_rows(each.values, "e"),
            }
            for name, each in element_maps(model).items()
        ],
        "node_maps": [
            {"name": name, "node_set": each.node_set, "rows": map_rows(each.values, "node")}
            for name, each in node_maps(model).items()
        ],
    }


def _info(model: LimbModel) -> Markup | None:
    """`info` as JSON that is valid in a comment, including the names of the sets that are not written."""
    kept = {key: value for key, value in model.info.items() if key not in _NOT_WRITTEN}
    empty_sets = [name for name, each in model.mesh.node_sets.items() if len(each) == 0]
    empty_surfaces = [name for name, each in model.mesh.surfaces.items() if each.n_facets == 0]
    if empty_sets:
        kept[EMPTY_NODE_SETS] = empty_sets
    if empty_surfaces:
        kept[EMPTY_SURFACES] = empty_surfaces
    if not kept:
        return None
    text = json.dumps(plain(kept), allow_nan=False)
    for mark, escaped in _IN_COMMENTS.items():
        text = text.replace(mark, escaped)
    return Markup(INFO_MARK + text)
