"""Routes that a service adds to its REST API for people with a browser."""

from collections.abc import Sequence
from dataclasses import dataclass

from starlette.routing import BaseRoute


@dataclass(frozen=True)
class WebPage:
    """A page at `/`, and what it calls besides the methods of the service.

    Attributes:
        routes: Routes of the page, of its files and of its calls; they come before those of the service.
        assets: Beginning of the paths of its files, which are there without the token, as the page itself is.
    """

    routes: Sequence[BaseRoute]
    assets: str
