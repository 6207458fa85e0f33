"""Origin policy: web pages that may call a service are its own, and those of the origins that an operator names.

A browser lets any page send simple requests, such as POST of `multipart/form-data`, without asking first, and reaches
services on loopback, too. It then names the page's origin in `Origin`, or, of a GET for an image or script, says in
`Sec-Fetch-Site` that the page is another's. A page whose own host name resolves to loopback
(DNS rebinding) counts as the service's own to a browser, but `Host` has its name.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from ipaddress import ip_address
from urllib.parse import urlsplit

from starlette.datastructures import Headers

from freerein.errors import PermissionDenied, quoted


@dataclass(frozen=True)
class OriginPolicy:
    """The rule for every request but health checks. Clients other than browsers send no `Origin`.

    Attributes:
        origins: Origins whose pages may call.
        is_local: Whether the service is on loopback, without token and TLS; `Host` must then name loopback.
    """

    origins: Sequence[str] = ()
    is_local: bool = False

    def check(self, headers: Headers) -> None:
        """Raises PermissionDenied for a request that a foreign page may have made."""
        host, origin = headers.get("host", "").lower(), headers.get("origin")
        if self.is_local and host and not _is_loopback(host):
            raise PermissionDenied(
                "`Host` must name loopback where a service has no token; it names another host.",
                hint="Call the service at localhost or 127.0.0.1, or set FREEREIN_TOKEN.",
            )
        is_allowed = _is_own_request(headers) if origin is None else origin.lower() in _own_origins(host)
        if not is_allowed and origin not in self.origins:
            named = "a page that names none" if origin is None else quoted(origin)
            raise PermissionDenied(
                f"A web page that calls must be of the service itself, or of an origin that it allows; got {named}.",
                hint="Set FREEREIN_CORS_ORIGINS to the page's origin.",
            )

    def check_session(self, headers: Headers, *, reads: bool) -> None:
        """Raises PermissionDenied for a request with a session's cookie that is not of the service's own page.

        Pages of the `origins` send the token, for pages of other ports of this host have the cookie sent, too.
        Behind a proxy that changes `Host`, an own page is one of the `origins` that the browser calls same-origin.
        """
        origin, site = headers.get("origin"), headers.get("sec-fetch-site")
        is_own = reads if origin is None else origin.lower() in _own_origins(headers.get("host", "").lower())
        is_behind_proxy = origin in self.origins and site == "same-origin"
        if not (is_own or is_behind_proxy) or site not in (None, "none", "same-origin"):
            raise PermissionDenied(
                "A call with the cookie of a session must come from the service's own page; it does not.",
                hint="Other programs and pages send the header Authorization: Bearer <the service's FREEREIN_TOKEN>.",
            )


def _own_origins(host: str) -> tuple[str, str]:
    """Returns the origins of pages of a service that is called `host`; browsers leave out default ports."""
    return f"http://{host.removesuffix(':80')}", f"https://{host.removesuffix(':443')}"


def _is_own_request(headers: Headers) -> bool:
    """Returns whether a request without `Origin` is of no browser, of the service's own page, or opens a page."""
    site, mode = headers.get("sec-fetch-site", "none"), headers.get("sec-fetch-mode")
    opens_page = mode == "navigate" and headers.get("sec-fetch-dest", "document") == "document"  # and no frame
    return site in ("none", "same-origin") or opens_page


def _is_loopback(host: str) -> bool:
    try:
        name = (urlsplit(f"//{host}").hostname or "").rstrip(".")
        return name == "localhost" or name.endswith(".localhost") or ip_address(name).is_loopback
    except ValueError:
        return False
