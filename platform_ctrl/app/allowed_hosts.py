"""Which requests are allowed, by the host that they name and by the page that they come from.

A page elsewhere can make its visitor's browser request 127.0.0.1, and under a name that resolves to it (DNS rebinding)
it could even read the responses. The browser reports this in the headers Host, Origin and Sec-Fetch-Site.
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Mapping, Sequence

from platform_ctrl.common.values import value
from platform_ctrl.errors import InputError

LOOPBACK_NAMES = frozenset({"127.0.0.1", "localhost", "[::1]"})
# A name, an IPv4 address or an IPv6 one in brackets; then a port, perhaps.
_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9_]([a-z0-9_.-]*[a-z0-9_])?\.?)(?::(\d{1,5}))?")


@value
class AllowedHosts:
    """The names under which the pages may be requested.

    Attributes
    ----------
    listening
        Address that is listened on.
    names
        Lower-case names and addresses, IPv6 ones in brackets, without ports: behind a tunnel the port is another.
    """

    listening: str
    names: frozenset[str]

    @classmethod
    def of(cls, host: str, allow: Sequence[str] = ()) -> AllowedHosts:
        """Return the names for an address that is listened on, and those that are allowed besides."""
        loopback = is_loopback(host)
        if not loopback and not allow:
            raise InputError(
                f"--host {host}: other machines could reach the page; give --allow NAME too, once for each name or "
                "address under which browsers reach this machine"
            )
        names = {_name(one) for one in allow}
        if loopback:
            names |= LOOPBACK_NAMES | ({_bracketed(host.lower())} - {""})
        return cls(listening=host, names=frozenset(names))

    @property
    def local_only(self) -> bool:
        """Whether only this machine reaches what listens."""
        return is_loopback(self.listening)

    def refusal(self, headers: Mapping[str, str], page: bool = False) -> str | None:
        """Return why a request is refused, or None.

        Parameters
        ----------
        headers
            Those of the request; their names in the usual spelling, or of a mapping that does not mind.
        page
            Whether the page itself is requested: then a link elsewhere may lead here.

        Returns
        -------
        str or None
            One line.

        References
        ----------
        RFC 6454 (Origin); W3C, Fetch Metadata Request Headers (Sec-Fetch-Site).
        """
        host = headers.get("Host", "")
        found = _HOST.fullmatch(host.lower())
        if found is None or found[1].rstrip(".") not in self.names:
            return f"refused: requested as {_shown(host)}, which is none of {', '.join(sorted(self.names))}"
        origin = headers.get("Origin")
        if origin is not None and origin.lower() not in (f"http://{host.lower()}", f"https://{host.lower()}"):
            return f"refused: requested by a page of {_shown(origin)}, not of {host.lower()}"
        site = headers.get("Sec-Fetch-Site", "none")
        led = page and headers.get("Sec-Fetch-Mode") == "navigate" and headers.get("Sec-Fetch-Dest") == "document"
        if site not in ("none", "same-origin") and not led:
            return f"refused: requested by another page ({_shown(site)})"
        return None


def is_loopback(host: str) -> bool:
    """Return whether an address is reached from this machine alone."""
    if host.lower().rstrip(".") == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def _bracketed(host: str) -> str:
    bare = host.strip("[]")
    return f"[{bare}]" if ":" in bare else bare


def _name(given: str) -> str:
    name = _bracketed(given.lower())
    found = _HOST.fullmatch(name)
    if found is None or found[3] is not None:
        raise InputError(
            f"--allow {given!r}: must be a name or an address as browsers show it, without http:// and without a port"
        )
    return found[1].rstrip(".")


def _shown(given: str) -> str:
    """Return a part of a request as short printable ASCII."""
    plain = "".join(letter if " " <= letter <= "~" and letter not in "<>&\"'" else "?" for letter in given[:80])
    return plain or "nothing"
