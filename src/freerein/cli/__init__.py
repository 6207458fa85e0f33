"""The command line: `freerein up`, `doctor`, and a verb for everything that a service does.

One module per group of verbs; `supervisor` is what `up`, `demo` and the end-to-end tests run services with. Modules are
imported by the verb that needs them, so that `freerein --help` answers at once.
"""
