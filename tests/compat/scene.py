"""The trajectories that both sides of the compatibility check know, drawn from one seed. Needs numpy only."""

import numpy as np

FPS = 20
TASK = "tidy the desk"
GOAL_TEXTS = ("", "put the cup away", "wipe the desk")
TASKS = tuple(text or TASK for text in GOAL_TEXTS)
SIZES = {"front": (24, 32, 3), "wrist": (16, 16, 1)}
VIDEO_SIZE = (64, 96, 3)
ACTION_NAMES = ("x", "y", "grip")
STATE_NAMES = ("shoulder", "elbow")
SKILLS = (("pick",), ("pick", "place"), ())
LENGTHS = (5, 7, 4)
CHOICES = 3
SKILL_NAMES = ("pick", "place")
LABELS = ((-1, 0, 0, 1, 1), (1, 0, 0, -1, -1, 1, 1), (0, 0, 0, 0))
"""The skill of each timestep, by index; -1 for none."""


def frames(index: int, camera: str) -> np.ndarray:
    """Returns uint8 (T, H, W, C)."""
    rng = np.random.default_rng([index, *camera.encode()])
    return rng.integers(0, 256, (LENGTHS[index], *SIZES[camera]), dtype=np.uint8)


def moving_bar(index: int) -> np.ndarray:
    """Returns uint8 (T, H, W, 3), smooth enough for video: a white bar goes to the right from episode to episode."""
    frames = np.full((LENGTHS[index], *VIDEO_SIZE), 40, np.uint8)
    for t in range(LENGTHS[index]):
        left = bar_at(index, t)
        frames[t, :, left : left + 6] = 230
    return frames


def bar_at(index: int, t: int) -> int:
    """Returns the left side of the bar."""
    return 4 * (sum(LENGTHS[:index]) + t)


def actions(index: int) -> np.ndarray:
    """Returns float32 (T, 3) in [-1, 1]."""
    return np.random.default_rng(index).uniform(-1, 1, (LENGTHS[index], len(ACTION_NAMES))).astype(np.float32)


def terminations(index: int) -> np.ndarray:
    """Returns bool (T,): trajectory 1 ends with a crash."""
    return np.arange(LENGTHS[index]) == (LENGTHS[index] - 1 if index == 1 else -1)


def states(index: int) -> np.ndarray:
    """Returns float32 (T, 2), the robot's own state."""
    return np.random.default_rng([1, index]).normal(0, 30, (LENGTHS[index], len(STATE_NAMES))).astype(np.float32)


def choices(index: int) -> np.ndarray:
    """Returns int64 (T, 1), discrete actions."""
    return np.random.default_rng(index).integers(0, CHOICES, (LENGTHS[index], 1))
