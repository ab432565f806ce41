"""The part of failstop that programs use: the robot, its state, its events."""
