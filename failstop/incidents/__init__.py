"""Incidents: what the black box held around a stop, saved as one file, and what people make of it."""
