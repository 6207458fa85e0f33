"""The course that a fit or a run has taken, as far as it was watched: its curves, and how long it may still take."""

from collections.abc import Iterable, Sequence

from freerein.cli.underway import Underway

_HISTORY_S = 1.0
_TELLING = ("return", "success", "accuracy", "reward", "loss")


class Course:
    """What was seen of a fit or run.

    Attributes:
        now: How it stands; None until something was seen.
    """

    def __init__(self) -> None:
        self.now: Underway | None = None
        self._curves: dict[str, list[tuple[int, float]]] = {}
        self._begun: tuple[float, int] | None = None
        self._watched_since_s: float | None = None
        self._seconds_per_step: float | None = None

    def add(self, now: Underway, *, at_s: float) -> None:
        """Adds how it stands.

        What comes within a second of the first is taken for history, from which no pace can be told.

        Args:
            now: How it stands. Steps that are made once more, after a crash, replace what they left the first time.
            at_s: When that was heard of, by a monotonic clock.
        """
        if self._watched_since_s is None:
            self._watched_since_s = at_s
        if at_s - self._watched_since_s < _HISTORY_S or self._begun is None or now.step < self._begun[1]:
            self._begun = at_s, now.step
        elif now.step > self._begun[1]:
            self._seconds_per_step = (at_s - self._begun[0]) / (now.step - self._begun[1])
        self.now = now
        for name, value in now.metrics.items():
            curve = self._curves.setdefault(name, [])
            while curve and curve[-1][0] >= now.step:
                curve.pop()
            curve.append((now.step, value))

    @property
    def seconds_left(self) -> float | None:
        """How long it will take if it goes on as it does; None where that cannot be told."""
        if self.now is None or self.now.state != "running" or self._seconds_per_step is None:
            return None
        return max(0, self.now.steps - self.now.step) * self._seconds_per_step

    def points(self, name: str) -> tuple[tuple[int, float], ...]:
        """Returns the steps at which a metric was seen, and its values."""
        return tuple(self._curves.get(name, ()))

    def curves(self, names: Sequence[str] | None, *, most: int) -> dict[str, list[float]]:
        """Returns the values of metrics that were seen twice or more, in the order of their steps.

        Args:
            names: Which; where it is None those that tell most, returns before losses.
            most: At most so many of those.
        """
        drawn = [name for name, values in self._curves.items() if len(values) > 1]
        chosen = by_telling(drawn)[:most] if names is None else [name for name in names if name in drawn]
        return {name: [value for _, value in self._curves[name]] for name in chosen}


def by_telling(names: Iterable[str]) -> list[str]:
    """Returns metrics in order, those that tell most first: returns before losses before the rest."""
    return sorted(names, key=lambda name: (_telling(name), name))


def _telling(name: str) -> int:
    return next((place for place, word in enumerate(_TELLING) if word in name), len(_TELLING))
