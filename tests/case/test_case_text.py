"""A case folder with two sites, for tests that need one but not its images."""

from __future__ import annotations

from pathlib import Path

from limbcli.case import Case

HEAD = """
format = 1
[subject]
id = "S1"
limb = "left"
[imaging]
mri = "mri"
[probe]
name = "GE 9L"
length_mm = 53.0
width_mm = 14.0
edge_radius_mm = 3.0
"""
SITE = """
[[site]]
name = "{name}"
position_mm = [12.0, 48.5, -60.0]
long_axis = "transverse"
levels = "{levels}"
"""
ONE_SITE = HEAD + SITE.format(name="p1", levels="levels.csv")
LEVELS = "force_n,depth_mm,swe_mean_m_per_s\n0,0,1.6\n2,1,1.7\n4,2,1.9\n"


def two_sites(folder: Path) -> Path:
    """Write the case folder and return it."""
    (folder / "mri").mkdir(parents=True)
    text = HEAD
    for name in ("p1", "p2"):
        text += SITE.format(name=name, levels=f"{name}.csv")
        (folder / f"{name}.csv").write_text(LEVELS)
    (folder / "case.toml").write_text(text)
    return folder


def test_the_case_of_the_tests_is_valid(tmp_path: Path):
    assert [each.name for each in Case.open(two_sites(tmp_path)).sites] == ["p1", "p2"]
