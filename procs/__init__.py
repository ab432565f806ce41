"""The service's processes: one folder each, and what starting and running any of them takes."""
