"""Wrong physics on purpose: each slip of this table must turn a named test red.

    python -m tests.benchmarks.mutations [--only WORD] [--limit-s 300]

Every slip is made in a copy of the package (kernels compiled anew where one is touched) and the test named
beside it is run there. Before, all these tests must pass without a slip.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Slip:
    """what : in words; old, new : text of `file`; test : that must fail; kernel : compiled code is touched"""

    what: str
    file: str
    old: str
    new: str
    test: str
    kernel: bool = False


LAWS, FRAME = "tests/materials/test_laws.py", "tests/meshing/test_frame.py"
BUILD, DICOM = "tests/stages/test_build_feb.py", "tests/imaging/test_dicom.py"
HOLDS, LABELS = "tests/measurement/test_holds.py", "tests/imaging/test_labels.py"
SPEED, FEBIO = "tests/measurement/test_elastography.py", "tests/solvers/test_febio_solver.py"
SLIPS = (
    Slip("sign of a stress term (squares)", "materials/ogden.py",
         "S[q] += inner * D[q] - 0.5 * minus * G[q]", "S[q] += inner * D[q] + 0.5 * minus * G[q]",
         f"{LAWS}::test_stress_is_derivative_of_energy", kernel=True),
    Slip("sign of a stress term (any exponent)", "materials/ogden.py",
         "tau[1] += c / m * e1", "tau[1] -= c / m * e1",
         f"{LAWS}::test_stress_is_derivative_of_energy", kernel=True),
    Slip("c/m for c/m^2 in the stress", "materials/ogden.py", "tau[0] += c / m * e0", "tau[0] += c * e0",
         f"{LAWS}::test_uniaxial_ogden_agrees_with_its_closed_form", kernel=True),
    Slip("tangent of the volume term", "materials/ogden.py",
         "slope = par[off] * (2.0 * J - 1.0) * J\n    for p", "slope = par[off] * (J - 1.0) * J\n    for p",
         f"{LAWS}::test_tangent_is_derivative_of_stress", kernel=True),
    Slip("factor 2 in c: c/2 for c in both terms", "materials/ogden.py",
         '"c1": c / 2, "m1": m, "c2": c / 2', '"c1": c, "m1": m, "c2": c',
         "limbcli/materials/stress.py"),
    Slip("f_kappa for kappa'", "materials/ogden.py", '"kappa": f_kappa * c', '"kappa": f_kappa',
         "limbcli/materials/ogden.py"),
    Slip("factor 2 in c from the wave speed", "stages/build_feb.py",
         "return 2 * float(modulus[0]), f", "return float(modulus[0]), f", BUILD),
    Slip("level off by one: c from level 1", "stages/build_feb.py",
         "speed = float(levels.swe_mean_m_per_s[0])", "speed = float(levels.swe_mean_m_per_s[1])",
         f"{BUILD}::test_c_comes_from_shear_waves_at_level_0"),
    Slip("depths in the order measured, not sorted", "site_model/site_levels.py",
         "depths = np.unique(levels.depth[levels.loading])", "depths = levels.depth[levels.loading]",
         f"{BUILD}::test_a_depth_that_shrinks_is_simulated_in_order_of_depth"),
    Slip("unloading levels simulated too", "site_model/site_levels.py",
         "depths = np.unique(levels.depth[levels.loading])", "depths = np.unique(levels.depth)", BUILD),
    Slip("unit of rho: g/cm3 for kg/m3", "measurement/shear_modulus.py",
         "density_kg_per_m3 * speed**2", "1e-3 * density_kg_per_m3 * speed**2", SPEED),
    Slip("speed not squared", "measurement/shear_modulus.py",
         "density_kg_per_m3 * speed**2", "density_kg_per_m3 * speed", SPEED),
    Slip("kPa for MPa", "numbers/units.py", "cast(Number, value_kpa / 1e3)", "cast(Number, value_kpa / 1e6)",
         "limbcli/numbers/units.py"),
    Slip("Pa for MPa", "numbers/units.py",
         "cast(Number, value_pa / 1e6)", "cast(Number, value_pa / 1e3)", SPEED),
    Slip("contact dropped on a facet", "fem/contacts/contact_kernels.py",
         "def force(facets, N, weights, state, facets2, out):\n",
         "def force(facets, N, weights, state, facets2, out):\n    facets = facets[1:]\n",
         "tests/fem/test_contact.py::test_tangent_agrees_with_differences", kernel=True),
    Slip("contact's normal not turned in the tangent", "fem/contacts/contact_kernels.py",
         "df[i] = weights[k] * (dt * n[i] + t * dn[i])", "df[i] = weights[k] * (dt * n[i])",
         "tests/fem/test_contact.py::test_tangent_agrees_with_differences", kernel=True),
    Slip("tet4's rule for tet10", "fem/elements/quadrature.py", '"tet10": _tet8', '"tet10": _tet1',
         "tests/fem/test_element.py::test_rule_integrates_polynomials_of_its_degree"),
    Slip("weights of tet10 swapped", "fem/elements/quadrature.py",
         "[0.138527967 / 6.0, 0.111472033 / 6.0]", "[0.111472033 / 6.0, 0.138527967 / 6.0]",
         "tests/fem/test_element.py::test_rule_integrates_polynomials_of_its_degree"),
    Slip("points of tri3 doubled", "fem/elements/quadrature.py",
         "[(1 / 6, 1 / 6), (2 / 3, 1 / 6), (1 / 6, 2 / 3)]), np.full(3, 1.0 / 6.0)",
         "[(1 / 6, 1 / 6), (2 / 3, 1 / 6), (1 / 6, 1 / 6)]), np.full(3, 1.0 / 6.0)",
         "tests/fem/test_element.py::test_rule_integrates_polynomials_of_its_degree"),
    Slip("depth's sign", "solvers/solver.py",
         'return -self.rigid[body].column("z")[:, 0]', 'return self.rigid[body].column("z")[:, 0]', FEBIO),
    Slip("force's sign", "solvers/solver.py",
         'return -self.rigid[body].column("Fz")[:, 0]', 'return self.rigid[body].column("Fz")[:, 0]', FEBIO),
    Slip("items of a record counted from 1", "solvers/record_tables.py",
         "items = numbers[records.ids]", "items = numbers[records.ids] + 1", FEBIO),
    Slip("E, v read as mu, lambda with 1 + v for 2 (1 + v)", "feb/law_tags.py",
         "return young / (2 * (1 + poisson)), young", "return young / (1 + poisson), young",
         "limbcli/feb/law_tags.py"),
    Slip("LPS taken for RAS in label maps", "imaging/volume.py",
         "np.diag([-1.0, -1.0, 1.0, 1.0])", "np.diag([1.0, 1.0, 1.0, 1.0])", LABELS),
    Slip("image turned over along the limb", "imaging/volume.py",
         "flipped = bool(affine[2, 2] < 0)", "flipped = bool(affine[2, 2] > 0)", LABELS),
    Slip("rows and columns of pixels swapped", "imaging/stacking.py",
         "pixel = np.array([first.pixel_spacing[1], first.pixel_spacing[0]])",
         "pixel = np.array([first.pixel_spacing[0], first.pixel_spacing[1]])", DICOM),
    Slip("slices in reverse", "imaging/dicom.py",
         'order = np.argsort(heights, kind="stable")', 'order = np.argsort(-heights, kind="stable")', DICOM),
    Slip("rescale intercept forgotten", "imaging/frames.py",
         "* np.float32(values[0]) + np.float32(values[1])", "* np.float32(values[0])", DICOM),
    Slip("markers numbered from proximal", "imaging/markers.py",
         "order = np.argsort(heights)", "order = np.argsort(-heights)", "tests/imaging/test_markers.py"),
    Slip("transverse axis the other way", "meshing/frame.py",
         "else np.cross(proximal, normal)", "else np.cross(normal, proximal)", FRAME),
    Slip("frame left-handed", "meshing/frame.py",
         "np.stack([x, np.cross(normal, x), normal])", "np.stack([x, np.cross(x, normal), normal])", FRAME),
    Slip("first touch not taken off", "meshing/frame.py",
         "to_model[2, 3] -= first_touch(limb.skin.moved(to_model), probe)", "pass", FRAME),
    Slip("bone outside the skin not counted", "meshing/anatomy.py",
         "(height > _OUT_MM)", "(height > 1e9)", "tests/meshing/test_anatomy.py"),
    Slip("probe's weight added, not taken off", "measurement/holds.py",
         "force = force - probe_mass_kg", "force = force + probe_mass_kg", HOLDS),
    Slip("tare not taken off", "measurement/holds.py",
         "force = trace.force - float(np.nanmean(trace.force[in_air]))", "force = trace.force", HOLDS),
    Slip("residual's sign against its derivative", "inference/prediction.py",
         "None if jacobian is None else -jacobian", "jacobian",
         "tests/inference/test_residual.py"),
    Slip("threshold of 90 % for 95 %", "numbers/interval_limits.py",
         "chdtri(1, 1.0 - 0.95)", "chdtri(1, 1.0 - 0.90)",
         "tests/inference/test_profile_intervals.py::test_profile_of_a_linear_model_is_its_textbook_interval"),
    Slip("a document type is let through", "files/xml.py",
         "    _refuse_document_type(content)\n", "", "tests/files/test_xml_files.py"),
    Slip("text after a tag does not count", "files/xml.py",
         '(element.text or "") + "".join(each.tail or "" for each in element)', '(element.text or "")',
         "tests/files/test_xml_files.py::test_numbers_after_a_tag_in_an_array_count"),
    Slip("text beside tags of a model passes", "feb/xml.py",
         "if (mixed := mixed_text(root)) is not None:", "if (mixed := None) is not None:",
         "tests/files/test_xml_files.py::test_text_beside_the_tags_of_a_model_is_not_passed_over"),
    Slip("what is unpacked is not counted", "files/unpacking.py", "        self.left -= n_bytes\n", "",
         "tests/files/test_unpacking.py::test_all_parts_of_a_surface_file_share_one_budget"),
    Slip("byte skip lifts the limit", "imaging/nrrd.py",
         "if skip > _MOST_SKIPPED:", "if skip > 10**12:",
         "tests/files/test_unpacking.py::test_a_header_s_byte_skip_does_not_lift_the_limit"),
    Slip("parallel directions pass", "imaging/volume.py",
         "if abs(np.linalg.det(affine[:3, :3] / lengths)) < _FLAT:", "if False:",
         "tests/imaging/test_placement.py::test_a_wrong_place_is_refused_in_every_format"),
    Slip("a missing origin is taken as 0", "imaging/nrrd.py",
         'if "none" in fields.get("space origin", "none").lower():', "if False:",
         "tests/imaging/test_placement.py::test_a_missing_origin_is_not_taken_as_0"),
    Slip("an input changed meanwhile is not noticed", "results.py", "        self._refuse_changed()\n", "",
         "tests/files/test_atomic.py::test_an_input_changed_while_a_stage_works_is_noticed"),
    Slip("a folder made meanwhile is replaced", "files/atomic.py",
         "                _put_where_nothing_is(partial, target)\n",
         "                _put_in_place(partial, target)\n",
         "tests/files/test_atomic.py::test_a_folder_that_another_program_made_meanwhile_is_not_replaced"),
    Slip("a log of another material passes", "feb/log_identity.py",
         "_compare(echo, outline, log)\n\n", "pass\n\n", "tests/feb/test_log_identity.py"),
)  # fmt: skip


def copy(folder: Path) -> None:
    """The package, its tests and templates; links where nothing is changed."""
    for name in ("limbcli", "templates", "tests"):
        shutil.copytree(REPOSITORY / name, folder / name)
    for name in ("cases", "pyproject.toml"):
        (folder / name).symlink_to(REPOSITORY / name)


def passes(folder: Path, tests: list[str], limit_s: float) -> tuple[bool, str]:
    """Whether the tests pass there, and pytest's last line."""
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
    try:
        ran = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, timeout=limit_s
        )
    except subprocess.TimeoutExpired:
        return True, f"over {limit_s:g} s"  # a test that does not end has caught nothing
    if ran.returncode not in (0, 1):
        raise RuntimeError(ran.stdout[-2000:] + ran.stderr[-2000:])
    failed = [line for line in ran.stdout.splitlines() if line.startswith("FAILED")]
    return ran.returncode == 0, (failed or ran.stdout.splitlines() or [""])[-1]


def caught(slip: Slip, limit_s: float) -> tuple[bool, str]:
    """Whether the named test turns red, and which of them did."""
    with tempfile.TemporaryDirectory(prefix="slip-") as name:
        folder = Path(name)
        copy(folder)
        path = folder / "limbcli" / slip.file
        text = path.read_text(encoding="utf-8")
        if text.count(slip.old) != 1:
            raise RuntimeError(f"{slip.what}: the text stands {text.count(slip.old)} times in {slip.file}")
        path.write_text(text.replace(slip.old, slip.new), encoding="utf-8")
        if slip.kernel:  # a caller's kernel keeps what it called
            for each in (*folder.rglob("*.nbi"), *folder.rglob("*.nbc")):
                each.unlink()
        green, line = passes(folder, [slip.test], limit_s)
        return not green, line.removeprefix("FAILED ").split(" - ")[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="slips with this word")
    parser.add_argument("--limit-s", type=float, default=300.0)
    options = parser.parse_args()
    chosen = [each for each in SLIPS if options.only in each.what]
    green, line = passes(REPOSITORY, sorted({each.test for each in chosen}), 10 * options.limit_s)
    print(f"without a slip: {line}\n\n| slip | file | red |\n|---|---|---|", flush=True)
    missed = 0 if green else 1
    for slip in chosen:
        red, test = caught(slip, options.limit_s)
        missed += not red
        print(f"| {slip.what} | {slip.file} | {test if red else '**none**'} |", flush=True)
    sys.exit(bool(missed))


if __name__ == "__main__":
    main()
