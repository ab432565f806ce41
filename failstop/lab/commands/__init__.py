"""The subcommands of `failstop` that need the laboratory."""
