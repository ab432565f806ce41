"""`python -m failstop` is the command."""

import sys

from failstop.cli import main

if __name__ == "__main__":
    sys.exit(main())
