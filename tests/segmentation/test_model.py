import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch

from freerein.errors import FailedPrecondition, InvalidInput
from freerein.learning import tensor_files, weights
from freerein.learning.model_files import save_model
from freerein.types.common import ActionSpec, Camera
from freerein_segmentation.model import Context, ModelSpec, SegmentationModel, SegmentationNetwork, load
from freerein_segmentation.model import network as network_module

FRONT = Camera("front", 20, 24, 3)
CONTINUOUS = ModelSpec(skills=("a", "b", "c"), cameras=(FRONT,), action=ActionSpec(2, 0, ("dy", "dz")))
DISCRETE = replace(
    CONTINUOUS, cameras=(replace(FRONT, channels=1),), action=ActionSpec(1, 5, tuple("abcde")), context=0
)
BLIND = replace(CONTINUOUS, use_actions=False)
FINITE = replace(CONTINUOUS, context=3)
NAMED = {"continuous": CONTINUOUS, "discrete": DISCRETE, "no actions": BLIND, "finite context": FINITE}
SPECS = pytest.mark.parametrize("spec", NAMED.values(), ids=NAMED.keys())


def make(spec: ModelSpec) -> SegmentationNetwork:
    network = SegmentationNetwork(spec)
    weights.initialise(network, generator=torch.Generator().manual_seed(0))
    frames = {"front": torch.from_numpy(trajectory(spec, 50)[0])}
    network.image.fit_normalisation(frames, generator=torch.Generator())
    return network


def trajectory(spec: ModelSpec, timesteps: int, *, seed: int = 0) -> tuple[npt.NDArray[np.uint8], npt.NDArray[Any]]:
    rng = np.random.default_rng(seed)
    (camera,) = spec.cameras
    frames = rng.integers(0, 256, (timesteps, camera.height, camera.width, camera.channels), np.uint8)
    if spec.action.choices:
        return frames, rng.integers(0, spec.action.choices, (timesteps, 1))
    return frames, rng.uniform(-1, 1, (timesteps, 2)).astype(np.float32)


def probabilities(
    model: SegmentationModel, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any] | None
) -> npt.NDArray[np.float32]:
    return model.predict(frames, actions).probabilities


def score(network: SegmentationNetwork, *lengths: int) -> torch.Tensor:
    """Returns the scores (B, T, K) of random trajectories of these lengths."""
    parts = [trajectory(network.spec, length, seed=seed) for seed, length in enumerate(lengths)]
    frames, actions = (torch.from_numpy(np.concatenate(part)) for part in zip(*parts, strict=True))
    scores, mask = network({"front": frames}, actions, torch.tensor(lengths))
    assert mask.sum(dim=1).tolist() == list(lengths)
    return scores


@SPECS
def test_padding_and_neighbours_in_the_batch_do_not_matter(spec: ModelSpec) -> None:
    network = make(spec)
    torch.testing.assert_close(score(network, 9, 4)[0, :9], score(network, 9)[0])
    torch.testing.assert_close(score(network, 4, 9)[0, :4], score(network, 4)[0])


@SPECS
def test_long_trajectories_in_windows_score_as_in_one_piece(spec: ModelSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    network = make(spec)
    whole = score(network, 23)[0].softmax(dim=1).detach().numpy()
    monkeypatch.setattr(network_module, "_TIMESTEPS_AT_ONCE", 5)
    np.testing.assert_allclose(probabilities(SegmentationModel(network), *trajectory(spec, 23)), whole, atol=1e-6)


@pytest.mark.fault("S9")
def test_frames_are_encoded_a_window_at_a_time_so_that_memory_does_not_grow_with_a_trajectory() -> None:
    network, encoded = make(CONTINUOUS), list[int]()
    network.image.register_forward_pre_hook(lambda _, inputs: encoded.append(len(inputs[0]["front"])))
    probabilities(SegmentationModel(network), *trajectory(CONTINUOUS, 600))
    assert encoded == [256, 256, 88]


@pytest.mark.parametrize(("context", "stride", "first_seen"), [(0, 1, 8), (3, 1, 5), (3, 2, 2), ("all", 1, 0)])
def test_a_score_depends_on_its_context_and_on_nothing_later(context: Context, stride: int, first_seen: int) -> None:
    model = SegmentationModel(make(replace(CONTINUOUS, context=context, stride=stride)))
    frames, actions = trajectory(CONTINUOUS, 12)
    later = frames.copy()
    later[8] = 255 - later[8]
    changed = np.abs(probabilities(model, frames, actions) - probabilities(model, later, actions)).max(axis=1) > 1e-6
    assert not changed[:first_seen].any()
    assert changed[first_seen:9:stride].all()


@pytest.mark.parametrize("context", [0, 2])
def test_a_network_can_be_shown_less_of_the_future_than_it_sees(context: int) -> None:
    network = make(CONTINUOUS)
    frames, actions = map(torch.from_numpy, trajectory(CONTINUOUS, 8))
    later = frames.clone()
    later[6] = 255 - later[6]
    scores, changed = (
        network({"front": seen}, actions, torch.tensor([8]), context=context)[0] for seen in (frames, later)
    )
    assert torch.equal(scores[:, : 6 - context], changed[:, : 6 - context])
    assert not (scores == changed)[:, 6 - context].all()


@pytest.mark.parametrize(("context", "stride"), [(0, 1), (1, 3), (5, 1), (5, 3), (200, 1)])
def test_a_stream_predicts_what_the_whole_trajectory_does_as_soon_as_its_lag_has_passed(
    context: int, stride: int
) -> None:
    model = SegmentationModel(make(replace(CONTINUOUS, context=context, stride=stride)))
    assert model.lag == context * stride
    frames, actions = trajectory(CONTINUOUS, 40)
    whole = model.predict(frames, actions)
    for sizes in ((1,) * 40, (40,), (0, 7, 1, 1, 19, 2, 10)):
        stream, parts, stops = model.stream(), [], np.cumsum(sizes)
        for start, stop in zip([0, *stops[:-1]], stops, strict=True):
            parts.append(stream.push(frames[start:stop], actions[start:stop]))
            assert sum(len(part.probabilities) for part in parts) == max(0, stop - model.lag)
        parts.append(stream.finish())
        for name in ("probabilities", "in_distribution"):
            together = np.concatenate([getattr(part, name) for part in parts])
            np.testing.assert_allclose(together, getattr(whole, name), atol=1e-6)


def test_what_a_stream_has_not_finished_is_predicted_as_if_the_trajectory_ended_there() -> None:
    model = SegmentationModel(make(FINITE))
    stream, (frames, actions) = model.stream(), trajectory(FINITE, 9)
    stream.push(frames[:6], actions[:6])
    shorter = probabilities(model, frames[:6], actions[:6])
    for _ in range(2):
        np.testing.assert_allclose(stream.finish().probabilities, shorter[3:], atol=1e-6)
    rest = stream.push(frames[6:], actions[6:])
    np.testing.assert_allclose(rest.probabilities, probabilities(model, frames, actions)[3:6], atol=1e-6)


def test_a_model_of_whole_trajectories_has_no_stream() -> None:
    model = SegmentationModel(make(CONTINUOUS))
    assert model.lag is None
    with pytest.raises(FailedPrecondition) as error:
        model.stream()
    assert "context=10" in error.value.hint


@SPECS
def test_probabilities_are_float32_and_sum_to_one(spec: ModelSpec) -> None:
    likely = probabilities(SegmentationModel(make(spec)), *trajectory(spec, 1))
    assert likely.shape == (1, 3)
    assert likely.dtype == np.float32
    assert likely.sum() == pytest.approx(1.0)


def test_with_a_stride_every_timestep_is_labelled_in_the_pass_that_it_belongs_to() -> None:
    strided = make(replace(CONTINUOUS, stride=3))
    every = SegmentationModel(make(CONTINUOUS))
    frames, actions = trajectory(CONTINUOUS, 11)
    together = probabilities(SegmentationModel(strided), frames, actions)
    for phase in range(3):
        np.testing.assert_array_equal(together[phase::3], probabilities(every, frames[phase::3], actions[phase::3]))
    assert probabilities(SegmentationModel(strided), frames[:2], actions[:2]).shape == (2, 3)


def test_a_model_without_actions_needs_none() -> None:
    model = SegmentationModel(make(BLIND))
    frames, actions = trajectory(BLIND, 6)
    np.testing.assert_array_equal(probabilities(model, frames, None), probabilities(model, frames, actions))


def test_read_only_frames_are_labelled_as_they_come_from_the_wire() -> None:
    frames, actions = trajectory(CONTINUOUS, 3)
    frames.flags.writeable = actions.flags.writeable = False
    SegmentationModel(make(CONTINUOUS)).predict(frames, actions)


@SPECS
def test_an_exported_model_loads_to_the_same_probabilities(spec: ModelSpec, tmp_path: Path) -> None:
    network = make(spec)
    save_model(network, tmp_path / "model", card={"seed": 3, "figures": {"validation_loss": 0.9}})
    model = load(tmp_path / "model", "cpu")
    seen = trajectory(spec, 7)
    np.testing.assert_array_equal(probabilities(model, *seen), probabilities(SegmentationModel(network), *seen))
    assert (model.skills, model.camera) == (spec.skills, spec.cameras[0])
    assert model.action == (spec.action if spec.use_actions else None)
    card = json.loads((tmp_path / "model" / "card.json").read_text())
    assert card["seed"] == 3
    assert {path.name for path in (tmp_path / "model").iterdir()} == {"model.safetensors", "card.json"}


@pytest.mark.parametrize(
    "change",
    [
        {"hidden_size": 50},
        {"hidden_size": 10**9},
        {"skills": ["a"]},
        {"skills": []},
        {"cameras": []},
        {"cameras": [asdict(FRONT), asdict(replace(FRONT, name="wrist"))]},
        {"cameras": [{**asdict(FRONT), "channels": 2}]},
        {"cameras": [{**asdict(FRONT), "height": 10**9}]},
        {"encoder": "pilot"},
        {"context": 0},
        {"surprise": 1},
    ],
)
def test_a_card_that_does_not_fit_the_weights_is_refused(tmp_path: Path, change: dict[str, object]) -> None:
    save_model(make(CONTINUOUS), tmp_path, card={})
    card = json.loads((tmp_path / "card.json").read_text())
    card["spec"].update(change)
    (tmp_path / "card.json").write_text(json.dumps(card))
    with pytest.raises(InvalidInput):
        load(tmp_path, "cpu")


@pytest.mark.fault("O13")
@pytest.mark.parametrize("name", ["model.safetensors", "card.json"])
@pytest.mark.parametrize("data", [None, b"", b"{}", b"[" * 100_000, b"\x80\x04\x95."])
def test_a_file_that_is_missing_or_something_else_is_refused(tmp_path: Path, name: str, data: bytes | None) -> None:
    save_model(make(CONTINUOUS), tmp_path, card={})
    (tmp_path / name).unlink() if data is None else (tmp_path / name).write_bytes(data)
    with pytest.raises(InvalidInput) as error:
        load(tmp_path, "cpu")
    assert str(tmp_path) not in error.value.detail


def test_weights_of_another_dtype_are_refused(tmp_path: Path) -> None:
    network = make(CONTINUOUS)
    save_model(network, tmp_path, card={})
    halves = {name: tensor.half() for name, tensor in network.state_dict().items()}
    (tmp_path / "model.safetensors").write_bytes(tensor_files.dump(halves))
    with pytest.raises(InvalidInput, match="weights"):
        load(tmp_path, "cpu")
