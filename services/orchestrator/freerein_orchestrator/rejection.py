"""What makes an iteration of a training worthless, though nothing is broken that waiting would mend."""

from freerein.errors import FailedPrecondition


class Rejected(FailedPrecondition):
    """A service answered nonsense, or the learner's numbers are not finite: go back to where the iteration began."""
