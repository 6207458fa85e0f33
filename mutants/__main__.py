"""Draws mutants, runs the tests that concern each, and reports the share killed: `python -m mutants [--only TEXT]`."""

import argparse
import difflib
import json
import random
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory

from mutants.edits import Edit, find_edits
from mutants.trial import Copy, Outcome

ROOT = Path(__file__).parents[1]
TARGETS: dict[str, list[str]] = {
    path: texts["tests"] for path, texts in tomllib.loads((ROOT / "mutants/targets.toml").read_text()).items()
}
EQUIVALENT = tomllib.loads((ROOT / "mutants/equivalent.toml").read_text()).get("equivalent", [])
GOAL = 0.95


@dataclass(frozen=True)
class Mutant:
    """An edit of a file."""

    path: str
    edit: Edit

    @property
    def change(self) -> tuple[str, str]:
        """The lines that it replaces, and those that take their place, each in one line."""
        source = (ROOT / self.path).read_bytes()
        old, new = (text.decode().splitlines() for text in (source, self.edit.apply(source)))
        changed = list(difflib.unified_diff(old, new, n=0))[3:]
        before, after = (" ".join(line[1:].strip() for line in changed if line[0] == sign) for sign in "-+")
        return before, after


def all_mutants(only: str = "") -> list[Mutant]:
    """Returns the mutants of the targets whose paths contain a text, but for the equivalent ones."""
    equivalent = {(one["file"], one["where"], one["before"], one["after"]) for one in EQUIVALENT}
    found = [Mutant(path, edit) for path in TARGETS if only in path for edit in find_edits((ROOT / path).read_bytes())]
    return [mutant for mutant in found if (mutant.path, mutant.edit.where, *mutant.change) not in equivalent]


def main() -> int:
    """Tries the mutants; returns 1 when too few are killed."""
    arguments = _parser().parse_args()
    mutants = all_mutants(arguments.only)
    if not mutants:
        sys.exit(f"No file of targets.toml has {arguments.only!r} in its path.")
    drawn = random.Random(arguments.seed).sample(mutants, min(arguments.count, len(mutants)))  # noqa: S311
    print(f"{len(drawn)} of {len(mutants)} mutants are drawn by seed {arguments.seed}; {arguments.jobs} at a time.")
    with _copies(arguments.jobs) as copies:
        limits = _time_limits(copies, {mutant.path for mutant in drawn})
        outcomes = _try_all(copies, drawn, limits)
    return _report(outcomes)


@contextmanager
def _copies(count: int) -> Iterator["SimpleQueue[Copy]"]:
    copies: SimpleQueue[Copy] = SimpleQueue()
    with TemporaryDirectory(prefix="mutants-") as folder:
        for i in range(count):
            copies.put(Copy(ROOT, Path(folder) / str(i)))
        yield copies


def _time_limits(copies: "SimpleQueue[Copy]", paths: set[str]) -> dict[str, float]:
    """Returns the seconds that the tests of each file may take: twice what they take without a change, and 10."""
    copy, limits = copies.get(), {}
    for path in sorted(paths):
        begun = time.monotonic()
        if copy.test(TARGETS[path], timeout_s=600) is not Outcome.SURVIVED:
            sys.exit(f"The tests of {path} fail without a change. Make them pass first.")
        limits[path] = 2 * (time.monotonic() - begun) + 10
        print(f"{limits[path]:6.0f} s at most for the tests of {path}", flush=True)
    copies.put(copy)
    return limits


def _try_all(copies: "SimpleQueue[Copy]", drawn: list[Mutant], limits: dict[str, float]) -> dict[Mutant, Outcome]:
    def run(mutant: Mutant) -> Outcome:
        copy = copies.get()
        try:
            return copy.try_edit(mutant.path, mutant.edit, TARGETS[mutant.path], timeout_s=limits[mutant.path])
        finally:
            copies.put(copy)

    outcomes = {}
    with ThreadPoolExecutor(copies.qsize()) as pool:
        for number, (mutant, outcome) in enumerate(zip(drawn, pool.map(run, drawn), strict=True), start=1):
            outcomes[mutant] = outcome
            print(f"{number:4}/{len(drawn)} {outcome:9} {mutant.path} {mutant.edit.where}", flush=True)
    return outcomes


def _report(outcomes: dict[Mutant, Outcome]) -> int:
    """Prints the survivors and the shares; returns the exit code."""
    survivors = [mutant for mutant, outcome in outcomes.items() if outcome is Outcome.SURVIVED]
    for mutant in sorted(survivors, key=lambda each: (each.path, each.edit)):
        before, after = mutant.change
        print(f"\nfile = {json.dumps(mutant.path)}\nwhere = {json.dumps(mutant.edit.where)}")
        print(f"before = {json.dumps(before)}\nafter = {json.dumps(after)}")
    drawn, alive = (Counter(each.path for each in some) for some in (outcomes, survivors))
    print()
    for path, count in sorted(drawn.items()):
        print(f"{count - alive[path]:4} of {count:4} killed  {path}")
    share = 1 - len(survivors) / len(outcomes)
    print(f"{len(outcomes) - len(survivors):4} of {len(outcomes):4} killed: {share:.1%}; the goal is {GOAL:.0%}.")
    return int(share < GOAL)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m mutants", description="Try whether the tests notice small changes."
    )
    parser.add_argument("--only", default="", help="part of the paths to change; default: all of targets.toml")
    parser.add_argument("--count", type=int, default=300, help="mutants to draw at most")
    parser.add_argument("--seed", type=int, default=0, help="seed of the draw")
    parser.add_argument("--jobs", type=int, default=2, help="mutants tried at a time")
    return parser


if __name__ == "__main__":
    sys.exit(main())
