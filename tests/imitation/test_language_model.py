"""Text embeddings as BERT's, and a language policy whose folder holds its text encoder."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from freerein.errors import InvalidInput
from freerein.learning import model_files, weights
from freerein.types.common import ActionSpec, Camera
from freerein_imitation.methods import METHODS
from freerein_imitation.methods.language.network import LanguageNetwork, LanguageSpec, principal_components
from freerein_imitation.methods.language.policy import TEXT_ENCODER_FILE, TEXTS_FILE, text_encoder_entry
from freerein_imitation.methods.language.texts import minilm
from freerein_imitation.methods.language.texts.goal_text_reader import GoalTextReader
from freerein_imitation.methods.language.texts.text_encoder import TextEncoder
from freerein_imitation.methods.language.texts.wordpiece import MAX_TOKENS, WordPieceTokenizer
from freerein_imitation.model.policy import ControlSpec

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "all_minilm_l6_v2.json").read_text())
CAMERAS = (Camera("front", 8, 8, 3),)
ACTION = ActionSpec(2, 0, ("x", "y"), "m", (0.1, 0.1))
TEXT_SIZE = 32
CODE_SIZE = GoalTextReader(TEXT_SIZE).code_size
PIECES = ("[UNK]", "[CLS]", "[SEP]", "red", "block", "##s", "left", ".", "日")


@pytest.fixture(scope="module")
def real() -> TextEncoder:
    return TextEncoder(minilm.read())


@pytest.mark.parametrize("golden", GOLDEN, ids=lambda golden: golden["text"][:12].encode("unicode_escape").decode())
def test_an_embedding_is_the_reference_s(real: TextEncoder, golden: dict[str, Any]) -> None:
    """Made by Hugging Face's tokenizer and BertModel in single precision: halving the weights does not show."""
    code = real.embed(real.tokenize(golden["text"])).numpy()
    expected = np.array(golden["code"], np.float32)
    assert float(code @ expected) / float(np.linalg.norm(expected)) > 0.99999


@pytest.mark.parametrize(
    ("text", "pieces"),
    [
        ("Red BLOCKS", ["red", "block", "##s"]),
        ("réd.left", ["red", ".", "left"]),
        ("red\t\x00 block\n\ufffd日日", ["red", "block", "日", "日"]),
        ("blockz", ["[UNK]"]),
        ("red" * 40, ["[UNK]"]),
        ("", []),
    ],
)
def test_words_are_split_into_the_longest_pieces_known(text: str, pieces: list[str]) -> None:
    assert WordPieceTokenizer(PIECES)(text) == [PIECES.index(piece) for piece in ("[CLS]", *pieces, "[SEP]")]


def test_a_long_text_is_cut_off(real: TextEncoder) -> None:
    assert len(WordPieceTokenizer(PIECES)("red " * 1000)) == MAX_TOKENS
    assert torch.equal(real.tokenize("red " * 400), real.tokenize("red " * 500))


def test_codes_lie_in_as_many_directions_as_there_are_differences() -> None:
    codes = torch.nn.functional.normalize(torch.randn(4, 8, generator=torch.Generator().manual_seed(0)), dim=1)
    basis = principal_components(codes)
    assert basis.shape == (8, 3)
    before, after = codes - codes.mean(dim=0), (codes - codes.mean(dim=0)) @ basis
    larger = torch.pdist(after) / torch.pdist(before)
    torch.testing.assert_close(larger, larger.mean().expand(6))  # nothing is bent: all distances grow alike
    torch.testing.assert_close(after.norm(dim=1).mean(), torch.tensor(3**0.5))


@pytest.mark.parametrize("codes", [torch.full((1, 8), 0.5), torch.full((3, 8), 0.1)])
def test_one_goal_text_has_no_differences(codes: torch.Tensor) -> None:
    assert principal_components(codes).tolist() == [[0.0]] * 8


def network(codes: torch.Tensor, **spec: Any) -> LanguageNetwork:
    sizes = {"text_size": TEXT_SIZE, "features": 8, "hidden_size": 8, **spec}
    texts = {"text_components": principal_components(codes).shape[1], "known_texts": len(codes)}
    made = LanguageNetwork(LanguageSpec(cameras=CAMERAS, action=ACTION, **texts, **sizes))
    generator = torch.Generator().manual_seed(0)
    weights.initialise(made, generator=generator)
    for parameter in made.reader.parameters():
        nn.init.zeros_(parameter)
    frames = torch.randint(256, (4, 8, 8, 3), dtype=torch.uint8, generator=generator)
    made.fit_normalisation({"front": frames}, codes, generator=generator)
    return made


def test_what_goal_texts_do_not_differ_in_does_not_matter() -> None:
    codes = torch.eye(CODE_SIZE)[:3]
    made, frame = network(codes), {"front": torch.zeros(1, 8, 8, 3, dtype=torch.uint8)}
    first = made(frame, codes[:1])
    torch.testing.assert_close(made(frame, codes[:1] + torch.eye(CODE_SIZE)[9:10]), first)
    assert not torch.allclose(made(frame, codes[1:2]), first)


def test_a_text_is_known_where_it_is_nearer_to_a_training_text_than_to_their_centre() -> None:
    left, right = codes = torch.eye(CODE_SIZE)[:2]
    made = network(codes)
    assert made.knows(torch.stack([left, right, 0.8 * left + 0.2 * right + torch.eye(CODE_SIZE)[9]])).all()
    assert not made.knows(torch.stack([(left + right) / 2, torch.zeros(CODE_SIZE), 3 * left - 2 * right])).any()
    assert network(codes[:1]).knows(codes).all()  # one text: nothing to confuse it with


def untrained_codes(text_encoder_file: bytes, *texts: str) -> torch.Tensor:
    """Codes by a reader to which no token matters."""
    encoder, reader = TextEncoder(text_encoder_file), GoalTextReader(TEXT_SIZE)
    for parameter in reader.parameters():
        nn.init.zeros_(parameter)
    return torch.stack([reader.encode(text, encoder) for text in texts])


@pytest.fixture
def folder(text_encoder_file: bytes, tmp_path: Path) -> Path:
    """The folder of an untrained policy."""
    codes = untrained_codes(text_encoder_file, "red", "left", "red block")
    card = {"method": "language", **ControlSpec(0.04, 1.0, 9).to_card()}
    card |= {**text_encoder_entry("tiny", text_encoder_file), "goal_texts": {"count": 2, "first": ["red", "left"]}}
    model_files.save_model(network(codes), tmp_path / "model", card=card)
    (tmp_path / "model" / TEXT_ENCODER_FILE).write_bytes(text_encoder_file)
    return tmp_path / "model"


def test_a_policy_on_disk_has_its_text_encoder_and_acts_as_it_did(folder: Path, text_encoder_file: bytes) -> None:
    policy = METHODS.load(folder, "cpu")
    spec = policy.spec
    assert (spec.goal_form, spec.action, spec.max_steps_per_goal, spec.recurrent_size) == ("text", ACTION, 9, 0)
    assert spec.training_texts == ("red", "left")
    frames = {"front": np.zeros((2, 8, 8, 3), np.uint8)}
    codes = policy.encode_goals(["red", "left"])
    step = policy.step(frames, codes, np.zeros((2, 2), np.float32), np.zeros((2, 0), np.float32))
    assert (step.actions.shape, step.actions.dtype, step.recurrent.shape) == ((2, 1, 2), np.float32, (2, 0))
    assert step.reached.tolist() == [0, 0]
    assert not np.allclose(step.actions[0], step.actions[1])
    np.testing.assert_array_equal(codes, untrained_codes(text_encoder_file, "red", "left"))


def change_one_bit(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize("tamper", [change_one_bit, Path.unlink])
def test_a_text_encoder_that_is_not_the_card_s_is_refused(folder: Path, tamper: Callable[[Path], None]) -> None:
    tamper(folder / TEXT_ENCODER_FILE)
    with pytest.raises(InvalidInput, match="must have the sha256 on the card"):
        METHODS.load(folder, "cpu")


@pytest.mark.parametrize("texts", [b"[]", b"{}", b'[["red"]]', b"[" * 99_999, b"\xff"])
def test_a_policy_that_does_not_know_its_training_texts_is_refused(folder: Path, texts: bytes) -> None:
    (folder / TEXTS_FILE).write_bytes(texts)
    with pytest.raises(InvalidInput, match="goal texts that it was fitted to"):
        METHODS.load(folder, "cpu")


def test_a_file_that_is_no_text_encoder_is_refused(text_encoder_file: bytes) -> None:
    for data in (b"", text_encoder_file[:-1], torch_file(vocabulary=torch.zeros(3, dtype=torch.uint8))):
        with pytest.raises(InvalidInput):
            TextEncoder(data)


def torch_file(**tensors: torch.Tensor) -> bytes:
    from freerein.learning import tensor_files

    return tensor_files.dump(tensors)
