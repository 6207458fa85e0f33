"""Configuration of `criterion_captions`."""

from dataclasses import dataclass

from freerein.config import bounded
from freerein.criteria import CONTAINER
from freerein.learning.fit_config import DatasetFitConfig


@dataclass(frozen=True)
class CriterionConfig(DatasetFitConfig):
    """Configuration of a fit of a model of criteria.

    Attributes:
        phrases: Noun phrases of the goal texts, 2 to 16, which must be given; located in the frames of each camera.
        views: Cameras of the front, side and tilted view of table 4.1, empty ones for views that there are not; by
            default `cameras` in this order. One camera may be several views, where objects move in a plane.
        object_widths: Object width as a fraction of the frame's width, one for all views or one for each.
        object_depth: Object width in depth, from front to back, as the tilted view shows it: a fraction of the frame's
            width, less than `object_widths` where that camera looks down at a slant; 0 for as much. With it, things are
            close to each other, and before or behind, by how far apart they lie, not by how far they seem to.
        container_width: Width of what contains other things, such as a tray, in object widths: a thing is inside of it
            where their centres are less than half of it apart.
        min_presence: Presence probability from which a phrase appears in captions; below 1 minus it, it is missing.
        tolerance: Where the keypoints miss a criterion's limits by less than this, in object widths, it is not learned.
        batch_size: Moments per optimiser step.
        augmentation: Strength of the camera augmentation; 0 for none.
        distractors: Strength of the distractors, shapes that no phrase names; 0 for none.
        hidden_size: Units of each of the two hidden layers that read keypoints.
        embedding_dim: Dimension of a caption's embedding.
    """

    phrases: tuple[str, ...] = ()
    views: tuple[str, ...] = ()
    object_widths: tuple[float, ...] = (0.1,)
    object_depth: float = bounded(0.0, least=0.0, most=0.5)
    container_width: float = bounded(CONTAINER, least=0.5, most=10.0)
    min_presence: float = bounded(0.95, least=0.55, most=1.0)
    tolerance: float = bounded(0.1, least=0.0, most=1.0)
    steps: int = bounded(1000, least=1, most=10_000_000)
    batch_size: int = bounded(64, least=2, most=4096)
    lr: float = bounded(3e-3, least=1e-7, most=1.0)
    warmup_steps: int = bounded(50, least=1, most=1_000_000)
    augmentation: float = bounded(1.0, least=0.0, most=1.0)
    distractors: float = bounded(1.0, least=0.0, most=1.0)
    hidden_size: int = bounded(64, least=1, most=4096)
    embedding_dim: int = bounded(16, least=4, most=64)
