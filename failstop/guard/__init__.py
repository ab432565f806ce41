"""The guard port: a serial port that behaves like the motor board, so that a driver program drives through the
service."""
