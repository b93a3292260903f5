"""What the documentation prints holds: its Python runs, its commands are commands, its TOML is understood."""

from __future__ import annotations

import ast
import inspect
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import typer

import limbcli
from limbcli.case import read_case, schema
from limbcli.cli.app import COMMANDS, app
from limbcli.effects import EFFECTS
from limbcli.effects.own_file import effect_of_file
from limbcli.fem.elements import element
from limbcli.materials import laws
from limbcli.measurement import indentation
from tests.loading import module_at

REPOSITORY = Path(__file__).resolve().parents[2]
DOCS = REPOSITORY / "docs"
PAGES = [*sorted(DOCS.glob("*.md")), *(REPOSITORY / name / "README.md" for name in ("cases", "templates"))]
PAGES.append(REPOSITORY / "README.md")
EXAMPLES = [DOCS / f"add-{name}.md" for name in ("a-law", "an-element", "an-effect")]


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(
        rf"^```{language}\n(.+?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )


def command_lines() -> list[tuple[str, str]]:
    """(page, arguments) of every `$ limbcli ...` that is printed."""
    return [
        (page.relative_to(REPOSITORY).as_posix(), line)
        for page in PAGES
        for block in blocks(page, "console")
        for line in re.findall(r"^\w*\$ limbcli (.+?)(?:\s+#.*)?$", block, flags=re.MULTILINE)
    ]


def case_keys() -> list[str]:
    """Every key that may stand below a table of case.toml."""
    tables = [each for each in vars(schema).values() if isinstance(each, dict) and each is not schema.TOP]
    return [name for each in tables for name, key in each.items() if isinstance(key, schema.Key)]


@pytest.mark.slow
@pytest.mark.parametrize("page", EXAMPLES, ids=lambda page: page.stem)
def test_the_example_of_every_extension_page_runs(page: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(element, "shape", element.shape)  # what a page changes is put back
    known = dict(laws.LAWS)
    code = blocks(page, "python")
    assert sum("assert" in each for each in code) >= 1
    try:
        exec(compile("\n".join(code), str(page), "exec"), {"__name__": "page"})
    finally:
        for name in set(laws.LAWS) - set(known):
            laws.LAWS.pop(name)  # type: ignore[attr-defined]


def test_the_effect_of_the_page_is_a_file_that_diagnose_takes(tmp_path: Path):
    file = tmp_path / "slip.py"
    text = blocks(EXAMPLES[2], "python")[0]
    file.write_text(text)
    assert effect_of_file(file, EFFECTS).name == "slip"
    assert "Source:" in text  # what the contract test asks of one that is kept
    assert "Tell-tale:" in text


@pytest.mark.parametrize("page", [REPOSITORY / "README.md", DOCS / "api.md"], ids=lambda page: page.stem)
def test_the_python_that_is_printed_calls_what_there_is(page: Path):
    """Names that are imported are there, and every call of one has arguments that it takes."""
    for block in blocks(page, "python"):
        names: dict[str, object] = {}
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and node.module == "limbcli":
                names |= {each.name: getattr(limbcli, each.name) for each in node.names}
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in names:
                given = {each.arg: None for each in node.keywords if each.arg}
                inspect.signature(names[node.func.id]).bind(*node.args, **given)  # type: ignore[arg-type]
    assert any("from limbcli import" in block for block in blocks(page, "python"))


def test_own_parameters_in_a_model_are_simulated_as_the_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    (code,) = (each for each in blocks(DOCS / "api.md", "python") if "read_feb" in each)
    folder = tmp_path / "out" / "subject" / "build-feb" / "p1"
    folder.mkdir(parents=True)
    shutil.copy(REPOSITORY / "tests" / "data" / "feb" / "punch.feb", folder / "model.feb")
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "api.md", "exec"), {})
    whole, softer = (float(re.findall(r"[\d.]+", line)[-1]) for line in capsys.readouterr().out.splitlines())
    assert 0 < softer < whole


def test_the_page_of_results_lists_every_file_that_a_stage_leaves():
    page = (DOCS / "results.md").read_text(encoding="utf-8")
    sources = [each.read_text("utf-8") for each in (REPOSITORY / "limbcli" / "stages").rglob("*.py")]
    named = {name for each in sources for name in re.findall(r'\.file\("\w+", "([\w.-]+)"\)', each)}
    assert len(named) > 25
    assert sorted(name for name in named if f"`{name}" not in page) == []


def test_the_page_of_the_python_interface_holds_all_of_it():
    page = (DOCS / "api.md").read_text(encoding="utf-8")
    assert set(limbcli.__all__) - {"__version__"} <= set(re.findall(r":: limbcli\.(\w+)", page))


@pytest.mark.parametrize(("page", "line"), command_lines())
def test_every_command_line_is_understood(page: str, line: str):
    """Parsed as the program parses it, and not run: names, options and values must be possible."""
    name, *rest = shlex.split(line)
    command = typer.main.get_command(app).commands[name]  # type: ignore[attr-defined]
    command.make_context(name, rest)


def test_every_command_that_is_spoken_of_exists():
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert set(re.findall(r"`limbcli ([a-z][a-z-]*)", text)) <= set(COMMANDS), page


def test_the_case_of_the_page_is_valid_but_for_its_files(tmp_path: Path):
    text, *others = blocks(DOCS / "case-format.md", "toml")
    other_geometries = [each for each in others if each.startswith("[imaging]")]
    assert len(other_geometries) == 2
    for each in (each for each in others if each not in other_geometries):
        (tmp_path / "case.toml").write_text(f"{text}\n{each}")
        assert all("not found" in problem.what for problem in read_case(tmp_path)[1])
    for each in ("[imaging]" + text.split("[imaging]")[1].split("[probe]")[0], *other_geometries):
        (tmp_path / "case.toml").write_text(
            text.split("[imaging]")[0] + each + "[probe]" + text.split("[probe]")[1]
        )
        problems = [problem.what for problem in read_case(tmp_path)[1]]
        assert problems
        assert all("not found" in problem for problem in problems), problems
    for each in blocks(REPOSITORY / "cases" / "README.md", "toml"):
        tomllib.loads(each)


def test_every_key_and_column_of_a_case_is_explained_by_hand_too():
    """The generated list has a key's type and default; what it means stands in the page's own text."""
    page = (DOCS / "case-format.md").read_text(encoding="utf-8")
    pages = page + (DOCS / "states.md").read_text(encoding="utf-8") + (DOCS / "fibres.md").read_text("utf-8")
    assert [name for name in case_keys() if not re.search(rf"\b{name}\b", pages)] == []
    columns = {*indentation.REQUIRED, *indentation.OPTIONAL, *indentation.TEXTS}
    template = (REPOSITORY / "templates/case/levels.csv.j2").read_text(encoding="utf-8")
    for text in (page, template):
        assert [name for name in sorted(columns) if not re.search(rf"\b{name}\b", text)] == []


def test_the_readme_counts_the_effects_that_a_diagnosis_may_name():
    may_be_named = sum(each.kind != "numerical" for each in EFFECTS)
    (told,) = re.findall(r"which of (\d+) effects", (REPOSITORY / "README.md").read_text(encoding="utf-8"))
    assert int(told) == may_be_named, "correct the number in README.md"


def test_every_case_is_told_of_in_the_list_of_cases():
    reported = set(re.findall(r"^\| `([^`]+)`", (REPOSITORY / "cases/README.md").read_text(), re.MULTILINE))
    assert reported == {path.parent.name for path in (REPOSITORY / "cases").glob("*/case.toml")}


@pytest.mark.slow
def test_the_pages_of_the_program_hold_every_command_key_and_effect(tmp_path: Path):
    module = module_at(DOCS / "from_program.py")
    (tmp_path / "command-gone.md").write_text("of a command that is no more")
    module.write_all(tmp_path)
    assert {each.stem for each in tmp_path.glob("command-*")} == {f"command-{name}" for name in COMMANDS}
    group = typer.main.get_command(app)
    for name in COMMANDS:
        page = (tmp_path / f"command-{name}.md").read_text()
        assert page.startswith(f"# limbcli {name}\n")
        options = [text for each in group.commands[name].params for text in each.opts]  # type: ignore
        assert all(text in page for text in options if text.startswith("--"))
    assert all(f"`{each.name}`" in (tmp_path / "effects.md").read_text() for each in EFFECTS)
    keys = case_keys()
    assert len(keys) > 50
    assert all(f"`{name}`" in (tmp_path / "case-keys.md").read_text() for name in keys)


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path: Path):
    pytest.importorskip("furo")
    pytest.importorskip("myst_parser")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-q",
        "-b",
        "html",
        "-d",
        tmp_path / "kept",
        "-D",  # without pages of the source code, which take half of the time
        "extensions=myst_parser,sphinx.ext.autodoc,sphinx.ext.napoleon,offline_math",
    ]
    result = subprocess.run([*command, DOCS, tmp_path / "html"], capture_output=True, text=True, timeout=500)
    assert result.returncode == 0, result.stderr
    assert "limbcli.segment" in (tmp_path / "html" / "api.html").read_text()


def test_the_readme_of_every_folder_of_templates_lists_its_files():
    for folder in ("feb", "report"):
        text = (REPOSITORY / "templates" / folder / "README.md").read_text(encoding="utf-8")
        files = {each.name for each in (REPOSITORY / "templates" / folder).iterdir()} - {"README.md"}
        assert {each for each in files if each not in text} == set()


def test_every_file_of_the_program_that_a_page_names_exists():
    pages = [*PAGES, REPOSITORY / "CONTRIBUTING.md", *(REPOSITORY / "templates").glob("*/README.md")]
    named = {(page.name, each) for page in pages for each in re.findall(
        r"`((?:limbcli|tests|templates)/[\w./-]+\.\w+)`", page.read_text(encoding="utf-8")
    )}  # fmt: skip
    assert len(named) > 40
    assert sorted(each for each in named if not (REPOSITORY / each[1]).exists()) == []


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Pages that are made when the documentation is built, as links name them."""
    folder = tmp_path_factory.mktemp("generated")
    module_at(DOCS / "from_program.py").write_all(folder)
    return {f"generated/{each.name}" for each in folder.iterdir()}


@pytest.mark.parametrize(
    "page", [*PAGES, *sorted((REPOSITORY / "tests/benchmarks").rglob("*.md"))],
    ids=lambda page: page.relative_to(REPOSITORY).as_posix(),
)  # fmt: skip
def test_every_link_leads_to_a_file(page: Path, generated: set[str]):
    links = re.findall(r"\]\(([^)#:\s]+)(?:#[\w-]*)?\)", page.read_text(encoding="utf-8"))
    assert [each for each in links if not (page.parent / each).exists() and each not in generated] == []
