"""Who may come in, and what they may ask: a page of another site, or a crafted message, gets nothing.

viser serves whoever reaches its port. Here browsers of other origins are turned away, what a control may be
told is its value alone, and no client can have the session shared through a public tunnel. No message names
a file: what is saved goes to the folder that the server was started with.
"""

import ipaddress
import logging
from math import isfinite
from typing import Any
from urllib.parse import urlsplit

import viser
from viser import _messages as messages
from viser import infra

log = logging.getLogger(__name__)
LARGEST = 1e9
LONGEST = 200
WARNING = (
    "WARNING: listening on {host}, which is not this machine alone. Whoever reaches it over the network can "
    "push the simulation, change its settings and make it write session files. There is no password. "
    "Use viewer.host=127.0.0.1 and an SSH tunnel unless you mean this."
)


def warn_of_open_host(host: str) -> str | None:
    """What must be said of listening on ``host``; None for loopback."""
    if host == "localhost":
        return None
    try:
        alone = ipaddress.ip_address(host).is_loopback
    except ValueError:
        alone = False
    return None if alone else WARNING.format(host=host)


def foreign(headers: Any, *, alone: bool) -> bool:
    """Whether a connection comes from a page of another site than the one it asks.

    A server that is ``alone`` on its machine is asked by a name of that machine only: another site may have
    its own name point here.
    """
    origin, host = headers.get("Origin"), headers.get("Host") or ""
    named = warn_of_open_host(urlsplit(f"//{host}").hostname or "") is None
    return (origin is not None and urlsplit(origin).netloc != host) or (alone and not named)


def plain(value: object) -> bool:
    """Whether a value may be one of a control: viser would pass on to everyone what it cannot even send."""
    if isinstance(value, bool):
        return True
    if isinstance(value, int | float):
        return isfinite(value) and abs(value) <= LARGEST
    return isinstance(value, str) and len(value) <= LONGEST


def restrict_access(server: viser.ViserServer, *, alone: bool) -> None:
    """Turn away other origins, refuse tunnels, and let clients set values of controls and nothing else.

    ``alone`` says that the server listens on loopback.
    """
    socket = server._websock_server

    async def look(connection: infra.WebsockClientConnection) -> None:
        live = socket._live_connections[connection.client_id]
        headers = {} if live.request is None else live.request.headers
        if foreign(headers, alone=alone):
            log.warning("a page of %s was turned away", headers.get("Origin"))
            await live.close(1008, "other origins are not served")

    socket.on_client_connect(look)
    for refused in (messages.ShareUrlRequest, messages.ShareUrlDisconnect):
        socket.unregister_handler(refused)
    set_value = socket._incoming_handlers.pop(messages.GuiUpdateMessage)

    async def only_values(client: infra.ClientId, message: messages.GuiUpdateMessage) -> None:
        if set(message.updates) != {"value"} or not plain(message.updates["value"]):
            log.warning("client %s sent what is no value of a control; refused", client)
            return
        for handler in set_value:
            try:
                await handler(client, message)  # type: ignore[misc]
            except (TypeError, ValueError, AssertionError, OverflowError) as error:
                log.warning("client %s sent a value that is none: %s", client, error)

    socket.register_handler(messages.GuiUpdateMessage, only_values)
