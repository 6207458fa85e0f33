"""The engine, ViZDoom's, in a process and a folder of its own; a guard ends both when this process ends."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO, cast

import numpy as np
import numpy.typing as npt
import vizdoom

from freerein.errors import Unimplemented, WorkerLost
from freerein_sim.worlds.doom import maps
from freerein_sim.worlds.doom.spec import TICS
from freerein_sim.worlds.doom.textmap import Point

_GUARD = Path(__file__).with_name("engine_guard.py")
_BUTTONS = (
    vizdoom.Button.MOVE_FORWARD,
    vizdoom.Button.TURN_LEFT,
    vizdoom.Button.TURN_RIGHT,
    vizdoom.Button.TURN_LEFT_RIGHT_DELTA,
)
_ACTIONS = ((0, 0, 0, 0), (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0))
"""No-op, forward, left, right."""

_VARIABLES = (vizdoom.GameVariable.POSITION_X, vizdoom.GameVariable.POSITION_Y, vizdoom.GameVariable.ANGLE)
_NOT_DRAWN = ("hud", "crosshair", "weapon", "decals", "particles", "messages", "corpses")
_SEED = 1
"""Seed of the engine's own generator, which draws nothing that matters here: starts are drawn by the world."""

_FIRST_TIC = 10
"""Tic from which the player can turn and move."""

_FAILURES = (
    vizdoom.MessageQueueException,
    vizdoom.SharedMemoryException,
    vizdoom.ViZDoomErrorException,
    vizdoom.ViZDoomIsNotRunningException,
    vizdoom.ViZDoomUnexpectedExitException,
)


@dataclass(frozen=True, eq=False)
class EngineObservation:
    """The player's frame and pose.

    Attributes:
        frame: uint8 (120, 160), gray.
        pose: float64 (3,): x and y in map units, heading in degrees.
    """

    frame: npt.NDArray[np.uint8]
    pose: npt.NDArray[np.float64]


class Engine:
    """An engine that runs a map.

    Args:
        map_file: A WAD file with the map.

    Raises:
        Unimplemented: The engine does not start on this machine.
    """

    def __init__(self, map_file: bytes) -> None:
        command = [sys.executable, "-I", "-S", str(_GUARD)]
        self._guard = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        self._game = vizdoom.DoomGame()
        try:
            self._start(map_file)
        except (*_FAILURES, OSError) as error:
            self.close()
            raise Unimplemented(
                f"Expected ViZDoom's engine to start; it said: {' '.join(str(error).split())}.",
                hint="It needs /dev/shm, and a temporary folder that can be written.",
            ) from error

    @property
    def is_running(self) -> bool:
        """Whether it has not been closed, nor found to have ended."""
        return bool(self._game.is_running())

    def begin(self, place: Point, heading: float) -> EngineObservation:
        """Begins an episode with the player at a place, turned towards a heading in degrees.

        Raises:
            WorkerLost: The engine has ended.
        """
        with self._alive():
            self._game.set_seed(_SEED)
            self._game.new_episode()
            turn = float(self._game.get_game_variable(vizdoom.GameVariable.ANGLE)) - heading
            self._game.send_game_command(f"warp {place[0]} {place[1]}")
            self._game.make_action([0, 0, 0, (turn + 180) % 360 - 180], 1)
            self._game.make_action([0, 0, 0, 0], 1)
        return _observation(self._game.get_state())

    def act(self, choice: int) -> EngineObservation | None:
        """Holds a choice for one control step; returns None where that ended the episode.

        Raises:
            WorkerLost: The engine has ended.
        """
        with self._alive():
            self._game.make_action(_ACTIONS[choice], TICS)
        state = self._game.get_state()
        return None if state is None else _observation(state)

    def close(self) -> None:
        """Ends the engine, and removes its folder; may be called twice."""
        with contextlib.suppress(*_FAILURES):
            self._game.close()
        if not cast(TextIO, self._guard.stdin).closed:
            self._guard.communicate("closed")

    def _start(self, map_file: bytes) -> None:
        folder = Path(cast(TextIO, self._guard.stdout).readline().rstrip("\n"))
        if not folder.is_absolute():
            raise OSError("there is no temporary folder")
        wad = folder / "map.wad"
        wad.write_bytes(map_file)
        game = self._game
        game.set_doom_game_path(str(maps.wheel() / maps.GAME))
        game.set_doom_scenario_path(str(wad))
        game.set_doom_map(maps.MAP_NAME)
        game.set_screen_resolution(vizdoom.ScreenResolution.RES_160X120)
        game.set_screen_format(vizdoom.ScreenFormat.GRAY8)
        game.set_available_buttons(list(_BUTTONS))
        game.set_available_game_variables(list(_VARIABLES))
        for part in _NOT_DRAWN:
            getattr(game, f"set_render_{part}")(False)
        game.set_window_visible(False)
        game.set_episode_start_time(_FIRST_TIC)
        game.set_episode_timeout(0)
        game.set_seed(_SEED)
        game.add_game_args("+sv_cheats 1")
        with contextlib.chdir(folder):  # the engine writes where it starts
            game.init()

    @contextlib.contextmanager
    def _alive(self) -> Iterator[None]:
        """Closes what is left, and raises WorkerLost, where the engine has ended."""
        try:
            yield
        except _FAILURES:
            self.close()
            raise WorkerLost(
                "The engine of this world has ended; its session has ended, too.", hint="Create the session anew."
            ) from None


def _observation(state: vizdoom.GameState) -> EngineObservation:
    return EngineObservation(state.screen_buffer, np.asarray(state.game_variables, np.float64))
