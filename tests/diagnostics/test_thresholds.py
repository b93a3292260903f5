"""One table holds every number that a diagnosis decides by."""

from __future__ import annotations

import ast
from pathlib import Path

from limbcli.diagnostics import thresholds

PACKAGE = Path(thresholds.__file__).parent
# Numbers of numerical algebra, of curves and of a prior: nothing is decided by them.
NUMERICAL = {
    *("RCOND", "_INVISIBLE", "_RANK", "_WAVES", "_DEGREE", "_LEAST_NU", "_PLACES", "_REFINED", "_FAR"),
    *("TAILS", "EXCESS", "USUAL_M", "LN_M_DEVIATION", "_MOST_COMPARED", "_EXACT", "_KEPT_BYTES", "_BETWEEN"),
    "_SAME",
}


def _numbers(tree: ast.Module) -> set[str]:
    found: set[str] = set()
    for node in tree.body:
        if not isinstance(node, ast.Assign):
            continue
        values = [n.value for n in ast.walk(node.value) if isinstance(n, ast.Constant)]
        if any(isinstance(each, int | float) for each in values):
            for target in node.targets:
                found |= {n.id for n in ast.walk(target) if isinstance(n, ast.Name)}
    return found


def test_every_threshold_has_its_meaning_and_source():
    body = ast.parse(Path(thresholds.__file__).read_text(encoding="utf-8")).body
    named = [k for k, node in enumerate(body) if isinstance(node, ast.AnnAssign)]
    assert len(named) > 30
    for k in named:
        text = body[k + 1]
        assert isinstance(text, ast.Expr), ast.unparse(body[k])
        assert isinstance(text.value, ast.Constant), ast.unparse(body[k])
        words = str(text.value.value)
        sources = ("Convention", "Chosen", "Assumed", "Numerical", "detected")
        assert any(each in words for each in sources), ast.unparse(body[k])


def test_no_other_module_of_the_diagnosis_holds_one():
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.name == "thresholds.py":
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        assert _numbers(tree) <= NUMERICAL, path
        for node in ast.walk(tree):
            if isinstance(node, ast.Compare):  # 0, 1 and 2 count things
                numbers = [n.value for n in node.comparators if isinstance(n, ast.Constant)]
                assert not [n for n in numbers if isinstance(n, float) and n not in (0.0, 1.0)], (
                    f"{path}:{node.lineno}"
                )


def test_the_table_is_used_whole():
    text = "".join(p.read_text(encoding="utf-8") for p in PACKAGE.parent.rglob("*.py"))
    unused = [name for name in vars(thresholds) if name.isupper() and f"thresholds.{name}" not in text]
    assert not unused
