"""Telemetry: decodes what the board sends and publishes it. No stop needs it, but it requests some stops."""
