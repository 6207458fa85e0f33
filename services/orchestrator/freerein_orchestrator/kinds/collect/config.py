"""Configuration of a run that collects."""

from dataclasses import asdict, dataclass
from typing import Any, Literal

from freerein.config import bounded, parse
from freerein.errors import InvalidInput, must_be
from freerein.types.common import check_name

RANDOM = "random"
PARTS_FIELD = "config.parts"
_MAX_SCRIPTED = 100_000


@dataclass(frozen=True)
class MixPart:
    """A part of a mix.

    Attributes:
        policy: A ppo run's id, an earlier step of the pipeline, or a policy among the models of the orchestrator;
            `random` for the task's random behaviour.
        share: Its share of the timesteps, in proportion to those of the other parts.
        stochastic: Whether the policy's actions are sampled; else the most likely one is taken.
        conditions: Conditions of the task, besides those of the whole mix.
        task: Its task, with the cameras and actions of the mix's; empty for the mix's own.
    """

    policy: str = RANDOM
    share: float = bounded(1.0, least=1e-6, most=1e6)
    stochastic: bool = False
    conditions: tuple[str, ...] = ()
    task: str = ""

    @property
    def is_random(self) -> bool:
        """Whether it is the task's random behaviour."""
        return self.policy == RANDOM


@dataclass(frozen=True)
class CollectConfig:
    """Configuration of a run of kind `collect`.

    Attributes:
        task: The task's name.
        dataset: The dataset's name; an unfinished one of the same configuration is continued.
        behaviour: `expert` and `random` are scripted; `curiosity` learns to reach what it cannot yet predict; `mix` are
            the `parts`.
        count: Trajectories in the finished dataset; at most 100 000 of `expert` and `random`.
        seed: Seed of every random draw.
        skills: The skills that the expert chooses from; empty for all of the task.
        min_skills: Fewest different skills per trajectory; 0 means the fewest of a recipe of the task.
        max_skills: Most different skills per trajectory; 0 means as many of `skills` as a recipe may have.
        settle: Timesteps for which a trajectory of the expert goes on once it is done, holding: else no frame shows
            what its last action came to.
        cameras: The cameras to record; empty for the task's first.
        height: Frame height in pixels; 0 means the camera's own.
        width: Frame width in pixels; 0 means the camera's own.
        length: Curiosity's rollout length, and so its longest trajectory, in timesteps.
        num_envs: Parallel environments of curiosity and of a mix, and the number of trajectories in a row of a part.
        conditions: Conditions of the task, named variations; empty for the nominal task.
        parts: Of a mix, objects with `policy`, `share`, `stochastic`, `conditions` and `task`; see below.

    Raises:
        InvalidInput: The dataset's name or a policy's is invalid, or a behaviour is given options of another.
    """

    task: str
    dataset: str
    behaviour: Literal["expert", "random", "curiosity", "mix"] = "expert"
    count: int = bounded(100, least=1, most=1_000_000)
    seed: int = bounded(0, least=0, most=2**31 - 1)
    skills: tuple[str, ...] = ()
    min_skills: int = bounded(0, least=0, most=1000)
    max_skills: int = bounded(0, least=0, most=1000)
    settle: int = bounded(0, least=0, most=1000)
    cameras: tuple[str, ...] = ()
    height: int = bounded(0, least=0, most=1024)
    width: int = bounded(0, least=0, most=1024)
    length: int = bounded(50, least=2, most=1000)
    num_envs: int = bounded(8, least=1, most=64)
    conditions: tuple[str, ...] = ()
    parts: tuple[dict[str, Any], ...] = ()

    def __post_init__(self) -> None:
        check_name(self.dataset, field="config.dataset")
        if bool(self.parts) != (self.behaviour == "mix"):
            raise InvalidInput(
                f"`parts` are of the behaviour mix, which has at least one; got {len(self.parts)} of {self.behaviour}.",
                field=PARTS_FIELD,
                hint='--set behaviour=mix --set \'parts=[{"policy": "ID", "share": 2}, {"policy": "random"}]\'',
            )
        object.__setattr__(self, "parts", tuple(map(asdict, self.mix)))  # defaults filled in
        for part in self.mix:
            check_name(part.policy, field=PARTS_FIELD)
        if self.behaviour in ("expert", "random") and self.count > _MAX_SCRIPTED:
            rule = f"at most {_MAX_SCRIPTED} where the behaviour is scripted"
            raise must_be("count", rule, self.count, field="config.count", hint="Record several datasets.")
        if self.behaviour != "expert" and (self.skills or self.min_skills or self.max_skills or self.settle):
            raise InvalidInput(
                f"Only the expert executes skills; `skills`, `min_skills`, `max_skills` and `settle` must be left out "
                f"where the behaviour is {self.behaviour}.",
                field="config.skills",
                hint="Leave them out, or ask for the expert.",
            )
        if self.behaviour == "curiosity" and len(self.cameras) > 1:
            raise InvalidInput(
                f"Curiosity sees one camera; got {len(self.cameras)}.",
                field="config.cameras",
                hint="Name one, or leave them out for the task's first.",
            )

    @property
    def mix(self) -> tuple[MixPart, ...]:
        """The parts."""
        return tuple(parse(MixPart, part) for part in self.parts)
