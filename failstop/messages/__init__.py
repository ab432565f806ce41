"""Messages: the records in shared memory that the processes exchange. Each record is declared once, with its shape, its
place in shared memory, its writer and its readers."""
