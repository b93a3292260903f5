"""What `from limbcli import ...` promises: names, signatures, documentation, and a quick start.

A change of `signatures.txt` is a change of the interface: it belongs into the change log.
`python tests/api/test_public.py` writes the file anew.
"""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import limbcli

SIGNATURES = Path(__file__).with_name("signatures.txt")
ASKED_FOR = {
    "Case", "segment", "mesh", "build_feb", "run", "fit", "diagnose", "report", "ReferenceSession",
    "read_feb",
}  # fmt: skip
NAMES = [name for name in limbcli.__all__ if name != "__version__"]
FUNCTIONS = [name for name in NAMES if inspect.isfunction(getattr(limbcli, name))]
CLASSES = [name for name in NAMES if inspect.isclass(getattr(limbcli, name))]


def signatures() -> list[str]:
    """Every public name with what it takes, and every public method of every class."""
    lines = []
    for name in sorted(NAMES):
        found = getattr(limbcli, name)
        lines.append(f"{name}{_taken(found)}")
        if inspect.isclass(found):
            lines += [f"{name}.{each}" for each in sorted(_members(found))]
    return lines


def _taken(found: object) -> str:
    if inspect.isclass(found) and issubclass(found, BaseException):
        return f"({', '.join(each.__name__ for each in found.__mro__[1:-2])})"
    return str(inspect.signature(found)).replace("typing.", "")  # type: ignore[arg-type]


def _members(found: type) -> list[str]:
    lines = []
    for name, each in inspect.getmembers_static(found):
        owner = next(base for base in found.__mro__ if name in base.__dict__)
        if name.startswith("_") or not owner.__module__.startswith("limbcli"):
            continue
        plain = each.__func__ if isinstance(each, staticmethod | classmethod) else each
        lines.append(f"{name}{_taken(plain)}" if inspect.isfunction(plain) else name)
    return lines


def test_the_names_that_were_asked_for_are_there():
    assert set(NAMES) >= ASKED_FOR
    assert len(set(NAMES)) == len(NAMES)


def test_names_and_signatures_are_as_promised():
    assert signatures() == SIGNATURES.read_text(encoding="utf-8").splitlines(), (
        "if the change is meant: python tests/api/test_public.py, and a line in CHANGELOG.md"
    )


def test_what_type_checkers_see_is_what_is_there():
    """The imports under TYPE_CHECKING and the table behind `__getattr__` name the same things."""
    tree = ast.parse(Path(limbcli.__file__).read_text(encoding="utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    seen = {alias.asname: f"{node.module}" for node in block.body for alias in node.names}  # type: ignore
    there = {name: f"limbcli.{module}" for name, module in limbcli._HOME.items()}
    assert seen == there
    assert Path(limbcli.__file__).with_name("py.typed").is_file()


def test_importing_the_package_opens_nothing_heavy():
    code = (
        "import sys, limbcli; limbcli.__version__; dir(limbcli);"
        "print([m for m in ('numpy', 'scipy', 'numba', 'typer', 'limbcli.stages') if m in sys.modules]);"
        "from limbcli import segment, fit, Case, LimbcliError;"
        "print([m for m in ('scipy', 'numba', 'pydicom', 'matplotlib', 'limbcli.fem') if m in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert shown.stdout == "[]\n[]\n", shown.stderr


def test_an_unknown_name_is_no_name():
    with pytest.raises(AttributeError, match="no attribute 'segmnt'"):
        limbcli.segmnt  # noqa: B018
    with pytest.raises(ImportError):
        exec("from limbcli import segmnt")


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_function_tells_parameters_and_errors(name: str):
    found = getattr(limbcli, name)
    text = inspect.getdoc(found) or ""
    assert "Raises\n------" in text or "raises nothing" in text
    if name in ("write_feb",):
        return
    assert "Parameters\n----------" in text
    words = text.partition("Parameters\n----------")[2]
    records_call = set(words.replace(",", " ").replace(":", " ").split())
    others = "the others" in words
    missing = [each for each in inspect.signature(found).parameters if each not in records_call]
    assert others or not missing, f"{name} does not tell of {missing}"


@pytest.mark.parametrize("name", CLASSES)
def test_every_class_and_its_members_are_told_of(name: str):
    found = getattr(limbcli, name)
    assert inspect.getdoc(found)
    for member, each in inspect.getmembers_static(found):
        if member.startswith("_") or member not in vars(found):
            continue
        plain = each.__func__ if isinstance(each, staticmethod | classmethod) else each
        if inspect.isfunction(plain) or isinstance(plain, property):
            assert inspect.getdoc(getattr(found, member)), f"{name}.{member} has no docstring"


if __name__ == "__main__":
    SIGNATURES.write_text("\n".join(signatures()) + "\n", encoding="utf-8")
