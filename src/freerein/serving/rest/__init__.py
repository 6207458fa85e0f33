"""The REST API of a service: a Starlette app made from its methods, its middleware and its HTTP server."""
