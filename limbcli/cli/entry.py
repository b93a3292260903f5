"""The command's way in and out: an interrupt is answered quietly from the first moment to the last.

Nothing heavy is imported before the handlers are set.
"""

from __future__ import annotations

import io
import os
import signal
import sys
from types import FrameType

from limbcli.cli.interrupted import INTERRUPTED, MESSAGE


def main() -> None:
    """`limbcli`, as installed."""
    _open_closed_streams()
    _answer_with(_exit_on_signal)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # letters that a terminal lacks are spelt
    try:
        from limbcli.cli.app import main as run

        _answer_with(_interrupt)
        run()
    except KeyboardInterrupt:
        print(MESSAGE, file=sys.stderr)
        sys.exit(_exit_code(_sent[-1]))
    except SystemExit as stop:
        if stop.code == INTERRUPTED:
            sys.exit(_exit_code(_sent[-1]))
        raise
    except Exception as error:  # the last net: whatever is left becomes a message
        if _is_interrupt(error):
            print(MESSAGE, file=sys.stderr)
            sys.exit(_exit_code(_sent[-1]))
        sys.exit(_caught(error))
    finally:
        _answer_with(_exit_on_signal)


def _open_closed_streams() -> None:
    """What a caller closed (`2>&-`) leads nowhere; else the first files opened would get its numbers, and
    with them what libraries and programs that are started print."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


def _is_interrupt(error: BaseException | None) -> bool:
    """Whether an interrupt lies behind it: a library that is being opened makes it an ImportError.

    >>> _is_interrupt(ImportError("initialization failed")), _is_interrupt(KeyboardInterrupt())
    (False, True)
    """
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _caught(error: Exception) -> int:
    """Tell what nobody foresaw; returns the exit code."""
    from limbcli.cli.named_output import output_folder
    from limbcli.errors.unexpected import unforeseen

    shown = unforeseen(error, output_folder(sys.argv[1:]))
    print(f"{type(shown).__name__}: {shown}", file=sys.stderr)
    if "--json" in sys.argv:
        from limbcli.cli.app import report_json

        report_json(shown)
    return shown.exit_code


def _answer_with(handler: object) -> None:
    """Set the handler of both signals; a signal that is ignored (nohup) stays ignored."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)  # type: ignore[arg-type]


_sent: list[int] = [signal.SIGINT]  # signals that came; Ctrl-C where a library tells of none


def _exit_code(number: int) -> int:
    """As a shell tells of a command that a signal ended.

    >>> _exit_code(signal.SIGINT), _exit_code(signal.SIGTERM)
    (130, 143)
    """
    return 128 + number


def _interrupt(number: int, _frame: FrameType | None) -> None:
    """A polite kill cleans up as Ctrl-C does."""
    _sent.append(number)
    raise KeyboardInterrupt


def _exit_on_signal(number: int, _frame: FrameType | None) -> None:
    """Before anything was begun, or after all was written: nothing to clean up."""
    os.write(2, f"{MESSAGE}\n".encode())
    os._exit(_exit_code(number))
