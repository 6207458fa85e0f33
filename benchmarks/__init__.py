"""Compares services with what they serve, in process or bare: `python -m benchmarks`.

A figure is a ratio of two measurements that take turns in one run, so that a slow or busy machine slows both. Required
values are bars. Only `experiments` imports this package, and no test judges a time.
"""
