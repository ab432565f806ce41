"""The Python API of failstop: the robot, its state, its events, and the explanation of a stop."""
