"""Shared by all experiments: arms, their results on disk, child processes that run them, claims and tables."""
