"""The gate: decides, at every tick and at once on news, whether and how the wheels may turn."""
