"""limb: build the finite-element model of the whole limb from the surfaces, with named parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from limbcli.case import Case
from limbcli.errors import CaseError
from limbcli.errors.problems import raise_errors
from limbcli.feb.write import write_feb
from limbcli.meshing.anatomy import SKIN, limb_problems
from limbcli.meshing.conforming_layers import Layer, layers_of
from limbcli.meshing.frame import site_frame
from limbcli.meshing.limb_parts import LimbFrame, LimbParts, limb_frame, limb_parts
from limbcli.meshing.limb_picture import limb_picture
from limbcli.meshing.mending import Limb, mend
from limbcli.meshing.probe import PlacedProbe, ProbeShape
from limbcli.meshing.quality import dihedral_angles_deg, scaled_jacobians, volumes
from limbcli.meshing.sites_on_skin import place_fault
from limbcli.meshing.surfaces import Triangles
from limbcli.meshing.whole_limb import (
    DISTAL_CUT,
    HELD,
    OFF,
    PROXIMAL_CUT,
    LimbMesh,
    LimbMeshOptions,
    cell_centroids,
    check_invariants,
    limb_mesh,
    with_surfaces,
)
from limbcli.model import Array, Domain, IntArray, LimbModel, Mesh, Step, Support, Surface
from limbcli.model.bodies import Drive, RigidBody
from limbcli.numbers.mesh_bounds import LIMB_NODES
from limbcli.numbers.units import kpa_from_mpa
from limbcli.progress import SILENT, Progress
from limbcli.provenance.chain_inputs import note_templates, noted
from limbcli.provenance.requested_options import requested_of
from limbcli.provenance.staleness import Chain
from limbcli.results import StageResult, StageWriter, open_stage
from limbcli.site_model.indentation_model import TISSUE, TissueLaw
from limbcli.site_model.segmented_limb import named_surfaces, note_segmented, site_position
from limbcli.site_model.site_layers import (
    Layering,
    LayerLaw,
    Thickness,
    layer_laws,
    locking_warning,
    with_layer_laws,
)
from limbcli.stages.limb_field.case_field import CaseField, case_field
from limbcli.stages.limb_field.limb_force import as_on_limb, contradicting_forces, cut_warnings
from limbcli.stages.limb_model.element_values import (
    F_KAPPA,
    ElementValues,
    M,
    columns_of,
    element_values,
    field_values,
    limb_stiffness,
    model_of_draw,
    sample_of,
    with_element_values,
)
from limbcli.stages.limb_model.hand_over import LimbFiles, write_limb
from limbcli.stages.segmenting.possible_sites import warnings_of_limb
from limbcli.stiffness_field import LABELS, Draws, limb_coordinates, write_draws
from limbcli.stiffness_field.draws import N_DRAWS

STAGE = "limb"
_LAYER_CELL = 6.0  # mm, height of a layer's cells
_UNLIKE = 1.5  # ratio of a layer's largest to its smallest thickness above which one thickness is doubtful
# N^2: FEBio iterates on an unloaded limb until the sum of the squared forces on all nodes is below this. Its
# default, 1e-20, is less than the round-off of a large limb (4e-20 of 6,233 nodes): it would not converge.
_NO_FORCE = 1e-14
_ASSUMED_TUBE = "numbers"  # kind of the assumed geometry without a distal end


@dataclass(frozen=True, kw_only=True)
class LimbOptions:
    """Options of a limb's model: those of its mesh, and its stiffness (kPa) if given by hand.

    site_size : edge length (mm) under a probe at the sites, as in their models; None: as elsewhere
    draws : numbers of the draws of the stiffness field whose models are written, too
    cohort, cohort_location : folder of a cohort's result; its location whose population is the field's prior
    """

    element: str | None = None
    nodes: int = 40_000
    cut: float | None = None
    distal_cut: bool = False
    skin_layer: Thickness | None = None
    fat_layer: Thickness | None = None
    c_kpa: float | None = None
    site_size: float | None = None
    draws: tuple[int, ...] = ()
    cohort: Path | None = None
    cohort_location: str | None = None


def limb(
    case: Case,
    *,
    out: Path,
    options: LimbOptions = LimbOptions(),
    templates: Path | None = None,
    progress: Progress = SILENT,
) -> StageResult:
    """Mesh the whole limb and write its model, surfaces, parts, picture and README.

    Raises
    ------
    CaseError
        If the limb, a site or an option cannot be used, or the result of `segment` is missing or out of date.
    MeshError
        If no volume mesh of sufficient quality could be made.
    """
    progress.event("stage", name=STAGE)
    if not LIMB_NODES[0] <= options.nodes <= LIMB_NODES[1]:
        low, high = LIMB_NODES
        raise CaseError(f"--nodes is {options.nodes}", where=case.subject, fix=f"give {low} to {high}")
    layering = Layering(options.skin_layer, options.fat_layer)
    layered = tuple(site.name for site in case.sites if layering.is_from_images(site))
    chain = Chain(case, out)
    segmented = chain.result("segment", about=layered)
    with open_stage(out, STAGE, subject=case.subject) as writer:
        writer.data["asked"] = requested_of({**vars(options), "templates": templates}, vars(LimbOptions()))
        case = noted(case, writer)
        markers = any(site.position is None for site in case.sites)
        note_segmented(segmented, writer, layered=layered, markers=markers)
        note_templates(writer, templates)
        skin, bones = named_surfaces(segmented)
        where = str(segmented.folder)
        raise_errors(limb_problems({SKIN: skin, **bones}, limb=case.limb, where=where), CaseError)
        body = mend(skin, list(bones.values()), where=where)
        frame = limb_frame(body, case.limb)
        layers, sources = limb_layers(case, layering, segmented, writer)
        field = _field(case, chain, skin, bones, frame, options, writer)
        stiffness = limb_stiffness(case, chain, writer, c_kpa=options.c_kpa) if field is None else None
        geometry = segmented.data.get("geometry")
        tube = isinstance(geometry, Mapping) and geometry.get("kind") == _ASSUMED_TUBE
        places = _places(case, segmented, skin, writer)
        mesh_options = LimbMeshOptions(
            element=options.element or case.model.element, nodes=options.nodes, cut=options.cut,
            distal_cut=options.distal_cut or tube, layers=layers,
        )  # fmt: skip
        probes = {} if options.site_size is None else probes_at(case, body, places)
        if options.site_size is not None:
            unlike = tuple(dict.fromkeys(probes.values()))
            mesh_options = replace(mesh_options, probes=unlike, under_probe=options.site_size)
        found = limb_mesh(body, bones, frame, mesh_options, where=where, progress=progress)
        check_invariants(found)
        parts, surface = parts_of(found, frame, bones)
        mesh = _with_parts(found.mesh, parts, surface, places)
        laws = _laws(case, layers)
        tissue = mesh.block(TISSUE)
        centroids, sizes = cell_centroids(mesh, tissue), volumes(mesh.points, tissue.cells)
        bare = with_layer_laws(limb_model(mesh, list(bones), frame, case), laws)

        def with_values(of: ElementValues) -> LimbModel:
            return with_element_values(bare, tissue, of.c, m=of.m, f_kappa=of.f_kappa)

        if field is not None:
            field = as_on_limb(
                field, lambda each: with_values(field_values(each, centroids, sizes)[0]), probes,
                writer.warnings, progress=progress,
            )  # fmt: skip
            values, stiffness = field_values(field, centroids, sizes)
        else:
            assert stiffness is not None
            used = [places[name] for name in stiffness.sites if name in places]
            values = element_values(centroids, stiffness, np.array(used).reshape(-1, 3))
        model = with_values(values)
        _report(writer, found, model, parts, frame, stiffness, values, options.nodes)
        if field is not None:
            _report_field(writer, field, values)
            _write_draws(writer, field, model, options.draws, templates, progress)
        _report_layers(writer, layers, sources, laws, mesh_options.element)
        writer.warnings.extend(warnings_of_limb(segmented))
        if tube and DISTAL_CUT in found.planes:
            writer.warnings.append("the assumed limb has no distal end: it is cut there, and free")
        picture, title = writer.file("picture", "limb.png"), f"{case.subject}: the limb"
        limb_picture(picture, frame, surface, parts, sites=places, title=title)
        write_limb(
            LimbFiles(
                model=model, frame=frame, side=case.limb, skin=surface, parts=parts, values=columns_of(values)
            ),
            writer,
            segmented,
            templates,
        )
    return writer.result


def _field(
    case: Case, chain: Chain, skin: Triangles, bones: Mapping[str, Triangles], frame: LimbFrame,
    options: LimbOptions, writer: StageWriter,
) -> CaseField | None:  # fmt: skip
    """The stiffness field through the case's sites; None if c is given by hand or no site says anything."""
    field = None
    if options.cohort is None and options.cohort_location is not None:
        what = "a cohort's location is given without a cohort"
        raise CaseError(what, where="--cohort-location", fix="add --cohort FOLDER, or leave it out")
    if options.c_kpa is None:
        limb = limb_coordinates(skin, list(bones.values()), frame.axis, where=case.subject)
        found = case_field(case, chain, limb, writer, cohort=options.cohort, location=options.cohort_location)
        field = found if found.results.sites or found.results.maps else None
    if options.cohort is not None and field is None:
        raise CaseError(
            "a cohort's population is the prior of a stiffness field, and there is none: "
            + ("no site is fitted or has a map at rest" if options.c_kpa is None else "c is given by hand"),
            where="--cohort", fix="fit a site" if options.c_kpa is None else "leave out --c-kpa or --cohort",
        )  # fmt: skip
    wrong = [k for k in options.draws if field is None or not 0 <= k < N_DRAWS]
    if wrong:
        why = f"there are draws 0 to {N_DRAWS - 1}" if field else "one stiffness for all has no draws"
        raise CaseError(
            f"draw {wrong[0]} cannot be written: {why}", where="--draw",
            fix="fit the sites, or leave --draw out" if field is None else "give their numbers",
        )  # fmt: skip
    return field


def _report_field(writer: StageWriter, field: CaseField, values: ElementValues) -> None:
    """The field's readings, how it does at sites left out, and the range of c, in result and summary."""
    content = writer.data["stiffness"]["field"] = field.to_json()
    share = [float(np.mean(values.label == k)) for k in range(len(LABELS))]
    low, high = kpa_from_mpa(np.quantile(values.c, [0.05, 0.95]))
    words = ", ".join(f"{name} {100 * part:.0f} %" for name, part in zip(LABELS, share, strict=True))
    writer.summary.append(f"c {low:.2f} to {high:.2f} kPa in nine tenths of the elements; {words}")
    if content["held_out"]["n"]:
        writer.summary.append(content["held_out"]["words"])
    for name, why in content["left_out"].items():
        writer.warnings.append(f"site {name} says nothing of the field: {why}")
    writer.warnings.extend(content["contradictions"])
    writer.warnings.extend([*cut_warnings(field), *contradicting_forces(field)])


def _write_draws(
    writer: StageWriter, field: CaseField, model: LimbModel, numbers: tuple[int, ...],
    templates: Path | None, progress: Progress,
) -> None:  # fmt: skip
    """draws.csv, and the models of some draws."""
    tissue = model.mesh.block(TISSUE)
    centroids, sizes = cell_centroids(model.mesh, tissue), volumes(model.mesh.points, tissue.cells)
    draws, few = Draws(field.field), sample_of(len(centroids))
    write_draws(writer.file("draws", "draws.csv"), draws.table(centroids[few], sizes[few]))
    for n, k in enumerate(dict.fromkeys(numbers)):
        progress.event("task", name="limb: models of draws", done=n, total=len(numbers))
        drawn = model_of_draw(model, tissue, draws.draw(k), centroids)
        write_feb(drawn, writer.file(f"feb_draw_{k:02d}", f"limb_draw_{k:02d}.feb"), templates)


# ---------------------------------------------------------------- layers


def limb_layers(
    case: Case, layering: Layering, segmented: StageResult, writer: StageWriter
) -> tuple[tuple[Layer, ...], dict[str, str]]:
    """Skin and fat of one thickness all over the limb: the mean of the sites where it is known."""
    thickness: dict[str, list[float]] = {"skin": [], "fat": []}
    origin: dict[str, set[str]] = {"skin": set(), "fat": set()}
    for site in case.sites:
        layers, sources = layering.of(site, segmented, size=_LAYER_CELL)
        for layer in layers:
            thickness[layer.name].append(layer.thickness)
            origin[layer.name].add(sources[layer.name].origin)
    if not case.sites:
        for name, value in (("skin", layering.skin), ("fat", layering.fat)):
            if isinstance(value, str):
                what = "the case has no sites, at which the images give a thickness"
                raise CaseError(what, where=f"--{name}-mm", fix="give it in mm")
            if value:
                thickness[name], origin[name] = [value], {"given"}
    known = {name: each for name, each in thickness.items() if each}
    means = {name: float(np.mean(each)) for name, each in known.items()}
    for name, each in known.items():
        if max(each) > _UNLIKE * min(each):
            writer.warnings.append(
                f"the {name} is {min(each):.1f} to {max(each):.1f} mm thick at the sites; the model has its "
                f"mean, {means[name]:.1f} mm, everywhere"
            )
    words = {name: f"mean of {len(each)} ({', '.join(sorted(origin[name]))})" for name, each in known.items()}
    return layers_of(skin=means.get("skin", 0.0), fat=means.get("fat", 0.0), size=_LAYER_CELL), words


def _laws(case: Case, layers: tuple[Layer, ...]) -> dict[str, LayerLaw]:
    """The law of each layer: that of the first site that states one."""
    laws: dict[str, LayerLaw] = {}
    for each in layers:
        stating = [site for site in case.sites if site.layers.get(each.name)] or list(case.sites)
        laws |= layer_laws(stating[0], [each.name]) if stating else {each.name: LayerLaw()}
    return laws


# ---------------------------------------------------------------- parts and model


def parts_of(
    found: LimbMesh, frame: LimbFrame, bones: Mapping[str, Triangles]
) -> tuple[LimbParts, Triangles]:
    """The limb's parts, and the skin's facets (corners only) in the order of their masks."""
    mesh = found.mesh
    surface = Triangles(mesh.points, next(iter(mesh.surfaces["skin"].facets.values()))[:, :3])
    top = float(frame.height(mesh.points[mesh.node_sets[PROXIMAL_CUT]]).min())
    bottom = -np.inf
    if DISTAL_CUT in mesh.node_sets:
        bottom = float(frame.height(mesh.points[mesh.node_sets[DISTAL_CUT]]).max())
    return limb_parts(frame, surface, bones, top=top, bottom=bottom), surface


def _with_parts(mesh: Mesh, parts: LimbParts, surface: Triangles, places: Mapping[str, Array]) -> Mesh:
    """The mesh with the patches as surfaces, landmarks and sites as sets of the skin node nearest to each."""
    kind, facets = next(iter(mesh.surfaces["skin"].facets.items()))
    names = {name: f"patch_{name}" for name in parts.patches}
    more = {names[name]: Surface(names[name], {kind: facets[mask]}) for name, mask in parts.patches.items()}
    nodes = np.unique(surface.faces)
    marks = {f"landmark_{name}": point for name, point in parts.landmarks.items()}
    marks |= {f"site_{name}": point for name, point in places.items()}
    sets: dict[str, IntArray] = {}
    for name, point in marks.items():
        nearest = np.argmin(np.linalg.norm(mesh.points[nodes] - point, axis=1))
        sets[name] = nodes[[nearest]]
    return with_surfaces(mesh, more, sets)


def _places(case: Case, segmented: StageResult, skin: Triangles, writer: StageWriter) -> dict[str, Array]:
    """Position (3,) of each site that lies on the skin; others are left out with a warning."""
    found = {}
    for site in case.sites:
        try:
            place = np.asarray(site_position(site, segmented), float)
        except CaseError as error:
            writer.warnings.append(f"site {site.name} is left out: {error.what}")
            continue
        fault = place_fault(skin, place) if site.marker is None else None
        if fault is not None and not fault.usable:
            writer.warnings.append(f"site {site.name} is left out: it {fault.what}")
            continue
        found[site.name] = place
    return found


def probes_at(case: Case, body: Limb, places: Mapping[str, Array]) -> dict[str, PlacedProbe]:
    """The case's probe at the sites, by the site's name; two that share a place and a long axis share it.

    places : (3,) mm, patient LPS, by the site's name
    """
    shape = ProbeShape(case.probe.length, case.probe.width, case.probe.edge_radius)
    if not np.isfinite([shape.length, shape.width, shape.edge_radius]).all():
        what = "no probe to mesh for: its dimensions are not known"
        raise CaseError(what, where="--site-size-mm", fix="complete [probe], or leave the option out")
    unlike: dict[tuple[object, ...], PlacedProbe] = {}
    found = {}
    for each in case.sites:
        if each.name not in places:
            continue
        place = places[each.name]
        key = (*place, str(each.long_axis))
        if key not in unlike:
            frame = site_frame(body, place, each.long_axis, shape, where=f"site {each.name}")
            unlike[key] = PlacedProbe(shape, frame.to_model)
        found[each.name] = unlike[key]
    return found


def limb_model(mesh: Mesh, bones: list[str], frame: LimbFrame, case: Case) -> LimbModel:
    """The model at rest, of any tissue: every bone a rigid body of its own, fixed; the proximal cut held; no
    load."""
    from limbcli.materials.ogden import ogden_type

    present = [name for name in bones if len(mesh.node_sets.get(name, ()))]
    bodies = tuple(
        RigidBody(_body(name), tuple(mesh.points[mesh.node_sets[name]].mean(axis=0).tolist()), (), (name,))
        for name in present
    )
    drives = tuple(
        Drive(each.name, dof, "fixed") for each in bodies for dof in ("x", "y", "z", "u", "v", "w")
    )  # type: ignore[arg-type]
    law = ogden_type(c=0.008, f_kappa=F_KAPPA, m=M)
    held = (Support(HELD, ("x", "y", "z")),) if len(mesh.node_sets[HELD]) else ()
    return LimbModel(
        mesh=mesh,
        materials={each.name: law for each in mesh.solid_blocks},
        domains=tuple(Domain(each.name, each.name) for each in mesh.solid_blocks),
        bodies=bodies,
        supports=held,
        drives=drives,
        steps=(Step(control={"min_residual": _NO_FORCE}),),
        info={
            "limb": case.subject,
            "side": case.limb,
            "frame": frame.to_json(),
            "element": mesh.blocks[0].kind,
        },
    )


def _body(name: str) -> str:
    """
    >>> _body("bone_tibia"), _body("bone_1")
    ('tibia', 'bone_1')
    """
    short = name.removeprefix("bone_")
    return name if short.isdigit() else short


# ---------------------------------------------------------------- report


def _nodes(number: int, asked: int) -> str:
    """
    >>> _nodes(11048, 4000), _nodes(4284, 4000)
    ('11048 nodes (4000 were asked for)', '4284 nodes')
    """
    return f"{number} nodes" + (f" ({asked} were asked for)" if abs(number - asked) > OFF * asked else "")


def _report(
    writer: StageWriter, found: LimbMesh, model: LimbModel, parts: LimbParts, frame: LimbFrame,
    stiffness: TissueLaw, values: ElementValues, asked: int,
) -> None:  # fmt: skip
    mesh = model.mesh
    cells = np.concatenate([each.cells for each in mesh.solid_blocks])
    angles = dihedral_angles_deg(mesh.points, cells)
    counts = {LABELS[k]: int((values.label == k).sum()) for k in range(len(LABELS))}
    writer.data.update(
        element=mesh.solid_blocks[0].kind,
        n_nodes=len(mesh.points),
        n_cells=len(cells),
        size_mm=found.size,
        quality={
            "min_angle_deg": float(angles.min()),
            "max_angle_deg": float(angles.max()),
            "min_scaled_jacobian": float(scaled_jacobians(mesh.points, cells).min()),
            "curved_share": found.curved_share,
        },
        volume_cm3=float(volumes(mesh.points, cells).sum()) / 1e3,
        expected_volume_cm3=found.expected / 1e3,
        mesher=found.maker,
        frame=frame.to_json(),
        bones=[each.name for each in model.bodies],
        surfaces={name: each.n_facets for name, each in mesh.surfaces.items()},
        missing_parts=dict(parts.missing),
        stiffness={
            "c_kpa": kpa_from_mpa(stiffness.c), "f_kappa": stiffness.f_kappa, "m": stiffness.m,
            "source": stiffness.source, "elements": counts,
        },
    )  # fmt: skip
    writer.summary.append(
        f"{_nodes(len(mesh.points), asked)}, {len(cells)} {mesh.solid_blocks[0].kind}, "
        f"edges {found.size:.1f} mm; smallest dihedral angle {angles.min():.1f} deg"
    )
    writer.summary.append(f"bones: {', '.join(each.name for each in model.bodies)}")
    writer.summary.append(
        "patches: " + (", ".join(each.replace("_", " ") for each in parts.patches) or "none")
    )
    for name, why in parts.missing.items():
        writer.summary.append(f"no patch {name.replace('_', ' ')}: {why}")
    if np.isnan(values.c_low).all():
        writer.summary.append(
            f"c = {kpa_from_mpa(stiffness.c):.2f} kPa everywhere (assumed): {stiffness.source}"
        )
    writer.warnings.extend(found.altered)


def _report_layers(
    writer: StageWriter, layers: tuple[Layer, ...], sources: Mapping[str, str], laws: Mapping[str, LayerLaw],
    element: str,
) -> None:  # fmt: skip
    writer.data["layers"] = {
        each.name: {"thickness_mm": each.thickness, "source": sources[each.name], **laws[each.name].to_json()}
        for each in layers
    }
    for each in layers:
        writer.summary.append(f"layer {each.name}: {each.thickness:.1f} mm all over, {sources[each.name]}")
    writer.warnings.extend(locking_warning(laws, element))
