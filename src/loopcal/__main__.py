"""`python -m loopcal` is the command `loopcal`."""

import sys

from loopcal.cli import main

if __name__ == "__main__":
    sys.exit(main())
