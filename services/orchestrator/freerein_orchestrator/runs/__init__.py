"""Runs: `service.py` answers calls, `dbos_queue.py` queues durably, `__main__.py` is the process of a run."""
