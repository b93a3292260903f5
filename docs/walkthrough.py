"""From DICOM slices to a diagnosis, in Python: a synthetic subject with a hidden error in its readings.

    python docs/walkthrough.py [--quick] [--out DIR]

Cells start with `# %%`, so editors can run it as a notebook. `--quick` uses coarse meshes and few levels: the
steps are the same, but the numbers mean little.
"""

# %% Imports and mesh sizes
from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import limbcli
from limbcli import Case, build_feb, diagnose, fit, make_phantom, mesh, report, run, segment, synth

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--quick", action="store_true", help="coarse meshes, few levels")
parser.add_argument("--out", type=Path, default=Path("walkthrough"), help="where everything goes")
asked, _ = parser.parse_known_args()

folder = asked.out
results = folder / "results"
HIDDEN_N = 1.5  # the load cell reads too high by this much
TRUTH = {"c_kpa": 8.0, "f_kappa": 20.0, "m": 4.0}
if asked.quick:
    measuring = {"element": "tet4", "size_mm": 7.0, "far_size_mm": 16.0, "max_force_n": 8.0}
    sizes = {"element": "tet4", "size_mm": 7.0, "far_size_mm": 16.0}
    how = {
        "size_mm": 8.0,
        "far_size_mm": 18.0,
        "interventions": False,
        "effects": ("force-zero", "depth-gain"),
    }
else:
    measuring, sizes, how = {}, {}, {}


def tell(kind: str, facts: dict[str, object]) -> None:
    """Progress is silent by default; this listener prints the stages only."""
    if kind == "stage":
        print("..", facts["name"], facts.get("site") or "")


# %% Make a subject: DICOM slices, no measurements yet
subject = make_phantom(folder / "subject", seed=7, no_measurement=True, force=True, progress=tell)
print(subject)

# %% Segment the images into surfaces. The markers on the skin define the position of the site.
anatomy = segment(subject.case, out=results, progress=tell)
print(f"bones: {', '.join(anatomy.bones)}; skin holds {anatomy.volume_cm3['skin']:.0f} cm3")
for marker in anatomy.markers:
    print(f"marker {marker.number} at {np.round(marker.position_mm, 1)} mm (patient LPS)")

# %% Simulate measurements on a different mesh from the fit's, with noise and a hidden error in the force
measured = synth(
    subject.case, folder / "case", out=results, effects=f"force-zero={HIDDEN_N}", force=True,
    progress=tell, **TRUTH, **measuring,
)  # fmt: skip
case = measured.case
print(measured.table())

# %% Build a local model of the site on the same surfaces and simulate it with start values
models = mesh(case, out=results, progress=tell, **sizes)
print(f"{models['p1'].n_cells} elements, smallest angle {models['p1'].min_angle_deg:.0f} degrees")
built = build_feb(case, out=results, progress=tell)
first = run(case, out=results, solver="reference", progress=tell)
print(f"with start values: {first['p1'].max_force_n:.2f} N at {first['p1'].max_depth_mm:.2f} mm")

# %% Fit the parameters. Never quote a number without its words.
checked = dict.fromkeys(("intervals", "contact_check", "boundary_check"), not asked.quick)
fits = fit(case, out=results, solver="reference", progress=tell, **checked)
for estimate in fits["p1"].parameters:
    print(f"{estimate.parameter} = {estimate.value:.3g}: {estimate.words}")

# %% Diagnose what the model lacks
found = diagnose(case, out=results, progress=tell, **how)["p1"]
print(f"{found.verdict}: {found.reason}")
print(f"what fits: {found.confidence_set}; hidden was force-zero {HIDDEN_N} N")

# %% Report everything on one page
page = report(case, out=results, progress=tell).page
print(f"report: {page}")

# %% Draw your own figure: tables are numpy arrays, or pandas tables with `.to_frame()`
curves = fits["p1"].curves()
levels = np.isfinite(curves["measured_n"])
figure = Figure(figsize=(8.0, 3.4), layout="constrained")
left, right = figure.subplots(1, 2)
left.plot(curves["depth_mm"][levels], curves["measured_n"][levels], "o", color="#22303c", label="measured")
left.plot(curves["depth_mm"], curves["start_n"], ":", color="#7a7a7a", label="start values")
left.plot(curves["depth_mm"], curves["ogden_n"], color="#0072b2", label="fitted")
left.set(xlabel="depth [mm]", ylabel="force [N]")
left.legend()
candidates = found.table()
right.barh(candidates["name"], candidates["probability"], color="#d55e00")
right.set(xlabel="probability that it is missing", title=f"verdict: {found.verdict}")
figure.savefig(folder / "walkthrough.png", dpi=120)
print(f"picture: {folder / 'walkthrough.png'}")

# %% Change parameters in the same model, with derivatives: a session keeps the model in memory
model = limbcli.read_feb(built["p1"].feb)
tissue = model.materials["tissue"]  # MPa: c1 = c2 = c / 2, m1 = -m2 = m, kappa = f_kappa c
softer = model.with_material("tissue", tissue.with_parameters(kappa=tissue.parameters["kappa"] / 2))
with limbcli.ReferenceSession(model) as session:
    solved = session.solve(wrt=[("tissue", "kappa")])
    halved = session.solve(softer)
slope = solved.force_gradient["tissue", "kappa"][-1]
print(f"last level: {solved.must_points.forces[-1]:.2f} N; d force / d kappa' = {slope:.3f} N/MPa")
print(f"with half of kappa': {halved.must_points.forces[-1]:.2f} N at {halved.must_points.depths[-1]:.2f} mm")

# %% Read results back without computing again
assert limbcli.FitResult.read(results, site="p1").m == fits["p1"].m
assert Case.open(folder / "case").subject == case.subject
