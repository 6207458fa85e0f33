import colorsys

import numpy as np
import pytest
import torch

from freerein.learning.augmentation import add_distractors, agreement, augment_camera, delayed, shift, turn_hue


def frames(count: int, channels: int = 3) -> torch.Tensor:
    drawn = np.random.default_rng(0).integers(60, 160, size=(count, 16, 16, channels), dtype=np.uint8)
    return torch.from_numpy(drawn)


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def test_without_strength_nothing_changes() -> None:
    seen = frames(3)
    assert augment_camera(seen, torch.arange(3), strength=0.0, generator=generator()) is seen


@pytest.mark.parametrize("channels", [1, 3])
def test_frames_stay_frames_and_the_generator_alone_says_how_they_change(channels: int) -> None:
    seen = frames(20, channels)
    first, again = (augment_camera(seen, torch.arange(20), strength=1.0, generator=generator()) for _ in range(2))
    assert (first.dtype, first.shape) == (torch.uint8, seen.shape)
    assert torch.equal(first, again)
    assert all(not torch.equal(before, after) for before, after in zip(seen, first, strict=True))


def test_frames_of_one_take_change_alike_but_for_noise() -> None:
    takes = torch.arange(20).repeat_interleave(2)
    twins = augment_camera(frames(1).repeat(40, 1, 1, 1), takes, strength=1.0, generator=generator())
    one, other = twins[::2].float(), twins[1::2].float()
    is_equal = (one == other).flatten(start_dim=1).all(dim=1)
    assert 4 <= is_equal.sum() <= 16  # about half have no noise
    assert (one - other).mean(dim=(1, 2, 3)).abs().max() < 6
    brightness = one.mean(dim=(1, 2, 3))
    assert brightness.min() < 90 < 140 < brightness.max()


def test_frames_are_shifted_each_by_its_own_offset_with_replicated_edges() -> None:
    seen = torch.arange(2 * 3 * 4).view(2, 3, 4, 1)
    moved = shift(seen, torch.tensor([[1, -2], [0, 9]]))[..., 0]
    assert moved.tolist() == [
        [[4, 4, 4, 5], [8, 8, 8, 9], [8, 8, 8, 9]],
        [[15, 15, 15, 15], [19, 19, 19, 19], [23, 23, 23, 23]],
    ]


def test_hues_turn_as_in_the_hsv_model() -> None:
    planes = torch.rand(3, 2, 4, 4, generator=generator())
    planes[:, :, 0] = planes[0, :, 0]  # gray
    planes[1, :, 1] = planes[0, :, 1]  # as green as red
    turns = [0.1, -0.9]
    turned = turn_hue(planes, torch.tensor(turns))
    for image, turn in enumerate(turns):
        for before, after in zip(*(each[:, image].flatten(1).T.tolist() for each in (planes, turned)), strict=True):
            hue, saturation, value = colorsys.rgb_to_hsv(*before)
            assert after == pytest.approx(colorsys.hsv_to_rgb((hue + turn) % 1, saturation, value), abs=1e-5)


def test_strength_comes_after_two_fifths_of_a_fit() -> None:
    assert [delayed(0.8, step=step, steps=40) for step in (0, 15, 16, 39)] == [0.0, 0.0, 0.8, 0.8]


def test_agreement_is_a_cross_entropy_that_does_not_train_the_teacher() -> None:
    scores = torch.tensor([[[0.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 2.0]]], requires_grad=True)
    teacher = torch.tensor([[[0.0, 0.0], [0.0, 50.0]], [[50.0, 0.0], [0.0, 2.0]]], requires_grad=True)
    probability = 1 / (1 + np.exp(-2.0))
    entropy = -probability * np.log(probability) - (1 - probability) * np.log(1 - probability)

    loss = agreement(scores, teacher)
    loss.backward()

    assert loss.item() == pytest.approx((3 * np.log(2) + entropy) / 4)
    assert teacher.grad is None
    assert scores.grad is not None
    assert scores.grad[0, 1].tolist() == pytest.approx([0.5 / 4, -0.5 / 4])
    assert scores.grad[1, 1].tolist() == pytest.approx([0.0, 0.0], abs=1e-7)


def test_distractors_are_rectangles_in_front_of_some_frames() -> None:
    seen = frames(60)
    cluttered = add_distractors(seen, strength=1.0, generator=generator())
    assert torch.equal(cluttered, add_distractors(seen, strength=1.0, generator=generator()))
    assert torch.equal(seen, add_distractors(seen, strength=0.0, generator=generator()))
    is_covered = (cluttered != seen).any(dim=3)  # (N, H, W)
    assert 50 < is_covered.flatten(1).any(dim=1).sum() <= 60  # 97 % have at least one
    assert is_covered.float().mean() < 0.1
    for before, after, covered in zip(seen, cluttered, is_covered, strict=True):
        assert torch.equal(before[~covered], after[~covered])
        assert len({tuple(pixel) for pixel in after[covered].tolist()}) <= 3  # of one colour each
