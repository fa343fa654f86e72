"""Access control of the live server: which pages are its own, and which messages are refused.

A message changes only the value of a control, and clients cannot share the session through a public tunnel.
No message names a file: sessions are saved in the folder that the server was started with. Who may connect at
all is decided before, in `lagsplat.viewer.server.handshake`.
"""

import contextlib
import ipaddress
import logging
from math import isfinite
from typing import Any
from urllib.parse import urlsplit

import viser
from viser import _messages as messages
from viser import infra

log = logging.getLogger(__name__)
LARGEST = 1e9  # largest number that a control accepts
LONGEST = 200  # longest text that a control accepts
WARNING = (
    "WARNING: listening on {host}, which is not this machine alone. Whoever reaches it over the network can "
    "push the simulation, change its settings and make it write session files, if they have seen the address "
    "with its token, which goes over the network as plain text. Use viewer.host=127.0.0.1 and an SSH tunnel "
    "unless you mean this."
)


def warn_of_open_host(host: str) -> str | None:
    """Return a warning if ``host`` is reachable from the network, None for loopback."""
    with contextlib.suppress(ValueError):  # a name is no address
        if host == "localhost" or ipaddress.ip_address(host).is_loopback:
            return None
    return WARNING.format(host=host)


def is_foreign_origin(headers: Any, *, loopback_only: bool) -> bool:
    """Tell whether a connection comes from a page of another site.

    A ``loopback_only`` server must be addressed by a name of its own machine, because another site may let
    its name point here.
    """
    origin, host = headers.get("Origin"), headers.get("Host") or ""
    named = warn_of_open_host(urlsplit(f"//{host}").hostname or "") is None
    return (origin is not None and urlsplit(origin).netloc != host) or (loopback_only and not named)


def is_plain_value(value: object) -> bool:
    """Tell whether a value is a finite number, a truth value or a short text, as controls have it."""
    if isinstance(value, bool):
        return True
    if isinstance(value, int | float):
        return isfinite(value) and abs(value) <= LARGEST
    return isinstance(value, str) and len(value) <= LONGEST


def restrict_access(server: viser.ViserServer) -> None:
    """Refuse tunnels, and let clients set only the values of controls."""
    socket = server._websock_server
    for refused in (messages.ShareUrlRequest, messages.ShareUrlDisconnect):
        socket.unregister_handler(refused)
    set_value = socket._incoming_handlers.pop(messages.GuiUpdateMessage)

    async def only_values(client: infra.ClientId, message: messages.GuiUpdateMessage) -> None:
        if set(message.updates) != {"value"} or not is_plain_value(message.updates["value"]):
            log.warning("client %s sent what is no value of a control; refused", client)
            return
        for handler in set_value:
            try:
                await handler(client, message)  # type: ignore[misc]
            except (TypeError, ValueError, AssertionError, OverflowError) as error:
                log.warning("client %s sent a value that is none: %s", client, error)

    socket.register_handler(messages.GuiUpdateMessage, only_values)
