"""The arm's part of the gate: pure decisions with explicit time. core.py ties them together."""
