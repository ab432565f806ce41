"""The modules of packaging/deb, which find each other as scripts do: beside themselves."""

from __future__ import annotations

import importlib
import sys

from tests.support.pages import ROOT

HERE = ROOT / "packaging" / "deb"

sys.path.insert(0, str(HERE))
try:
    build, tree = map(importlib.import_module, ("build", "tree"))
finally:
    sys.path.remove(str(HERE))
