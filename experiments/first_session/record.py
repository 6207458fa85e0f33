"""The record that the pipeline of an arm left on disk: evaluations, seconds and curves."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from experiments.workbench.pipelines import run_folder
from freerein.cli.demo.evaluations import Evaluation
from freerein.jobs.metrics import read_metrics

_MAX_ROWS = 10_000
_CURVE = "ppo/episode_return"


@dataclass(frozen=True)
class Record:
    """The record of an arm, in its folder."""

    folder: Path

    def evaluation(self, step: str) -> Evaluation:
        """Returns the evaluation of a step."""
        prefix = f"{step}."
        found = (run_folder(self.folder) / "artifacts").glob(f"{prefix}*")
        return Evaluation.read({path.name: path.read_bytes() for path in found}, prefix)

    def seconds(self) -> dict[str, float]:
        """Returns the duration of each step."""
        steps = json.loads((run_folder(self.folder) / "artifacts" / "steps.json").read_bytes())
        return {row["name"]: float(row["seconds"]) for row in steps}

    def ppo_returns(self) -> Sequence[tuple[int, float]]:
        """Returns the learned return by iteration of PPO."""
        rows = read_metrics(run_folder(self.folder) / "metrics.jsonl", from_step=0, max_rows=_MAX_ROWS).rows
        returns = [row.metrics[_CURVE] for row in rows if _CURVE in row.metrics]
        return list(enumerate(returns, 1))
