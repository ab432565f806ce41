"""Incidents: saves the black box around a stop as a file, and shows the file to people as a story, a plot or an
export."""
