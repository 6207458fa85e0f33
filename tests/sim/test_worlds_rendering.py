import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import mujoco
import numpy as np
import pytest

from freerein.cli.doctor import machine
from freerein.errors import FailedPrecondition
from freerein.serving.lifecycle import CONFIGURATION_ERROR
from freerein_sim.worlds.blocks import TASKS
from freerein_sim.worlds.opengl import check_rendering, choose_backend
from freerein_sim.worlds.rendering import gray, open_renderer
from freerein_sim.worlds.world import Frame, World

RENDER = """
import sys
import numpy as np
from freerein.errors import ServiceError
from freerein_sim.worlds.blocks import TASKS
try:
    world = TASKS[0].make()
    world.reset(np.random.default_rng(0))
    print(world.render("front", height=64, width=64).std() > 10)
    world.close()
except ServiceError as error:
    print("mujoco" in sys.modules, error.detail, error.hint, sep="|")
"""
CHOOSE = """
import os
from freerein.errors import ServiceError
from freerein_sim.worlds.opengl import choose_backend
for backend in ("", "egl", "osmesa"):
    os.environ["MUJOCO_GL"] = backend
    try:
        print(choose_backend())
    except ServiceError as error:
        print(error.detail, error.hint, sep="|")
"""
HINT = "Install one: apt-get install libegl1 libgl1 (MUJOCO_GL=egl) or libosmesa6 (MUJOCO_GL=osmesa)."


def begin(seed: int) -> World:
    world = TASKS[0].make()
    world.reset(np.random.default_rng(seed))
    return world


def look(world: World, size: int = 64) -> Frame:
    return world.render("front", height=size, width=size)


def environ(**variables: str) -> dict[str, str]:
    inherited = {key: value for key, value in os.environ.items() if key not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    return inherited | variables


def run(code: str, **variables: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", code], env=environ(**variables), capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()


def cannot(backends: str) -> str:
    return f"Expected to render with {backends}; this machine cannot.|{HINT}"


@pytest.fixture
def without(tmp_path: Path) -> Callable[[str], str]:
    """Returns an LD_LIBRARY_PATH where a library is an empty file, which no loader opens."""

    def shadow(name: str) -> str:
        for version in ("", *(f".{i}" for i in range(10))):
            (tmp_path / f"lib{name}.so{version}").touch()
        return str(tmp_path)

    return shadow


@pytest.mark.parametrize("backend", ["egl", "osmesa"])
def test_both_backends_draw(backend: str) -> None:
    assert run(RENDER, MUJOCO_GL=backend) == ["True"]


def test_a_backend_that_there_is_not_is_refused_before_mujoco_is_imported() -> None:
    assert run(RENDER, MUJOCO_GL="vulkan") == [
        "False|Expected MUJOCO_GL to be egl, osmesa or glfw, or not set; got vulkan.|Unset MUJOCO_GL."
    ]


@pytest.mark.fault("M12")
@pytest.mark.parametrize(
    ("missing", "chosen"),
    [
        (("EGL",), ["osmesa", cannot("egl"), "osmesa"]),
        (("OSMesa",), ["egl", "egl", cannot("osmesa")]),
        (("EGL", "OSMesa"), [cannot("egl or osmesa"), cannot("egl"), cannot("osmesa")]),
    ],
)
def test_the_backend_that_there_is_is_used_and_a_machine_that_cannot_draw_says_what_to_install(
    missing: tuple[str, ...], chosen: list[str], without: Callable[[str], str]
) -> None:
    (path,) = {without(library) for library in missing}

    assert run(CHOOSE, LD_LIBRARY_PATH=path) == chosen


@pytest.mark.parametrize("backend", ["egl", ""])
def test_pyopengl_on_another_platform_is_refused(backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", backend)
    monkeypatch.setenv("PYOPENGL_PLATFORM", "glx")
    with pytest.raises(FailedPrecondition, match="Expected PYOPENGL_PLATFORM"):
        choose_backend()


SAID = {
    "a device that there is not": (
        {"MUJOCO_GL": "egl", "MUJOCO_EGL_DEVICE_ID": "77"},
        "The MUJOCO_EGL_DEVICE_ID environment variable must be an integer between 0 and",
    ),
    "a device that is no number": ({"MUJOCO_EGL_DEVICE_ID": "x"}, "invalid literal for int() with base 10: 'x'"),
    "no screen": ({"MUJOCO_GL": "glfw", "DISPLAY": ""}, "Expected a screen for MUJOCO_GL=glfw"),
    "a screen that there is not": (
        {"MUJOCO_GL": "glfw", "DISPLAY": ":99"},
        "MuJoCo cannot: an OpenGL platform library has not been loaded",
    ),
}


@pytest.mark.parametrize(("variables", "said"), SAID.values(), ids=SAID)
def test_what_mujoco_says_is_said_by_the_service_at_its_start(
    variables: dict[str, str], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(FailedPrecondition) as refused:
        check_rendering()
    assert said in refused.value.detail
    assert "apt-get" not in refused.value.hint


def test_the_service_does_not_start_with_a_device_that_there_is_not(
    run_badly: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    code, stderr = run_badly("freerein_sim", tmp_path, MUJOCO_GL="egl", MUJOCO_EGL_DEVICE_ID="77")
    assert code == CONFIGURATION_ERROR
    assert "must be an integer between 0 and" in stderr


def test_the_doctor_says_with_what_the_service_renders_and_what_mujoco_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)
    found = machine.check_rendering()
    assert (found.state, found.detail.split(":")[0]) == ("ok", "osmesa")
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    monkeypatch.setenv("DISPLAY", "")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    found = machine.check_rendering()
    assert (found.state, found.fix) == ("problem", "Unset MUJOCO_GL, or set it to egl or osmesa.")
    assert "Expected a screen for MUJOCO_GL=glfw" in found.detail


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


def test_every_geom_of_a_large_model_is_drawn() -> None:
    spec = mujoco.MjSpec()
    spec.worldbody.add_camera(name="front", pos=(0, 0, 3))
    for _ in range(300):
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.1, 0, 0), rgba=(0, 0, 1, 1))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(1, 0, 0), rgba=(1, 0, 0, 1))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)

    with closing(open_renderer(model)) as renderer:
        middle = renderer.render(data, "front", height=8, width=8)[4, 4].astype(int)

    assert middle[0] > middle[2] + 50


def test_closing_twice_is_fine() -> None:
    world = begin(0)
    look(world)
    world.close()
    world.close()


def test_the_image_is_upright_and_the_table_lies_below() -> None:
    with closing(begin(0)) as world:
        image = look(world).astype(int)

    assert image[-1].mean() < image[0].mean()


def test_gray_is_the_rounded_luma() -> None:
    rgb = np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255], [1, 1, 0]]], np.uint8)

    np.testing.assert_array_equal(gray(rgb), np.array([[[76], [150], [29], [255], [1]]], np.uint8))
