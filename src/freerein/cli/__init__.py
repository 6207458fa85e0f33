"""The command line `freerein`.

`commands` holds the commands, `jobs` shows fits and runs, `services` runs services as child processes, `doctor` and
`demo` are packages of their own.
"""
