"""Worlds: scenes, scripted experts and privileged oracles; independent of servers, sessions and worker processes.

`world.py` defines the `World` protocol, `tasks.py` finds installed tasks, `episodes.py` records a policy, and
`conformance.py` tests any implementation.
"""
