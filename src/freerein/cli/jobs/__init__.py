"""Fits and runs on the command line: their configuration, events, progress and display."""
