"""Cameras of their configurations: a picture of one colour, which tells who took it."""

from __future__ import annotations

from lerobot.cameras import CameraConfig


class Camera:
    def __init__(self, config: CameraConfig) -> None:
        self.config = config
        self.is_connected = False

    def connect(self) -> None:
        self.is_connected = True

    def disconnect(self) -> None:
        self.is_connected = False

    def read_latest(self) -> tuple[int | None, int | None, int]:
        """Its shape, in the place of a picture."""
        assert self.is_connected
        return (self.config.height, self.config.width, 3)


def make_cameras_from_configs(configs: dict[str, CameraConfig]) -> dict[str, Camera]:
    return {name: Camera(config) for name, config in configs.items()}
