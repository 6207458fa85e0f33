"""Measures freerein beside its peers: `python -m benchmarks`.

A figure is a ratio of two things measured in one run, turn by turn, so that a slow or busy machine slows both. Where
the project promises a figure it has a bar. Nothing imports what is here, and no test judges a time.
"""
