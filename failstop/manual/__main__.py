"""`python -m failstop.manual`: print the man page."""

from __future__ import annotations

import sys

from failstop.manual import grammar, man

sys.stdout.write(man.page(grammar.read()))
