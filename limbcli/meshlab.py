"""pymeshlab, opened so that the process can end.

Its library Qt counts how many of its objects belong to the thread that opened its plug-ins. At the process's
end it looks at that thread's account; if the thread has ended, and its account with it, the process aborts.
"""

from __future__ import annotations

import importlib
import sys
import threading
from typing import Any

_NAME = "pymeshlab"


def open_pymeshlab() -> Any:
    """The module; outside of the main thread it is opened by a thread of its own that never ends.

    Raises
    ------
    ImportError
        If it is not installed, or cannot be opened.
    """
    if _NAME not in sys.modules and threading.current_thread() is not threading.main_thread():
        is_opened = threading.Event()
        threading.Thread(target=_open_and_stay, args=(is_opened,), name=_NAME, daemon=True).start()
        is_opened.wait()
    return importlib.import_module(_NAME)


def _open_and_stay(is_opened: threading.Event) -> None:
    try:
        importlib.import_module(_NAME)
    except ImportError:
        return  # whoever asked meets it, too
    finally:
        is_opened.set()
    threading.Event().wait()
