"""Safety case: hazards, claims and assumptions as tables, and what in the project cites each claim."""
