"""What a person who waits is told: how long still, which solve of how many, and never nothing for long."""

from __future__ import annotations

import gc
import io
import threading
import time

from limbcli.cli import terminal as module
from limbcli.cli.terminal import TimeLeft, keep_alive, terminal

NEWTON = {"n_steps": 25, "iteration": 2, "residual": 1e-3, "target": 1e-6, "aim": "depth 3.00 mm"}


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def test_time_left_is_that_of_the_pace_so_far():
    clock = Clock()
    left = TimeLeft(clock)
    assert left.words("a", 0, 10) == ""
    clock.now = 2.0
    assert left.words("a", 2, 10) == "", "too early to tell"
    clock.now = 4.0
    assert left.words("a", 4, 10) == ", about 6 s left"
    assert left.words("a", 10, 10) == ""


def test_other_work_and_the_same_once_more_start_anew():
    clock = Clock()
    left = TimeLeft(clock)
    left.words("a", 0, 10)
    clock.now = 100.0
    assert left.words("b", 5, 10) == ""
    clock.now = 104.0
    assert left.words("b", 6, 10) == ", about 16 s left"
    assert left.words("b", 1, 10) == "", "begun again"


def reported(*events: tuple[str, dict]) -> list[str]:
    stream = io.StringIO()
    progress = terminal(stream=stream, verbose=1)
    for kind, facts in events:
        progress.event(kind, **facts)
    return stream.getvalue().splitlines()


def test_a_level_says_of_which_solve_of_how_many():
    lines = reported(
        ("newton", {**NEWTON, "step": 7}),
        ("solve", {"number": 3, "at_most": None}),
        ("newton", {**NEWTON, "step": 7}),
        ("solve", {"number": 9, "at_most": 20}),
        ("newton", {**NEWTON, "step": 7}),
        ("stage", {"name": "report"}),
        ("newton", {**NEWTON, "step": 7}),
    )
    assert lines[0].startswith("  level 7 of 25, depth 3.00 mm")
    assert lines[2].startswith("  solve 3, level 7 of 25")
    assert lines[4].startswith("  solve 9 of at most 20, level 7 of 25")
    assert lines[6].startswith("  level 7 of 25"), "another stage's solves are others"


def test_long_tasks_tell_the_time_left(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(module, "TimeLeft", lambda: TimeLeft(clock))
    stream = io.StringIO()
    progress = terminal(stream=stream, verbose=1)
    for done in (0, 1, 2):
        clock.now = 4.0 * done
        progress.event("task", name="maps", done=done, total=4)
    lines = stream.getvalue().splitlines()
    assert "left" not in lines[0]
    assert lines[2].endswith("2/4, about 8 s left")


def test_a_log_has_one_line_a_minute_of_a_task_and_its_end(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(module.time, "monotonic", clock)
    stream = io.StringIO()
    lines = module._Lines(stream, verbose=0, live=False)
    for second in range(301):
        clock.now = float(second)
        lines("task", {"name": "maps", "done": second, "total": 300})
    shown = stream.getvalue().splitlines()
    assert 4 <= len(shown) <= 6
    assert shown[-1].endswith("300/300")


def test_a_heartbeat_is_rare_in_a_log_and_quick_on_a_terminal(monkeypatch):
    asked = []
    monkeypatch.setattr(module, "keep_alive", lambda _, silence_s: asked.append(silence_s))

    class Screen(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal(stream=io.StringIO())
    terminal(stream=Screen())
    assert asked == [60.0, 4.0]


class Silent:
    def __init__(self) -> None:
        self.last, self.signs = time.monotonic(), 0

    def silent_s(self) -> float:
        return time.monotonic() - self.last

    def alive(self) -> None:
        self.last, self.signs = time.monotonic(), self.signs + 1


def test_silence_is_broken_and_the_watch_ends_with_its_listener():
    listener = Silent()
    before = threading.active_count()
    keep_alive(listener, silence_s=0.1)
    deadline = time.monotonic() + 20.0
    while listener.signs < 3 and time.monotonic() < deadline:
        time.sleep(0.02)
    assert listener.signs >= 3
    del listener
    gc.collect()
    while threading.active_count() > before and time.monotonic() < deadline:
        time.sleep(0.02)
    assert threading.active_count() <= before


def test_a_sign_of_life_names_the_work_and_how_long_it_has_taken():
    stream = io.StringIO()
    lines = module._Lines(stream, verbose=0, live=False)
    assert lines.silent_s() == 0.0, "before anything is told there is nothing to be silent about"
    lines("note", {"text": "reading and repairing the surfaces"})
    lines._begun -= 12.0
    lines.alive()
    assert stream.getvalue().splitlines()[-1] == (
        "  reading and repairing the surfaces ... still running, 12 s"
    )
