"""One module per group of commands. A command imports what is slow to import inside its function."""
