"""The arm's part of the gate. All decisions are pure, with the time as an argument. core.py connects them."""
