"""Probe: whether any base stops when what drives it dies or falls silent, without adopting failstop."""
