"""LeRobot as far as the plugin meets it. facts.json has what the real one was seen to do."""
