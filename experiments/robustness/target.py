"""A target of the benchmark: what a claim measures, and what it must reach."""

from dataclasses import dataclass

_SHARE = 1


@dataclass(frozen=True)
class Target:
    """A claim to be made.

    Attributes:
        claim: Its name.
        text: What it measures.
        worlds: Worlds of the arms that measure it, whose trials are joined.
        samples: Figures, the worst of which it is.
        least: What it must reach at least; None where it must not exceed `most`.
        most: What it must not exceed; with neither it is only reported.
        unit: 100 for per cent, 1 for a share.
        seeds: Arms that it needs in each of its worlds to be met.
        low_above: What the lower end of the interval must exceed, if anything.
        apart: Pairs of samples; the interval of the first must lie above that of the second.
        also: Claims that must be met for this one to be.
        method: Method of the arms; empty for the fits that have variants.
        baseline: Method of the arms that they are compared with.
        ceiling: Method of the arms that they cannot exceed, if any.
        of_runs: Whether it is of runs of the same thing, such as a speed: their median, and their range in the place of
            an interval, on the processor with most of them.
    """

    claim: str
    text: str
    worlds: tuple[str, ...]
    samples: tuple[str, ...]
    least: float | None = None
    most: float | None = None
    unit: int = _SHARE
    seeds: int = 3
    low_above: float | None = None
    apart: tuple[tuple[str, str], ...] = ()
    also: tuple[str, ...] = ()
    method: str = ""
    baseline: str = ""
    ceiling: str = ""
    of_runs: bool = False

    @property
    def has_bar(self) -> bool:
        """Whether it must reach anything."""
        return self.least is not None or self.most is not None

    @property
    def must_reach(self) -> str:
        """The bar in words, such as `≥ 92`."""
        if not self.has_bar:
            return "reported"
        bar = f"≥ {self.least:g}" if self.least is not None else f"≤ {self.most:g}"
        return bar if self.low_above is None else f"{bar}, lower end > {self.low_above:g}"

    def is_reached(self, value: float, low: float) -> bool:
        """Returns whether a value, and the lower end of its interval, are good enough."""
        if self.low_above is not None and low <= self.low_above:
            return False
        return value >= self.least if self.least is not None else value <= (self.most or 0.0)
