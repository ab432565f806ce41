"""The gate: decides, every tick and at once on news, whether and how the wheels may turn."""
