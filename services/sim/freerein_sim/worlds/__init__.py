"""The worlds: scenes, their scripted experts and their privileged oracles.

A world knows nothing of servers, sessions or worker processes. `world.py` says what a world is, `tasks.py` finds the
tasks that are installed, `demonstrate.py` records an expert, `conformance.py` checks any world, ours or yours.
"""
