"""What the `simbench` command starts. It stands outside the packages, whose imports take a second:
what goes wrong in that second ends like anything else, without a traceback."""

from __future__ import annotations

import sys

_NO_PLACE_FOR_LOOPS = "no locator available"     # what numba says, while modules are imported


def main() -> int:
    """Run the command line; returns its exit code, 130 after Ctrl-C, 2 where loops that numba
    compiles can be kept nowhere."""
    try:
        from simbench.cli import main as command_line  # noqa: PLC0415 (inside the try on purpose)
        return command_line()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except RuntimeError as error:
        if _NO_PLACE_FOR_LOOPS not in str(error):
            raise
        print("error: no place to keep compiled loops: neither simbench's own folder nor ~/.cache "
              "may be written; set NUMBA_CACHE_DIR to a folder that may", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
