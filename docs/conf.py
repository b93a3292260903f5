"""How the documentation is built: `make docs`. Warnings are errors.

Commands, keys of case.toml and effects are written from the program itself into `docs/generated/`.
"""

from __future__ import annotations

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
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
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
