"""Configuration of language policies."""

from dataclasses import dataclass

from freerein.config import bounded, one_of
from freerein.learning.actor_critic.object_encoder import OBJECT_ENCODER
from freerein.learning.encoders import ENCODERS
from freerein.learning.fit_config import DatasetFitConfig
from freerein_imitation.methods.language.network import Conditioning, Fusion
from freerein_imitation.methods.language.texts.goal_text_codes import TextCode


@dataclass(frozen=True)
class LanguageConfig(DatasetFitConfig):
    """Configuration of a fit of a language policy; `validation_fraction` is that of each goal text's trajectories.

    Attributes:
        encoder: Image encoder; or `goal_eye`, the frozen object encoder of the first policy that acted in the dataset,
            which gives the keypoints of the text's two phrases.
        max_shift: Largest random shift of a frame along each axis, as a share of its side; 0 for none. Unused with
            an object encoder, as `resized_crops` is.
        resized_crops: Whether frames are random crops, enlarged to their size, as in section 4.3.
        amsgrad: Whether Adam is AMSGrad.
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
        fusion: How the two meet: the text modulates the image features (`film`), or stands beside them (`concatenate`),
            as in section 4.3.
        text_code: What a text's code is: its `statement`, or its `sentence` embedding, as in section 4.3.
        unseen_objects: Whether goals may name objects that no training text has. With an object encoder they may be
            what it locates.
    """

    encoder: str = one_of((OBJECT_ENCODER, *ENCODERS), "spatial")
    max_shift: float = bounded(0.03, least=0.0, most=0.25)
    resized_crops: bool = False
    amsgrad: bool = False
    steps: int = bounded(3000, least=1, most=10_000_000)
    batch_size: int = bounded(128, least=1, most=4096)
    features: int = bounded(128, least=8, most=1024)
    text_features: int = bounded(32, least=1, most=1024)
    hidden_size: int = bounded(128, least=8, most=1024)
    max_steps_per_goal: int = bounded(0, least=0, most=1_000_000)
    reached_weight: float = bounded(0.3, least=0.0, most=100.0)
    reached_steps: int = bounded(5, least=1, most=256)
    conditioning: Conditioning = "text"
    fusion: Fusion = "film"
    text_code: TextCode = "statement"
    unseen_objects: bool = False
