"""The documentation is read without a network: its equations are MathML, and nothing is fetched."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

converter = pytest.importorskip("latex2mathml.converter", reason="needs latex2mathml, of the extra dev")
DOCS = Path(__file__).resolve().parents[2] / "docs"
EQUATIONS = [
    (page.name, found)
    for page in sorted(DOCS.glob("*.md"))
    for found in re.findall(
        r"\$\$(.+?)\$\$|(?<![\w$`])\$([^$`\n]+?)\$(?![\w$])", page.read_text("utf-8"), re.DOTALL
    )
]


def test_there_are_equations():
    assert len(EQUATIONS) > 3


@pytest.mark.parametrize(("page", "equation"), EQUATIONS)
def test_an_equation_becomes_mathml(page: str, equation: tuple[str, str]):
    block, inline = equation
    drawn = converter.convert(block or inline, display="block" if block else "inline")
    assert drawn.startswith("<math")
    assert not re.search(r"\\[a-zA-Z]+", drawn), drawn  # every command was understood


def test_no_script_of_another_server_is_named():
    conf = (DOCS / "conf.py").read_text(encoding="utf-8")
    assert 'html_math_renderer = "mathml"' in conf
    assert "mathjax" not in conf
    for page in DOCS.glob("*.md"):
        assert not re.search(r"<(script|img|link)[^>]+https?://", page.read_text("utf-8")), page.name
