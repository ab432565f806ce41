"""LeRobot as far as the plugin meets it, in the version that STANDIN names. facts.json has what the real ones do."""

import os

__version__ = os.environ.get("STANDIN", "0.4.4")
