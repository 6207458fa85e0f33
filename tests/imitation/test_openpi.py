"""A robot with openpi's client holds where its goal is over: by no motion, or at its last target.

Messages are read strictly, and in bounded memory.
"""

import struct
import threading
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from typing import Any

import msgpack
import numpy as np
import numpy.typing as npt
import pytest
from tests.faults import faulty_policy as policies

from freerein.errors import FailedPrecondition, InvalidInput, MalformedRequest, ServiceError
from freerein.serving.batcher import Batcher
from freerein.serving.limits import FEW_VALUES, MAX_INLINE_BYTES, MAX_VALUES
from freerein.serving.metrics import Metrics
from freerein.types.common import ModelRef
from freerein_imitation.core import PolicyRunner
from freerein_imitation.openpi import messages
from freerein_imitation.openpi.messages import pack, read, unpack
from freerein_imitation.openpi.observations import parse_observation
from freerein_imitation.openpi.service import OpenpiConnection, OpenpiQuery, parse_query

GOAL = 6
Ask = Callable[..., Any]


@pytest.fixture
async def connect() -> AsyncIterator[Callable[..., Ask]]:
    """Returns how a robot asks for actions; its actions are targets, or changes."""
    batcher = Batcher(PolicyRunner().run_batch, queue=8, batch=8, metrics=Metrics())

    def make(absolute: bool, *, most: int = 100) -> Ask:
        policy = policies.FaultyPolicy(7)
        policy.spec = replace(policy.spec, action=replace(policy.spec.action, absolute=absolute))
        query = OpenpiQuery(ModelRef(), None, most, 0)
        connection = OpenpiConnection(ModelRef("targets", "1"), policy, query, batcher)

        async def ask(brightness: int, **values: Any) -> Any:
            seen = {"observation/front": frame(brightness), "goal/front": frame(GOAL), **values}
            return unpack(await connection.answer(pack(seen)))["actions"]

        return ask

    yield make
    batcher.close()


def frame(brightness: int) -> npt.NDArray[np.uint8]:
    pixels = np.zeros((4, 4, 3), np.uint8)
    pixels[0, 0, 2] = brightness
    return pixels


async def test_a_robot_of_changes_holds_by_none(connect: Callable[[bool], Ask]) -> None:
    ask = connect(False)
    await ask(0)
    np.testing.assert_array_equal(await ask(GOAL), np.zeros((3, 2)))


async def test_a_robot_of_targets_holds_at_the_last_one(connect: Callable[[bool], Ask]) -> None:
    ask = connect(True)
    proposed = await ask(0)
    np.testing.assert_array_equal(await ask(GOAL), proposed[[-1] * 3])
    np.testing.assert_array_equal(await ask(GOAL), proposed[[-1] * 3])
    clipped = np.array([[0.5, -0.5], [0.25, 0.75]], np.float32)
    np.testing.assert_array_equal(await ask(GOAL, executed_actions=clipped), clipped[[-1] * 3])


async def test_a_robot_of_targets_holds_at_the_last_one_of_another_goal(connect: Callable[..., Ask]) -> None:
    ask, other = connect(True), GOAL + 2
    await ask(0)
    proposed = await ask(0)
    np.testing.assert_array_equal(await ask(other, **{"goal/front": frame(other)}), proposed[[-1] * 3])


async def test_actions_count_once_though_observations_after_them_are_not_answered(connect: Callable[..., Ask]) -> None:
    ask, unanswered = connect(False, most=6), frame(0)
    unanswered[0, 0, 0] = policies.RAISES
    await ask(0)
    for _ in range(2):  # 3 actions, then 1 that is repeated
        with pytest.raises(ServiceError):
            await ask(0, **{"observation/front": unanswered})
    assert (await ask(0)).any()


async def test_a_robot_of_targets_that_was_told_none_is_not_sent_anywhere(connect: Callable[[bool], Ask]) -> None:
    ask = connect(True)
    await ask(0)
    with pytest.raises(FailedPrecondition, match="must have executed one") as refused:
        await ask(GOAL, reset=True)
    assert refused.value.field == "executed_actions"


# --- messages

ONES = {
    "empty maps": b"\x80",
    "empty lists": b"\x90",
    "empty lists with a length": b"\xdd" + bytes(4),
    "lists in lists": b"\x91\xc0",
    "nothing": b"\xc0",
    "small numbers": b"\x07",
    "numbers": b"\xcf" + bytes(8),
    "floats": b"\xca" + bytes(4),
    "texts": b"\xa1x",
    "texts with a length": b"\xdb" + struct.pack(">I", 3) + b"xyz",
    "bytes": b"\xc4\x02ab",
    "extensions": b"\xd4\x05a",
    "extensions with a length": b"\xc7\x02\x05ab",
}


def listed(one: bytes, count: int, key: bytes = b"\xa6recipe") -> bytes:
    """Returns a message of one list."""
    return b"\x81" + key + b"\xdd" + struct.pack(">I", count) + one * count


def mapped(count: int) -> bytes:
    """Returns a message of a map."""
    return b"\xdf" + struct.pack(">I", count) + b"".join(msgpack.packb(str(i)) + b"\xc0" for i in range(count))


@pytest.mark.fault("I19")
@pytest.mark.parametrize("one", ONES.values(), ids=ONES)
def test_values_are_counted_before_they_are_built(one: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(msgpack, "unpackb", lambda *_, **__: pytest.fail("it is built"))
    with pytest.raises(MalformedRequest, match=f"at most {MAX_VALUES} values"):
        unpack(listed(one, MAX_VALUES))


@pytest.mark.fault("I19")
def test_announced_values_count_before_they_come() -> None:
    for start in (b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff", b"\x81\xa6recipe\xdf\x7f\xff\xff\xff"):
        with pytest.raises(MalformedRequest, match=f"at most {MAX_VALUES} values"):
            unpack(start)


@pytest.mark.fault("I19")
def test_as_many_values_as_allowed_are_read_and_no_more() -> None:
    most = MAX_VALUES - 3  # the map, its key and the list count, too
    assert unpack(listed(b"\xc0", most)) == {"recipe": [None] * most}
    pairs = MAX_VALUES // 2 - 1
    assert len(unpack(mapped(pairs))) == pairs
    for over in (listed(b"\xc0", most + 1), mapped(pairs + 1)):
        with pytest.raises(MalformedRequest, match=f"at most {MAX_VALUES} values"):
            unpack(over)


KINDS = {
    "nothing": (None, 1),
    "booleans": ([True, False], 3),
    "small integers": ([0, 127, -1, -32], 5),
    "unsigned integers": ([128, 255, 256, 65_535, 65_536, 2**32 - 1, 2**32, 2**64 - 1], 9),
    "signed integers": ([-33, -128, -129, -32_768, -32_769, -(2**31), -(2**31) - 1, -(2**63)], 9),
    "doubles": ([1.5, -2.5], 3),
    "texts": (["", "x" * 31, "x" * 32, "x" * 255, "x" * 256, "x" * 65_535, "x" * 65_536], 8),
    "bytes": ([b"", b"x" * 255, b"x" * 256, b"x" * 65_535, b"x" * 65_536], 6),
    "lists": ([[], [0] * 15, [0] * 16, [0] * 300, [0] * 65_536], 6 + 15 + 16 + 300 + 65_536),
    "maps": (
        [dict.fromkeys(map(str, range(count))) for count in (0, 15, 16, 300, 65_536)],
        6 + 2 * (15 + 16 + 300 + 65_536),
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_value_counts_once_whatever_it_is(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    value, count = KINDS[kind]
    data = msgpack.packb({"value": value, "after": [1, 2]})  # a value that is misread shifts what follows
    most = 1 + 2 + count + 3
    monkeypatch.setattr(messages, "MAX_VALUES", most)
    assert unpack(data) == {"value": value, "after": [1, 2]}
    monkeypatch.setattr(messages, "MAX_VALUES", most - 1)
    with pytest.raises(MalformedRequest, match=f"at most {most - 1} values"):
        unpack(data)


@pytest.mark.parametrize("size", [1, 2, 4, 8, 16, 3, 300, 70_000])
def test_extensions_count_as_one_value_and_are_refused(size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    data = msgpack.packb({"value": msgpack.ExtType(5, bytes([0x91]) * size), "after": [1, 2]})
    monkeypatch.setattr(messages, "MAX_VALUES", 7)
    with pytest.raises(MalformedRequest, match="no msgpack extension types"):
        unpack(data)
    monkeypatch.setattr(messages, "MAX_VALUES", 6)
    with pytest.raises(MalformedRequest, match="at most 6 values"):
        unpack(data)


@pytest.mark.fault("I19")
def test_what_values_hold_counts_as_bytes_not_as_values() -> None:
    content = {"observation": bytes(2 * MAX_VALUES), "prompt": "x" * 2 * MAX_VALUES, "small": b"abc", "number": 1.5}
    assert unpack(msgpack.packb(content)) == content


@pytest.mark.fault("I19")
@pytest.mark.parametrize("key", ["reset", "other"])
def test_a_key_that_is_repeated_is_refused_at_any_depth(key: str) -> None:
    twice = b"\x82" + 2 * (msgpack.packb(key) + b"\xc2")
    for message in (twice, b"\x81\xa5inner" + twice, b"\x81\xa5inner\x91" + twice):
        with pytest.raises(MalformedRequest, match="keys must be unique"):
            unpack(message)


@pytest.mark.fault("I19")
@pytest.mark.parametrize(
    ("message", "is_quick"),
    [
        (listed(b"\x80", MAX_INLINE_BYTES - 20), True),
        (listed(b"\x80", MAX_INLINE_BYTES), False),
        (msgpack.packb({"observation": bytes(2 * MAX_INLINE_BYTES)}), True),
        (msgpack.packb({"observation": bytes(MAX_INLINE_BYTES), "recipe": [1] * FEW_VALUES}), False),
        (msgpack.packb({"observation": bytes(2**20)}), False),
    ],
    ids=["short", "long", "an image", "many values", "a long image"],
)
async def test_a_message_that_takes_long_is_read_off_the_event_loop(
    message: bytes, is_quick: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads, real = [], msgpack.unpackb

    def recorded(*arguments: Any, **options: Any) -> Any:
        threads.append(threading.current_thread())
        return real(*arguments, **options)

    monkeypatch.setattr(msgpack, "unpackb", recorded)
    await read(message)
    assert (threads == [threading.current_thread()]) == is_quick


# --- keys of other robots, arrays of other packages

DROID = {
    "observation/exterior_image_1_left": np.zeros((4, 4, 3), np.uint8),
    "observation/joint_position": np.zeros(7),
    "observation/gripper_position": np.zeros(1),
}


def refused(spec: Any, message: dict[str, Any]) -> InvalidInput:
    with pytest.raises(InvalidInput) as error:
        parse_observation(spec, message)
    return error.value


def test_a_picture_without_pixels_is_refused_though_others_are_resized() -> None:
    message = {"observation/front": np.zeros((0, 4, 3), np.uint8), "goal/front": frame(GOAL)}
    with pytest.raises(InvalidInput, match=r"got uint8 \(0, 4, 3\)"):
        parse_observation(policies.FaultyPolicy(7).spec, message, resizes=True)


def test_keys_of_another_robot_are_named_and_where_its_picture_belongs() -> None:
    error = refused(policies.FaultyPolicy.spec, DROID)
    assert f"got {', '.join(f'`{key}`' for key in DROID)}." in error.detail
    assert error.hint.startswith("`observation/exterior_image_1_left` is probably `observation/front`.")


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("observation/Front", "observation/front"),
        ("front", "observation/front"),
        ("executed_action", "executed_actions"),
        ("observation.state", "observation/state"),
        ("Reset", "reset"),
        ("goal/fornt", "goal/front"),
    ],
)
def test_a_key_close_to_a_known_one_is_named_beside_it(key: str, meant: str) -> None:
    error = refused(policies.FaultyPolicy.spec, {"observation/front": frame(0), key: 1})
    assert error.hint.startswith(f"`{key}` is probably `{meant}`.")


def test_long_and_many_keys_are_not_repeated() -> None:
    error = refused(
        policies.FaultyPolicy.spec, {"s3cr3t" * 20: "s3cr3t", "s3cr3t\n": 1, **{f"k{i}": 1 for i in range(9)}}
    )
    assert "s3cr3t" not in f"{error.detail} {error.hint}"
    assert "a name of 120 characters, a name of 7 characters, `k0`" in error.detail
    assert error.detail.endswith("3 more.")


@pytest.mark.parametrize(
    ("key", "got"),
    [
        ("goalText", "`goalText`; did you mean `goal.text`?"),
        ("recipe", "`recipe`; did you mean `goal.recipe`?"),
        ("model", "`model`."),
        ("x" * 65, "a name of 65 characters."),
    ],
)
def test_a_parameter_that_there_is_not_is_named(key: str, got: str) -> None:
    with pytest.raises(InvalidInput) as error:
        parse_query([("model.name", "skills"), (key, "s3cr3t")])
    assert error.value.detail.endswith(f"got {got}")
    with pytest.raises(InvalidInput, match=r"got one twice\."):
        parse_query([("goal.text", "a"), ("goal.text", "b")])


async def test_a_prompt_beside_another_form_of_goal_is_ignored_and_the_reply_says_so() -> None:
    spec = policies.FaultyPolicy.spec
    told = parse_observation(spec, {"observation/front": frame(0), "goal/front": frame(GOAL), "prompt": "pick it up"})
    assert told.goal is not None
    assert (told.goal.text, told.note) == ("", "`prompt` is ignored: a goal of this model is given by images.")
    plain = parse_observation(replace(spec, goal_form="text"), {"observation/front": frame(0), "prompt": "pick it up"})
    assert plain.goal is not None
    assert (plain.goal.text, plain.note) == ("pick it up", "")


@pytest.mark.parametrize("dtype", ["|u1", "<f4", "<f8", "<i8", "|b1"])
def test_arrays_and_scalars_of_the_package_msgpack_numpy_are_read(dtype: str) -> None:
    array = np.arange(6).reshape(2, 3).astype(dtype)
    packed = {b"nd": True, b"type": dtype, b"kind": b"", b"shape": [2, 3], b"data": array.tobytes()}
    scalar = {b"nd": False, b"type": dtype, b"data": array[1, 2].tobytes()}
    found = unpack(msgpack.packb({"array": packed, "scalar": scalar}))
    assert found["array"].dtype == array.dtype
    np.testing.assert_array_equal(found["array"], array)
    assert found["scalar"] == array[1, 2].item()


@pytest.mark.parametrize(
    "value",
    [
        {b"nd": True, b"type": "|O", b"kind": b"O", b"shape": [1], b"data": b"\x80\x04N."},
        {b"nd": True, b"type": [["x", "<f4"]], b"kind": b"V", b"shape": [1], b"data": bytes(4)},
        {b"nd": True, b"type": "<f4", b"kind": b"", b"shape": [2**40], b"data": bytes(4)},
        {b"nd": False, b"type": "<f4", b"data": bytes(3)},
        {b"nd": False, b"type": "<f4", b"data": 1.0},
    ],
)
def test_other_values_of_that_package_are_refused(value: Any) -> None:
    with pytest.raises(InvalidInput):
        unpack(msgpack.packb({"value": value}))
