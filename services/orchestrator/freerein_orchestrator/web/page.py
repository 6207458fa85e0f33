"""The files of the web page: `/`, and `/web/<file>` with a hash of the contents in each name.

They are built from `web/` of the repository, and lie in the wheel. Nothing of them changes with who asks.
"""

import asyncio
import re
from pathlib import Path

from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Route

from freerein.errors import NotFound, quoted

FOLDER = Path(__file__).parents[1] / "page"
ASSETS = "/web/"
NOT_BUILT = "The page is not built: run `npm ci && npm run build` in web/ of the repository. Calls are at /docs.\n"

_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; media-src 'self' blob:; "
    "connect-src 'self'; font-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
_HEADERS = {
    "content-security-policy": _POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
}
_MEDIA_TYPES = {
    ".css": "text/css",
    ".html": "text/html",
    ".js": "text/javascript",
    ".json": "application/json",
    ".svg": "image/svg+xml",
    ".webp": "image/webp",
}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")
_COMPRESSED = [Middleware(GZipMiddleware, minimum_size=1024)]


def page_routes(folder: Path = FOLDER) -> list[BaseRoute]:
    """Returns the routes of the page and its files, which lie side by side in a folder; it may be empty."""

    async def page(_request: Request) -> Response:
        content = await asyncio.to_thread(_read, folder / "index.html")
        if content is None:
            return PlainTextResponse(NOT_BUILT, 404, _HEADERS)
        return Response(content, headers={**_HEADERS, "cache-control": "no-cache"}, media_type="text/html")

    async def asset(request: Request) -> Response:
        path = folder / request.path_params["name"]
        media_type = _MEDIA_TYPES.get(path.suffix)
        content = await asyncio.to_thread(_read, path) if media_type and _NAME.fullmatch(path.name) else None
        if content is None:
            raise NotFound(f"The file must be one of the page; got {quoted(path.name)}.", hint="Reload the page.")
        headers = {**_HEADERS, "cache-control": "public, max-age=31536000, immutable"}
        return Response(content, headers=headers, media_type=media_type)

    return [
        Route("/", page, middleware=_COMPRESSED),
        Route(f"{ASSETS}{{name}}", asset, middleware=_COMPRESSED),
    ]


def _read(path: Path) -> bytes | None:
    """Returns the contents of a file; None where there is none."""
    return path.read_bytes() if path.is_file() else None
