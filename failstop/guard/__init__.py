"""The guard port: a serial port that behaves like the motor board, so that an existing driver program drives through
the service."""
