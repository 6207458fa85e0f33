"""The scripted expert of the dial world: presses keys with random speed, hesitation and noise."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.dial import keypad
from freerein_sim.worlds.dial.durations import Durations
from freerein_sim.worlds.dial.ik import Angles, key_targets
from freerein_sim.worlds.dial.predicates import is_pressed
from freerein_sim.worlds.dial.simulation import DialWorld
from freerein_sim.worlds.dial.spec import RECIPES, TORQUE_NM
from freerein_sim.worlds.tempo import draw_tempo
from freerein_sim.worlds.world import LabelledAction, skill_indices

_STIFFNESS = np.array((150.0,) * 3 + (35.0,) * 3) / TORQUE_NM
_DAMPING = np.array((10.0,) * 3 + (1.5,) * 3) / TORQUE_NM
"""Shares of each joint's greatest torque per radian, and per radian per second; the drives damp, too."""

_CLEAR_M, _LOW_M = 0.03, 0.02
"""Heights over the keys from which the arm moves sideways, and under which it does not go on."""

_OVER_M = 0.03
"""How far from the centre of a key along x and y it may be pressed."""

_NOISE, _NOISE_KEPT = (0.0, 0.1, 0.2), 0.8
"""Levels of noise of an episode, as shares of the greatest torque, and the share of it that is kept for a step."""

_CALM = 0.3
"""Share of the noise that does not depend on the torque."""

_TURN_RAD = 0.15
"""How far the fastest joint turns in a step at full speed."""

_UP_AND_DOWN_STEPS, _MOST_PRESS_STEPS = 5, 20
"""Steps up and down at full speed, and steps after which a key is tried again that is not down then."""

_FASTEST_STEPS, _SPARE_STEPS = 15, 13
"""Steps of a press at full speed, and steps of an episode that are not planned for."""


@dataclass(frozen=True)
class _Stage:
    """Part of a press.

    Attributes:
        target: Joint angles to go to.
        is_over: Whether the next stage begins, asked once it has taken `steps` steps.
        speed: Share of the greatest torque that it takes at most.
        steps: Fewest steps.
        has_failed: Whether its key is to be tried again.
    """

    target: Angles
    is_over: Callable[[], bool] = lambda: True
    speed: float = 1.0
    steps: int = 0
    has_failed: Callable[[], bool] = lambda: False


class DialExpert:
    """Lifts the fingertip, moves it over a key, may hesitate there, and presses; one key after the other.

    A PD controller of the joint angles, whose torques are limited to a speed, and disturbed by noise that stays similar
    for some steps. The actions that it returns contain the noise. Without skills it draws two to five keys.
    """

    def __init__(
        self, world: DialWorld, skills: Sequence[str], rng: np.random.Generator, *, durations: Durations
    ) -> None:
        self._world = world
        self._durations = durations
        recipe = skills or RECIPES.draw(rng, world.spec.skills, fewest=2, most=RECIPES.most)
        self._waiting = deque(skill_indices(world.spec, recipe))
        self._rng = rng
        self._targets = key_targets()
        self._stages: deque[_Stage] = deque()
        self._digit: int | None = None
        self._acts = self._stage_acts = 0
        self._noise_level = float(rng.choice(_NOISE))
        self._noise = np.zeros(len(TORQUE_NM))

    def act(self) -> LabelledAction | None:
        """Returns the next torques; None once the last key is pressed and held."""
        self._advance()
        if self._digit is None:
            return None
        self._acts += 1
        self._stage_acts += 1
        return LabelledAction(self._torques(self._stages[0]), self._digit)

    def succeeded(self) -> bool:
        """Returns whether all keys were pressed."""
        return not self._waiting and not self._stages

    def _advance(self) -> None:
        """Leaves stages that are over; begins the next key when there is none left."""
        if self._stages and self._digit is not None and self._stages[0].has_failed():
            self._stages = deque(self._plan(self._digit, extra=0.0))
            self._stage_acts = 0
        while not self._stages or self._is_over(self._stages[0]):
            if self._stages:
                self._stages.popleft()
            elif self._waiting:
                self._digit = self._waiting.popleft()
                self._stages.extend(self._plan(self._digit, extra=self._extra_steps()))
            else:
                self._digit = None
                return
            self._stage_acts = 0

    def _is_over(self, stage: _Stage) -> bool:
        return self._stage_acts >= stage.steps and stage.is_over()

    def _plan(self, digit: int, *, extra: float) -> tuple[_Stage, ...]:
        """Returns the stages that press a key, in `extra` steps more than at full speed."""
        hover, press = self._targets.hover[digit], self._targets.press[digit]
        off = np.linalg.norm(keypad.CENTRES_M - self._world.fingertip[:2], axis=1)
        lift = self._targets.hover[int(np.argmin(off))]
        moving = _UP_AND_DOWN_STEPS + float(np.abs(hover - self._world.angles).max()) / _TURN_RAD
        tempo = draw_tempo(self._rng, extra, moving_steps=moving, least_speed=self._durations.least_speed)
        speed = tempo.speed
        return (
            _Stage(lift, self._is_clear, speed=speed),
            _Stage(hover, lambda: self._is_over_key(digit), speed=speed, has_failed=self._is_low),
            _Stage(hover, steps=round(tempo.hesitation_steps)),
            _Stage(press, lambda: self._presses(digit), speed=speed, has_failed=self._is_late),
            _Stage(press, steps=int(self._rng.integers(1, 4))),
        )

    def _extra_steps(self) -> float:
        """Draws how many steps the next key may take beyond the fastest, so that all fit into the episode."""
        left = self._world.spec.max_episode_steps - _SPARE_STEPS - self._acts
        spare = left - _FASTEST_STEPS * (1 + len(self._waiting))
        return self._durations.draw_extra_steps(self._rng, spare)

    def _is_clear(self) -> bool:
        return bool(self._world.fingertip[2] > keypad.TOP_M + _CLEAR_M)

    def _is_low(self) -> bool:
        return bool(self._world.fingertip[2] < keypad.TOP_M + _LOW_M)

    def _is_late(self) -> bool:
        return self._stage_acts >= max(_MOST_PRESS_STEPS, _UP_AND_DOWN_STEPS / self._stages[0].speed)

    def _is_over_key(self, digit: int) -> bool:
        return bool((np.abs(self._world.fingertip[:2] - keypad.CENTRES_M[digit]) < _OVER_M).all())

    def _presses(self, digit: int) -> bool:
        return bool(is_pressed(digit, self._world.fingertip, self._world.depths[digit]))

    def _torques(self, stage: _Stage) -> npt.NDArray[np.float32]:
        way = _STIFFNESS * (stage.target - self._world.angles) - _DAMPING * self._world.velocities
        furthest = float(np.abs(way).max())
        size = min(stage.speed, furthest)
        way *= size / max(furthest, 1e-9)
        fresh = self._noise_level * np.sqrt(1 - _NOISE_KEPT**2) * self._rng.standard_normal(len(way))
        self._noise = _NOISE_KEPT * self._noise + fresh
        noise = (_CALM + (1 - _CALM) * size) * self._noise
        return np.asarray(np.clip(way + noise, -1, 1), np.float32)
