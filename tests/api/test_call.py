"""Results say the call they came from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import limbcli
from limbcli.api.call import names_of, public
from limbcli.errors import CaseError
from limbcli.results import provenance


@public(str, "str")
def simulate(case: object, *, m: float = 1.0, progress: object = None) -> str:
    return str(provenance()["command"])


def test_a_result_of_a_call_says_the_call(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sys.argv", ["/usr/lib/ipykernel_launcher.py", "-f", "kernel-1.json"])
    message = simulate(Path("my limb"), m=2.5, progress=print)
    assert message == "limbcli.simulate('my limb', m=2.5)"
    assert provenance()["command"].startswith("ipykernel_launcher.py"), "only while it is at work"


def test_a_result_of_a_command_says_it_as_it_can_be_typed_again(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sys.argv", ["/usr/lib/limbcli/__main__.py", "fit", "my limb", "--site", "p1"])
    assert provenance()["command"] == "python -m limbcli fit 'my limb' --site p1"


def test_a_call_that_fails_leaves_nothing_behind():
    @public(str, "str")
    def fail() -> None:
        raise ValueError

    with pytest.raises(ValueError):  # noqa: PT011
        fail()
    assert "limbcli.fail" not in provenance()["command"]


@pytest.mark.parametrize(
    ("name", "argument", "value", "fix"),
    [
        ("fit", "intervals", "no", "give True or False"),
        ("segment", "fresh", None, "give True or False"),
        ("mesh", "wait", 2, "give True or False"),
        ("segment", "smooth_mm", None, "leave it out: 0.7"),
        ("fit", "max_iterations", None, "leave it out: 50"),
        ("diagnose", "measured", "tare_n=0.4", "give numbers by name, such as {'tare_n': 0.4}"),
        ("synth", "stretch_along", ["bent=0.8"], "give numbers by name, such as {'bent': 0.8}"),
    ],
)
def test_what_is_of_another_kind_is_told_by_its_name(
    tmp_path: Path, name: str, argument: str, value: object, fix: str
):
    more = (tmp_path / "made",) if name == "synth" else ()
    with pytest.raises(CaseError, match=f"{argument} is ") as caught:
        getattr(limbcli, name)(tmp_path, *more, out=tmp_path / "out", **{argument: value})
    assert caught.value.where == f"{name}({argument}={value!r})"
    assert caught.value.fix == fix


def test_every_number_of_a_table_is_one(tmp_path: Path):
    with pytest.raises(CaseError, match="tare_n is nan, not a finite number") as caught:
        limbcli.diagnose(tmp_path, measured={"tare_n": float("nan")})
    assert caught.value.where == "diagnose(tare_n=nan)"


def test_flags_of_numpy_and_numbers_are_flags(tmp_path: Path):
    for value in (np.True_, 1, 0):
        with pytest.raises(CaseError, match=r"no case.toml"):
            limbcli.segment(tmp_path, fresh=value)  # type: ignore[arg-type]


@pytest.mark.parametrize("sites", [[], (), 3, ["p1", 2]])
def test_a_selection_that_names_nothing_is_not_everything(sites: object):
    with pytest.raises(CaseError, match="sites is") as caught:
        names_of(sites)  # type: ignore[arg-type]
    assert caught.value.fix == "give one or several names, or omit it for all"


def test_no_effects_are_the_usual_ones(tmp_path: Path):
    assert names_of("skin-layer", "effects") == ["skin-layer"]
    with pytest.raises(CaseError, match="effects is 3"):
        limbcli.make_phantom(tmp_path / "subject", effects=3)  # type: ignore[arg-type]


def test_a_material_that_the_model_does_not_have_is_told_with_those_that_it_has():
    model = limbcli.read_feb(Path(__file__).parents[1] / "data" / "feb" / "punch.feb")
    with pytest.raises(limbcli.LimbcliError, match="no material 'tisue'") as found:
        model.with_material("tisue", model.materials["tissue"])
    assert "tissue" in found.value.fix
