"""Folders. Without a setting for them, one that nobody but the stand-in uses."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

HF_LEROBOT_HOME = Path(os.environ.get("HF_LEROBOT_HOME") or f"{tempfile.gettempdir()}/lerobot-standin-{os.getuid()}")
HF_LEROBOT_CALIBRATION = HF_LEROBOT_HOME / "calibration"
ROBOTS = "robots"
