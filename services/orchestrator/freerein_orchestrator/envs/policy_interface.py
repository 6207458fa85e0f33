"""Observations and actions of policies, and checks that tasks, teachers and students fit together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from freerein.errors import InvalidInput
from freerein.learning.actor_critic.policy_files import StoredPolicy
from freerein.types.common import ActionSpec, Camera
from freerein.types.imitation import GetSpecResponse
from freerein.types.sim import Task

_FIELD = "config.teachers"


@dataclass(frozen=True)
class PolicyInterface:
    """Observations and actions of a policy.

    Attributes:
        cameras: The cameras that it sees, with its frame sizes.
        action_size: Numbers per action.
        action_choices: Number of discrete actions, 0 if continuous.
    """

    cameras: tuple[Camera, ...]
    action_size: int
    action_choices: int

    @classmethod
    def of_stored(cls, policy: StoredPolicy) -> "PolicyInterface":
        """Returns the interface of a policy of a ppo run."""
        spec = policy.network.spec
        cameras = [Camera(name, spec.height, spec.width, spec.channels) for name in policy.cameras]
        return cls(tuple(cameras), spec.action_size, spec.action_choices)

    @classmethod
    def of_served(cls, spec: GetSpecResponse) -> "PolicyInterface":
        """Returns the interface of a model of the imitation service."""
        return cls(spec.cameras, spec.action.size, spec.action.choices)

    def frame_size(self, task: Task) -> tuple[int, int]:
        """Returns height and width in pixels at which a session renders the policy's frames; 0 for the cameras' own.

        Raises:
            InvalidInput: Sizes differ from each other and from the task's own: a session has one for all cameras.
        """
        if set(self.cameras) <= set(task.cameras):
            return 0, 0
        sizes = {(camera.height, camera.width) for camera in self.cameras}
        if len(sizes) > 1:
            raise InvalidInput(
                f"All cameras of a policy must have one frame size, or those of the task; got {self}.",
                field="config.policy",
                hint="Fit it on frames of one size, or of the task's own sizes.",
            )
        return sizes.pop()

    def __str__(self) -> str:
        action = f"one of {self.action_choices} actions" if self.action_choices else f"{self.action_size} numbers"
        cameras = ", ".join(
            f"camera {each.name}, {each.height} x {each.width} x {each.channels}" for each in self.cameras
        )
        return f"{cameras}, {action}"


def check_teachers(specs: Sequence[PolicyInterface], *, student_cameras: object) -> None:
    """Checks that teachers have the same spec, and their student the same cameras.

    Args:
        specs: Of each teacher, at least one.
        student_cameras: `cameras` of the student's configuration, a list or one name; an empty list for the first of
            the teachers'.

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
    names = [camera.name for camera in specs[0].cameras]
    chosen = [student_cameras] if isinstance(student_cameras, str) else student_cameras
    if not isinstance(chosen, list | tuple) or not set(chosen) <= set(names):
        raise InvalidInput(
            f"A student must have cameras of its teachers, {', '.join(names)}; got another.",
            field="config.config.cameras",
            hint="Leave it out for the first.",
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
    """Checks that a task has a policy's cameras and actions.

    Raises:
        InvalidInput: It has not.
    """
    channels: Mapping[str, int] = {camera.name: camera.channels for camera in task.cameras}
    same_action = (spec.action_size, spec.action_choices) == (task.action.size, task.action.choices)
    same_cameras = all(channels.get(camera.name) == camera.channels for camera in spec.cameras)
    if not (same_cameras and same_action):
        cameras = ", ".join(f"camera {name} with {count} channels" for name, count in channels.items())
        raise InvalidInput(
            f"Policy and task must have the same cameras and actions; this task has {cameras} and "
            f"{task.action.size} numbers or {task.action.choices} choices per action; the policy has {spec}.",
            field="config.task",
            hint="Choose a task of the same world.",
        )
