"""Prove: the stand test. Every stop path is timed on the robot itself, and the IMU says when the wheels stood still."""
