"""`python -m failstop_lab.pages`: renew every file that is made from the code; with --check only say which differ."""

from __future__ import annotations

import argparse
import sys

from failstop_lab.pages import made

parser = argparse.ArgumentParser(prog="python -m failstop_lab.pages", description=__doc__)
parser.add_argument("--check", action="store_true", help="write nothing, and end with 1 where one differs")
only_check = parser.parse_args().check
found = made.differing()
for name, text in found.items():
    if not only_check:
        (made.ROOT / name).write_text(text, "utf-8")
    sys.stdout.write(f"{name} {'differs: make docs' if only_check else 'is renewed'}\n")
sys.exit(only_check and bool(found))
