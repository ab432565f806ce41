"""What the command line's own parsers say, for shells (completion) and for people (the man page)."""
