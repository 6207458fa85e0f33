"""Worker processes: each holds many sessions, each session a vector of worlds.

    WorkerPool -> Worker -> Connection ~~socket~~ handler.serve -> RequestHandler -> VectorEnv -> worlds

The service's half is asyncio and knows no world; the child's half is synchronous, has one thread and knows no asyncio.
`protocol` is what they say to each other. A child that crashes takes its own sessions with it and nothing else.
"""
