"""Shared memory between the processes: the layout, segments and their records, bells, claims, lifelines."""
