"""The arms: the pipeline on services of its own, in its full size, and in one that takes two minutes."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from experiments.first_session import pictures, report
from experiments.first_session.figures import figures
from experiments.first_session.pipeline import FULL, SMALL, pipeline
from experiments.first_session.record import Record
from experiments.workbench.arms import Arm, Experiment, world_version
from experiments.workbench.configs import Config
from experiments.workbench.pipelines import Step, run_pipeline
from experiments.workbench.results import ArmResult, Outcome
from experiments.workbench.table import Table

_WORLD, _GRID, _METHOD = "blocks", "grid", "pipeline"


class FirstSession(Experiment):
    """One arm for each size."""

    arms: tuple[Arm, ...] = tuple(Arm(_WORLD, _METHOD, {"size": size}) for size in (FULL, SMALL))

    def config(self, arm: Arm) -> Config:
        """Returns the pipeline, and the version of its second world."""
        return {"steps": _steps(arm), "grid": world_version(_GRID)}

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Runs the pipeline, and draws its pictures to `results/ARM/`; see `Experiment`."""
        record, steps, drawn = Record(folder), _steps(arm), results / arm.name
        drawn.mkdir(parents=True, exist_ok=True)
        draw = partial(pictures.draw, record, drawn)
        if run_pipeline(steps, folder, on_progress, then=draw) is None:
            return None
        names = [each["name"] for each in steps if each["kind"] == "evaluate"]
        evaluations = {name: record.evaluation(name).result for name in names}
        kept = report.shown(evaluations, record.seconds(), record.ppo_returns())
        found = figures(report.session_of(kept))
        return Outcome({each.name: each.measured.value for each in found}, {}, kept)

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns the table of the full size, or of the small one where there is no other."""
        return report.table(next((each for each in results if each.options["size"] == FULL), results[0]))


def _steps(arm: Arm) -> list[Step]:
    return pipeline(arm.options["size"], arm.seed)
