"""Events reach every listener, and can be kept."""

from __future__ import annotations

import numpy as np

from limbcli.progress import Progress, read_events, recorded


def test_recording_does_not_silence_the_other_listeners(tmp_path):
    seen = []
    with recorded(Progress(lambda kind, facts: seen.append(kind)), tmp_path / "p.jsonl") as progress:
        progress.event("note", text="hello")
    assert seen == ["note"]
    assert read_events(tmp_path / "p.jsonl")[0]["text"] == "hello"


def test_numpy_values_are_kept_as_numbers(tmp_path):
    path = tmp_path / "p.jsonl"
    with recorded(Progress(), path) as progress:
        progress.event("fit", iteration=np.int64(3), cost=np.float64(0.5), parameters={"m": np.float64(2)})
    (event,) = read_events(path)
    assert (event["iteration"], event["cost"], event["parameters"]) == (3, 0.5, {"m": 2.0})


def test_a_line_cut_short_is_left_out(tmp_path):
    path = tmp_path / "p.jsonl"
    path.write_text('{"kind": "newton", "residual": 1.0}\n{"kind": "newt')
    assert len(read_events(path)) == 1
