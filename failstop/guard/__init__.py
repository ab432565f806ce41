"""The guard port: a serial port that behaves like the motor board. An existing driver program opens it instead of the
board's port, and so drives through failstop's service."""
