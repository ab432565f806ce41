"""The gate: decides whether the wheels may turn, and how fast. It decides at every tick, and at once when something
changes, for example when a command arrives."""
