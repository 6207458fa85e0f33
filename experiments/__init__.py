"""The workbench: trains the arms of an experiment and makes its table: `python -m experiments run|table NAME`.

An experiment is one module of this package and one name in `registry.py`. `workbench/` runs arms and makes tables of
any experiment; `segmentation/` trains and evaluates the arms of chapter 2.
"""
