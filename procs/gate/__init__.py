"""The gate: decides whether and how the wheels may turn, at every tick, and at once when something happens."""
