"""Hoverboard: the main board of a hoverboard with hoverboard-firmware-hack-FOC, connected by its serial cable."""
