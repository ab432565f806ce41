"""`python -m failstop.lab.pages causes` or `settings`: print docs/causes.md or docs/configuration.md."""

from __future__ import annotations

import argparse
import sys

from failstop.lab.pages import causes, settings

PAGES = {"causes": causes.page, "settings": settings.page}

parser = argparse.ArgumentParser(prog="python -m failstop.lab.pages", description=__doc__)
parser.add_argument("page", choices=PAGES)
sys.stdout.write(PAGES[parser.parse_args().page]())
