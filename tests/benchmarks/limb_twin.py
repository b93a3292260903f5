"""Twin: a probe on the model of the whole limb against each site's own model, at the sizes that they have.

    limbcli segment CASE --out OUT
    python -m tests.benchmarks.limb_twin CASE --out OUT [--site-size-mm 2.5] [--nodes 40000] [--element tet10]

Prints a row for each place of a site: the force at the site's deepest level (c 8 kPa, f_kappa 100, m 2, no
layers) by the site's model, and how far those of others are from it: the limb's; the limb's held beyond the
site's cuts as the site's model is there; the site's model with its cuts free, and without cuts. The last
column is the limb's with a tissue as much stiffer as `limb` takes it: by half of what free cuts change.
`--site-size-mm 0` leaves the limb's mesh as coarse at the sites as elsewhere.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from limbcli.case import Case, Site
from limbcli.effects.crop import EFFECT as CROP
from limbcli.effects.crop import LIMB_POSITION
from limbcli.meshing.frame import site_frame
from limbcli.meshing.limb_parts import limb_frame
from limbcli.meshing.mending import Limb, mend
from limbcli.meshing.probe import PlacedProbe, ProbeShape
from limbcli.meshing.quality import dihedral_angles_deg
from limbcli.meshing.site_model import MeshOptions, SiteModel, site_model
from limbcli.meshing.whole_limb import LimbMeshOptions, check_invariants, limb_mesh
from limbcli.model import LimbModel, Mesh
from limbcli.numbers.mesh_bounds import MARGIN_MM
from limbcli.provenance.staleness import Chain
from limbcli.site_model.mesh_study import full_depth, reference_force
from limbcli.site_model.segmented_limb import named_surfaces, site_position
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
    asked = parser.parse_args()
    case = Case.open(asked.case)
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
        with_probe(mesh, local.frame, bones, shape),
        with_probe(mesh, local.frame, bones, shape, cuts=local.domain.planes),
        CROP.apply(local.model, CROP.start),
        site_model(body, place, site.long_axis, shape, uncut, name=site.name).model,
    ]


if __name__ == "__main__":
    main()
