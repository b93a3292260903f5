"""Twin: a probe on the model of the whole limb against each site's own model, at the sizes that they have.

    limbcli segment CASE --out OUT
    python -m tests.benchmarks.limb_twin CASE --out OUT [--site-size-mm 2.5] [--nodes 40000] [--element tet10]

Prints a row for each place of a site: the force at the site's deepest level (c 8 kPa, f_kappa 100, m 2, no
layers) by the site's model, and how far those of others are from it: the limb's; the limb's held beyond the
site's cuts as the site's model is there; the site's model with its cuts free, and without cuts. The last
column is the limb's with a tissue as much stiffer as `limb` takes it: by half of what free cuts change.
`--site-size-mm 0` leaves the limb's mesh as coarse at the sites as elsewhere.

    limbcli mesh, build-feb, fit, limb --site-size-mm 2.5 CASE --out OUT
    python -m tests.benchmarks.limb_twin CASE --out OUT --field

Prints a row for each site with a fit or diagnosis: the force at its deepest level of the tissue that was
found (`tissue_force`), and how far from it are those of the site's model and of the limb, both with the
tissue that the limb's stiffness field has. The limb has that of each element, the site's model one: the mean
of logarithms over what the site averages. A diagnosis lies half-way between held and free cuts, the site's
model is held.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from limbcli.case import Case, Site
from limbcli.effects.crop import EFFECT as CROP
from limbcli.effects.crop import LIMB_POSITION
from limbcli.feb.settings import schedule
from limbcli.meshing.frame import site_frame
from limbcli.meshing.limb_parts import limb_frame
from limbcli.meshing.mending import Limb, mend
from limbcli.meshing.probe import PlacedProbe, ProbeShape
from limbcli.meshing.quality import dihedral_angles_deg
from limbcli.meshing.site_model import MeshOptions, SiteModel, site_model
from limbcli.meshing.whole_limb import LimbMeshOptions, cell_centroids, check_invariants, limb_mesh
from limbcli.model import Array, ElementMap, LimbModel, Mesh
from limbcli.model.npz_file import load_model
from limbcli.numbers.mesh_bounds import MARGIN_MM
from limbcli.provenance.staleness import Chain
from limbcli.results import StageResult
from limbcli.site_model.indentation_model import (
    TISSUE,
    indentation_model,
    starting_depth,
    with_penalty,
)
from limbcli.site_model.mesh_study import TissueLaw, full_depth, reference_force
from limbcli.site_model.segmented_limb import named_surfaces, site_position
from limbcli.site_model.site_layers import layer_laws, layers_in, with_layer_laws
from limbcli.solvers.session import ReferenceSession
from limbcli.stages.limb_field.limb_force import limb_forces
from limbcli.stages.limb_field.site_results import region_of_site
from limbcli.stages.mesh import MeshRequest, mesh_options
from tests.meshing.test_limb_twin import with_probe

MODELS = ("limb", "limb held as the site", "site, cuts free", "site without cuts", "limb, corrected")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("case", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--element", choices=["tet4", "tet10"], help="default: the case's")
    parser.add_argument("--nodes", type=int, default=LimbMeshOptions.nodes)
    parser.add_argument("--site-size-mm", type=float, default=LimbMeshOptions.under_probe)
    parser.add_argument("--margin-mm", type=float, help="of the sites' models; default: the case's")
    parser.add_argument("--depth-mm", type=float, help="default: the site's deepest level")
    parser.add_argument("--field", action="store_true", help="with the tissue of the limb's stiffness field")
    asked = parser.parse_args()
    case = Case.open(asked.case)
    if asked.field:
        return print_fields(case, asked.out)
    segmented = Chain(case, asked.out).result("segment")
    skin, bones = named_surfaces(segmented)
    body = mend(skin, list(bones.values()))
    shape = ProbeShape(case.probe.length, case.probe.width, case.probe.edge_radius)
    options = mesh_options(case, MeshRequest(element=asked.element, margin=asked.margin_mm))
    places = {(site_position(each, segmented), str(each.long_axis)): each for each in case.sites}
    whole = LimbMeshOptions(element=options.element, nodes=asked.nodes, distal_cut=True)
    if asked.site_size_mm:
        frames = [site_frame(body, np.array(at), site.long_axis, shape) for (at, _), site in places.items()]
        probes = tuple(PlacedProbe(shape, each.to_model) for each in frames)
        whole = replace(whole, probes=probes, under_probe=asked.site_size_mm)
    found = limb_mesh(body, bones, limb_frame(body, case.limb), whole)
    check_invariants(found)
    angle = min(dihedral_angles_deg(found.mesh.points, each.cells).min() for each in found.mesh.solid_blocks)
    print(
        f"limb: {len(found.mesh.points)} nodes, edges {found.size:.1f} mm, smallest angle {angle:.1f} deg\n"
    )
    print(
        "| site | element | depth | nodes: limb, site | force of the site | " + " | ".join(MODELS) + " | s |"
    )
    print("|-" * (6 + len(MODELS)) + "|", flush=True)
    for (place, _), site in places.items():
        depth, before = asked.depth_mm or full_depth(site), time.process_time()
        local = site_model(body, place, site.long_axis, shape, options, name=site.name)
        force = reference_force(local.model, depth)
        others = others_of(local, body, place, site, shape, options, found.mesh, list(bones))
        ratios = [reference_force(each, depth) / force for each in others]
        ratios.append(ratios[0] / ratios[2] ** LIMB_POSITION)
        shares = [f"{100 * (each - 1):+.1f} %" for each in ratios]
        print(
            f"| {case.subject}, {site.name} | {options.element} | {depth:.1f} mm "
            f"| {len(found.mesh.points):,}, {len(local.model.mesh.points):,} | {force:.3f} N "
            f"| {' | '.join(shares)} | {time.process_time() - before:.0f} |",
            flush=True,
        )


def others_of(
    local: SiteModel, body: Limb, place: tuple[float, float, float], site: Site, shape: ProbeShape,
    options: MeshOptions, mesh: Mesh, bones: list[str],
) -> list[LimbModel]:  # fmt: skip
    """The models that are compared with a site's, in the order of `MODELS` (the last is one of them)."""
    uncut = replace(options, margin=MARGIN_MM[1])
    return [
        with_probe(mesh, local.frame.to_model, bones, shape),
        with_probe(mesh, local.frame.to_model, bones, shape, cuts=local.domain.planes),
        CROP.apply(local.model, CROP.start),
        site_model(body, place, site.long_axis, shape, uncut, name=site.name).model,
    ]


def print_fields(case: Case, out: Path) -> None:
    """The table with the tissue of the limb's field."""
    chain = Chain(case, out)
    limb = load_model(chain.result("limb").path("model"))
    shape = ProbeShape(case.probe.length, case.probe.width, case.probe.edge_radius)
    print("| site | from | depth | force | site's model with the field's tissue | limb with its field |")
    print("|-" * 6 + "|", flush=True)
    for site in case.sites:
        mesh, used = chain.present("mesh", site=site.name), known_of(chain, site.name)
        told = None if used is None else used.data.get("tissue_force")
        if mesh is None or used is None or not told:
            continue
        depths, order = np.unique(np.array(told["depths_mm"], float), return_index=True)
        fitted, penalty = np.array(told["fitted_n"], float)[order], float(told["contact_penalty"])
        to_model = np.linalg.inv(np.array(mesh.data["frame"]["patient_from_model"], float))
        tissue = tissue_at(limb, region_of_site(mesh))
        local = load_model(mesh.path("model"))
        local = with_layer_laws(local, layer_laws(site, layers_in(local)))
        of_site = forces_of(local, depths, tissue, penalty)
        of_limb = limb_forces(limb, PlacedProbe(shape, to_model), depths, penalty=penalty)
        shares = [
            f"{100 * (each[-1] / fitted[-1] - 1):+.1f} % (levels {100 * (each / fitted - 1).min():+.1f} to "
            f"{100 * (each / fitted - 1).max():+.1f})" for each in (of_site, of_limb)
        ]  # fmt: skip
        words = f"c {1e3 * tissue.c:.2f} kPa, m {tissue.m:.2f}, f_kappa {tissue.f_kappa:.1f}"
        print(
            f"| {case.subject}, {site.name} | {used.stage} | {depths[-1]:.1f} mm | {fitted[-1]:.3f} N "
            f"| {shares[0]}; {words} | {shares[1]} |",
            flush=True,
        )


def known_of(chain: Chain, site: str) -> StageResult | None:
    """What the stiffness field takes of a site: its diagnosis if that named an effect, else its fit."""
    fit, diagnosis = (chain.present(stage, site=site) for stage in ("fit", "diagnose"))
    return diagnosis if diagnosis is not None and (diagnosis.data["added"] or fit is None) else fit


def tissue_at(limb: LimbModel, region: Array) -> TissueLaw:
    """The tissue of a limb's model in a region (n, 3), mm: means of logarithms over the nearest elements."""
    block = limb.mesh.block(TISSUE)
    near = cKDTree(cell_centroids(limb.mesh, block)).query(region)[1]
    law = limb.materials[TISSUE].parameters
    c1, m1, kappa = (
        float(np.exp(np.log(each.values[near]).mean())) if isinstance(each, ElementMap) else float(each)
        for each in (law["c1"], law["m1"], law["kappa"])
    )
    return TissueLaw(2.0 * c1, kappa / (2.0 * c1), m1, "field")


def forces_of(model: LimbModel, depths: Array, tissue: TissueLaw, penalty: float) -> Array:
    """Forces (n,) N at depths (n,) mm of a site's model."""
    plan = schedule(depths.tolist(), start=starting_depth(model, float(depths[0])))
    ready = indentation_model(model, plan, c=tissue.c, f_kappa=tissue.f_kappa, m=tissue.m)
    session = ReferenceSession(with_penalty(ready, penalty))
    try:
        return session.solve().must_points.forces
    finally:
        session.close()


if __name__ == "__main__":
    main()
