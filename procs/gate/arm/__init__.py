"""The arm's part of the gate. All its decisions are pure, with the time as an argument; core.py connects them."""
