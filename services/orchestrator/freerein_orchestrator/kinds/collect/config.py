"""Configuration of a run that collects."""

from dataclasses import dataclass
from typing import Literal

from freerein.config import bounded
from freerein.errors import InvalidInput
from freerein.types.common import check_name


@dataclass(frozen=True)
class CollectConfig:
    """Configuration of a run of kind `collect`.

    Attributes:
        task: The task's name.
        dataset: The dataset's name; an unfinished one of the same configuration is continued.
        behaviour: `expert` and `random` are scripted; `curiosity` learns to reach what it cannot yet predict.
        count: Trajectories in the finished dataset.
        seed: Seed of every random draw.
        skills: The skills that the expert chooses from; empty for all of the task.
        min_skills: Fewest different skills per trajectory; 0 means the fewest of a recipe of the task.
        max_skills: Most different skills per trajectory; 0 means as many of `skills` as a recipe may have.
        cameras: The cameras to record; empty for the task's first.
        height: Frame height in pixels; 0 means the camera's own.
        width: Frame width in pixels; 0 means the camera's own.
        length: Curiosity's rollout length, and so its longest trajectory, in timesteps.
        num_envs: Curiosity's number of parallel environments.
        conditions: Conditions of the task, named variations; empty for the nominal task.

    Raises:
        InvalidInput: The dataset's name is invalid, or a behaviour is given options of another.
    """

    task: str
    dataset: str
    behaviour: Literal["expert", "random", "curiosity"] = "expert"
    count: int = bounded(100, least=1, most=1_000_000)
    seed: int = bounded(0, least=0, most=2**31 - 1)
    skills: tuple[str, ...] = ()
    min_skills: int = bounded(0, least=0, most=1000)
    max_skills: int = bounded(0, least=0, most=1000)
    cameras: tuple[str, ...] = ()
    height: int = bounded(0, least=0, most=1024)
    width: int = bounded(0, least=0, most=1024)
    length: int = bounded(50, least=2, most=1000)
    num_envs: int = bounded(8, least=1, most=64)
    conditions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_name(self.dataset, field="config.dataset")
        if self.behaviour != "expert" and (self.skills or self.min_skills or self.max_skills):
            raise InvalidInput(
                f"Only the expert executes skills; `skills`, `min_skills` and `max_skills` must be left out where the "
                f"behaviour is {self.behaviour}.",
                field="config.skills",
                hint="Leave them out, or ask for the expert.",
            )
        if self.behaviour == "curiosity" and len(self.cameras) > 1:
            raise InvalidInput(
                f"Curiosity sees one camera; got {len(self.cameras)}.",
                field="config.cameras",
                hint="Name one, or leave them out for the task's first.",
            )
