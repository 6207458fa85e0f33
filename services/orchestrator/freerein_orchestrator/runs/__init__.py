"""Runs: what was asked for, what became of it, and the child processes that do the work."""
