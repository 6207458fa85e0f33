"""The sim service as a process: `python -m freerein_sim`."""

from functools import partial

from freerein.api.sim.v1 import sim_pb2
from freerein.fork_server import ForkServer, StartChild, spawn
from freerein.serving.health import Health
from freerein.serving.lifecycle import Service, run
from freerein.serving.limits import Limits
from freerein.serving.methods import methods_of
from freerein.serving.metrics import Metrics
from freerein_sim.core import SimCore
from freerein_sim.settings import SimSettings
from freerein_sim.step_stream import StepStream
from freerein_sim.workers.pool import WorkerPool
from freerein_sim.worlds.opengl import check_rendering

NAME = "sim"


def build(
    settings: SimSettings, limits: Limits, _metrics: Metrics, health: Health, *, start_child: StartChild = spawn
) -> Service:
    """Returns the service. Raises ServiceError where the environment has a wrong setting of rendering."""
    check_rendering()
    pool = WorkerPool(start_child, workers=settings.sim_workers, demonstrators=settings.sim_workers)
    core = SimCore(pool, max_sessions=settings.sim_sessions, max_envs=settings.sim_envs)
    step_stream = StepStream(core, health, limits.drain_s)
    return Service(
        name=NAME,
        methods=methods_of(sim_pb2.DESCRIPTOR.services_by_name["SimService"], core, step_stream),
        start=core.start,
        close=core.close,
        not_ready=lambda: "" if pool.tasks else "Its workers are starting.",
    )


if __name__ == "__main__":
    fork_server = ForkServer.fork("freerein_sim.workers.handler")
    run(NAME, SimSettings, partial(build, start_child=fork_server.start))
