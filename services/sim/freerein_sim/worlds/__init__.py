"""Worlds: scenes, scripted experts and privileged oracles; independent of servers, sessions and worker processes.

`world.py` defines the `World` protocol, `recipes.py` what episodes execute and `predicates.py` what a task judges from
true states. `tasks.py` finds installed tasks, `episodes.py` records a policy, and `conformance/` tests any
implementation. `mujoco_world.py` is what MuJoCo worlds share; `replay.py` is for worlds that cannot save their state.
"""
