"""The REST API of a service: a FastAPI app made from its methods, its middleware and its HTTP server."""
