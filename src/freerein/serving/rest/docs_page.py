"""Swagger UI at `/docs`, from files of the package fastapi-offline: it opens without internet. `/` leads there."""

import asyncio
from collections.abc import Callable
from functools import partial
from importlib.resources import files
from typing import Any

import orjson
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import BaseRoute, Route

_MEDIA_TYPES = {
    "swagger-ui-bundle.js": "text/javascript",
    "swagger-ui.css": "text/css",
    "favicon.png": "image/png",
}


def docs_routes(document: Callable[[], dict[str, Any]], *, title: str) -> list[BaseRoute]:
    """Returns the routes of the page, its files, the redirection, and the OpenAPI document that it shows."""
    script, style, icon = (f"docs/{name}" for name in _MEDIA_TYPES)

    async def openapi(_request: Request) -> Response:
        return Response(orjson.dumps(document()), media_type="application/json")

    def written() -> Response:
        from fastapi.openapi.docs import get_swagger_ui_html  # half a second, at the start of a service

        return get_swagger_ui_html(
            openapi_url="openapi.json",
            title=title,
            swagger_js_url=script,
            swagger_css_url=style,
            swagger_favicon_url=icon,
        )

    async def page(_request: Request) -> Response:
        return await asyncio.to_thread(written)

    async def root(_request: Request) -> Response:
        return RedirectResponse("docs")

    return [
        Route("/openapi.json", openapi),
        Route("/docs", page),
        Route("/", root),
        *(Route(f"/docs/{name}", partial(_file, name, media_type)) for name, media_type in _MEDIA_TYPES.items()),
    ]


async def _file(name: str, media_type: str, _request: Request) -> Response:
    content = files("fastapi_offline").joinpath("static", name).read_bytes()
    return Response(content, media_type=media_type, headers={"cache-control": "max-age=86400"})
