import pytest
import torch

from freerein.types.common import Camera
from freerein_imitation.methods.shared.views import SharedView, Views

HEIGHT, WIDTH = 20, 40


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def dots(count: int) -> torch.Tensor:
    """Returns black frames with a white pixel in the middle, uint8 (N, 20, 40, 1)."""
    frames = torch.zeros((count, HEIGHT, WIDTH, 1), dtype=torch.uint8)
    frames[:, 10, 20] = 255
    return frames


def places(frames: torch.Tensor) -> torch.Tensor:
    """Returns x and y of the brightest pixel's centre in [-1, 1], float32 (N, 2)."""
    row, column = torch.unravel_index(frames[..., 0].flatten(1).argmax(dim=1), (HEIGHT, WIDTH))
    return torch.stack([(2 * column + 1) / WIDTH - 1, (2 * row + 1) / HEIGHT - 1], dim=1)


def test_places_move_with_what_is_seen() -> None:
    frames = dots(200)
    seen, moved = Views(1.0, 1.0, generator()).of(frames)
    assert places(seen).numpy() == pytest.approx((places(frames) + moved).numpy(), abs=1e-6)
    assert moved.abs().amax(dim=0).tolist() == pytest.approx([0.2, 0.2], abs=0.03)  # 11 % of a side that is 2 long


def test_a_share_of_the_frames_is_augmented_and_without_strength_none_is() -> None:
    frames = dots(400)
    seen, moved = Views(1.0, 0.25, generator()).of(frames)
    is_seen_anew = (seen != frames).flatten(1).any(dim=1)
    assert 60 < is_seen_anew.sum() < 140
    assert not moved[~is_seen_anew].any()
    seen, moved = Views(0.0, 1.0, generator()).of(frames)
    assert seen is frames
    assert not moved.any()


def test_a_shared_view_changes_equal_frames_alike() -> None:
    cameras = [Camera("front", HEIGHT, WIDTH, 1), Camera("wrist", HEIGHT, WIDTH, 1)]
    view = SharedView.draw(cameras, strength=1.0, generator=generator())
    seen = view.of({"front": dots(8), "wrist": dots(3)})
    for frames in seen.values():
        found = places(frames)
        assert torch.equal(found, found[:1].expand_as(found))
    assert not torch.equal(places(seen["front"])[:1], places(seen["wrist"])[:1])
    recorded = {"front": dots(2)}
    assert SharedView.draw(cameras, strength=0.0, generator=generator()).of(recorded) is recorded
