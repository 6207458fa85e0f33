"""The inputs of every network: cameras and actions."""

from dataclasses import dataclass, fields
from typing import Any, TypeVar

from freerein.data.input_bounds import ACTION_HINT, action_problem, frame_hint, frame_problem
from freerein.errors import InvalidInput
from freerein.learning.fit_config import FitConfig
from freerein.types.common import ActionSpec, Camera

_MAX_CAMERAS = 8


@dataclass(frozen=True, kw_only=True)
class InputSpec:
    """Cameras and actions of a network, as of the dataset that it is trained on. Each network's spec adds its sizes.

    Attributes:
        cameras: Cameras whose frames are the input, each with a name of its own.
        action: The action space; of size 0 for a network that needs none, trained on a dataset without.

    Raises:
        InvalidInput: Cameras or actions are out of bounds.
    """

    cameras: tuple[Camera, ...]
    action: ActionSpec

    def __post_init__(self) -> None:
        names = {camera.name for camera in self.cameras}
        if not 1 <= len(names) == len(self.cameras) <= _MAX_CAMERAS:
            raise InvalidInput(
                f"A network must have 1 to {_MAX_CAMERAS} cameras, each with a name of its own; "
                f"got {len(self.cameras)} cameras and {len(names)} names.",
                field="config.cameras",
            )
        for camera in self.cameras:
            size = (camera.height, camera.width, camera.channels)
            if problem := frame_problem(size):
                raise InvalidInput(problem, field="dataset", hint=frame_hint(size))
        if problem := action_problem(self.action):
            raise InvalidInput(problem, field="dataset", hint=ACTION_HINT)

    @property
    def encoded_action_size(self) -> int:
        """Numbers of an action as a network takes it: its one-hot code when discrete, else its values."""
        return self.action.choices or self.action.size


S = TypeVar("S", bound=InputSpec)


def spec_of(
    config: FitConfig, spec_class: type[S], *, cameras: tuple[Camera, ...], action: ActionSpec, **others: object
) -> S:
    """Returns the spec of a network, with the values of a configuration's fields of the same names.

    Args:
        config: Configuration of the fit.
        spec_class: Class of the spec.
        cameras: The cameras.
        action: The action space.
        others: Fields that the configuration does not have.

    Raises:
        InvalidInput: A value is out of bounds.
    """
    given: dict[str, Any] = {"cameras": cameras, "action": action, **others}
    names = {each.name for each in fields(spec_class)} & {each.name for each in fields(config)}
    return spec_class(**{name: getattr(config, name) for name in names - given.keys()}, **given)
