"""The gate: decides whether the wheels may turn, and how fast. It decides at every tick, and also at once when
something has changed, for example when a command arrives."""
