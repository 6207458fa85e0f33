"""The parts of a service: REST API and gRPC server over one core, limits, auth, health, batching, models.

    core object --methods--> rest (Starlette) | grpc_server (grpc.aio) --lifecycle--> a process

The core has one coroutine per RPC of the service's `.proto`, of the same name; REST and gRPC are generated from it.
"""

import os

os.environ.setdefault("GRPC_VERBOSITY", "NONE")  # read when grpc is imported: its core writes lines that are no JSON
