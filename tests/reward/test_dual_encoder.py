from collections.abc import Callable

import numpy as np
import pytest
import torch

from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.encoders.clip import AttentionPool, RelationPool
from freerein_reward.model import DualEncoder, DualEncoderModel, DualEncoderSpec

PHRASES = ("a red block", "a blue block", "a cup")
SPEC = DualEncoderSpec(cameras=("front",), vocabulary=("a", "red", "block"), phrases=PHRASES, hidden_size=32)


@pytest.fixture(scope="module")
def network() -> DualEncoder:
    made = DualEncoder(SPEC)
    weights.initialise(made, generator=torch.Generator().manual_seed(0))
    return made


@pytest.fixture(scope="module")
def model(network: DualEncoder) -> DualEncoderModel:
    return DualEncoderModel(network)


def test_an_image_alone_or_in_a_batch_has_the_same_embedding(model: DualEncoderModel) -> None:
    frames = np.random.default_rng(0).integers(0, 256, size=(33, 64, 64, 3), dtype=np.uint8)
    together = model.embed_images({"front": frames}).vectors
    alone = np.concatenate([model.embed_images({"front": frame[None]}).vectors for frame in frames])
    assert np.abs(together - alone).max() < 1e-5


def test_a_text_alone_or_among_longer_ones_has_the_same_embedding(model: DualEncoderModel) -> None:
    together, _ = model.embed_texts(["a red block", "red " * 100])
    alone, _ = model.embed_texts(["a red block"])
    assert np.abs(together[0] - alone[0]).max() < 1e-5


def test_two_views_are_averaged() -> None:
    two = DualEncoder(DualEncoderSpec(cameras=("front", "tilt"), vocabulary=("a",), phrases=PHRASES, hidden_size=32))
    weights.initialise(two, generator=torch.Generator().manual_seed(0))
    frames = np.random.default_rng(0).integers(0, 256, size=(2, 3, 64, 64, 3), dtype=np.uint8)
    there = DualEncoderModel(two).embed_images({"front": frames[0], "tilt": frames[1]}).vectors
    back = DualEncoderModel(two).embed_images({"front": frames[1], "tilt": frames[0]}).vectors
    assert np.abs(there - back).max() < 1e-5


@pytest.mark.parametrize(
    "make",
    [
        lambda: np.zeros((64, 64, 3), np.uint8),
        lambda: np.full((64, 64, 1), 255, np.uint8),
        lambda: np.full((1, 1, 3), 7, np.uint8),
        lambda: np.zeros((1, 4096, 1), np.uint8),
        lambda: np.full((4096, 2, 3), 200, np.uint8),
    ],
)
def test_any_image_has_a_unit_vector_for_every_pair_of_phrases(
    model: DualEncoderModel, make: Callable[[], np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]
) -> None:
    view = model.preprocess(make())
    embedding = model.embed_images({"front": view[None]}).vectors
    assert (str(view.dtype), view.shape) == ("uint8", (64, 64, 3))
    lengths = np.linalg.norm(embedding.reshape(len(PHRASES), len(PHRASES), -1), axis=2)
    np.testing.assert_allclose(lengths, 1 - np.eye(len(PHRASES)), atol=1e-5)


def test_the_inverse_temperature_is_at_most_100(network: DualEncoder) -> None:
    with torch.no_grad():
        before = network.temperature.log_scale.clone()
        network.temperature.log_scale.fill_(10.0)
        assert network.temperature(torch.ones(())).item() == pytest.approx(100.0)
        network.temperature.log_scale.copy_(before)


def test_attention_pooling_equals_attention_with_explicit_keys_and_values() -> None:
    pool = AttentionPool(64, embedding_dim=32)
    weights.initialise(pool, generator=torch.Generator().manual_seed(0))
    maps = torch.rand(2, 64, 16, 16, generator=torch.Generator().manual_seed(1))
    cells = maps.flatten(start_dim=2).transpose(1, 2)
    mean = cells.mean(dim=1, keepdim=True)
    tokens = torch.cat([mean, cells], dim=1)
    query, key, value = (
        part.unflatten(2, (4, 16)).transpose(1, 2) for part in (pool.query(mean), pool.key(tokens), pool.value(tokens))
    )
    expected = torch.nn.functional.scaled_dot_product_attention(query, key, value).transpose(1, 2).flatten(start_dim=1)
    assert torch.allclose(pool(maps), pool.out(expected), atol=1e-5)


def test_a_keypoint_is_the_centroid_of_squared_heat_with_a_presence_that_saturates() -> None:
    pool = RelationPool(2, 2, hidden_size=8, embedding_dim=8)
    with torch.no_grad():
        pool.heat.weight.copy_(torch.eye(2))
        pool.heat.bias.fill_(-0.5)
    maps = torch.zeros(1, 2, 16, 16)
    maps[0, 0, 0, 12], maps[0, 0, 0, 8] = 2.5, 1.5  # heats 2 and 1 in the first row, columns 12 and 8 of 16
    presence = 5 / (5 + 0.5)

    found = pool.keypoints(maps)[0]

    row, column = 1 / 16 - 1, (4 * 25 + 1 * 17) / 5 / 16 - 1
    assert found[0].tolist() == pytest.approx([row * presence, column * presence, presence], abs=1e-5)
    assert found[1].tolist() == [0.0, 0.0, 0.0]


def test_a_pair_is_embedded_alike_whichever_phrases_it_is_of() -> None:
    pool = RelationPool(3, 3, hidden_size=8, embedding_dim=8)
    weights.initialise(pool, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        pool.heat.weight.copy_(torch.eye(3))
        pool.heat.bias.fill_(-0.8)
    maps = torch.rand(1, 3, 16, 16, generator=torch.Generator().manual_seed(1))
    there = pool(maps).view(3, 3, 8)
    exchanged = pool(maps[:, [1, 0, 2]]).view(3, 3, 8)
    assert torch.allclose(there, exchanged[[1, 0, 2]][:, [1, 0, 2]], atol=1e-6)


def test_the_similarity_of_a_text_and_an_image_is_a_cosine(model: DualEncoderModel) -> None:
    frames = np.random.default_rng(0).integers(0, 256, size=(8, 64, 64, 3), dtype=np.uint8)
    texts, _ = model.embed_texts(["a red block", "red " * 100, "a"])
    assert np.abs(model.embed_images({"front": frames}).vectors @ texts.T).max() <= 1.0


def test_a_spec_with_an_odd_size_is_refused() -> None:
    with pytest.raises(InvalidInput):
        DualEncoderSpec(cameras=("front",), vocabulary=("a",), image_size=63)
