"""CameraConfig, the base of every camera's configuration."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(kw_only=True)
class CameraConfig:
    fps: int | None = None
    width: int | None = None
    height: int | None = None
