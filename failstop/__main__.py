"""Run the command `failstop` as `python -m failstop`."""

import sys

from failstop import helpers

if __name__ == "__main__":
    helpers.leave_current_folder()  # before Python looks for the command's own modules
    from failstop.cli.main import main

    sys.exit(main())
