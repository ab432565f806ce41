"""`python -m failstop.cli.manual`: print the man page, or with the word `causes` the page docs/causes.md."""

from __future__ import annotations

import sys

from failstop.cli.manual import causes, man

sys.stdout.write(causes.page() if sys.argv[1:] == ["causes"] else man.page())
