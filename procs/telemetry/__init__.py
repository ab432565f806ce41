"""Telemetry: decodes the board's bytes and publishes what they say. It requests some stops itself, for example when a
button is pressed, but no other stop depends on it."""
