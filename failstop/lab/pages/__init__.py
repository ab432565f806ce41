"""What `make docs` makes from tables of the code: pages of docs/, the man page, the journal's catalog."""
