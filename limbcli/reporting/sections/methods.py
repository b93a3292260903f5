"""The methods of this run in words for a paper: numbers, versions and citations, and only of what was run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from limbcli.reporting.fit_view import EstimateView, FitView, read_fit_view
from limbcli.reporting.numbers import number, significant
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Reportlet
from limbcli.reporting.sections.diagnosis import in_short

KEY, TITLE, FILE = "methods", "What could a paper say of the methods?", "methods.txt"

# Keys are cited in square brackets in the text.
REFERENCES: Mapping[str, str] = {
    "Ranger 2023": (
        "Ranger BJ, Moerman KM, Anthony BW, Herr HM. Constitutive parameter identification of transtibial "
        "residual limb soft tissue using ultrasound indentation and shear wave elastography. J Mech Behav "
        "Biomed Mater 2023, 105541. doi 10.1016/j.jmbbm.2022.105541"
    ),
    "Raue 2009": (
        "Raue A et al. Structural and practical identifiability analysis of partially "
        "observed dynamical models by exploiting the profile likelihood. Bioinformatics "
        "2009, 25:1923. doi 10.1093/bioinformatics/btp358"
    ),
    "Maas 2012": (
        "Maas SA, Ellis BJ, Ateshian GA, Weiss JA. FEBio: finite elements for "
        "biomechanics. J Biomech Eng 2012, 134:011005. doi 10.1115/1.4005694"
    ),
    "Si 2015": (
        "Si H. TetGen, a Delaunay-based quality tetrahedral mesh generator. ACM Trans "
        "Math Softw 2015, 41:11. doi 10.1145/2629697"
    ),
    "Harris 2020": (
        "Harris CR et al. Array programming with NumPy. Nature 2020, 585:357. doi 10.1038/s41586-020-2649-2"
    ),
    "Virtanen 2020": (
        "Virtanen P et al. SciPy 1.0: fundamental algorithms for scientific computing in "
        "Python. Nat Methods 2020, 17:261. doi 10.1038/s41592-019-0686-2"
    ),
}
_GEOMETRY = {
    "labels": "The geometry of the {limb} limb was taken from label maps of an image.",
    "edited labels": "The geometry of the {limb} limb was taken from a label map that was edited by hand.",
    "surfaces": "The geometry of the {limb} limb was given as surfaces of skin and bones.",
}
_TISSUE = (
    "Soft tissue was described by the strain energy Psi = c/(2 m^2) sum(l_i^m + l_i^-m - "
    "2) + kappa'/2 (J - 1)^2 with kappa' = f_kappa c (FEBio's `Ogden unconstrained`); "
    "bone was rigid, the probe rigid and frictionless."
)


def methods(page: ReportData, own: Mapping[str, Any]) -> Reportlet:
    """The paragraphs on the page."""
    paragraphs = methods_paragraphs(page, own)
    answer = f"The text below is of this run alone; the same is in {FILE} beside this page."
    return Reportlet(KEY, TITLE, answer=answer, notes=tuple(paragraphs))


def methods_text(page: ReportData, own: Mapping[str, Any]) -> str:
    """The same as plain text."""
    return "\n\n".join(methods_paragraphs(page, own)) + "\n"


def methods_paragraphs(page: ReportData, own: Mapping[str, Any]) -> list[str]:
    """Geometry, models, identification, results, software, and a reference for every citation in them."""
    fits = {each.name: found for each in page.sites if (found := _fit(page, each)) is not None}
    told = [
        " ".join(each for each in (_geometry(page), *(_model(page, site) for site in page.sites)) if each),
        _identification(list(fits.values())),
        " ".join(_results(page, site, fits[site.name]) for site in page.sites if site.name in fits),
        _software(page, own),
    ]
    paragraphs = [each for each in told if each]
    cited = [key for key in REFERENCES if any(key in each for each in paragraphs)]
    if cited:
        paragraphs.append("References: " + "; ".join(f"[{key}] {REFERENCES[key]}" for key in cited) + ".")
    return paragraphs


def _fit(page: ReportData, site: SiteMaterial) -> FitView | None:
    found = page.outcomes.usable("fit", site.name)
    return None if found is None else read_fit_view(found)


def _data(page: ReportData, stage: str, site: str | None = None) -> Mapping[str, Any]:
    found = page.outcomes.usable(stage, site)
    return {} if found is None else found.data


def _geometry(page: ReportData) -> str:
    data = _data(page, "segment")
    if shape := page.case.imaging.assumed_shape:
        return f"The {page.case.limb} limb was not imaged: {shape}."
    image = data.get("image")
    if data.get("source") == "mri" and isinstance(image, Mapping):
        kind = "CT" if image.get("modality") == "CT" else "MRI"
        spacing = [f"{each:g}" for each in image.get("spacing_mm") or ()]
        voxels = f" of {' x '.join(spacing)} mm" if spacing else ""
        slices = f" ({image['n_slices']} slices, voxels{voxels})" if image.get("n_slices") else ""
        limb = f"{page.case.limb} limb"
        return f"Skin and bones of the {limb} were segmented from a series of {kind} images{slices}."
    return _GEOMETRY.get(str(data.get("source")), "").format(limb=page.case.limb)


def _model(page: ReportData, site: SiteMaterial) -> str:
    data, probe = _data(page, "mesh", site.name), page.case.probe
    quality = data.get("quality")
    if not isinstance(quality, Mapping):
        return ""
    kinds, element = {"tet10": "quadratic", "tet4": "linear"}, str(data.get("element"))
    mesher = str(data.get("mesher", ""))
    made = f" by {mesher}{' [Si 2015]' if mesher == 'TetGen' else ''}" if mesher else ""
    sizes = (number(quality.get(key)) for key in ("edge_under_probe_mm", "edge_far_mm"))
    near, far = (f"{each:.1f} mm" if each is not None else "unknown" for each in sizes)
    margin = number(data.get("margin_mm"))
    reach = f"; it reached {margin:g} mm beyond the probe" if margin is not None else ""
    return (
        f"The model of site {site.name} had {quality.get('n_cells')} {kinds.get(element, '')} tetrahedra "
        f"({element}, {quality.get('n_nodes')} nodes), meshed{made}, with mean edges of "
        f"{near} under the probe and {far} far from it{reach}. The probe had a face of {probe.length:g} x "
        f"{probe.width:g} mm with edges rounded by {probe.edge_radius:g} mm."
    )


def _identification(fits: list[FitView]) -> str:
    if not fits:
        return ""
    solvers = ", ".join(dict.fromkeys(_solver(each) for each in fits))
    given = all(each.c_is_given for each in fits)
    source = "given by hand" if given else "2 rho v^2 of the shear-wave speed v without load"
    return (
        f"{_TISSUE} The parameters were identified as published [Ranger 2023]: c was {source} and held "
        "fixed; f_kappa (with m = 2), then f_kappa and m, were fitted to the measured force over depth by "
        f"least-squares iterations of the simulation ({solvers}). Intervals (95 %) are those of the profile "
        f"likelihood [Raue 2009]; they count {'; '.join(dict.fromkeys(map(_noise, fits)))}."
    )


def _solver(fit: FitView) -> str:
    version = f" {fit.raw['solver_version']}" if fit.raw.get("solver_version") else ""
    if fit.raw.get("solver") == "febio":
        return f"FEBio{version} [Maas 2012]"
    return f"the reference solver of limbcli{version}"


def _noise(fit: FitView) -> str:
    noise = fit.raw.get("noise")
    parts = []
    if isinstance(noise, Mapping):
        parts += [
            f"{number(noise.get(key)) or 0.0:g} {unit} of {what}"
            for key, unit, what in (("force_n", "N", "force"), ("depth_mm", "mm", "depth"))
        ]
        parts[-1] += f" (one standard deviation, {noise.get('source')})"
    share = number(fit.raw.get("numerical_error_fraction"))
    if share is not None:
        parts.append(f"{100 * share:.1f} % of the force for the mesh")
    return ", ".join(parts) or "no stated noise"


def _results(page: ReportData, site: SiteMaterial, fit: FitView) -> str:
    last, measured = fit.last, site.measured
    if last is None:
        return ""
    levels = ""
    if measured is not None and len(measured.force):
        most = f"{measured.force.max():.1f} N and {measured.depth.max():.1f} mm"
        levels = f" ({len(measured.force)} levels, to {most})"
    found = [_stiffness(last.estimate("c"), last.c_kpa)]
    found += [f"{name} {each.headline}" for name in ("f_κ", "m") if (each := last.estimate(name)) is not None]
    numbers = ", ".join(each.replace("f_κ", "f_kappa") for each in found if each)
    off = [f"R2 {last.r2:.4f}" if last.r2 is not None else "", _misfit(fit)]
    agreement = f"; agreement with the data: {fit.whole.state} ({fit.whole.words.rstrip('.')})"
    diagnosed = in_short(page, site)
    tail = f" The diagnosis of what the model lacks: {diagnosed.rstrip('.')}." if diagnosed else ""
    residue = ", ".join(each for each in off if each)
    return f"Site {site.name}{levels}: {numbers}; {residue}{agreement}.{tail}"


def _misfit(fit: FitView) -> str:
    """The number that the page shows: of the loaded levels alone, since the curve starts at first touch."""
    rms = fit.force.rms
    return "" if rms is None else f"root mean square difference under load {significant(rms)} N"


def _stiffness(c: EstimateView | None, c_kpa: float | None) -> str:
    """mu and E at rest, with the interval of c."""
    if c_kpa is None:
        return ""

    def of(factor: float) -> str:
        if c is None or c.low is None or c.high is None:
            return ""
        return f" (95 % {significant(factor * c.low)} to {significant(factor * c.high)})"

    mu, young = 0.5 * c_kpa, 1.5 * c_kpa
    return (
        f"at rest mu = c/2 = {significant(mu)} kPa{of(0.5)} and E = 3 mu = {significant(young)} kPa{of(1.5)}"
    )


def _software(page: ReportData, own: Mapping[str, Any]) -> str:
    versions: dict[str, str] = {}
    for each in (*(done.result.provenance for done in page.outcomes.done if done.result), own):
        versions |= {str(key): str(value) for key, value in (each.get("packages") or {}).items()}
    cited = {"numpy": " [Harris 2020]", "scipy": " [Virtanen 2020]"}
    named = [f"{name} {version}{cited.get(name, '')}" for name, version in versions.items()]
    packages = f" with {', '.join(named)}" if named else ""
    return f"Computed by limbcli {own.get('limbcli', '')} on Python {own.get('python', '')}{packages}."
