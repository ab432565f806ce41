"""Messages: each record of shared memory, declared once: its shape, its place, its writer and its readers."""
