"""What policies see and do, and whether it fits: a task, or the other teachers of one student."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from freerein.errors import InvalidInput
from freerein.types.common import ActionSpec
from freerein.types.sim import Task
from freerein_orchestrator.networks import ActorCriticSpec
from freerein_orchestrator.policy_artifact import Policy

_FIELD = "config.teachers"


@dataclass(frozen=True)
class Bearing:
    """What a policy sees, and what its actions are.

    Attributes:
        camera: Whose frames it sees.
        height: Of these, in pixels.
        width: Of these, in pixels.
        channels: Of these.
        action_size: Numbers per action.
        action_choices: How many different actions there are when they are discrete, else 0.
    """

    camera: str
    height: int
    width: int
    channels: int
    action_size: int
    action_choices: int

    @classmethod
    def of(cls, policy: Policy) -> "Bearing":
        """Returns that of a policy of a ppo run."""
        spec: ActorCriticSpec = policy.network.spec
        return cls(
            str(policy.card["camera"]), spec.height, spec.width, spec.channels, spec.action_size, spec.action_choices
        )

    def __str__(self) -> str:
        action = f"one of {self.action_choices} actions" if self.action_choices else f"{self.action_size} numbers"
        return f"camera {self.camera}, {self.height} x {self.width} x {self.channels}, {action}"


def check_alike(bearings: Sequence[Bearing], *, student_camera: str) -> None:
    """Does nothing where all teachers see and do the same, and their student sees it too.

    Args:
        bearings: Of each teacher, at least one.
        student_camera: What the student is to see through; empty for the teachers' camera.

    Raises:
        InvalidInput: One sees or does something else than the others, or than the student.
    """
    if len(set(bearings)) > 1:
        told = "; ".join(f"teacher {number}: {bearing}" for number, bearing in enumerate(bearings, start=1))
        raise InvalidInput(
            f"Teachers of one student must see and do the same; got {told}.",
            field=_FIELD,
            hint="Distill those apart that differ, or train them on frames of one size.",
        )
    if student_camera not in ("", bearings[0].camera):
        raise InvalidInput(
            f"A student must see through its teachers' camera, {bearings[0].camera}; got another.",
            field="config.config.camera",
            hint="Leave it out.",
        )


def agreed_action(tasks: Sequence[Task]) -> tuple[ActionSpec, float]:
    """Returns what an action means in all tasks, and the time between two of them, in seconds.

    Raises:
        InvalidInput: It means something else in one.
    """
    meanings = {(task.action, task.control_dt_s) for task in tasks}
    if len(meanings) > 1:
        told = "; ".join(
            f"teacher {number}: {', '.join(task.action.names)} in {task.action.unit or 'choices'} by "
            f"{task.action.scale} every {task.control_dt_s:g} s"
            for number, task in enumerate(tasks, start=1)
        )
        raise InvalidInput(
            f"Actions must mean the same in the tasks of all teachers; got {told}.",
            field=_FIELD,
            hint="Distill those apart that differ.",
        )
    return meanings.pop()


def check_bearing(bearing: Bearing, task: Task) -> None:
    """Does nothing where a task shows what a policy sees, and takes its actions.

    Raises:
        InvalidInput: It does not.
    """
    channels: Mapping[str, int] = {camera.name: camera.channels for camera in task.cameras}
    same_action = (bearing.action_size, bearing.action_choices) == (task.action.size, task.action.choices)
    if channels.get(bearing.camera) != bearing.channels or not same_action:
        cameras = ", ".join(f"camera {name} with {count} channels" for name, count in channels.items())
        raise InvalidInput(
            f"A policy acts in tasks like the one that it was made for; this task has {cameras} and "
            f"{task.action.size} numbers or {task.action.choices} choices per action; the policy has {bearing}.",
            field="config.task",
            hint="Choose a task of the same world.",
        )
