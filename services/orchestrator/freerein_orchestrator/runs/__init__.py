"""Runs: `service.py` answers calls, `dbos_queue.py` queues durably, `child.py` is the process of a run."""
