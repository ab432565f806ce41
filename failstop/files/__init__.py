"""Files: a run's directory, its names on the disk, and files that outlive it."""
