"""Snapshots of worlds that cannot save their state: how the episode began, and the actions since."""

import hashlib
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from freerein.errors import InvalidInput
from freerein_sim.worlds import generators
from freerein_sim.worlds.world import (
    MAX_EPISODE_STEPS,
    Action,
    StepResult,
    UnsavedWorld,
    WorldSpec,
    check_actions,
    foreign_snapshot,
    skill_indices,
)

_FORMAT_VERSION = 1
_HEADER = struct.Struct(f"<BHI{generators.PACKED_BYTES}s")  # version, skills of the recipe, actions, generator
_RECIPE_DTYPE = np.dtype("<u2")
_EXPECTED = "a snapshot of an episode of this world"


@dataclass(frozen=True, eq=False)
class _Episode:
    """The generator before the reset, packed; the recipe that was asked for; and the actions since."""

    start: bytes
    recipe: tuple[str, ...]
    actions: list[Action]


class ReplayedWorld:
    """A `World` over one that cannot save its state: `restore` resets it and repeats the actions, without rendering.

    The world must be deterministic: equal generators, recipes and actions give equal bits.
    """

    def __init__(self, world: UnsavedWorld) -> None:
        self._world = world
        self._episode = _Episode(b"", (), [])
        self.spec = world.spec
        self.expert = world.expert
        self.render, self.truth, self.close = world.render, world.truth, world.close

    @property
    def fingerprint(self) -> str:
        """Hash of the format version and the world's fingerprint."""
        return hashlib.sha256(f"replay {_FORMAT_VERSION} {self._world.fingerprint}".encode()).hexdigest()

    @property
    def steps(self) -> int:
        """Steps made since the reset."""
        return len(self._episode.actions)

    def reset(self, rng: np.random.Generator, *, recipe: Sequence[str] = ()) -> None:
        """Resets the world, and begins to record."""
        start = generators.pack(rng)
        self._world.reset(rng, recipe=recipe)
        self._episode = _Episode(start, tuple(recipe), [])

    def step(self, action: Action) -> StepResult:
        """Steps the world, and records the action."""
        result = self._world.step(action)
        self._episode.actions.append(action.copy())
        return result

    def snapshot(self) -> bytes:
        """Returns the record of the episode."""
        recipe, actions = skill_indices(self.spec, self._episode.recipe), self._episode.actions
        header = _HEADER.pack(_FORMAT_VERSION, len(recipe), len(actions), self._episode.start)
        numbers = np.array(actions, _wire_dtype(self.spec))
        return header + np.array(recipe, _RECIPE_DTYPE).tobytes() + numbers.tobytes()

    def restore(self, snapshot: bytes) -> None:
        """Repeats the episode of a snapshot."""
        before = self._episode
        if not self._replay(_decode(self.spec, snapshot)):
            if before.start:
                self._replay(before)
            raise foreign_snapshot(_EXPECTED, "one that is over")

    def _replay(self, episode: _Episode) -> bool:
        """Repeats an episode; returns whether it goes on after its last action."""
        self.reset(generators.unpack(episode.start), recipe=episode.recipe)
        ended = [self.step(action).terminated for action in episode.actions]
        return not any(ended)


def _decode(spec: WorldSpec, snapshot: bytes) -> _Episode:
    """Returns the episode of a snapshot, after checking every number."""
    if len(snapshot) < _HEADER.size:
        raise foreign_snapshot(_EXPECTED, f"{len(snapshot)} bytes")
    version, skills, steps, start = _HEADER.unpack_from(snapshot)
    dtype, middle = _wire_dtype(spec), _HEADER.size + skills * _RECIPE_DTYPE.itemsize
    length = middle + steps * spec.action.size * dtype.itemsize
    if version != _FORMAT_VERSION or steps > MAX_EPISODE_STEPS or len(snapshot) != length:
        raise foreign_snapshot(_EXPECTED, "another version or length")
    recipe = np.frombuffer(snapshot[_HEADER.size : middle], _RECIPE_DTYPE)
    actions = np.frombuffer(snapshot[middle:], dtype).astype(spec.action.dtype).reshape(steps, spec.action.size)
    if (recipe >= len(spec.skills)).any():
        raise foreign_snapshot(_EXPECTED, "an unknown skill")
    try:
        check_actions(spec.action, actions, batch=(steps,))
    except InvalidInput:
        raise foreign_snapshot(_EXPECTED, "actions out of bounds") from None
    return _Episode(start, tuple(spec.skills[i] for i in recipe), list(actions))


def _wire_dtype(spec: WorldSpec) -> np.dtype[Any]:
    return spec.action.dtype.newbyteorder("<")
