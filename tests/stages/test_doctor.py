"""What this machine lacks is named, with the way to get it; a wrong solver is found out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement

from limbcli.cli.app import main
from limbcli.progress import Progress
from limbcli.solvers.reference import ReferenceSolver
from limbcli.stages import doctor as module
from limbcli.stages.doctor import doctor
from limbcli.stages.machine import libraries
from limbcli.stages.machine import self_test as test_module
from limbcli.stages.machine.self_test import HEIGHT, SIDE, indentation, nominal_stress, self_test

HEARD: list[str] = []


@pytest.fixture(scope="module")
def healthy():
    return doctor(progress=Progress(lambda kind, facts: HEARD.append(kind)))


def test_a_machine_that_runs_these_tests_lacks_nothing(healthy):
    assert [each for each in healthy.findings if each.state == "missing"] == []
    assert healthy.exit_code == 0
    topics = {each.topic for each in healthy.findings}
    assert topics == {"versions", "packages", "computer", "tried", "solvers"}
    names = {each.name for each in healthy.findings}
    assert {"python", "limbcli", "numpy", "pymeshlab", "matplotlib", "reference", "febio", "cores"} <= names


def test_no_time_left_is_promised_of_work_of_unequal_parts(healthy):
    """Compiling takes a minute where trying packages takes seconds: a share done would say nothing."""
    assert "note" in HEARD
    assert "task" not in HEARD


def test_stress_is_the_derivative_of_the_energy(rng):
    """Against central differences of Psi in uniaxial strain, at a random stretch."""
    stretch = rng.uniform(0.5, 1.2)
    c, fk, m = test_module.C, test_module.F_KAPPA, test_module.M

    def psi(x: float) -> float:
        return c / (2 * m**2) * (x**m + x**-m - 2) + fk * c / 2 * (x - 1) ** 2

    h = 1e-6
    assert nominal_stress(stretch) == pytest.approx((psi(stretch + h) - psi(stretch - h)) / (2 * h), rel=1e-8)


def test_closed_form_holds_to_the_tolerance_of_newton():
    """Newton ends at 1e-6 of the forces; a solver that is wrong by a per mille would be seen."""
    found = self_test(ReferenceSolver(threads=1))
    assert found.error_fraction < 1e-6
    assert found.passed
    assert found.force > 1.0


def test_model_has_the_block_and_covers_its_top():
    model = indentation()
    points, cells = model.mesh.points, model.mesh.block("tissue").cells
    volumes = np.linalg.det(points[cells[:, 1:4]] - points[cells[:, :1]]) / 6
    assert volumes.min() > 0
    assert volumes.sum() == pytest.approx(SIDE**2 * HEIGHT)
    top = points[model.mesh.surfaces["contact"].facets["tri6"][:, :3]]
    normals = np.cross(top[:, 1] - top[:, 0], top[:, 2] - top[:, 0])
    assert normals[:, 2].min() > 0
    assert normals[:, 2].sum() / 2 == pytest.approx(SIDE**2)


def test_a_solver_that_is_wrong_is_told_with_exit_code_4(monkeypatch, capsys):
    true = test_module.self_test

    def off(solver, **more):
        found = true(solver, **more)
        return replace(found, force=found.force * 1.01)

    monkeypatch.setattr(test_module, "self_test", off)
    monkeypatch.setattr(libraries, "TRIALS", {})
    with pytest.raises(SystemExit) as stop:
        main(["doctor", "--json", "--quiet"])
    assert stop.value.code == 4
    content = json.loads(capsys.readouterr().out)
    wrong = {each["name"]: each["found"] for each in content["findings"] if each["state"] == "missing"}
    assert not content["ok"]
    assert "closed form" in wrong.pop("reference")
    assert set(wrong) <= {"febio"}, "it is wrong too where it is found"


def test_febio_that_was_named_and_is_not_there_is_missing(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(libraries, "TRIALS", {})
    monkeypatch.setattr(module, "_tested", lambda *_: module.Finding("solvers", "reference", "good", ""))
    result = doctor(febio=tmp_path / "nowhere")
    assert [each.name for each in result.missing] == ["febio"]
    monkeypatch.setenv("LIMBCLI_FEBIO", str(tmp_path / "nowhere"))
    assert [each.name for each in doctor().missing] == ["febio"]
    assert result.exit_code == 4


@pytest.mark.parametrize(("version", "state"), [("4.11.0", "good"), ("4.12.0", "note")])
def test_a_febio_that_was_not_compared_is_a_note(monkeypatch, version: str, state: str):
    test = test_module.SelfTest("febio", version, force=1.0, expected=1.0, seconds=0.1)
    monkeypatch.setattr(test_module, "self_test", lambda *_, **__: test)
    monkeypatch.setattr(module, "choose", lambda *_: None)
    finding = module._tested("febio", None, Progress(lambda *_: None))
    assert finding.state == state
    assert ("not been compared" in finding.fix) == (state == "note")


@pytest.mark.slow
def test_missing_library_is_named_with_its_debian_package(monkeypatch):
    """A trial that fails as a missing library makes it fail."""
    message = "ImportError: libOpenGL.so.0: cannot open shared object file: No such file or directory"
    monkeypatch.setattr(libraries, "TRIALS", {"pymeshlab": f"import sys; sys.exit({message!r})"})
    trial = libraries.end("pymeshlab", libraries.start("pymeshlab"))
    assert (trial.works, trial.missing) == (False, ("libOpenGL.so.0",))
    finding = module._library(trial)
    assert finding.state == "missing"
    assert finding.fix == "apt-get install libopengl0"


def test_package_that_dies_without_a_word_is_missing(monkeypatch):
    monkeypatch.setattr(libraries, "TRIALS", {"tetgen": "import os; os.abort()"})
    trial = libraries.end("tetgen", libraries.start("tetgen"))
    assert not trial.works
    assert "status -6" in trial.why


@pytest.mark.parametrize(
    ("wanted", "state"), [("numpy>=2.0", "good"), ("numpy>=99", "missing"), ("nothing-like-it>=1", "missing")]
)
def test_packages_are_held_to_their_range(wanted: str, state: str):
    finding = module._package(Requirement(wanted))
    assert finding.state == state
    assert bool(finding.fix) == (state == "missing")


def test_version_tells_the_solvers(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("limbcli ")
    assert lines[1].startswith("reference solver ")
    assert lines[2].startswith("FEBio")
