"""The subcommands of `tagvio`, one file each; nothing heavy is imported before one runs."""
