"""Model files that would write elsewhere, take all memory, or name what is not there: refused, by line."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest

from limbcli.errors import CaseError
from limbcli.feb.outline import check_output, read_outline
from limbcli.feb.read import read_feb
from limbcli.feb.runnable import runnable

DATA = Path(__file__).resolve().parents[1] / "data" / "feb"
TEXT = (DATA / "punch.feb").read_text()


def refused(folder: Path, old: str, new: str, read=read_feb) -> CaseError:
    assert old in TEXT
    path = folder / "model.feb"
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(CaseError) as caught:
        read(path)
    assert caught.value.fix
    return caught.value


@pytest.mark.parametrize("read", [read_feb, read_outline])
@pytest.mark.parametrize(
    "name",
    ["../../x.csv", "/tmp/x.csv", "a/b.csv", "..", "C:x.csv", "a\\b.csv", ".hidden", "", "n" * 200],
)
def test_records_stay_in_the_run_s_folder(tmp_path: Path, name: str, read) -> None:
    error = refused(tmp_path, 'file="nodes.csv"', f'file="{name}"', read)
    assert "plain file name" in error.what
    assert error.facts["line"] == 377


@pytest.mark.parametrize("name", ["model.feb", "MODEL.log", "run.json", "rigid_body.csv", "force-depth.csv"])
def test_records_do_not_take_the_run_s_own_names(tmp_path: Path, name: str) -> None:
    error = refused(tmp_path, 'file="nodes.csv"', f'file="{name}"', read_outline)
    assert name in error.what


def test_the_log_and_plot_file_may_not_be_led_elsewhere(tmp_path: Path) -> None:
    """FEBio prefers their names to those of its command line; a run leaves them out (`runnable`)."""

    def read(path: Path) -> None:
        check_output(read_outline(path), path)

    error = refused(tmp_path, "<logfile>", '<logfile file="../../x.csv">', read)
    assert "would write its log" in error.what
    run = runnable(tmp_path / "model.feb")
    assert b"x.csv" not in run.text
    assert "<logfile>" in run.said[0]
    (tmp_path / "model.feb").write_bytes(run.text)
    read(tmp_path / "model.feb")
    assert read_feb(tmp_path / "model.feb").info == read_feb(DATA / "punch.feb").info


@pytest.mark.parametrize("read", [read_feb, read_outline])
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("mm-N-s", "ft-lb-s", "ft-lb-s"),
        ("<Material>", "<Include>sub.feb</Include><Material>", "another file (sub.feb)"),
        ("<Material>", '<Material from="laws.feb">', "another file (laws.feb)"),
        ("</Output>", '</Output><Step><step id="1"><Boundary from="b.feb"/></step></Step>', "(b.feb)"),
        ('sz" delim=","', 'sz" delim=";"', "delim=';' leaves a file"),
        ('name="probe">2<', 'name="probe">1<', "not the material id of one rigid body"),
        ('name="probe">2<', 'name="probe">2,3<', "not the material id of one rigid body"),
    ],
)
def test_what_a_run_could_not_take_along_or_name_is_refused_before_it(
    tmp_path: Path, old: str, new: str, words: str, read
) -> None:
    assert words in refused(tmp_path, old, new, read).what


@pytest.mark.parametrize("form", ['format="%g"', 'comments="off"'])
def test_records_in_a_form_that_cannot_be_read_back_are_refused(tmp_path: Path, form: str) -> None:
    assert "leaves a file" in refused(tmp_path, 'data="J;sz"', f'data="J;sz" {form}', read_outline).what


def test_bodies_without_a_name_are_told_apart(tmp_path: Path) -> None:
    other = '<material id="3" type="rigid body"><center_of_mass>0,0,5</center_of_mass></material></Material>'
    more = '<rigid_body_data data="z;Fz" file="other.csv">3</rigid_body_data></logfile>'
    text = TEXT.replace('id="2" name="probe"', 'id="2"').replace("<rb>probe<", "<rb>material_2<")
    path = tmp_path / "model.feb"
    path.write_text(text.replace("</Material>", other).replace("</logfile>", more))
    named = [each.items for each in read_outline(path).records if each.kind == "rigid_body"]
    assert named == ["material_2", "material_3"]


@pytest.mark.parametrize("read", [read_feb, read_outline])
@pytest.mark.parametrize("number", ["99999999999", "99999999999999999999999", "-4", "0", "1e3", "seven"])
@pytest.mark.parametrize("tag", ["node", "elem"])
def test_an_id_out_of_range_is_told_with_its_line(tmp_path: Path, tag: str, number: str, read) -> None:
    error = refused(tmp_path, f'<{tag} id="5"', f'<{tag} id="{number}"', read)
    assert "is not an id" in error.what
    assert (
        f'<{tag} id="{number}"' in (tmp_path / "model.feb").read_text().splitlines()[error.facts["line"] - 1]
    )


@pytest.mark.parametrize("node", ["90000", "99999999999", "3.5", "nan"])
def test_an_element_of_an_absent_node_is_told_with_its_line(tmp_path: Path, node: str) -> None:
    start = TEXT.index('<elem id="3">') + len('<elem id="3">')
    old = TEXT[start - len('<elem id="3">') : TEXT.index("</elem>", start)]
    nodes = old.split(">")[1].split(",")
    error = refused(tmp_path, old, f'<elem id="3">{",".join([*nodes[:2], node, *nodes[3:]])}')
    assert '<elem id="3">' in (tmp_path / "model.feb").read_text().splitlines()[error.facts["line"] - 1]


def test_a_list_of_ids_that_unfolds_without_end_is_refused(tmp_path: Path) -> None:
    ids = TEXT[TEXT.index(">51,52") + 1 : TEXT.index("</NodeSet>", TEXT.index(">51,52"))]
    assert "list of ids" in refused(tmp_path, ids, "1:99999999999999").what


def test_a_packed_file_that_unfolds_without_end_is_refused(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("limbcli.feb.xml._LARGEST", 1_000_000)
    path = tmp_path / "model.feb.gz"
    path.write_bytes(gzip.compress(b"<febio_spec>" + b" " * 5_000_000))
    with pytest.raises(CaseError, match="unpacks to more than 1 MB"):
        read_feb(path)
