"""The command `failstop` and its screens."""
