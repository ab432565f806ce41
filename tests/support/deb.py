"""The modules of packaging and packaging/deb, which find each other as scripts do: beside themselves."""

from __future__ import annotations

import importlib
import sys

from tests.support.pages import ROOT

HERE = ROOT / "packaging" / "deb"
PLACES = (str(HERE), str(HERE.parent))

sys.path[:0] = PLACES
try:
    NAMES = ("build", "c_library", "tree", "sbom", "image", "release", "lock", "versions", "apt")
    build, c_library, tree, sbom, image, release, lock, versions, apt = map(importlib.import_module, NAMES)
finally:
    for place in PLACES:
        sys.path.remove(place)
