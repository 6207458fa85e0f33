"""The command line `freerein`.

`commands` holds the commands, `services` runs services as child processes, `doctor` and `demo` are rooms of their own.
Slow imports are inside the functions that need them, so that `freerein --help` is fast.
"""
