"""Observations and actions of policies, and checks that tasks, teachers and students fit together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from freerein.errors import InvalidInput
from freerein.types.common import ActionSpec
from freerein.types.imitation import GetSpecResponse
from freerein.types.sim import Task
from freerein_orchestrator.rl.policy_files import StoredPolicy

_FIELD = "config.teachers"


@dataclass(frozen=True)
class PolicyInterface:
    """Observations and actions of a policy.

    Attributes:
        camera: The camera that it sees.
        height: Frame height in pixels.
        width: Frame width in pixels.
        channels: 1 or 3.
        action_size: Numbers per action.
        action_choices: Number of discrete actions, 0 if continuous.
    """

    camera: str
    height: int
    width: int
    channels: int
    action_size: int
    action_choices: int

    @classmethod
    def of_stored(cls, policy: StoredPolicy) -> "PolicyInterface":
        """Returns the interface of a policy of a ppo run."""
        spec, camera = policy.network.spec, str(policy.card["camera"])
        return cls(camera, spec.height, spec.width, spec.channels, spec.action_size, spec.action_choices)

    @classmethod
    def of_served(cls, spec: GetSpecResponse) -> "PolicyInterface":
        """Returns the interface of a model of the imitation service."""
        camera, action = spec.cameras[0], spec.action
        return cls(camera.name, camera.height, camera.width, camera.channels, action.size, action.choices)

    def __str__(self) -> str:
        action = f"one of {self.action_choices} actions" if self.action_choices else f"{self.action_size} numbers"
        return f"camera {self.camera}, {self.height} x {self.width} x {self.channels}, {action}"


def check_teachers(specs: Sequence[PolicyInterface], *, student_cameras: object) -> None:
    """Checks that teachers have the same spec, and their student the same camera.

    Args:
        specs: Of each teacher, at least one.
        student_cameras: `cameras` of the student's configuration; an empty list for the teachers'.

    Raises:
        InvalidInput: They differ.
    """
    if len(set(specs)) > 1:
        listed = "; ".join(f"teacher {number}: {spec}" for number, spec in enumerate(specs, start=1))
        raise InvalidInput(
            f"Teachers of one student must have the same observations and actions; got {listed}.",
            field=_FIELD,
            hint="Distill those that differ separately, or train them on frames of one size.",
        )
    if student_cameras not in ([], [specs[0].camera]):
        raise InvalidInput(
            f"A student must have its teachers' camera, {specs[0].camera}; got another.",
            field="config.config.cameras",
            hint="Leave it out.",
        )


def common_action(tasks: Sequence[Task]) -> tuple[ActionSpec, float]:
    """Returns the action spec and control period in seconds that all tasks share.

    Raises:
        InvalidInput: They differ.
    """
    actions = {(task.action, task.control_dt_s) for task in tasks}
    if len(actions) > 1:
        listed = "; ".join(
            f"teacher {number}: {', '.join(task.action.names)} in {task.action.unit or 'choices'} by "
            f"{task.action.scale} every {task.control_dt_s:g} s"
            for number, task in enumerate(tasks, start=1)
        )
        raise InvalidInput(
            f"Actions must mean the same in the tasks of all teachers; got {listed}.",
            field=_FIELD,
            hint="Distill those that differ separately.",
        )
    return actions.pop()


def check_task(spec: PolicyInterface, task: Task) -> None:
    """Checks that a task has a policy's camera and actions.

    Raises:
        InvalidInput: It has not.
    """
    channels: Mapping[str, int] = {camera.name: camera.channels for camera in task.cameras}
    same_action = (spec.action_size, spec.action_choices) == (task.action.size, task.action.choices)
    if channels.get(spec.camera) != spec.channels or not same_action:
        cameras = ", ".join(f"camera {name} with {count} channels" for name, count in channels.items())
        raise InvalidInput(
            f"Policy and task must have the same camera and actions; this task has {cameras} and "
            f"{task.action.size} numbers or {task.action.choices} choices per action; the policy has {spec}.",
            field="config.task",
            hint="Choose a task of the same world.",
        )
