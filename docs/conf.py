"""How the documentation is built: `make docs`. Warnings are errors.

Commands, keys of case.toml and effects are written from the program itself into `docs/generated/`.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

import from_program  # noqa: E402

from limbcli import __version__  # noqa: E402

project = "limbcli"
author = "the limbcli contributors"
copyright = author
version = release = __version__
extensions = [
    "myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode", "offline_math",
]  # fmt: skip
html_math_renderer = "mathml"
exclude_patterns = ["**.ipynb_checkpoints"]
myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
suppress_warnings = ["myst.xref_missing", "myst.header"]  # of README files that are shown as they stand
html_theme = "furo"
html_title = f"limbcli {release}"
templates_path: list[str] = []
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
python_use_unqualified_type_names = True
napoleon_use_param = False
napoleon_use_rtype = False
nitpicky = False

from_program.write_all(HERE / "generated")


def as_numpy(_app, _what, _name, _object, _options, lines: list[str]) -> None:
    """Our docstrings as napoleon reads them: `name : words` has no type, `Source:` is no exception."""
    section, found = "", []
    for line, below in zip(lines, [*lines[1:], ""], strict=True):
        if below and not below.strip("-"):
            section = line
        named = re.match(r"([\w, ]+) : (.+)", line) if section in ("Parameters", "Attributes") else None
        if named:
            found += [named[1], f"    {named[2]}"]
        elif line.startswith("Source: "):
            section = "References"
            found += [section, "-" * len(section), line.removeprefix("Source: ")]
        else:
            found.append(line)
    lines[:] = found


def setup(app) -> None:
    app.connect("autodoc-process-docstring", as_numpy, priority=400)  # before napoleon's own
