"""Visitors of a live page without a browser: the messages that one sends, well meant or not."""

import msgspec
import viser
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from lagsplat.viewer.server.server import ViewerServer

PROTOCOL = Subprotocol(f"viser-v{viser.__version__}")
NAN = float("nan")


def visit(live: ViewerServer, **settings):
    url = live.url.replace("http", "ws")
    return connect(url, subprotocols=[PROTOCOL], open_timeout=10, **settings)


def send(client, *messages: dict) -> None:
    for message in messages:
        client.send(msgspec.msgpack.encode(message))


def camera(**changes) -> dict:
    look = {"wxyz": (1, 0, 0, 0), "position": (0, 0, 5), "look_at": (0, 0, 0), "up_direction": (0, 1, 0)}
    view = {"image_height": 100, "image_width": 100, "fov": 0.75, "near": 0.1, "far": 100.0}
    return {"type": "ViewerCameraMessage", **look, **view, **changes}


def dragged(phase: str, start, end, name: str = "/picture", **changes) -> dict:
    return {
        "type": "SceneNodeDragMessage",
        "phase": phase,
        "name": name,
        "instance_index": None,
        "start_position": start,
        "start_screen_pos": (0, 0),
        "end_position": end,
        "end_screen_pos": (0, 0),
        "button": "left",
        "modifier": None,
        "owner": "",
        **changes,
    }


def hostile(live: ViewerServer, name: str) -> list[bytes | str]:
    """Messages that no page of ours would send, about the node that can be dragged and all controls."""
    updates = [
        {"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates}
        for uuid in list(live.server.gui._gui_input_handle_from_uuid)
        for updates in (
            {"update_cb": []},
            {"removed": True},
            {"value": "__import__('os').abort()"},
            {"value": NAN},
            {"value": 1e308},
            {"value": None},
            {"gui_api": 0},
            {"value": []},
        )
    ]
    drags = [
        dragged("start", (NAN, 0, 0), (0, 0, 0), name, start_screen_pos=(NAN, 0.5)),
        dragged("update", (0, 0, 0), (1e308, -1e308, 0), name, end_screen_pos=(1e308, -1e308)),
        dragged("end", (0, 0, 0), (0, 0, 0), name="/../../etc"),
        dragged("start", ("a", None, []), ({}, 0, 0), name, start_screen_pos=("a", {}), end_screen_pos=[]),
        dragged("start", (0, 0, 0), (0, 0, 9), name, start_screen_pos=(-9, 1e308)),
    ]
    cameras = [
        camera(wxyz=(NAN, 0, 0, 0)),
        camera(wxyz=(0, 0, 0, 0)),
        camera(wxyz=("a", None, {}, [])),
        camera(position=(1e308, -1e308, NAN)),
        camera(fov=0.0),
        camera(fov=-1e308),
        camera(fov="wide"),
        camera(image_width=10**18, image_height=1),
        camera(image_width=0, image_height=0),
        camera(image_width=-5),
        camera(position=(0, 0)),
        camera(look_at=(NAN, NAN, NAN)),
    ]
    others = [
        {"type": "ShareUrlRequest"},
        {
            "type": "FileTransferStartUpload",
            "source_component_uuid": "../../x",
            "transfer_uuid": "../y",
            "filename": "../../../../tmp/evil",
            "mime_type": "text/plain",
            "part_count": 1,
            "size_bytes": 4,
        },
        {
            "type": "FileTransferPart",
            "source_component_uuid": None,
            "transfer_uuid": "../y",
            "part_index": 0,
            "content": b"evil",
        },
        {"type": "NoSuchMessage"},
        {"type": "ResetGuiMessage"},
        {"type": "RunJavascriptMessage", "source": "1"},
        {},
    ]
    packed = [msgspec.msgpack.encode(message) for message in (*updates, *drags, *cameras, *others)]
    return [*packed, b"", b"\xc1", bytes(range(256)), b"\x80" * 4096, "text where bytes are meant"]
