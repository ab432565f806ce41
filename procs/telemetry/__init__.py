"""Telemetry: decodes the board's bytes and publishes what they say. No stop depends on it, but it requests some
stops."""
