"""A folder for the loops that numba compiles, where none of numba's own places may be written.

numba keeps them beside the sources or in the user's cache folder, and refuses to import a module
when it may write neither, as in a container with a read-only installation and no home.
"""

from __future__ import annotations

import logging
import os
import stat
import tempfile
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"
_PACKAGE = Path(__file__).resolve().parent     # simbench is installed beside it


def find_place(package: Path = _PACKAGE) -> None:
    """Say where compiled loops go, in NUMBA_CACHE_DIR, where numba would find no place itself.

    A line of the log tells it. Must be called before numba is imported; processes that are started
    later inherit it. Where not even a temporary folder can be had nothing is said, and numba's own
    error follows.
    """
    if os.environ.get(VARIABLE) or _writable(_users_cache()) \
            or _writable(package / "__pycache__"):
        return
    try:
        folder = _temporary()
    except OSError:
        return
    os.environ[VARIABLE] = str(folder)
    logging.getLogger(__name__).warning(
        "compiled loops are kept in %s: neither the installation nor the user's cache may be "
        "written; set %s to keep them elsewhere", folder, VARIABLE)


def _users_cache() -> Path:
    """Where numba looks on Linux; elsewhere the home folder stands for it."""
    named = os.environ.get("XDG_CACHE_HOME")
    home = os.path.expanduser("~")  # noqa: PTH111 (as numba does: a user without a home is no error)
    return Path(named or f"{home}/.cache") / "numba"


def _writable(folder: Path) -> bool:
    """Whether it is a folder that may be written, or could be made."""
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)


def _temporary() -> Path:
    """A folder of this user's for all runs to come, or a fresh one where that cannot be trusted.

    What is loaded from it is run: it must be ours, no link, and closed to all others.
    """
    if hasattr(os, "getuid"):
        folder = Path(tempfile.gettempdir()) / f"simbench-loops-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() \
                and not stat.S_IMODE(found.st_mode) & 0o077:
            return folder
    return Path(tempfile.mkdtemp(prefix="simbench-loops-"))
