"""Configuration of skill cloning, and the network that it asks for."""

from dataclasses import dataclass
from typing import Literal

from freerein.config import bounded, one_of
from freerein.errors import InvalidInput
from freerein.learning.encoders import ENCODERS
from freerein.learning.fit_config import DatasetFitConfig
from freerein.learning.inputs import spec_of
from freerein.types.common import ActionSpec, Camera
from freerein_imitation.methods.skill_cloning.network import SkillCloningSpec


@dataclass(frozen=True)
class SkillCloningConfig(DatasetFitConfig):
    """Configuration of a fit of skill cloning.

    Attributes:
        ends: End of a skill: by the termination `head`, or after a `budget` of steps alone, from the labelled segments.
        encoder: Image encoder.
        features: Image features per camera.
        hidden_size: Units of the hidden layers.
        memory: Earlier frames that an action depends on.
        past_actions: Executed actions that an action depends on. They tempt a policy to repeat itself.
        past_action_dropout: Share of timesteps that are not conditioned on past actions.
        chunk: Actions that are predicted from one frame.
        use_robot_state: Whether an action also depends on the robot's own state, `observation.state`.
        shift: Largest random shift of training frames, in pixels.
        min_segment_steps: Shorter segments are left out, as in section 2.4.
        termination_steps: Timesteps after a segment's last in which its skill has ended.
        termination_weight: Weight of the termination loss relative to the action loss.
        span: Consecutive timesteps of one trajectory in a batch.
        batch_size: Spans per update.
    """

    ends: Literal["head", "budget"] = "head"
    encoder: str = one_of(ENCODERS, "spatial")
    features: int = bounded(128, least=8, most=1024)
    hidden_size: int = bounded(256, least=8, most=1024)
    memory: int = bounded(2, least=0, most=16)
    past_actions: int = bounded(0, least=0, most=16)
    past_action_dropout: float = bounded(0.5, least=0.0, most=1.0)
    chunk: int = bounded(5, least=1, most=32)
    use_robot_state: bool = False
    shift: int = bounded(2, least=0, most=32)
    min_segment_steps: int = bounded(5, least=1, most=1000)
    termination_steps: int = bounded(3, least=0, most=1000)
    termination_weight: float = bounded(0.3, least=0.0, most=100.0)
    span: int = bounded(10, least=1, most=256)
    steps: int = bounded(5000, least=1, most=10_000_000)
    batch_size: int = bounded(16, least=1, most=4096)
    lr: float = bounded(1e-3, least=1e-7, most=1.0)
    evaluate_every: int = bounded(500, least=1, most=1_000_000)
    checkpoint_every: int = bounded(1000, least=1, most=1_000_000)
    log_every: int = bounded(50, least=1, most=1_000_000)


def network_spec(
    config: SkillCloningConfig,
    *,
    cameras: tuple[Camera, ...],
    action: ActionSpec,
    skills: tuple[str, ...],
    robot_state_size: int = 0,
) -> SkillCloningSpec:
    """Returns the spec of the network for some cameras, actions and skills, and a dataset's size of the robot's state.

    Raises:
        InvalidInput: Frames, actions, skills or sizes are out of bounds, or the dataset lacks the state that is used.
    """
    if config.use_robot_state and not robot_state_size:
        raise InvalidInput(
            "`use_robot_state` needs a dataset with the robot's own state; this one has none.",
            field="config.use_robot_state",
            hint="Import it from a LeRobot dataset with `observation.state`, a vector of floats, or leave the key out.",
        )
    size = robot_state_size if config.use_robot_state else 0
    return spec_of(config, SkillCloningSpec, cameras=cameras, action=action, skills=skills, robot_state_size=size)
