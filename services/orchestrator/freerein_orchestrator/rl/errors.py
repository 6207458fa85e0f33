"""Errors and signals of a training."""

from freerein.errors import FailedPrecondition


class IterationRejected(FailedPrecondition):
    """An iteration's numbers are invalid: roll back to the last checkpoint and repeat it."""


class Stopped(Exception):
    """The work was told to stop."""
