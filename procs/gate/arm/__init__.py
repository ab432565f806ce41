"""The arm's part of the gate. The modules that make decisions are pure, with the time as an argument. core.py puts the
decisions together, and shell.py connects core.py with clients and servos."""
