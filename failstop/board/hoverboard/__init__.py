"""Hoverboard: a main board with hoverboard-firmware-hack-FOC, on its serial cable."""
