"""Worker processes, each with many sessions; a session is a vector env.

    WorkerPool -> Worker ~~socket~~ handler.serve -> RequestHandler -> VectorEnv -> worlds

The service's half is asyncio and knows no world; the child's half is synchronous with one thread. `protocol` defines
their messages. A child that crashes loses its own sessions only.
"""
