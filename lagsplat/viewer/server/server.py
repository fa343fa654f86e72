"""The live simulation in a browser: a session, its two clocks, the scene and the controls, on one port."""

import contextlib
import logging
import socket
import threading
import time
import webbrowser
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import viser
from jaxtyping import Float64, UInt8

from lagsplat.viewer.config import ViewerConfig
from lagsplat.viewer.rendering.renderer import open_renderer
from lagsplat.viewer.server.access_control import restrict_access, warn_of_open_host
from lagsplat.viewer.server.canvas import Drag, Pointer
from lagsplat.viewer.server.controls import ControlPanel, Keep
from lagsplat.viewer.server.scene import SceneView, open_canvas
from lagsplat.viewer.server.session_export import export_session
from lagsplat.viewer.simulation.history import SessionHistory
from lagsplat.viewer.simulation.realtime_loop import RealtimeLoop
from lagsplat.viewer.simulation.session import Session, Snapshot

PATIENCE_S = 20.0
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ViewerContent:
    """What is shown: the session, its title, the recorded pictures, and where sessions are saved.

    ``residual`` is the acceleration of the state that a diagnosis found missing, or None.
    """

    session: Session
    title: str
    frame: Callable[[int], UInt8[np.ndarray, "H W 3"]]
    folder: Path
    residual: Callable[[Snapshot], Float64[np.ndarray, " d"]] | None = None


class ViewerServer:
    """Serves a show until `stop`.

    Raises:
        OSError: no port is free from ``viewer.port`` on, or the address is not this machine's.
    """

    def __init__(self, show: ViewerContent, config: ViewerConfig) -> None:
        if text := warn_of_open_host(config.host):
            log.warning(text)
        _require_address(config.host)
        session, held = show.session, show.session.held
        self.show, self.config = show, config
        own = max(held.kinematics.height, held.kinematics.width)
        self.easel, self.small = (
            open_renderer(held.autoencoder, held.chart, side=side) for side in (config.side, own)
        )
        self.server = viser.ViserServer(config.host, config.port, verbose=False)
        restrict_access(self.server, alone=warn_of_open_host(config.host) is None)
        board = open_canvas(self.server, held, side=config.side, window=config.window)
        self.stage = SceneView(self.server, session, board, frame=show.frame, residual=show.residual)
        self.loop = RealtimeLoop(session, self._show, pictures_hz=config.pictures_hz, refuse=self._refuse)
        keep = Keep(self._save, self._replay)
        self.panel = ControlPanel(self.server, session, self.loop, self.stage, keep, title=show.title)
        self.holder: int | None = None
        self.pull: Drag | None = None
        self.saving = threading.Lock()
        board.on_drag(self._drag)
        board.on_look(lambda: self.loop.tell(lambda s: None))
        self.loop.start()

    @property
    def url(self) -> str:
        """Where to look."""
        host = "localhost" if self.config.host in ("0.0.0.0", "::") else self.config.host
        return f"http://{host}:{self.server.get_port()}"

    def open_browser(self) -> None:
        """Open the system's browser there, if there is one."""
        with contextlib.suppress(webbrowser.Error):
            webbrowser.open(self.url)

    def wait(self) -> None:
        """Serve until interrupted."""
        with contextlib.suppress(KeyboardInterrupt):
            while True:
                time.sleep(1.0)

    def stop(self) -> None:
        """End the clocks and the server."""
        self.loop.stop()
        self.server.stop()

    def _show(self, snapshot: Snapshot) -> None:
        self.stage.show(snapshot)
        self.panel.refresh(snapshot, time.perf_counter())

    def _refuse(self, text: str) -> None:
        log.warning(text)
        self.panel.tell(text)

    def _drag(self, phase: str, pull: Drag | None, pointer: Pointer, who: int) -> None:
        """One hand at a time: who grasped last holds, and others' releases do not let go."""
        now = time.perf_counter()
        if phase == "end":
            if who == self.holder:
                self.loop.tell(lambda s: s.release(asked_s=now))
            return
        if phase == "start":
            self.holder, self.pull = who, pull
            self.loop.tell(lambda s: self._grasp(s, pull, now))
        if who == self.holder and (held := self.pull) is not None:
            self.loop.tell(lambda s: s.pull(held.way(pointer), asked_s=now))

    def _grasp(self, session: Session, pull: Drag | None, now_s: float) -> None:
        session.release()
        if pull is None:
            raise ValueError("the pointer does not point at anything; nothing was pushed")
        at, met = pull.aim(session.q)
        if session.grasp(at, met=met, asked_s=now_s).still:
            self.panel.tell("Nothing there moves: that is background. Drag the object.")

    def _taped(self) -> SessionHistory:
        found: list[SessionHistory | ValueError] = []
        ready = threading.Event()

        def read(session: Session) -> None:
            try:
                found.append(session.tape.read())
            except ValueError as error:
                found.append(error)
            ready.set()

        self.loop.tell(read)
        if not ready.wait(PATIENCE_S):
            raise ValueError("the simulation does not answer; look at the server's log")
        if isinstance(found[0], ValueError):
            raise found[0]
        return found[0]

    def _replay(self) -> str:
        taped = self._taped()
        self.loop.tell(lambda s: s.replay(taped))
        return f"Replaying {taped.time_s[-1]:.1f} s."

    def _save(self) -> str:
        taped, session = self._taped(), self.show.session
        with self.saving:
            number = 1
            while (stem := self.show.folder / f"session_{number:03d}").with_suffix(".mcap").exists():
                number += 1
            meta = {"title": self.show.title, "inputs": list(session.recorded.names), "kappa": session.kappa}
            gain = session.touch.gain
            paths = export_session(stem, taped, self.easel, meta, gain=gain, small=self.small)
        return "Saved " + ", ".join(path.name for path in paths) + f" in {self.show.folder}"


def _require_address(host: str) -> None:
    # viser tries a thousand ports where an address cannot be bound, and says nothing
    try:
        family, _, _, _, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.bind(address)
    except OSError as error:
        raise OSError(
            f"viewer.host={host}: {error}; give an address of this machine, or 127.0.0.1"
        ) from error
