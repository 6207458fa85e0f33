"""A robot that has `freerein-client` only: `robot.py ADDRESS` steps the sim service there, and prints what it met."""

import importlib
import json
import pkgutil
import sys

import numpy as np

import freerein
from freerein import images
from freerein.clients import Channel, SimClient, SyncClient
from freerein.errors import NotFound
from freerein.types.sim import CloseSessionRequest, CreateSessionRequest, RenderRequest, ResetRequest, StepRequest


def session(address):
    """Returns the frames of an episode's first four timesteps, as a list, and what a session says that was closed."""
    with SyncClient(SimClient(Channel(address))) as sim:
        opened = sim.create_session(CreateSessionRequest("grid", seed=3))
        name, camera = opened.session, opened.task.cameras[0].name
        frames = [sim.reset(ResetRequest(name, seed=4, cameras=(camera,))).frames[camera]]
        for i in range(3):
            actions = np.full((1, opened.task.action.size), i, opened.task.action.dtype)
            frames.append(sim.step(StepRequest(name, i + 1, actions, (camera,))).frames[camera])
        rendered = sim.render(RenderRequest(name, (camera,))).frames[camera][0]
        np.testing.assert_array_equal(images.decode(images.encode(rendered)), rendered)
        sim.close_session(CloseSessionRequest(name))
        try:
            sim.render(RenderRequest(name))
        except NotFound as error:
            return np.concatenate(frames), error
    raise AssertionError("The session must be closed.")


def main():
    """Imports every module there is, calls, and prints."""
    modules = [each.name for each in pkgutil.walk_packages(freerein.__path__, "freerein.")]
    for name in modules:
        importlib.import_module(name)
    frames, refusal = session(sys.argv[1])
    shown = "\n".join([str(refusal), *getattr(refusal, "__notes__", [])])
    sys.stdout.write(json.dumps({"modules": modules, "frames": frames.tolist(), "code": refusal.code, "shown": shown}))


if __name__ == "__main__":
    main()
