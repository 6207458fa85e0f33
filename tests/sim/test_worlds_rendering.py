import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import numpy as np
import pytest

from freerein.errors import FailedPrecondition
from freerein_sim.worlds.blocks import TASKS
from freerein_sim.worlds.world import Frame, World

RENDER = """
import numpy as np
from freerein.errors import Unimplemented
from freerein_sim.worlds.blocks import TASKS
world = TASKS[0].make()
world.reset(np.random.default_rng(0))
try:
    print(world.render("front", height=64, width=64).std() > 10)
except Unimplemented as error:
    print(error.hint)
world.close()
"""


def begin(seed: int) -> World:
    world = TASKS[0].make()
    world.reset(np.random.default_rng(seed))
    return world


def look(world: World, size: int = 64) -> Frame:
    return world.render("front", height=size, width=size)


def run(**environment: str) -> str:
    inherited = {key: value for key, value in os.environ.items() if key not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    done = subprocess.run(
        [sys.executable, "-c", RENDER], env=inherited | environment, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


@pytest.mark.parametrize("backend", ["egl", "osmesa"])
def test_both_backends_draw(backend: str) -> None:
    assert run(MUJOCO_GL=backend) == "True"


@pytest.mark.fault("M12")
def test_a_machine_that_cannot_draw_says_what_to_install() -> None:
    assert run(PYOPENGL_PLATFORM="glx") == (
        "apt-get install libegl1 libgl1 for MUJOCO_GL=egl, or libosmesa6 for MUJOCO_GL=osmesa."
    )


def test_worlds_that_share_a_context_see_each_their_own_scene() -> None:
    with closing(begin(0)) as first, closing(begin(1)) as second:
        alone = [look(first), look(second)]
        mixed = [look(world, size) for size in (64, 128, 64) for world in (first, second)]

    assert not np.array_equal(alone[0], alone[1])
    assert np.array_equal(alone[0], mixed[0])
    assert np.array_equal(alone[0], mixed[4])
    assert np.array_equal(alone[1], mixed[5])


def test_a_world_goes_on_drawing_after_another_of_its_model_closed() -> None:
    with closing(begin(0)) as staying:
        before = look(staying)
        with closing(begin(1)) as leaving:
            look(leaving)

        assert np.array_equal(look(staying), before)


def test_every_thread_draws_with_a_context_of_its_own() -> None:
    def draw() -> bytes:
        with closing(begin(0)) as world:
            return look(world).tobytes()

    with ThreadPoolExecutor(2) as threads:
        drawn = {future.result() for future in [threads.submit(draw) for _ in range(4)]}

    assert drawn == {draw()}


def test_a_world_is_not_closed_from_another_thread() -> None:
    with closing(begin(0)) as world:
        look(world)
        with ThreadPoolExecutor(1) as threads, pytest.raises(FailedPrecondition, match="one thread"):
            threads.submit(world.close).result()


def test_closing_twice_is_fine() -> None:
    world = begin(0)
    look(world)
    world.close()
    world.close()


def test_the_image_is_upright_and_the_table_lies_below() -> None:
    with closing(begin(0)) as world:
        image = look(world).astype(int)

    assert image[-1].mean() < image[0].mean()
