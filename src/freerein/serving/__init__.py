"""What a service is made of: two doors over one core, limits, auth, health, batching, models, fits, drain.

    core object --methods--> rest (FastAPI) | rpc (grpc.aio) --lifecycle--> a process

A service gives a core object whose coroutines are named like the RPCs of its `.proto`; both doors are made from that.
"""
