"""Constants and errors."""
