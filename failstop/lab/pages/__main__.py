"""`python -m failstop.lab.pages man`, `causes` or `settings`: print systemd/failstop.1, docs/causes.md or
docs/configuration.md."""

from __future__ import annotations

import argparse
import sys

from failstop.lab.pages import causes, man, settings

PAGES = {"man": man.page, "causes": causes.page, "settings": settings.page}

parser = argparse.ArgumentParser(prog="python -m failstop.lab.pages", description=__doc__)
parser.add_argument("page", choices=PAGES)
sys.stdout.write(PAGES[parser.parse_args().page]())
