"""Swagger UI at `/docs`, from files of the package fastapi-offline: it opens without internet. `/` leads there."""

from functools import partial
from importlib.resources import files

from fastapi import FastAPI
from fastapi.openapi.docs import get_swagger_ui_html
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

_MEDIA_TYPES = {
    "swagger-ui-bundle.js": "text/javascript",
    "swagger-ui.css": "text/css",
    "favicon.png": "image/png",
}


def add_docs_page(app: FastAPI) -> None:
    """Adds the page, its files and the redirection to an app that serves `/openapi.json`."""
    script, style, icon = (f"docs/{name}" for name in _MEDIA_TYPES)

    async def page(_request: Request) -> Response:
        return get_swagger_ui_html(
            openapi_url="openapi.json",
            title=app.title,
            swagger_js_url=script,
            swagger_css_url=style,
            swagger_favicon_url=icon,
        )

    async def root(_request: Request) -> Response:
        return RedirectResponse("docs")

    app.add_route("/docs", page, include_in_schema=False)
    app.add_route("/", root, include_in_schema=False)
    for name, media_type in _MEDIA_TYPES.items():
        app.add_route(f"/docs/{name}", partial(_file, name, media_type), include_in_schema=False)


async def _file(name: str, media_type: str, _request: Request) -> Response:
    content = files("fastapi_offline").joinpath("static", name).read_bytes()
    return Response(content, media_type=media_type, headers={"cache-control": "max-age=86400"})
