"""Frames per second of the blocks world, beside `mujoco.Renderer` on the same scene.

The first baseline renders our compiled scene with MuJoCo's defaults: shadows, and four samples per pixel. On a CPU
shadows are most of the cost, so the second, stricter baseline has none; both have the same bar. The third baseline has
all our settings, and shows that the render loop itself gains nothing.
"""

import copy
from collections.abc import Callable
from contextlib import ExitStack, closing
from functools import partial

import mujoco
import numpy as np

from benchmarks.report import Ratio, Results
from benchmarks.timing import Effort, Workload, measure_rates, repeat_function
from freerein_sim.worlds.blocks import COLOURS, TASKS, scene
from freerein_sim.worlds.world import Frame, World

_CAMERA, _SIZE_PX = "front", 64
_POSE_SIZE = 7
_BAR = 3.0
_TOLERANCE = 2.0
"""Tolerance of the mean pixel difference, in 1/255: default flags change, for example, the sky."""


async def measure(effort: Effort) -> Results:
    """Returns the speedup in frames per second."""
    with ExitStack() as opened:
        world = opened.enter_context(closing(TASKS[0].make()))
        world.reset(np.random.default_rng(0))
        tuned = scene.build(COLOURS).model
        stock = _with_stock_quality(tuned)
        models = {
            "stock": _with_cast_shadows(stock),
            "stock-without-shadows": stock,
            "stock-with-our-settings": tuned,
        }
        peers = {name: opened.enter_context(closing(StockRenderer(model, world))) for name, model in models.items()}
        _check_same_scene(world, peers["stock-with-our-settings"])
        calls: dict[str, Callable[[], Frame]] = {
            "ours": partial(world.render, _CAMERA, height=_SIZE_PX, width=_SIZE_PX),
            **{name: peer.frame for name, peer in peers.items()},
        }
        workloads = [Workload(name, repeat_function(call), 1, "frames") for name, call in calls.items()]
        times = await measure_rates(workloads, effort)
    without_shadows = times.speedup("ours", over="stock-without-shadows")
    return Results(
        ratios=(
            Ratio("render.blocks_vs_stock", times.speedup("ours", over="stock"), at_least=_BAR),
            Ratio("render.blocks_vs_stock_without_shadows", without_shadows, at_least=_BAR),
            Ratio("render.blocks_vs_stock_with_our_settings", times.speedup("ours", over="stock-with-our-settings")),
        ),
        rates={"render": times},
    )


class StockRenderer:
    """`mujoco.Renderer`, used as its documentation shows, on a scene in the poses of a blocks world."""

    def __init__(self, model: mujoco.MjModel, world: World) -> None:
        self._data = mujoco.MjData(model)
        state = world.truth().state
        self._data.joint("gripper.y").qpos, self._data.joint("gripper.z").qpos = state[:2]
        for finger in ("finger.left", "finger.right"):
            self._data.joint(finger).qpos = state[2] / 2
        for colour, pose in zip(COLOURS, state[3:].reshape(-1, _POSE_SIZE), strict=True):
            self._data.joint(colour).qpos = pose
        mujoco.mj_forward(model, self._data)
        self._renderer = mujoco.Renderer(model, _SIZE_PX, _SIZE_PX)

    def frame(self) -> Frame:
        """Returns a frame, uint8 (H, W, 3)."""
        self._renderer.update_scene(self._data, camera=_CAMERA)
        frame: Frame = self._renderer.render()
        return frame

    def close(self) -> None:
        """Frees the OpenGL context."""
        self._renderer.close()


def _with_stock_quality(model: mujoco.MjModel) -> mujoco.MjModel:
    """Returns a copy of a model with MuJoCo's default shadow maps and samples per pixel."""
    changed, stock = copy.deepcopy(model), mujoco.MjSpec().visual.quality
    changed.vis.quality.shadowsize, changed.vis.quality.offsamples = stock.shadowsize, stock.offsamples
    return changed


def _with_cast_shadows(model: mujoco.MjModel) -> mujoco.MjModel:
    changed = copy.deepcopy(model)
    changed.light_castshadow[:] = True
    return changed


def _check_same_scene(world: World, renderer: StockRenderer) -> None:
    ours = world.render(_CAMERA, height=_SIZE_PX, width=_SIZE_PX).astype(np.float64)
    difference = float(np.abs(ours - renderer.frame()).mean())
    if difference > _TOLERANCE:
        raise RuntimeError(
            f"Both must render the same scene; their frames differ by {difference:.1f} of 255 on average."
        )
