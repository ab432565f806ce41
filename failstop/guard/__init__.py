"""The guard port: a serial port that plays the motor board, so that a driver program drives through the service."""
