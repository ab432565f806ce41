"""The gate: decides whether and how fast the wheels may turn, at every tick, and also at once when something
happens."""
