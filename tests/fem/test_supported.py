"""What the solver takes; and whether its kernels are on disk already."""

from __future__ import annotations

from dataclasses import replace

import pytest
from small_models import punch

from limbcli.bodies import Drive
from limbcli.errors import SolveError
from limbcli.fem.analysis import Analysis
from limbcli.fem.equilibrium.newton import Settings
from limbcli.fem.supported import check_supported, on_disk
from limbcli.model import Step


def test_kernels_that_were_compiled_are_found_on_disk():
    """Their index files carry the name of the module they are in, which a rename changes."""
    Analysis(punch(levels=1, depth=0.2), Settings(threads=1)).run()
    assert on_disk()


def test_a_relative_force_is_taken_in_the_first_step_alone():
    """There it is from no force; later from what the body is held with."""
    load = Drive("probe", "z", "force", -0.01, "ramp", relative=True)
    model = replace(punch(), drives=())
    check_supported(replace(model, steps=(Step(drives=(load,)), Step())))
    with pytest.raises(SolveError, match="relative force"):
        check_supported(replace(model, steps=(Step(), Step(drives=(load,)))))
