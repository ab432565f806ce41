"""The arm's room within the gate: pure decisions with explicit time. core.py ties it together."""
