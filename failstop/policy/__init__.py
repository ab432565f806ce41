"""Policy: what the service goes by - the settings, and the causes of a stop. Below every process; it imports none."""
