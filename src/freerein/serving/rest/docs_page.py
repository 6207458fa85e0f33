"""Swagger UI at `/docs`, from files of the package fastapi-offline: it opens without internet. `/` leads there.

The page and the document that it shows are there without the token: they say how to call, and nothing else.
"""

import asyncio
import re
from collections.abc import Callable
from functools import cache, partial
from importlib.resources import files
from typing import Any

import orjson
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import BaseRoute, Route

from freerein.serving.rest.examples import BASE_URL

_HOST = re.compile(r"([A-Za-z0-9.-]{1,253}|\[[0-9A-Fa-f:.]+\])(:[0-9]{1,5})?")
_MEDIA_TYPES = {
    "swagger-ui-bundle.js": "text/javascript",
    "swagger-ui.css": "text/css",
    "favicon.png": "image/png",
}
PATHS = frozenset({"/", "/docs", "/openapi.json", *(f"/docs/{name}" for name in _MEDIA_TYPES)})
"""All paths of the page."""


def docs_routes(document: Callable[[], dict[str, Any]], *, title: str) -> list[BaseRoute]:
    """Returns the routes of the page, its files, the redirection, and the OpenAPI document that it shows."""
    script, style, icon = (f"docs/{name}" for name in _MEDIA_TYPES)

    dumped = cache(lambda: orjson.dumps(document()))

    async def openapi(request: Request) -> Response:
        content = dumped() if dumped.cache_info().currsize else await asyncio.to_thread(dumped)
        located = content.replace(BASE_URL.encode(), _base_url(request).encode())
        return Response(located, media_type="application/json")

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
        response = await asyncio.to_thread(written)
        response.headers["content-security-policy"] = "frame-ancestors 'none'"  # it calls with the page's cookie, too
        return response

    async def root(_request: Request) -> Response:
        return RedirectResponse("docs")

    return [
        Route("/openapi.json", openapi),
        Route("/docs", page),
        Route("/", root),
        *(Route(f"/docs/{name}", partial(_file, name, media_type)) for name, media_type in _MEDIA_TYPES.items()),
    ]


def _base_url(request: Request) -> str:
    """Returns where the caller has reached the service, for commands: its own `Host`, where that is a plain one."""
    if not _HOST.fullmatch(request.url.netloc):
        host, port = request.scope["server"] or ("localhost", 80)
        return f"{request.url.scheme}://{host}:{port}"
    return f"{request.url.scheme}://{request.url.netloc}"


async def _file(name: str, media_type: str, _request: Request) -> Response:
    content = files("fastapi_offline").joinpath("static", name).read_bytes()
    return Response(content, media_type=media_type, headers={"cache-control": "max-age=86400"})
