"""Jobs: long work in child processes that survives crashes. A fit and a run are jobs.

store.py     jobs on disk: request, configuration, events, metrics, artifacts
attempt.py   one child process, watched until it ends or must stop; attempts are retried
queue.py     runs the jobs of one process one at a time
child.py     what a child process does: stop on SIGTERM, end with its parent, exit codes
metrics.py   metrics.jsonl, written by the child and read in pages
"""
