"""The commands: made from the functions of `api`, with the terminal's progress, messages and exit codes."""
