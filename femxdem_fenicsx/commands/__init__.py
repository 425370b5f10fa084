"""Subcommands of `femxdem`, one module each: `add` puts the options into a parser."""
