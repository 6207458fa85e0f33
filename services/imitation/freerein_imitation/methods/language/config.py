"""Configuration of language policies."""

from dataclasses import dataclass

from freerein.config import bounded, one_of
from freerein.learning.encoders import ENCODERS
from freerein.learning.fit_config import DatasetFitConfig
from freerein_imitation.methods.language.network import Conditioning


@dataclass(frozen=True)
class LanguageConfig(DatasetFitConfig):
    """Configuration of a fit of a language policy; `validation_fraction` is that of each goal text's trajectories.

    Attributes:
        encoder: Image encoder.
        max_shift: Largest random shift of a frame along each axis, as a share of its side; 0 for none.
        features: Image features per camera.
        text_features: Size of the text features.
        hidden_size: Units of the two hidden layers.
        max_steps_per_goal: Control steps after which a goal is abandoned; 0 for the longest trajectory's.
        reached_weight: Weight of the loss of what it says of reaching the goal, learned where a reward model has judged
            the frames; 0 to say nothing.
        reached_steps: Control steps in a row in which the goal must seem reached before it counts as reached.
        conditioning: What the network gets of a goal text. `text`: what it says. `code`: the number of the training
            text that is nearest to it, as in the primitive-code baseline of section 4.3. `none`: nothing, the baseline
            of a policy that follows texts.
    """

    encoder: str = one_of(ENCODERS, "spatial")
    max_shift: float = bounded(0.03, least=0.0, most=0.25)
    steps: int = bounded(3000, least=1, most=10_000_000)
    batch_size: int = bounded(128, least=1, most=4096)
    features: int = bounded(128, least=8, most=1024)
    text_features: int = bounded(32, least=1, most=1024)
    hidden_size: int = bounded(128, least=8, most=1024)
    max_steps_per_goal: int = bounded(0, least=0, most=1_000_000)
    reached_weight: float = bounded(0.3, least=0.0, most=100.0)
    reached_steps: int = bounded(5, least=1, most=256)
    conditioning: Conditioning = "text"
