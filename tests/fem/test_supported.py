"""Whether the solver's kernels are on disk already."""

from __future__ import annotations

from small_models import punch

from limbcli.fem.analysis import Analysis
from limbcli.fem.equilibrium.newton import Settings
from limbcli.fem.supported import on_disk


def test_kernels_that_were_compiled_are_found_on_disk():
    """Their index files carry the name of the module they are in, which a rename changes."""
    Analysis(punch(levels=1, depth=0.2), Settings(threads=1)).run()
    assert on_disk()
