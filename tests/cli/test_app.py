"""The command line's manners: quick help, exit codes, messages with a fix, no traceback."""

from __future__ import annotations

import json
import re
import resource
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from limbcli import errors
from limbcli.cli.app import COMMANDS, app, main


def limbcli(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "limbcli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=120)


def in_this_process(capsys, *arguments: str) -> tuple[object, str, str]:
    """Exit code, output and errors, without the second that a new process takes to start."""
    with pytest.raises(SystemExit) as stop:
        main(list(arguments))
    shown = capsys.readouterr()
    return stop.value.code, shown.out, shown.err


def test_help_answers_in_under_a_second():
    """Processor time, the best of three: a busy machine does not make the program slow."""
    limbcli("--help")
    spent = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        result = limbcli("--help")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    assert min(spent) < 1.0
    assert all(name in result.stdout for name in COMMANDS)


def test_a_command_imports_only_what_it_needs(tmp_path):
    code = (
        "import sys; from limbcli.cli.entry import main\n"
        "sys.argv = ['limbcli', 'new', sys.argv[1], '--quiet']\n"
        "try:\n    main()\nexcept SystemExit as stop:\n    assert not stop.code\n"
        "heavy = ('numpy', 'scipy', 'portalocker', 'limbcli.api.stage_result', 'limbcli.api.cohorts')\n"
        "print([each for each in heavy if each in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "case")], capture_output=True, text=True, timeout=120
    )
    assert (tmp_path / "case" / "case.toml").is_file()
    assert done.stderr == "[]\n"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_json_quiet_and_verbose(capsys, name: str):
    code, shown, _ = in_this_process(capsys, name, "--help")
    assert code == 0
    text = re.sub(r"\x1b\[[0-9;]*m", "", shown)
    for option in ("--json", "--quiet", "--verbose"):
        assert option in text, f"{name} lacks {option}"


def test_the_list_of_commands_says_of_each_what_it_does_to_the_end(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    _, shown, _ = in_this_process(capsys, "--help")
    assert "..." not in shown.partition("Commands:")[2]
    assert "versions, libraries, solvers with a self test, memory." in " ".join(shown.split())


@pytest.mark.parametrize("arguments", [[], ["-h"], ["--help"]])
def test_the_list_of_commands_is_that_of_the_program_with_all_options(capsys, arguments: list[str]):
    shown = []
    for program in (main, lambda args: app(args=args)):
        with pytest.raises(SystemExit):
            program(arguments)
        shown.append("".join(capsys.readouterr()).partition("Commands:")[2])
    assert "segment" in shown[0]
    assert shown[0] == shown[1]


@pytest.mark.parametrize("name", COMMANDS)
def test_help_names_every_option_whole_on_a_narrow_terminal(capsys, monkeypatch, name: str):
    monkeypatch.setenv("COLUMNS", "80")
    _, shown, _ = in_this_process(capsys, name, "--help")
    assert max(map(len, shown.splitlines())) <= 80
    assert "…" not in shown
    for each in typer.main.get_command(app).commands[name].params:  # type: ignore[attr-defined]
        assert all(text in shown for text in (*each.opts, *each.secondary_opts) if text.startswith("--"))


@pytest.mark.parametrize("name", COMMANDS)
def test_example_below_the_help_is_one_that_the_command_takes(capsys, name: str):
    program, *words = shlex.split(COMMANDS[name].example)
    assert program == "limbcli"
    assert words[0] == name
    tool = typer.main.get_command(app)
    command = tool.commands[name]
    with command.make_context(name, words[1:]) as context:  # raises where it does not parse
        assert context.params
    _, shown, _ = in_this_process(capsys, name, "--help")
    plain = re.sub(r"\s+", " ", re.sub(r"\x1b\[[0-9;]*m", "", shown))
    assert COMMANDS[name].example in plain


@pytest.mark.parametrize(
    "name", ["check", "segment", "mesh", "build-feb", "run", "fit", "diagnose", "report", "batch", "measure"]
)
def test_missing_case_is_a_message_with_a_fix_and_exit_code_2(capsys, tmp_path: Path, name: str):
    out = [] if name == "check" else ["--out", str(tmp_path / "out")]
    code, out_text, error_text = in_this_process(capsys, name, str(tmp_path / "nowhere"), *out)
    assert code == 2, error_text
    assert "fix:" in error_text + out_text
    assert "Traceback" not in error_text


def test_error_is_json_where_json_was_asked_for(capsys, tmp_path: Path):
    _, shown, _ = in_this_process(capsys, "segment", str(tmp_path / "nowhere"), "--json")
    content = json.loads(shown)
    assert (content["error"], content["exit_code"]) == ("CaseError", 2)
    assert content["fix"]


def test_every_error_family_has_an_exit_code_of_its_own():
    families = {each for each in vars(errors).values() if isinstance(each, type)}
    codes = [each.exit_code for each in families if issubclass(each, errors.LimbError)]
    assert sorted(codes) == [1, 2, 3, 4, 5, 6, 7, 70]


def test_unknown_option_is_a_usage_error(capsys):
    code, _, error_text = in_this_process(capsys, "segment", "x", "--nonsense")
    assert code == 2
    assert "Traceback" not in error_text


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (("mesh", "x", "--size-mm", "0"), "--size-mm"),
        (("mesh", "x", "--size-mm", "nan"), "--size-mm"),
        (("mesh", "x", "--margin-mm=inf"), "--margin-mm"),
        (("diagnose", "x", "--size-mm", "-1"), "--size-mm"),
        (("diagnose", "x", "--far-size-mm", "1000"), "--far-size-mm"),
        (("synth", "x", "--far-size-mm", "0"), "--far-size-mm"),
        (("synth", "x", "--unloaded-stretch-along", "3"), "--unloaded-stretch-along"),
        (("fit", "x", "--c-kpa", "-inf"), "--c-kpa"),
    ],
)
def test_numbers_that_no_option_can_mean_are_refused(capsys, arguments, option):
    code, _, error_text = in_this_process(capsys, *arguments)
    assert code == 2
    assert option in re.sub(r"\x1b\[[0-9;]*m", "", error_text)


def default_signals() -> None:
    """A test run in the background ignores interrupts, and so would its children."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


CLOSED = """
import sys
import typer
from limbcli.cli import entry
import limbcli.stages.check as module
def held(case, *, progress):
    progress.event("note", text="of the progress")
    with open(case / "kept", "w") as stream:
        sys.stderr.write("not meant for the file")
        sys.stderr.flush()
        stream.write(str(stream.fileno() > 2))
    raise typer.Exit(3)
module.check = held
sys.argv = ["limbcli", "check", sys.argv[1]]
entry.main()
"""


@pytest.mark.slow
def test_closed_streams_lead_nowhere_and_into_no_file(tmp_path: Path):
    words = [sys.executable, "-c", CLOSED, str(tmp_path)]
    done = subprocess.run(["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", *words], check=False, timeout=60)
    assert done.returncode == 3
    assert (tmp_path / "kept").read_text() == "True"


@pytest.mark.slow
@pytest.mark.parametrize(("sent", "code_of_shell"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_interruption_keeps_nothing_half_written_and_says_so(
    tmp_path: Path, sent: signal.Signals, code_of_shell: int
):
    code = (
        "import sys, time; from pathlib import Path; from limbcli.cli import entry;"
        "from limbcli.files.atomic import atomic_folder\n"
        "def slow(case, **_):\n"
        "    with atomic_folder(case / 'stage') as work:\n"
        "        (work / 'half').write_text('x'); print('ready', flush=True); time.sleep(60)\n"
        "import limbcli.stages.check as module; module.check = slow\n"
        f"sys.argv = ['limbcli', 'check', {str(tmp_path)!r}]; entry.main()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=default_signals,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(sent)
    _, errors_text = process.communicate(timeout=30)
    assert process.returncode == code_of_shell
    assert "interrupted" in errors_text
    assert list(tmp_path.iterdir()) == []


WHILE_IMPORTING = """
import os, signal, sys
from limbcli.cli import entry
class Hook:
    def find_spec(self, name, *rest):
        if name == "typer":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Hook())
sys.argv = ["limbcli", "--help"]
entry.main()
"""
AT_THE_END = """
import atexit, os, signal, sys
from limbcli.cli import entry
atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT))
sys.argv = ["limbcli", "--version"]
entry.main()
"""


INSIDE_A_LIBRARY = """
import os, signal, sys
from limbcli.cli import app, entry
def opening():
    try:
        os.kill(os.getpid(), signal.SIGINT)
        [None for _ in range(1000)]
    except KeyboardInterrupt as interrupt:
        raise ImportError("initialization failed") from interrupt
app.main = opening
entry.main()
"""


@pytest.mark.slow
@pytest.mark.parametrize(("sent", "code"), [("SIGINT", 130), ("SIGTERM", 143)])
@pytest.mark.parametrize(
    "moment", [WHILE_IMPORTING, AT_THE_END, INSIDE_A_LIBRARY], ids=["importing", "leaving", "in a library"]
)
def test_interruption_at_the_first_and_the_last_moment_is_quiet(moment: str, sent: str, code: int):
    done = subprocess.run(
        [sys.executable, "-c", moment.replace("SIGINT", sent)],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=default_signals,
    )
    assert done.returncode == code
    assert "interrupted" in done.stderr
    assert "Traceback" not in done.stderr
