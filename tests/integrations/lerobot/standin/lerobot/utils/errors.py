"""Errors of a device."""

from __future__ import annotations


class DeviceNotConnectedError(ConnectionError):
    """It is not connected."""


class DeviceAlreadyConnectedError(ConnectionError):
    """It is connected already."""
