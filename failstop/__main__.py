"""`python -m failstop` is the command."""

import sys

from failstop import helpers

if __name__ == "__main__":
    helpers.leave_current_folder()  # before the command's own modules are looked for
    from failstop.cli.main import main

    sys.exit(main())
