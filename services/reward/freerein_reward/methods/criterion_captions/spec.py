"""The architecture of a model of criteria."""

from dataclasses import dataclass

from freerein.config import bounded
from freerein.criteria import View
from freerein.errors import InvalidInput
from freerein_reward.model import DualEncoderSpec

NO_CAMERA = ""
"""In place of a camera: the model has no such view."""


@dataclass(frozen=True, kw_only=True)
class CriterionSpec:
    """Architecture of a model of criteria.

    Attributes:
        cameras: Camera names.
        views: The camera of each `View`, by its value; `NO_CAMERA` for none.
        phrases: Noun phrases of the fit.
        other_phrases: More noun phrases that goal texts may have.
        vocabulary: Words of the grounding model, whose text encoder embeds noun phrases.
        units: Object width as a fraction of the frame's width and height in each camera, camera by camera.
        image_size: Height and width of the images, in pixels; a multiple of 4.
        width: Channels of the image encoder's stem; a multiple of 8.
        depth: Bottlenecks per stage of the image encoder.
        text_width: Channels of the text encoder; a multiple of 16.
        text_depth: Layers of the text encoder.
        phrase_dim: Dimension of the embeddings of noun phrases and cells.
        hidden_size: Units of each of the two hidden layers that read keypoints.
        embedding_dim: Dimension of the embeddings of captions.

    Raises:
        InvalidInput: There is no camera, a view's camera is none of them, there is no front view, or a camera has no
            units.
    """

    cameras: tuple[str, ...]
    views: tuple[str, ...]
    phrases: tuple[str, ...]
    other_phrases: tuple[str, ...]
    vocabulary: tuple[str, ...]
    units: tuple[float, ...]
    image_size: int = bounded(64, least=16, most=512)
    width: int = bounded(8, least=8, most=128)
    depth: int = bounded(1, least=1, most=8)
    text_width: int = bounded(64, least=16, most=1024)
    text_depth: int = bounded(2, least=1, most=12)
    phrase_dim: int = bounded(64, least=4, most=1024)
    hidden_size: int = bounded(64, least=1, most=4096)
    embedding_dim: int = bounded(16, least=4, most=1024)

    def __post_init__(self) -> None:
        check_views(self.cameras, self.views)
        if len(self.units) != 2 * len(self.cameras) or min(self.units) <= 0:
            raise InvalidInput(
                f"`units` must be two positive numbers for each of {len(self.cameras)} cameras; got {len(self.units)}.",
                hint="Fit the model again, or restore its folder from a copy.",
            )

    @property
    def texts(self) -> DualEncoderSpec:
        """Sizes of the grounding model's text encoder."""
        return DualEncoderSpec(
            cameras=("",),
            vocabulary=self.vocabulary,
            text_width=self.text_width,
            text_depth=self.text_depth,
            embedding_dim=self.phrase_dim,
        )

    @property
    def seen(self) -> tuple[View, ...]:
        """The views that the model has."""
        return tuple(view for view, camera in zip(View, self.views, strict=True) if camera != NO_CAMERA)


def check_views(cameras: tuple[str, ...], views: tuple[str, ...]) -> None:
    """Raises InvalidInput unless each view has a camera or none, the front view has one, and each camera a view."""
    named = tuple(each for each in views if each != NO_CAMERA)
    if len(views) != len(View) or set(named) != set(cameras) or views[View.FRONT] == NO_CAMERA:
        raise InvalidInput(
            "`views` must name the camera of the front, side and tilted view, each one of `cameras`, or, but for the "
            f"front, empty; got {len(views)} views of {len(cameras)} cameras.",
            field="config.views",
            hint=f"For example --set 'cameras=[\"{cameras[0] if cameras else 'front'}\"]' "
            f'--set \'views=["{cameras[0] if cameras else "front"}", "", ""]\'.',
        )
