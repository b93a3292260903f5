"""Entry point of the command; handles interrupts cleanly from start to exit.

No heavy module is imported before the signal handlers are set.
"""

from __future__ import annotations

import gc
import io
import os
import signal
import sys
import warnings
from types import FrameType

from limbcli.cli.output import INTERRUPTED, MESSAGE, keep_stdout_for_results, say

# Objects made between two looks for unreachable cycles (Python's own: 700). Imports and pictures make some
# hundred thousand that stay.
_OBJECTS = 50_000


def main() -> None:
    """The installed command `limbcli`."""
    gc.set_threshold(_OBJECTS, *gc.get_threshold()[1:])
    # Streams that the caller closed (`2>&-`) are opened on the null device: else the first files opened would
    # get their descriptors, and what libraries and child processes print would be written into them.
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115
    if not sys.warnoptions:  # those of libraries, for developers; -W or PYTHONWARNINGS shows them
        warnings.simplefilter("ignore")
    _answer_with(_exit_on_signal)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # escape characters that the terminal cannot show
    if "--json" in sys.argv and not {"--help", "-h"} & set(sys.argv):
        keep_stdout_for_results()
    try:
        from limbcli.cli.app import main as run

        _answer_with(_interrupt)
        run()
    except KeyboardInterrupt:
        say(MESSAGE, to_stderr=True)
        sys.exit(_exit_code(_sent[-1]))
    except SystemExit as stop:
        if stop.code == INTERRUPTED:
            sys.exit(_exit_code(_sent[-1]))
        raise
    except Exception as error:  # last resort: any other error becomes a message
        if _is_interrupt(error):
            say(MESSAGE, to_stderr=True)
            sys.exit(_exit_code(_sent[-1]))
        sys.exit(_caught(error))
    finally:
        _answer_with(_exit_on_signal)


def _is_interrupt(error: BaseException | None) -> bool:
    """Whether an interrupt caused the error: during the import of a library it may appear as an ImportError.

    >>> _is_interrupt(ImportError("initialization failed")), _is_interrupt(KeyboardInterrupt())
    (False, True)
    """
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _caught(error: Exception) -> int:
    """Report an unexpected error; returns the exit code."""
    from limbcli.cli.fixes import output_folder
    from limbcli.errors.unexpected import unforeseen

    shown = unforeseen(error, output_folder(sys.argv[1:]))
    say(f"{type(shown).__name__}: {shown}", to_stderr=True)
    if "--json" in sys.argv:
        from limbcli.cli.output import report_json

        report_json(shown)
    return shown.exit_code


def _answer_with(handler: object) -> None:
    """Set the handler of both signals; a signal that is ignored (nohup) stays ignored."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)  # type: ignore[arg-type]


_sent: list[int] = [signal.SIGINT]  # signals received; SIGINT for an interrupt without a recorded one


def _exit_code(number: int) -> int:
    """Exit code by the shell's convention for a command that was ended by a signal.

    >>> _exit_code(signal.SIGINT), _exit_code(signal.SIGTERM)
    (130, 143)
    """
    return 128 + number


def _interrupt(number: int, _frame: FrameType | None) -> None:
    """Handle a termination signal like Ctrl-C, so that it also cleans up."""
    _sent.append(number)
    raise KeyboardInterrupt


def _exit_on_signal(number: int, _frame: FrameType | None) -> None:
    """Exit at once: before the work starts, or after everything is written, there is nothing to clean up."""
    os.write(2, f"{MESSAGE}\n".encode())
    os._exit(_exit_code(number))
