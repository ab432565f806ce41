"""Pages that `make docs` makes from tables of the code: those of docs/, the man page, the journal's catalog."""
