"""Images of other sizes than the model's, by all doors."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from tests.faults import control_robot as robots
from tests.faults import faulty_policy as policies

from freerein.errors import InvalidInput
from freerein.images import encode
from freerein.serving.batcher import Batcher
from freerein.serving.metrics import Metrics
from freerein.types.common import Camera, Goal, Image, ModelRef, Observation
from freerein_imitation.core import PolicyRunner
from freerein_imitation.core.resizing import Resizer
from freerein_imitation.openpi.messages import pack, unpack
from freerein_imitation.openpi.service import OpenpiConnection, parse_query

Pixels = npt.NDArray[np.uint8]
CAMERA = Camera("front", 4, 4, 3)


def stripes(height: int, width: int, *, channels: int = 3) -> Pixels:
    """Columns of a brightness each."""
    columns = np.arange(width, dtype=np.uint8)[None, :, None] + np.uint8(100)
    return np.broadcast_to(columns, (height, width, channels)).copy()


def raw(pixels: Pixels) -> Image:
    encoding: Any = "raw_rgb8" if pixels.shape[2] == 3 else "raw_gray8"
    return Image(encoding, *pixels.shape[:2], pixels.tobytes(), "front")


def test_fit_shows_the_whole_picture_between_black_bars() -> None:
    resizer = Resizer("fit")
    wide, high = (resizer.resized(each, CAMERA)[..., 0] for each in (stripes(4, 8), stripes(8, 4)))
    assert wide.tolist() == [[0] * 4, [101, 103, 105, 107], [101, 103, 105, 107], [0] * 4]
    assert high[:, [0, 3]].max() == 0
    assert (high[:, 1:3] > 0).all()
    assert resizer.has_resized


def test_crop_shows_the_middle() -> None:
    resizer = Resizer("crop")
    assert resizer.resized(stripes(4, 8), CAMERA)[..., 0].tolist() == [[102, 103, 104, 105]] * 4
    assert resizer.resized(stripes(8, 4), CAMERA)[..., 0].tolist() == [[100, 101, 102, 103]] * 4


@pytest.mark.parametrize("mode", ["fit", "crop"])
def test_what_has_the_proportions_is_scaled_and_what_has_the_size_is_left(mode: Any) -> None:
    scaled, left = Resizer(mode), Resizer(mode)
    assert scaled.resized(stripes(8, 8), CAMERA)[..., 0].tolist() == [[101, 103, 105, 107]] * 4
    same = stripes(4, 4)
    assert left.resized(same, CAMERA) is same
    assert (scaled.has_resized, left.has_resized) == (True, False)


@pytest.mark.parametrize("mode", ["fit", "crop"])
@pytest.mark.parametrize("size", [(1, 1), (1, 2000), (2000, 1), (3, 5), (480, 640), (4, 5)])
def test_any_size_becomes_the_cameras(mode: Any, size: tuple[int, int]) -> None:
    for camera in (CAMERA, Camera("wide", 3, 17, 1), Camera("high", 64, 2, 3)):
        resized = Resizer(mode).resized(stripes(*size, channels=camera.channels), camera)
        assert (resized.shape, resized.dtype) == ((camera.height, camera.width, camera.channels), np.uint8)


@pytest.mark.parametrize("as_image", [raw, partial(encode, camera="front")])
async def test_act_resizes_observation_and_goal_on_request_and_says_so(
    core: Any, as_image: Callable[[Pixels], Image]
) -> None:
    large, small = stripes(6, 12), Resizer("crop").resized(stripes(6, 12), CAMERA)
    request = replace(robots.asked(1, 3), observation=Observation((as_image(large),)), goal=Goal((as_image(large),)))
    with pytest.raises(InvalidInput, match="as in training") as error:
        await core.act.act(request)
    assert "`resize`" in error.value.hint
    resized = await core.act.act(replace(request, resize="crop"))
    expected = await core.act.act(
        replace(request, observation=Observation((raw(small),)), goal=Goal((raw(small),)), resize="crop")
    )
    assert (resized.resized, expected.resized) == (True, False)
    np.testing.assert_array_equal(resized.actions, expected.actions)
    of_goal = await core.act.act(replace(request, observation=Observation((raw(small),)), resize="fit"))
    assert of_goal.resized


async def test_resizing_changes_no_channels(core: Any) -> None:
    request = replace(robots.asked(1, 3), observation=Observation((raw(stripes(6, 6, channels=1)),)), resize="fit")
    with pytest.raises(InvalidInput, match="height, width and channels") as error:
        await core.act.act(request)
    assert error.value.hint.startswith("Send colour")


async def test_a_stream_takes_cameras_of_other_sizes_on_request(core: Any) -> None:
    stream = robots.Stream(core.control.control)
    cameras = (Camera("front", 6, 12, 3),)
    assert (await stream.ask(robots.hello(255, cameras=cameras, resize="fit"))).spec.cameras == robots.CAMERAS
    observed = robots.seen(1).observed
    large = replace(observed, observation=Observation((raw(stripes(6, 12)),)))
    assert (await stream.ask(replace(robots.seen(1), observed=large))).chunk.resized
    assert not (await stream.ask(robots.seen(2))).chunk.resized
    assert await stream.rest() == []


async def test_a_robot_with_openpis_client_asks_for_it_in_its_url() -> None:
    batcher = Batcher(PolicyRunner().run_batch, queue=8, batch=8, metrics=Metrics())
    message = pack({"observation/front": stripes(6, 12), "goal/front": stripes(6, 12)})

    async def reply(*query: tuple[str, str]) -> dict[str, Any]:
        asked = parse_query(query)
        connection = OpenpiConnection(ModelRef("p", "1"), policies.FaultyPolicy(7), asked, batcher)
        return unpack(await connection.answer(message))

    assert (await reply(("resize", "fit")))["resized"] is True
    with pytest.raises(InvalidInput, match="as in training"):
        await reply()
    with pytest.raises(InvalidInput, match="`resize` must be fit or crop"):
        parse_query([("resize", "stretch")])
    batcher.close()
