"""The port owner: owns the port, and is the only process that writes motion frames."""
