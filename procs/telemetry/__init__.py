"""Telemetry: decodes the board's bytes and publishes what they say. It causes some stops itself, for example when a
button is pressed. All other stops work without it."""
