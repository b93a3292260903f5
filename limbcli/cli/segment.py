"""`limbcli segment CASE`."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Annotated, Any

from limbcli.api.geometry import segment
from limbcli.cli.terminal import emit
from limbcli.options import CASE


def segment_case(case: Annotated[Path, CASE], *, json: bool, **options: Any) -> None:
    """Segment an MRI or CT series, a label map or surfaces into skin, bones, fat and markers.

    A label map edited by hand in the output folder (labels.nii.gz) takes precedence over the automatic one.
    If a site is not on the skin, the command ends with an error after everything is written.
    """
    from limbcli.case import CASE_FILE
    from limbcli.errors import CaseError
    from limbcli.errors.problems import raise_errors
    from limbcli.stages.segmenting.possible_sites import site_errors

    result = inspect.unwrap(segment)(case, **options)
    emit(result, as_json=json)
    raise_errors(site_errors(result.data, str(case / CASE_FILE)), CaseError)
