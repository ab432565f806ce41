"""Messages: declares each record of shared memory once, with its shape, its place, its writer and its readers."""
