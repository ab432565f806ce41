"""Messages: the records in shared memory that the processes exchange. Each record is declared only once. The
declaration has the record's shape, its place in shared memory, the process that writes the record and the processes
that read it."""
