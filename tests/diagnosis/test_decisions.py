"""One table holds every number that a diagnosis decides by."""

from __future__ import annotations

import ast
from pathlib import Path

from limbcli.diagnosis.explanations import decisions

PACKAGE = Path(decisions.__file__).parent
TREE = ast.parse(Path(decisions.__file__).read_text(encoding="utf-8"))


def test_every_number_has_its_meaning_and_source():
    named = [k for k, node in enumerate(TREE.body) if isinstance(node, ast.AnnAssign)]
    assert len(named) == len([name for name in vars(decisions) if name.isupper()]) > 8
    for k in named:
        text = TREE.body[k + 1]
        assert isinstance(text, ast.Expr), ast.unparse(TREE.body[k])
        assert isinstance(text.value, ast.Constant), ast.unparse(TREE.body[k])
        words = str(text.value.value)
        sources = ("Convention", "Chosen", "Computed", "principle", "by chance")
        assert any(each in words for each in sources), ast.unparse(TREE.body[k])


def test_no_module_that_decides_compares_with_a_number_of_its_own():
    """0 and 1 are ends of probabilities; weights below 0.001 are left out of averages; 1e-9 is none."""
    for path in [each for each in sorted(PACKAGE.glob("*.py")) if each.stem != "sentences"]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Compare):
                numbers = [n.value for n in node.comparators if isinstance(n, ast.Constant)]
                own = [n for n in numbers if isinstance(n, float) and n not in (0.0, 1.0, 1e-3, 1e-9)]
                assert not own, f"{path}:{node.lineno}"


def test_the_table_is_used_whole():
    text = "".join(p.read_text(encoding="utf-8") for p in PACKAGE.parent.rglob("*.py"))
    unused = [name for name in vars(decisions) if name.isupper() and f"decisions.{name}" not in text]
    assert not unused
