"""What the `simbench` command starts. It stands outside the packages, whose imports take a second:
Ctrl-C ends that second like any other, without a traceback."""

from __future__ import annotations

import sys


def main() -> int:
    """Run the command line; returns its exit code, 130 after Ctrl-C."""
    try:
        from simbench.cli import main as command_line  # noqa: PLC0415 (inside the try on purpose)
        return command_line()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
