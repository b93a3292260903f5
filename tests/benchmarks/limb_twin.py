"""Twin: a probe on the model of the whole limb against each site's own model, at the sizes that they have.

    limbcli segment CASE --out OUT
    python -m tests.benchmarks.limb_twin CASE --out OUT [--site-size-mm 3] [--nodes 40000] [--element tet10]

Prints a row for each place of a site: the force at the site's deepest level by the two models (c 8 kPa,
f_kappa 100, m 2, the same for both, no layers), and their difference. `--site-size-mm 0` leaves the limb's
mesh as coarse at the sites as elsewhere.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

from limbcli.case import Case
from limbcli.meshing.limb_parts import limb_frame
from limbcli.meshing.mending import mend
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.site_model import site_model
from limbcli.meshing.whole_limb import LimbMeshOptions, limb_mesh
from limbcli.provenance.staleness import Chain
from limbcli.site_model.mesh_study import full_depth, reference_force
from limbcli.site_model.segmented_limb import named_surfaces, site_position
from limbcli.stages.mesh import mesh_options
from tests.meshing.test_limb_twin import with_probe


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("case", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--element", choices=["tet4", "tet10"], help="default: the case's")
    parser.add_argument("--nodes", type=int, default=LimbMeshOptions.nodes)
    parser.add_argument("--site-size-mm", type=float, default=LimbMeshOptions.fine_size)
    parser.add_argument("--margin-mm", type=float, help="of the sites' models; default: the case's")
    parser.add_argument("--depth-mm", type=float, help="default: the site's deepest level")
    asked = parser.parse_args()
    case = Case.open(asked.case)
    segmented = Chain(case, asked.out).result("segment")
    skin, bones = named_surfaces(segmented)
    body = mend(skin, list(bones.values()))
    probe = ProbeShape(case.probe.length, case.probe.width, case.probe.edge_radius)
    options = mesh_options(case, element=asked.element, size=None, far_size=None, margin=asked.margin_mm)
    places = {(site_position(each, segmented), str(each.long_axis)): each for each in case.sites}
    whole = LimbMeshOptions(element=options.element, nodes=asked.nodes, distal_cut=True)
    if asked.site_size_mm:
        fine = tuple({place: None for place, _ in places})
        whole = replace(whole, fine_at=fine, fine_size=asked.site_size_mm)
    found = limb_mesh(body, bones, limb_frame(body, case.limb), whole)
    print("| site | element | depth | nodes: limb, site | force: limb, site | difference | processor time |")
    print("|-|-|-|-|-|-|-|", flush=True)
    for (place, _), site in places.items():
        depth, before = asked.depth_mm or full_depth(site), time.process_time()
        local = site_model(body, place, site.long_axis, probe, options, name=site.name)
        limb = with_probe(found.mesh, local.frame, list(bones), probe)
        ours, theirs = (reference_force(each, depth) for each in (limb, local.model))
        print(
            f"| {case.subject}, {site.name} | {options.element} | {depth:.1f} mm "
            f"| {len(found.mesh.points):,}, {len(local.model.mesh.points):,} | {ours:.3f}, {theirs:.3f} N "
            f"| {100 * (ours / theirs - 1):+.1f} % | {time.process_time() - before:.0f} s |",
            flush=True,
        )


if __name__ == "__main__":
    main()
