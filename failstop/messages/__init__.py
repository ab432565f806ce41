"""Messages: the records in shared memory that the processes exchange. Each is declared once, with its shape, its place,
the process that writes it and the processes that read it."""
