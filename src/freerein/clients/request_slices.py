"""Slices of many encoded images that are small enough for one request each."""

from collections.abc import Iterator, Sequence
from operator import add, gt

from freerein import images
from freerein.clients.channel import MAX_MESSAGE_BYTES
from freerein.types.common import Image

_LONGEST = 16
_BOUNDS = (_LONGEST, MAX_MESSAGE_BYTES - 2**20, images.MAX_REQUEST_PIXELS)


def request_slices(moments: Sequence[Sequence[Image]]) -> Iterator[slice]:
    """Yields slices of moments, each the images of all cameras, by number, bytes and pixels; never an empty one.

    Raises UnsupportedMedia or InvalidInput for an image whose header cannot be read.
    """
    start, size = 0, (0, 0, 0)
    for stop, moment in enumerate(moments):
        pixels = sum(images.pixel_count(image, field="image") for image in moment)
        own = (1, sum(len(image.data) for image in moment), pixels)
        size = tuple(map(add, size, own))
        if stop > start and any(map(gt, size, _BOUNDS)):
            yield slice(start, stop)
            start, size = stop, own
    if moments:
        yield slice(start, len(moments))
