"""Import pymeshlab in such a way that the process can end cleanly.

Its library Qt counts the objects that belong to the thread that loaded its plug-ins. At exit it accesses that
thread's data; if the thread has ended, and its data with it, the process aborts.
"""

from __future__ import annotations

import importlib
import sys
import threading
from typing import Any

_NAME = "pymeshlab"


def open_pymeshlab() -> Any:
    """Import pymeshlab; outside the main thread, by a thread that never ends.

    Raises ImportError if it is not installed, or cannot be loaded.
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
        return  # the caller's own import raises it, too
    finally:
        is_opened.set()
    threading.Event().wait()
