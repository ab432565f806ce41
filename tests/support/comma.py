"""A locale whose decimal point is a comma, which few systems that run tests have."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

NAME = "de_DE"


def comma_locale(folder: Path) -> dict[str, str]:
    """The environment of a program that is to have it. Where it can't be made, the test is skipped and says so."""
    if not shutil.which("localedef") or not Path("/usr/share/i18n/locales", NAME).exists():
        pytest.skip("no locale with a decimal comma can be made here: apt install locales")
    # A warning is an exit code of 1 too, and the locale is made.
    words = ("localedef", "--no-archive", "-i", NAME, "-f", "UTF-8", str(folder / f"{NAME}.UTF-8"))
    subprocess.run(words, capture_output=True, check=False)
    return {"LOCPATH": str(folder), "LC_ALL": f"{NAME}.UTF-8", "LANG": f"{NAME}.UTF-8"}
