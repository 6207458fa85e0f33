"""How much one reply may hold, known before anything is rendered."""

from collections.abc import Sequence

from freerein.errors import InvalidInput
from freerein.types.sim import Task

MAX_SIZE_PX = 256
MAX_FRAME_BYTES = 63 * 2**20
"""Of one reply: a message has at most 64 MiB, and so at most 64 Mpx."""


def check_frames(task: Task, cameras: Sequence[str], *, height: int, width: int, images: int) -> None:
    """Checks what a reply would hold. A camera that there is not counts nothing: the worker refuses it.

    Args:
        task: Whose cameras they are.
        cameras: The cameras asked for.
        height: Height, in pixels; 0 means the cameras' own.
        width: Width, in pixels; 0 means the cameras' own.
        images: Most images that the reply holds of each camera.

    Raises:
        InvalidInput: It is too much.
    """
    if not (0 <= height <= MAX_SIZE_PX and 0 <= width <= MAX_SIZE_PX):
        raise InvalidInput(
            f"`height` and `width` must be at most {MAX_SIZE_PX} pixels; got {height} and {width}.", field="height"
        )
    frame_bytes = sum(
        images * (height or camera.height) * (width or camera.width) * camera.channels
        for camera in task.cameras
        if camera.name in cameras
    )
    if frame_bytes > MAX_FRAME_BYTES:
        raise InvalidInput(
            f"The frames of one reply must have at most {MAX_FRAME_BYTES} bytes; these may have {frame_bytes}.",
            field="cameras",
            hint="Ask for fewer or smaller cameras, or hold fewer environments.",
        )
