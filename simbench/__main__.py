"""`python -m simbench`: the command line, where no `simbench` is on the path."""

import sys

from simbench.cli import main

if __name__ == "__main__":
    sys.exit(main())
