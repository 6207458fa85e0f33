"""What a fit of skills may choose."""

from dataclasses import dataclass
from typing import Literal

from freerein.learning.config import bounded
from freerein.learning.fit_config import FitConfig


@dataclass(frozen=True)
class SkillsConfig(FitConfig):
    """Everything that a fit of skills may choose.

    Attributes:
        policy: Which kind of policy this is.
        camera: Whose frames to learn from; empty where the dataset has one camera.
        shortest_segment: Segments of fewer timesteps are taken for mistakes of whoever labelled, as in section 2.4.
        start_jitter: Timesteps by which a segment may begin earlier or later than its labels say.
        late_start_share: The share of segments entered anywhere, so that time alone does not tell what to do.
        end_steps: Timesteps after a segment in which the end head is to fire, as it is in the segment's last.
        shift: How far a frame's contents are moved at random, sideways; 1 is half of the frame.
        end_weight: Of the end head's loss beside that of the actions.
        batch_size: Segments per update.
        colours: Colours that the policy tells from one another.
        hidden: Units of its layers.
        memory: Units of its LSTM.
        validation_fraction: Fraction of trajectories held out, to choose the best weights and the end head's threshold.
    """

    policy: Literal["skills"] = "skills"
    camera: str = ""
    shortest_segment: int = bounded(5, least=1, most=1000)
    start_jitter: int = bounded(3, least=0, most=1000)
    late_start_share: float = bounded(0.5, least=0.0, most=1.0)
    end_steps: int = bounded(3, least=0, most=1000)
    shift: float = bounded(0.3, least=0.0, most=1.0)
    end_weight: float = bounded(0.1, least=0.0, most=100.0)
    steps: int = bounded(2500, least=1, most=10_000_000)
    batch_size: int = bounded(12, least=1, most=1024)
    colours: int = bounded(32, least=2, most=256)
    hidden: int = bounded(128, least=8, most=1024)
    memory: int = bounded(64, least=8, most=1024)
    validation_fraction: float = bounded(0.1, least=0.01, most=0.5)
    evaluate_every: int = bounded(200, least=1, most=1_000_000)
    checkpoint_every: int = bounded(500, least=1, most=1_000_000)
    log_every: int = bounded(20, least=1, most=1_000_000)
