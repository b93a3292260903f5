"""What a model file says is held by the model or refused by tag and line."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from limbcli.errors import CaseError
from limbcli.feb.law_tags import lame
from limbcli.feb.outline import read_outline
from limbcli.feb.read import read_feb
from limbcli.model import Curved, ElementMap, NodeMap

GOLDEN_LAWS = {
    "effect-fibre": ["mixture", "ogden", "fiber_exp_pow"],
    "effect-contraction": ["mixture", "ogden", "active_contraction"],
    "effect-viscoelastic": ["viscoelastic", "ogden"],
    "effect-prestrain": ["prestrain", "ogden"],
    "effect-biphasic": ["biphasic", "ogden"],
    "effect-base": ["ogden"],
}
SPRING = (
    '<rigid_connector type="rigid spring"><body_a>probe</body_a><body_b>probe</body_b><k>20</k>'
    "<insertion_a>0,0,0</insertion_a><insertion_b>0,0,5</insertion_b><free_length>5</free_length>"
    "</rigid_connector></Rigid>"
)

TISSUE = (
    'type="Ogden unconstrained"><density>1e-09</density><cp>0.05</cp>'
    "<c1>0.0025</c1><m1>2</m1><c2>0.0025</c2><m2>-2</m2>"
)
MAPPED_OGDEN = 'type="Ogden unconstrained"><cp>1</cp><c1 type="map">own</c1><m1>2</m1>'
NEO_HOOKE = 'type="neo-Hookean"><E>1</E><v>0.3</v>'
MAPPED_E = NEO_HOOKE.replace("<E>1", '<E type="map">own')
FIBRES_OF_A_MAP = (
    'type="solid mixture"><solid type="neo-Hookean"><E>1</E><v>0.3</v></solid><solid type="fiber-exp-pow">'
    '<alpha>0</alpha><beta>2</beta><ksi>1</ksi><fiber type="map"><map>own</map></fiber></solid>'
)


def golden_file(folder: Path) -> Path:
    return next(folder.glob("model.feb*"))


def edited(source: Path, target: Path, old: str, new: str) -> Path:
    """A copy of a model file with one thing changed."""
    text = source.read_text()
    assert old in text
    target.write_text(text.replace(old, new, 1))
    return target


def test_records_may_name_a_set(punch: Path, tmp_path: Path) -> None:
    listed = read_feb(punch).records
    text = punch.read_text()
    start = text.index("<node_data")
    end = text.index("</node_data>") + len("</node_data>")
    named = '<node_data data="ux;uy;uz" delim="," file="nodes.csv" node_set="skin"/>'
    text = text[:start] + named + text[end:]
    text = text.replace('file="elements.csv">', 'file="elements.csv" elem_set="tissue">')
    (tmp_path / "named.feb").write_text(text)
    found = read_feb(tmp_path / "named.feb").records
    np.testing.assert_array_equal(found[1].items, listed[1].items)
    np.testing.assert_array_equal(found[2].items, np.arange(192))
    for old, new, what in (("skin", "skim", "node set 'skim'"), ("tissue", "bone", "element set 'bone'")):
        path = edited(tmp_path / "named.feb", tmp_path / "bad.feb", f'_set="{old}"', f'_set="{new}"')
        with pytest.raises(CaseError, match=f"there is no {what}"):
            read_feb(path)


def test_the_punch_is_read_whole(punch: Path) -> None:
    model = read_feb(punch)
    assert {block.name: (block.kind, len(block.cells)) for block in model.mesh.blocks} == {
        "tissue": ("tet4", 192),
        "probe": ("quad4", 4),
    }
    assert model.mesh.points.shape == (84, 3)
    assert model.mesh.points[:75, 2].min() == -10
    assert model.materials["tissue"].parameters == {
        "kappa": 0.05, "c1": 0.0025, "m1": 2.0, "c2": 0.0025, "m2": -2.0,
    }  # fmt: skip
    assert [(each.dof, each.kind) for each in model.drives][-1] == ("z", "displacement")
    assert model.drives[-1].value == -1.95
    assert model.curves[model.drives[-1].curve or ""].points == ((0, 0), (1, 1))
    assert model.bodies[0].blocks == ("probe",)
    assert model.contacts[0].penalty == 20
    assert model.contacts[0].primary == "skin"
    assert model.steps[0].must_points == (0.25, 0.5, 1.0)
    assert model.records[0].items == "probe"
    assert np.array_equal(np.asarray(model.records[1].items), np.arange(50, 75))
    assert model.info["site"] == "made by hand"


def test_packed_files_read_the_same(punch: Path, tmp_path: Path) -> None:
    packed = tmp_path / "punch.feb.gz"
    packed.write_bytes(gzip.compress(punch.read_bytes()))
    assert np.array_equal(read_feb(packed).mesh.points, read_feb(punch).mesh.points)


@pytest.mark.parametrize(
    ("old", "new", "tag", "words"),
    [
        ("<penalty>", "<penalti>1</penalti><penalty>", "penalti", "did you mean penalty"),
        ('id="1" name="tissue"', 'id="1" colour="red" name="tissue"', "material", "colour"),
        ("Ogden unconstrained", "Ogden unconstraint", "material", "Ogden unconstraint"),
        ('id="2" name="probe"', 'id="3" name="probe"', "material", "where 2 was expected"),
        ("<cp>0.05</cp>", "<cp>0,05</cp>", "cp", "not 1 number"),
        ("<cp>0.05</cp>", "<cp>nan</cp>", "cp", "finite"),
        ("<cp>0.05</cp>", '<cp lc="7">0.05</cp>', "cp", "no load controller 7"),
        ("<cp>0.05</cp>", '<cp type="math">X</cp>', "cp", "'math' is not supported"),
        ("<cp>0.05</cp>", '<cp type="map">k</cp>', "cp", "no element map"),
        ("<cp>0.05</cp>", "<cp>0.05</cp><cp>0.06</cp>", "cp", "twice"),
        ("<search_tol>", '<search_tol lc="1">', "search_tol", "attribute lc='1'"),
        ("<penalty>", '<penalty type="math">', "penalty", "attribute type='math'"),
        ("<laugon>", '<laugon lc="1">', "laugon", "attribute lc='1'"),
        ("<maxaug>", '<maxaug lc="1">', "maxaug", "attribute lc='1'"),
        ("</Rigid>", SPRING.replace("<k>", '<k lc="1">'), "k", "attribute lc='1'"),
        ("</Rigid>", SPRING.replace("<free_length>", '<free_length lc="1">'), "free_length", "attribute lc"),
        ("mm-N-s", "ft-lb-s", "units", "ft-lb-s"),
        ('version="4.0"', 'version="1.2"', "febio_spec", "1.2"),
        ('node_set="fixed"', 'node_set="fixd"', "bc", "fixd"),
        ("<rb>probe</rb>", "<rb>prob</rb>", "rb", "prob"),
        ("<dof>z</dof>", "<dof>Rz</dof>", "dof", "Rz"),
        ("zero displacement", "normal displacement", "bc", "normal displacement"),
        ("sliding-elastic", "sliding-facet-on-facet", "contact", "sliding-facet-on-facet"),
        ('surface_pair="probe', 'surface_pair="robe', "contact", "robe_contact_pair"),
        ("<interpolate>LINEAR", "<interpolate>CSPLINE", "interpolate", "CSPLINE"),
        ('data="J;sz" delim=","', 'data="J;sz" delim=","  format="%g"', "element_data", "format"),
        ('type="tet4"', 'type="tet5"', "Elements", "tet5"),
        ('<node id="2">-6.0', '<node id="2">x', "node", "not 3 number"),
        ('<elem id="1">', '<elem id="1">999,', "elem", "not 4 number"),
        ("<analysis>STATIC", "<analysis>STEADY-STATE", "analysis", "STEADY-STATE"),
        ("<Boundary>", "<Loads><load/></Loads><Boundary>", "load", "know this tag"),
        (">2</rigid_body_data>", ">1</rigid_body_data>", "rigid_body_data", "not the material id"),
        ("<cp>0.05</cp>", "<cp>1_0</cp>", "cp", "not 1 number"),
        ("<time_steps>10", "<time_steps>0", "time_steps", "not positive"),
        ("<step_size>0.1", "<step_size>0", "step_size", "not positive"),
        (
            "<interpolate>LINEAR</interpolate><extend>CONSTANT</extend><points>",
            "<interpolate>SMOOTH</interpolate><extend>CONSTANT</extend><points><pt>0,1</pt>",
            "points",
            "two points at one time",
        ),
        (
            '<NodeSet name="skin">',
            '<NodeSet name="fixed">1</NodeSet><NodeSet name="skin">',
            "NodeSet",
            "'fixed'",
        ),
        (
            '<NodeSet name="bone">',
            '<ElementSet name="tissue">1</ElementSet><NodeSet name="bone">',
            "ElementSet",
            "'tissue' is that of the <Elements>",
        ),
        (
            '<Surface name="probe_face">',
            '<Surface name="skin"><tri3 id="1">51,52,57</tri3></Surface><Surface name="probe_face">',
            "Surface",
            "'skin'",
        ),
        (
            "</Mesh>",
            '<SurfacePair name="probe_contact_pair"><primary>probe_face</primary><secondary>skin'
            "</secondary></SurfacePair></Mesh>",
            "SurfacePair",
            "'probe_contact_pair'",
        ),
        ("<ShellDomain", '<SolidDomain name="tissue" mat="tissue"/><ShellDomain', "SolidDomain", "'tissue'"),
        ('name="bone">1,2,3,', 'name="bone">1 2,3,', "NodeSet", "not a list of ids"),
        ('name="bone">1,', 'name="bone">1_0,', "NodeSet", "not a list of ids"),
    ],
)
def test_what_cannot_be_held_is_refused_by_tag_and_line(
    punch: Path, tmp_path: Path, old: str, new: str, tag: str, words: str
) -> None:
    path = edited(punch, tmp_path / "bad.feb", old, new)
    line = 1 + path.read_text().split(new)[0].count("\n")
    with pytest.raises(CaseError) as caught:
        read_feb(path)
    error = caught.value
    assert error.facts["tag"] == tag
    assert abs(int(str(error.facts["line"])) - line) <= 1
    assert words in str(error)
    assert str(path) in error.where


def test_a_comment_within_a_value_stands_for_nothing(punch: Path, tmp_path: Path) -> None:
    path = edited(punch, tmp_path / "model.feb", 'name="fixed">1,2,3,', 'name="fixed">1,2,<!-- bone: -->3,')
    path = edited(path, path, "<cp>0.05</cp>", "<!-- MPa --><cp>0<!-- point -->.0<!-- five -->5</cp>")
    found, whole = read_feb(path), read_feb(punch)
    assert found.mesh.node_sets["fixed"].tolist() == whole.mesh.node_sets["fixed"].tolist()
    assert found.materials == whole.materials
    assert found.info == whole.info
    assert read_outline(path).materials == read_outline(punch).materials


@pytest.mark.parametrize("ids", ["1:25", "1:25:1", "1,2:10,\n11:24,25,", " 1 , 2:25 "])
def test_ranges_of_ids_are_febios(punch: Path, tmp_path: Path, ids: str) -> None:
    """FEBio, XMLTag::value(vector<int>&)."""
    start = punch.read_text().index('name="fixed">') + len('name="fixed">')
    listed = punch.read_text()[start : punch.read_text().index("<", start)]
    path = edited(punch, tmp_path / "model.feb", f'name="fixed">{listed}', f'name="fixed">{ids}')
    assert read_feb(path).mesh.node_sets["fixed"].tolist() == list(range(25))


def test_a_load_controller_of_any_name_is_looked_for(punch: Path, tmp_path: Path) -> None:
    path = edited(punch, tmp_path / "model.feb", '<dtmax lc="2">', '<dtmax lc="2\'">')
    assert read_outline(path).must_points == ()
    assert read_outline(punch).must_points == (0.25, 0.5, 1.0)


def test_an_element_type_of_default_is_none(punch: Path, tmp_path: Path) -> None:
    old = '<SolidDomain name="tissue" mat="tissue"'
    path = edited(punch, tmp_path / "model.feb", old, f'{old} elem_type="default"')
    assert read_feb(path).domains == read_feb(punch).domains


def test_a_must_point_that_stands_twice_is_one(punch: Path, tmp_path: Path) -> None:
    path = edited(punch, tmp_path / "model.feb", "<pt>0.5,0.1</pt>", "<pt>0.5,0.1</pt><pt>0.5,0.05</pt>")
    assert read_feb(path).steps[0].must_points == (0.25, 0.5, 1.0)


def test_the_line_is_right_beyond_65535(punch: Path, tmp_path: Path) -> None:
    path = edited(punch, tmp_path / "long.feb", "<Mesh>", "\n" * 70_000 + "<Mesh>")
    edited(path, path, "<Boundary>", "<Constraints><c>1</c></Constraints>\n<Boundary>")
    with pytest.raises(CaseError) as caught:
        read_feb(path)
    assert int(str(caught.value.facts["line"])) > 70_000


def test_files_that_are_no_model_are_case_errors(tmp_path: Path) -> None:
    path = tmp_path / "model.feb"
    with pytest.raises(CaseError, match="does not exist"):
        read_feb(path)
    for content in (b"", b"<febio_spec", b"\x1f\x8bnot really", b"<html/>"):
        path.write_bytes(content)
        with pytest.raises(CaseError, match="not a "):
            read_feb(path)


def test_an_entity_bomb_is_not_expanded(tmp_path: Path) -> None:
    path = tmp_path / "model.feb"
    path.write_text(
        '<!DOCTYPE a [<!ENTITY b "bbbb">]><febio_spec version="4.0"><Mesh>&b;</Mesh></febio_spec>'
    )
    with pytest.raises(CaseError):
        read_feb(path)


def test_an_entity_of_the_files_own_is_refused(punch: Path, tmp_path: Path) -> None:
    text = punch.read_text().replace("<febio_spec", '<!DOCTYPE x [<!ENTITY more "4,5">]>\n<febio_spec', 1)
    path = tmp_path / "model.feb"
    path.write_text(text.replace('name="fixed">1,2,3,', 'name="fixed">1,2,&more;,3,', 1))
    with pytest.raises(CaseError, match="entities"):
        read_feb(path)


def test_left_out_contact_settings_are_febios_own(punch: Path, tmp_path: Path) -> None:
    text = punch.read_text()
    start, end = text.index("<laugon>"), text.index("</contact>")
    path = tmp_path / "bare.feb"
    path.write_text(text[:start] + text[end:])
    contact = read_feb(path).contacts[0]
    assert (contact.penalty, contact.auto_penalty, contact.search_radius) == (1.0, False, 1.0)
    assert (contact.tolerance, contact.symmetric, contact.augmented) == (0.1, True, False)


def test_neo_hooke_is_kept_in_lames_constants(punch: Path, tmp_path: Path) -> None:
    text = punch.read_text()
    start = text.index("<density>")
    law = text[start : text.index("</material>")]
    path = tmp_path / "neo.feb"
    path.write_text(text.replace(law, "<E>0.03</E><v>0.25</v>").replace("Ogden unconstrained", "neo-Hookean"))
    parameters = read_feb(path).materials["tissue"].parameters
    assert parameters["mu"] == pytest.approx(0.012, rel=1e-15)
    assert parameters["lambda"] == pytest.approx(0.012, rel=1e-15)


@pytest.mark.parametrize("n_parts", [0, 2])
def test_a_wrapper_law_has_one_elastic_part(punch: Path, tmp_path: Path, n_parts: int) -> None:
    text = punch.read_text()
    start, end = text.index("<density>"), text.index("</material>")
    elastic = f'<elastic type="Ogden unconstrained">{text[start:end]}</elastic>'
    path = tmp_path / "wrapped.feb"
    wrapped = text[:start] + "<g0>1</g0>" + elastic * n_parts + text[end:]
    path.write_text(wrapped.replace('type="Ogden unconstrained"', 'type="viscoelastic"', 1))
    with pytest.raises(CaseError, match=f"it has {n_parts} <elastic>"):
        read_feb(path)


# ---------------------------------------------------------------- against the stored models of FEBio


@pytest.mark.parametrize("name", list(GOLDEN_LAWS))
def test_golden_laws_get_their_names(golden: Path, name: str) -> None:
    material = read_feb(golden_file(golden / name)).materials["tissue"]
    assert [material.law, *(part.law for part in material.parts)] == GOLDEN_LAWS[name]


def test_golden_curves_maps_springs_and_rules_are_held(golden: Path) -> None:
    contraction = read_feb(golden_file(golden / "effect-contraction"))
    active = contraction.materials["tissue"].parts[1].parameters
    assert active["T0"] == Curved(0.005, "curve_3")
    assert active["fiber"] == (0.0, 1.0, 0.0)
    assert contraction.curves["curve_3"].points[1] == (0.5, 0.0)

    mapped = read_feb(golden_file(golden / "effect-map")).materials["tissue"].parameters["c1"]
    assert isinstance(mapped, ElementMap)
    assert mapped.block == "Tissue"
    assert mapped.values.shape == (1080,)
    assert mapped.values.max() == pytest.approx(4 * 0.0025, rel=0.01)

    driven = read_feb(golden_file(golden / "cube-law-m2-fk100")).supports[0]
    assert isinstance(driven.value, NodeMap)
    assert driven.dofs == ("x",)

    spring = read_feb(golden_file(golden / "effect-bone-spring"))
    assert (spring.springs[0].stiffness, spring.springs[0].free_length) == (2.0, 50.0)
    assert next(body for body in spring.bodies if body.name == "bone").node_sets == ("fixed",)
    assert [record.file for record in spring.records] == [
        "rigid_body.csv", "bone.csv", "nodes.csv", "elements.csv",
    ]  # fmt: skip

    assert read_feb(golden_file(golden / "effect-tet10g4")).domains[0].rule == "TET10G4"
    assert read_feb(golden_file(golden / "effect-ut4")).domains[0].rule_parameters["alpha"] == 0.05
    assert read_feb(golden_file(golden / "effect-friction")).contacts[0].friction == 0.3
    assert read_feb(golden_file(golden / "punch-tet4-auglag")).contacts[0].augmented
    force = read_feb(golden_file(golden / "punch-tet4-force")).drives[-1]
    assert (force.dof, force.kind, force.value) == ("z", "force", -8.0)
    assert not read_feb(golden_file(golden / "effect-viscoelastic")).steps[0].adaptive
    varying = read_feb(golden_file(golden / "effect-biphasic"))
    assert varying.steps[0].dt_max_curve == "curve_2"
    assert varying.contacts[0].kind == "sliding-biphasic"


def test_the_golden_limb_carries_its_must_points(golden: Path) -> None:
    model = read_feb(golden / "limb-posterior" / "tet10.feb.gz")
    step = model.steps[0]
    assert step.must_points == (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
    assert (step.n_steps, step.step_size, step.dt_max) == (50, 0.02, 0.1)
    assert len(model.mesh.block("Tissue").cells) == 12345
    assert list(model.curves) == ["curve_1"]


def _mapped(values: list[str], *, part: str = "tissue", kind: str = "scalar") -> str:
    """`<MeshData>` with the map "own" over a part, before what follows it."""
    rows = "".join(f'<e lid="{k}">{value}</e>' for k, value in enumerate(values, start=1))
    name = f'name="own" elem_set="{part}" data_type="{kind}"'
    return f"<MeshData><ElementData {name}>{rows}</ElementData></MeshData>\n<MeshDomains>"


@pytest.mark.parametrize(
    ("law", "mapped", "words"),
    [
        (MAPPED_OGDEN, _mapped(["1,0,0"] * 192, kind="vec3"), "not one of scalars"),
        (FIBRES_OF_A_MAP, _mapped(["1"] * 192), "not one of vec3s"),
        (MAPPED_OGDEN, _mapped(["1"] * 4, part="probe"), "a map over 'probe'"),
        (MAPPED_E.replace("0.3", "0.5"), _mapped(["1"] * 192), "v = 0.5"),
        (NEO_HOOKE.replace("<v>0.3", '<v type="map">own'), _mapped(["0.3"] * 191 + ["0.6"]), "v = 0.6"),
    ],
)  # fmt: skip
def test_a_map_that_says_nothing_of_the_law_is_refused(
    punch: Path, tmp_path: Path, law: str, mapped: str, words: str
) -> None:
    path = edited(punch, tmp_path / "model.feb", TISSUE, law)
    edited(path, path, "<MeshDomains>", mapped)
    with pytest.raises(CaseError, match=words):
        read_feb(path)


@pytest.mark.parametrize("mapped", ["E", "v"])
def test_either_elastic_constant_may_be_a_map(punch: Path, tmp_path: Path, mapped: str) -> None:
    value = {"E": "1", "v": "0.3"}[mapped]
    law = NEO_HOOKE.replace(f"<{mapped}>{value}", f'<{mapped} type="map">own')
    path = edited(punch, tmp_path / "model.feb", TISSUE, law)
    edited(path, path, "<MeshDomains>", _mapped([value] * 192))
    found = read_feb(path).materials["tissue"].parameters
    for name, constant in zip(("mu", "lambda"), lame(1.0, 0.3), strict=True):
        assert isinstance(found[name], ElementMap)
        np.testing.assert_array_equal(found[name].values, np.full(192, constant))


def test_nodes_and_elements_keep_the_ids_of_their_file(punch: Path, tmp_path: Path) -> None:
    """Messages name them; ids that count from 1 need not be kept."""
    assert read_feb(punch).mesh.cell_ids is None
    path = edited(punch, tmp_path / "ids.feb", '<elem id="192">', '<elem id="5000">')
    mesh = read_feb(path).mesh
    assert [mesh.cell_id(190), mesh.cell_id(191), mesh.node_id(7)] == [191, 5000, 8]
