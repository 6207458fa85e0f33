"""Bytes of a REST request to a dataclass, or to an error that says why not and repeats nothing of them."""

import contextlib
import json
import tempfile
from typing import Any, TypeVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from starlette.requests import Request

from freerein import images, wire
from freerein.errors import Cancelled, InvalidInput, MalformedRequest, OutOfStorage, ServiceError, UnsupportedMedia
from freerein.serving.limits import FEW_VALUES, MAX_INLINE_IMAGE_BYTES
from freerein.serving.rest import body
from freerein.types.common import ModelRef
from freerein.types.learning import StartFitRequest, WatchFitRequest
from freerein.types.reward import RewardRequest
from freerein.types.segmentation import ListSkillsRequest, SegmentRequest

T = TypeVar("T")
JSON = "application/json"
MULTIPART = "multipart/form-data; boundary=b"
SECRET = "s3cr3t"


def request(data: bytes = b"", content_type: str | None = JSON, query: str = "", chunk: int = 7) -> Request:
    headers = [] if content_type is None else [(b"content-type", content_type.encode())]
    chunks = [data[i : i + chunk] for i in range(0, len(data), chunk)] or [b""]
    messages: list[dict[str, Any]] = [{"type": "http.request", "body": part, "more_body": True} for part in chunks]
    messages.append({"type": "http.request", "body": b"", "more_body": False})

    async def receive() -> dict[str, Any]:
        return messages.pop(0) if messages else {"type": "http.disconnect"}

    scope = {"type": "http", "method": "POST", "path": "/", "headers": headers, "query_string": query.encode()}
    return Request(scope, receive)


async def read(data: bytes, cls: type[T], content_type: str | None = JSON) -> T:
    return await body.read(request(data, content_type, chunk=max(1, len(data) // 3)), cls)


def is_parsed_at_once(data: bytes, cls: type[object]) -> bool:
    """Returns whether a body that has arrived is parsed without leaving the event loop."""
    with contextlib.closing(body.read(request(data, chunk=len(data)), cls)) as reading:
        try:
            reading.send(None)
        except StopIteration:
            return True
    return False


async def test_images_are_parsed_on_the_event_loop_and_bodies_that_take_long_are_not() -> None:
    def image_of(size: int) -> bytes:
        return json.dumps({"images": [{"encoding": "png", "data": "A" * size}]}).encode()

    assert is_parsed_at_once(image_of(224 * 224 * 4), SegmentRequest)
    assert not is_parsed_at_once(image_of(MAX_INLINE_IMAGE_BYTES), SegmentRequest)
    many = [{"encoding": "png", "data": "A" * 300}] * FEW_VALUES
    assert not is_parsed_at_once(json.dumps({"images": many}).encode(), SegmentRequest)


async def outcome_of(data: bytes, cls: type[T], content_type: str = JSON) -> T | ServiceError:
    try:
        return await read(data, cls, content_type)
    except ServiceError as error:
        return error


def part(name: str, content: bytes, filename: str = "") -> bytes:
    file = f'; filename="{filename}"' if filename else ""
    return f'--b\r\nContent-Disposition: form-data; name="{name}"{file}\r\n\r\n'.encode() + content + b"\r\n"


def form(*parts: bytes) -> bytes:
    return b"".join(parts) + b"--b--\r\n"


def png() -> bytes:
    return images.encode(np.full((2, 2, 1), 7, np.uint8)).data


# --- JSON


async def test_json_becomes_the_dataclass() -> None:
    data = b'{"dataset": "demos", "config": {"steps": 5.0, "rate": 0.5}}'
    assert await read(data, StartFitRequest) == StartFitRequest("demos", "", {"steps": 5, "rate": 0.5})


@pytest.mark.parametrize("size", [0, 100_000])
async def test_a_large_body_is_read_as_a_small_one(size: int) -> None:
    data = b'{"model": {"name": "a"}' + b" " * size + b"}"
    assert (await read(data, SegmentRequest)).model == ModelRef("a")


@pytest.mark.fault("C1")
@pytest.mark.parametrize(
    "number", ["NaN", "Infinity", "-Infinity", "1e999", "-1e999", "9" * 400, "9" * 5000, "0x1", "01", ".5", "+1", "1_0"]
)
async def test_what_is_no_finite_number_is_refused(number: str) -> None:
    with pytest.raises(InvalidInput) as error:
        await read(b'{"smoothing": %s}' % number.encode(), SegmentRequest)
    assert number[:8] not in error.value.detail


async def test_minus_zero_is_a_number() -> None:
    assert (await read(b'{"smoothing": -0.0}', SegmentRequest)).smoothing == 0.0


@pytest.mark.fault("C2")
@pytest.mark.parametrize(
    "data",
    [
        b"",
        b" ",
        b"null",
        b"[]",
        b'"x"',
        b"{",
        b"{}}",
        b"{'dataset': 'x'}",
        b'{"dataset": "x",}',
        b'{"dataset": "\\ud800"}',
        b'{"dataset": "x\\ud800y"}',
        b'{"dataset": "a\0b"}',
        b'{"dataset": "\xc0\xaf"}',
        b'{"dataset": "\xe4"}',
        b'\xef\xbb\xbf{"dataset": "x"}',
        '{"dataset": "x"}'.encode("utf-16"),
        b'{"dataset": "x", "dataset": "y"}',
        b'{"dataset": "x:y", "config": {"a": 1, "a": 2}}',
        b'{"dataset": "x", "config": {"a": 1, "\\u0061": 2}}',
        b'{"dataset": "x", "config": [{"a": 1}, {"a": 1}]}',
    ],
)
async def test_what_is_no_json_object_in_utf_8_with_each_key_once_is_refused(data: bytes) -> None:
    with pytest.raises(InvalidInput):
        await read(data, StartFitRequest)


def test_keys_of_json_in_a_query_are_unique() -> None:
    with pytest.raises(InvalidInput, match="unique"):
        body.read_query(request(query='model={"name":"a","name":"b"}'), ListSkillsRequest)


async def test_a_disk_that_takes_no_part_of_an_upload_is_out_of_storage(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", "/sys")  # takes no files
    part = b'--b\r\ncontent-disposition: form-data; name="video"; filename="x.mp4"\r\n\r\n%s\r\n--b--\r\n'
    with pytest.raises(OutOfStorage, match="temporary files"):
        await read(part % bytes(2**21), SegmentRequest, MULTIPART)


@pytest.mark.parametrize("text", ["a:b", '\\"k\\": 1', "\\\\", "{:}", "\\u003a"])
async def test_colons_and_quotes_in_strings_are_no_repeated_keys(text: str) -> None:
    data = b'{"dataset": "%s", "config": {"a": "%s", "b": {"a": 1}}}' % (text.encode(), text.encode())
    assert (await read(data, StartFitRequest)).config["b"] == {"a": 1}


@given(st.recursive(st.none() | st.text(), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner)))
async def test_no_key_of_ordinary_json_counts_as_repeated(value: Any) -> None:
    data = json.dumps({"dataset": "x", "config": {"value": value}}).encode()
    outcome = await outcome_of(data, StartFitRequest)
    assert isinstance(outcome, StartFitRequest) or "repeated" not in outcome.detail


@pytest.mark.fault("C3")
@pytest.mark.parametrize("depth", [31, 900, 1_023, 100_000])
@pytest.mark.parametrize(("opening", "closing"), [("[", "]"), ('{"a":', "}")])
async def test_deep_nesting_is_refused(depth: int, opening: str, closing: str) -> None:
    deep = opening * depth + "1" + closing * depth
    with pytest.raises(InvalidInput):
        await read(b'{"dataset": "x", "config": {"a": %s}}' % deep.encode(), StartFitRequest)
    with pytest.raises(InvalidInput):
        await read(deep.encode(), StartFitRequest)


@pytest.mark.parametrize(("opening", "closing"), [("[", "]"), ('{"a":', "}")])
async def test_thirty_levels_are_allowed_over_rest_and_grpc_and_no_more(opening: str, closing: str) -> None:
    for levels, allowed in ((30, True), (31, False)):  # of which `config` is one
        config = '{"a":' + opening * (levels - 1) + "1" + closing * (levels - 1) + "}"
        outcome = await outcome_of(b'{"dataset": "x", "config": %s}' % config.encode(), StartFitRequest)
        assert isinstance(outcome, StartFitRequest) is allowed
        message = wire.message_type(StartFitRequest)(dataset="x", config=json.loads(config))
        message = wire.message_type(StartFitRequest).FromString(message.SerializeToString())
        if allowed:
            assert wire.unpack(message, StartFitRequest) == outcome
        else:
            with pytest.raises(InvalidInput, match="30 levels"):
                wire.unpack(message, StartFitRequest)


@pytest.mark.fault("C2")
@given(st.binary(max_size=200))
async def test_any_bytes_are_a_request_or_an_error_of_ours(data: bytes) -> None:
    for content_type in (JSON, MULTIPART):
        outcome = await outcome_of(data, SegmentRequest, content_type)
        assert isinstance(outcome, SegmentRequest) or outcome.http_status in (400, 415, 422)


@pytest.mark.parametrize(
    ("value", "field"),
    [
        ({"images": [{"encoding": SECRET, "data": ""}]}, "images.0.encoding"),
        ({"images": [{"encoding": "png", "data": SECRET}]}, "images.0.data"),
        ({"model": SECRET}, "model"),
        ({SECRET: 1, "smoothing": "x"}, "smoothing"),
        ({"x" * 65 + SECRET: 1}, ""),
        ({f"{SECRET}\n": 1}, ""),
        ({"goalText": SECRET}, ""),
        ({"frames": {"datatype": SECRET, "shape": [], "raw": ""}}, "frames.datatype"),
        ({"frames": {"datatype": "FP32", "shape": [2], "raw": ""}}, "frames"),
    ],
)
async def test_an_error_names_the_field_and_repeats_nothing(value: object, field: str) -> None:
    with pytest.raises(InvalidInput) as error:
        await read(json.dumps(value).encode(), SegmentRequest)
    assert error.value.field == field
    assert SECRET not in error.value.detail + error.value.hint + error.value.field
    assert error.value.hint


@pytest.mark.parametrize(
    ("value", "cls", "expected"),
    [
        ({"goalText": "x"}, RewardRequest, "got `goalText`; did you mean `goal_text`?"),
        ({"Goal-Text": "x"}, RewardRequest, "got `Goal-Text`; did you mean `goal_text`?"),
        ({"smothing": 1}, SegmentRequest, "got `smothing`; did you mean `smoothing`?"),
        ({"version": "x"}, SegmentRequest, "got `version`; did you mean `model.version`?"),
        ({"modelName": "x"}, SegmentRequest, "got `modelName`; did you mean `model.name`?"),
        ({"model": {"Name": "x"}}, SegmentRequest, "got `Name`; did you mean `name`?"),
        (
            {"images": [{"encoding": "png", "data": "", "camara": "x"}]},
            SegmentRequest,
            "got `camara`; did you mean `camera`?",
        ),
        ({"gr\u00fc\u00dfe": 1}, SegmentRequest, "got `gr\u00fc\u00dfe`."),
        ({"unrelated": 1}, SegmentRequest, "got `unrelated`."),
        ({"": 1}, SegmentRequest, "got a name of 0 characters."),
        ({"a`b": 1}, SegmentRequest, "got a name of 3 characters."),
        ({"\u202eabc": 1}, SegmentRequest, "got a name of 4 characters."),
    ],
)
async def test_a_name_that_is_no_field_is_quoted_beside_the_one_that_was_meant(
    value: object, cls: type[object], expected: str
) -> None:
    with pytest.raises(InvalidInput) as error:
        await read(json.dumps(value).encode(), cls)
    assert error.value.detail == f"The request must have only the fields of its schema; {expected}"


async def test_names_of_parts_and_parameters_are_quoted_too() -> None:
    expected = "got `goalText`; did you mean `goal_text`[?]"
    with pytest.raises(InvalidInput, match=expected):
        await read(form(part("goalText", b"x")), RewardRequest, MULTIPART)
    with pytest.raises(InvalidInput, match=expected):
        body.read_query(request(query="goalText=x"), RewardRequest)
    with pytest.raises(InvalidInput, match=r"got `Version`; did you mean `version`[?]"):
        body.read_query(request(query="model.Version=x"), RewardRequest)


@pytest.mark.fault("F11")
@pytest.mark.parametrize(
    "value", [{SECRET: 5}, {SECRET: {}}, {SECRET: {"datatype": 5}}, {"value": {SECRET: 5}}, {"x": {"shape": [SECRET]}}]
)
async def test_an_error_does_not_name_the_key_of_a_map(value: object) -> None:
    with pytest.raises(InvalidInput) as error:
        await read(json.dumps({"goal_text": "x", "frames": value}).encode(), RewardRequest)
    assert error.value.field == "frames"
    assert SECRET not in error.value.detail + error.value.hint


@pytest.mark.parametrize(
    "value",
    [
        {"smoothing": "1.5"},
        {"smoothing": True},
        {"min_segment": "3"},
        {"min_segment": 3.0},
        {"min_segment": True},
        {"model": {"name": 3}},
        {"images": {}},
        {"images": [{"encoding": "png", "data": [1, 2]}]},
        {"frames": {"datatype": "UINT8", "shape": ["1"], "raw": "AA=="}},
    ],
)
async def test_json_values_must_have_the_fields_own_type(value: object) -> None:
    with pytest.raises(InvalidInput):
        await read(json.dumps(value).encode(), SegmentRequest)


@pytest.mark.fault("C6")
@pytest.mark.parametrize("items", [900_000, 1_100_000])
async def test_a_million_bad_items_are_a_short_error(items: int) -> None:
    with pytest.raises(InvalidInput) as error:
        await read(b'{"images": [%s1]}' % (b"1," * items), SegmentRequest)
    assert len(error.value.detail) < 500


@pytest.mark.parametrize("data", [b'{"images": [%s[]]}', b'{"images": [%s{}]}', b'{"images": %s'])
async def test_small_values_that_would_fill_the_memory_are_not_parsed(data: bytes) -> None:
    with pytest.raises(InvalidInput, match="200000 values"):
        await read(data % (b"[]," * 200_000), SegmentRequest)
    with pytest.raises(InvalidInput, match="200000 values"):
        await read(form(part("model", b"[%s[]]" % (b"[]," * 200_000))), SegmentRequest, MULTIPART)


@pytest.mark.parametrize(("commas", "error"), [(199_998, "`images.0` is invalid"), (199_999, "at most 200000 values")])
async def test_as_many_values_as_allowed_are_parsed_and_no_more(commas: int, error: str) -> None:
    with pytest.raises(InvalidInput, match=error):
        await read(b'{"images": [%s1]}' % (b"1," * commas), SegmentRequest)


# --- media types


@pytest.mark.parametrize("content_type", ["application/json; charset=utf-8", "APPLICATION/JSON", "application/json;"])
async def test_json_has_many_spellings(content_type: str) -> None:
    assert await read(b"{}", ListSkillsRequest, content_type) == ListSkillsRequest()


@pytest.mark.fault("C4")
@pytest.mark.parametrize(
    "content_type",
    [
        None,
        *("", "image/png", "text/plain", "application/x-www-form-urlencoded", "application/jsonx", "json", ";", "*/*"),
        "application/json; charset=latin1",
        "application/json; charset=utf-16",
        "multipart/form-data; boundary=b; charset=hex",
    ],
)
async def test_any_other_media_type_is_refused(content_type: str | None) -> None:
    with pytest.raises(UnsupportedMedia):
        await read(b"{}", ListSkillsRequest, content_type)


async def test_a_caller_that_goes_away_in_the_middle_cancels() -> None:
    for content_type in (JSON, MULTIPART):
        broken = request(b"{", content_type)
        await broken.receive()
        await broken.receive()
        with pytest.raises(Cancelled):
            await body.read(broken, ListSkillsRequest)


# --- multipart


async def test_parts_are_fields_by_their_dotted_names() -> None:
    data = form(
        part("images", png(), "0.png"),
        part("images", png(), "1.png"),
        part("smoothing", b"1.5"),
        part("model.name", b"blocks"),
        part("actions", b'{"datatype": "UINT8", "shape": [1], "raw": "AA=="}'),
    )
    read_ = await read(data, SegmentRequest, MULTIPART)
    assert [image.encoding for image in read_.images] == ["png", "png"]
    assert read_.images[0].data == png()
    assert (read_.smoothing, read_.model) == (1.5, ModelRef("blocks"))
    assert read_.actions is not None
    assert read_.actions.tolist() == [0]


@pytest.mark.parametrize(
    "parts",
    [
        [part("unknown", b"1")],
        [part("", b"1")],
        [part(".", b"1")],
        [part("model.", b"1")],
        [part("model.name.x", b"1")],
        [part("smoothing.x", b"1")],
        [part("smoothing", b"1"), part("smoothing", b"1")],
        [part("smoothing", b"nan")],
        [part("smoothing", b"1e999")],
        [part("smoothing", b"")],
        [part("min_segment", b"9" * 5000)],
        [part("model", b"5"), part("model.name", b"x")],
        [part("model", b"[]"), part("model.name", b"x")],
        [part("model.name", b"x"), part("model", b'{"name": "y"}')],
        [part("model", b'{"name": "x"}'), part("model.name", b"y")],
        [part("images", png(), "0.png"), part("images.height", b"3")],
        [part("images.height", b"3"), part("images", png(), "0.png")],
        [part("images", b'{"encoding": "png"}'), part("images", png(), "0.png")],
        [part("images", png(), "0.png"), part("images", b"[]")],
        [part("images", b"http://localhost/0.png")],
        [part("model", png(), "0.png")],
        [part("frames", png(), "0.png")],
        [part("frames.raw", png(), "0.png")],
        [part("smoothing", png(), "0.png")],
        [part("model", b"[" * 2000)],
    ],
)
async def test_parts_that_make_no_request_are_refused(parts: list[bytes]) -> None:
    with pytest.raises(InvalidInput):
        await read(form(*parts), SegmentRequest, MULTIPART)


@pytest.mark.parametrize("name", ["config.steps", "config.fields", "config.fields.steps"])
async def test_nothing_leads_into_free_form_values(name: str) -> None:
    with pytest.raises(InvalidInput, match="must be a field of the request"):
        await read(form(part("dataset", b"x"), part(name, b"5")), StartFitRequest, MULTIPART)


async def test_a_file_that_is_no_image_is_refused() -> None:
    with pytest.raises(UnsupportedMedia):
        await read(form(part("images", b"%!PS-Adobe", "0.png")), SegmentRequest, MULTIPART)


@pytest.mark.parametrize(
    ("data", "content_type"),
    [
        (form(part("smoothing", b"1")), "multipart/form-data"),
        (form(part("smoothing", b"1")), "multipart/form-data; boundary=other"),
        (form(part("smoothing", b"1"))[:-4], MULTIPART),
        (part("smoothing", b"1") + part("images", png(), "0.png")[:-9], MULTIPART),
        (b"--b\r\n\r\n1\r\n--b--\r\n", MULTIPART),
        (b"--b\r\nContent-Disposition: form-data\r\n\r\n1\r\n--b--\r\n", MULTIPART),
        (b"", MULTIPART),
        (b"{}", MULTIPART),
    ],
)
async def test_broken_framing_is_malformed(data: bytes, content_type: str) -> None:
    with pytest.raises(MalformedRequest):
        await read(data, SegmentRequest, content_type)


# --- queries


def query(text: str, cls: type[T]) -> T:
    return body.read_query(request(query=text), cls)


def test_parameters_are_fields_by_their_dotted_names() -> None:
    assert query("model.name=a&model.version=b", ListSkillsRequest) == ListSkillsRequest(ModelRef("a", "b"))
    assert query("id=x&from_sequence=3", WatchFitRequest) == WatchFitRequest("x", 3)
    assert query("", ListSkillsRequest) == ListSkillsRequest()


@pytest.mark.parametrize(
    "text",
    [
        *("x=1", "model=1", "model=", "model.name=a&model.name=b", "model.name.x=1", "model.=1", "token=x", "%00=1"),
        *("id=a&id=a", "from_sequence=-1", "from_sequence=1.5", "from_sequence=", "from_sequence=%ff"),
        "from_sequence=18446744073709551616",
    ],
)
@pytest.mark.parametrize("cls", [ListSkillsRequest, WatchFitRequest])
def test_a_query_that_makes_no_request_is_refused(text: str, cls: type) -> None:
    with pytest.raises(InvalidInput):
        query(text, cls)


@given(st.text())
def test_any_query_is_a_request_or_invalid_input(text: str) -> None:
    with contextlib.suppress(InvalidInput):
        query(text, WatchFitRequest)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "line 1, column 1: "),
        (b'{"dataset": "s3cr3t",}', "line 1, column 21: trailing comma"),
        (b'{\n  "dataset": "a"\n  "model_name": "s3cr3t"\n}', "line 3, column 3: "),
        (b"{'dataset': 1}", "line 1, column 2: "),
        (b'{"dataset": NaN}', "line 1, column 13: "),
        ('{"config": {"ä": s3cr3t}}'.encode(), "line 1, column 18: "),
        (b'{\n"dataset": "s3cr3t\xff}', "line 2, column 19: not UTF-8"),
        (b'{"dataset": "a"', "line 1, column 16: unexpected end"),
    ],
)
async def test_broken_json_says_where_it_breaks(data: bytes, says: str) -> None:
    part = b'--b\r\ncontent-disposition: form-data; name="config"\r\n\r\n%s\r\n--b--\r\n'
    for content, media_type in ((data, JSON), (part % data.replace(b"\xff", b"'"), MULTIPART)):
        with pytest.raises(InvalidInput) as error:
            await read(content, StartFitRequest, media_type)
        if b"\xff" in content or b"\xff" not in data:
            assert says in error.value.detail
        assert SECRET not in f"{error.value.detail} {error.value.hint}"


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b'{"dataset": "s3cr3t", "dataset": "b"}', "`dataset` is repeated"),
        (b'{"config": {"a": [{"lr": "s3cr3t", "lr": 1}]}}', "`lr` is repeated"),
        (b'{"config": {"%s": 1, "%s": 2}}' % (b"k" * 65, b"k" * 65), "a name of 65 characters is repeated"),
        (b'{"config": {"a": ' + b"[" * 1020 + b'{"b": 1, "b": 2}' + b"]" * 1020 + b"}}", " is repeated"),
    ],
)
async def test_a_repeated_key_is_named(data: bytes, says: str) -> None:
    with pytest.raises(InvalidInput, match=says) as error:
        await read(data, StartFitRequest)
    assert SECRET not in error.value.detail
