"""The guard port: a serial port that behaves like the motor board. An existing driver program opens this port instead
of the board's, and then drives through failstop's service."""
