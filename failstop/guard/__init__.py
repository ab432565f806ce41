"""The guard port: a serial port that behaves like the motor board. If an existing driver program opens this port
instead of the board's port, it drives through failstop's service."""
