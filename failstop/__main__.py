"""`python -m failstop` is the command."""

import sys

from failstop.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
