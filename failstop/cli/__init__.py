"""The command `failstop`, its subcommands, and the screens that they show on a terminal."""
