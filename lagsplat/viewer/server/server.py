"""The live simulation in a browser: a session, its real-time loop, the scene and the controls on one port."""

import contextlib
import io
import logging
import socket
import threading
import time
import webbrowser
from concurrent.futures import Future
from pathlib import Path

import viser

from lagsplat.viewer.rendering.renderer import open_renderer
from lagsplat.viewer.server.access_control import restrict_access, warn_of_open_host
from lagsplat.viewer.server.canvas import Drag, Pointer
from lagsplat.viewer.server.controls import ControlPanel
from lagsplat.viewer.server.handshake import Gate, guard_sockets
from lagsplat.viewer.server.scene import ReadFrame, Residual, SceneView, open_canvas
from lagsplat.viewer.server.session_export import export_session
from lagsplat.viewer.simulation.history import SessionHistory
from lagsplat.viewer.simulation.realtime_loop import RealtimeLoop
from lagsplat.viewer.simulation.session import Session, Snapshot

PATIENCE_S = 20.0  # longest wait for the history of the session [s]
log = logging.getLogger(__name__)


class ViewerServer:
    """Serves the live view of a session until `stop`; sessions are saved in ``folder``.

    If ``moving``, the object moves as in the recording when somebody arrives, until it is pushed.

    Raises:
        OSError: no port is free from ``viewer.port`` on, or the address is not this machine's.
    """

    def __init__(
        self,
        session: Session,
        *,
        title: str,
        read_frame: ReadFrame,
        folder: Path,
        residual: Residual = None,
        moving: bool = False,
    ) -> None:
        config, operating_point = session.config, session.operating_point
        if text := warn_of_open_host(config.host):
            log.warning(text)
        _require_address(config.host)
        self.session, self.title, self.folder = session, title, folder
        training_side = max(operating_point.height, operating_point.width)
        self.renderer = open_renderer(operating_point, side=config.side)
        self.small_renderer = open_renderer(operating_point, side=training_side)
        self.gate = Gate(loopback_only=warn_of_open_host(config.host) is None)
        # viser tells its address, which is not the whole one
        with guard_sockets(self.gate), contextlib.redirect_stdout(io.StringIO()):
            self.server = viser.ViserServer(config.host, config.port, verbose=False)
        restrict_access(self.server)
        canvas = open_canvas(self.server, operating_point, self.renderer, window=config.window)
        self.scene_view = SceneView(session, canvas, read_frame=read_frame, residual=residual)
        self.loop = RealtimeLoop(session, self._draw, self._refuse)
        self.gate.is_behind = self.loop.is_behind
        actions = {"Save the session": self._save, "Replay what I did": self._replay}
        self.panel = ControlPanel(self.loop, self.scene_view, title=title, actions=actions)
        self.holder_id: int | None = None
        self.drag: Drag | None = None
        self.saving = threading.Lock()
        canvas.listen(self._drag, lambda: self.loop.submit(lambda s: None))
        if moving:
            self.server.on_client_connect(lambda _: self.loop.submit(self._begin))
        self.loop.start()

    def _begin(self, session: Session) -> None:
        """Set the object in motion for who arrives alone, unless somebody has pushed it."""
        if session.last_push is None and len(self.server.get_clients()) <= 1:
            session.begin_in_motion()

    @property
    def url(self) -> str:
        """Address of the page, with the token that lets its reader in."""
        host = self.session.config.host
        host = "localhost" if host in ("0.0.0.0", "::") else host
        return f"http://{host}:{self.server.get_port()}/{self.gate.token}/"

    def open_browser(self) -> None:
        """Open the page in the system's browser, if there is one."""
        with contextlib.suppress(webbrowser.Error):
            webbrowser.open(self.url)

    def stop(self) -> None:
        """Stop the loop and the server, after a session that is being saved."""
        with self.saving:
            self.loop.stop()
            self.server.stop()

    def _draw(self, snapshot: Snapshot) -> None:
        self.scene_view.draw(snapshot)
        self.panel.refresh(snapshot, time.perf_counter())

    def _refuse(self, text: str) -> None:
        log.warning(text)
        self.panel.notify(text)

    def _drag(self, phase: str, drag: Drag | None, pointer: Pointer, client_id: int) -> None:
        """Apply a drag; the last visitor who grasped holds, and only their release ends the grasp."""
        now = time.perf_counter()
        if phase == "end":
            if client_id == self.holder_id:
                self.loop.submit(lambda s: s.release(requested_s=now))
            return
        if phase == "start":
            self.holder_id, self.drag = client_id, drag
            self.loop.submit(lambda s: self._grasp(s, drag, now))
        if client_id == self.holder_id and (drag := self.drag) is not None:
            self.loop.submit(lambda s: s.pull(drag.displacement(pointer), requested_s=now))

    def _grasp(self, session: Session, drag: Drag | None, now_s: float) -> None:
        session.release()
        if drag is None:
            raise ValueError("the pointer does not point at anything; nothing was pushed")
        if session.grasp(drag.find_target(session.q), requested_s=now_s).is_background:
            self.panel.notify("Nothing there moves: that is background. Drag the object.")

    def _read_history(self) -> SessionHistory:
        future: Future[SessionHistory] = Future()

        def read(session: Session) -> None:
            try:
                future.set_result(session.history.read())
            except ValueError as error:
                future.set_exception(error)

        self.loop.submit(read)
        try:
            return future.result(PATIENCE_S)
        except TimeoutError as error:
            raise ValueError("the simulation does not answer; look at the server's log") from error

    def _replay(self) -> str:
        history = self._read_history()
        self.loop.submit(lambda s: s.replay(history))
        return f"Replaying {history.time_s[-1]:.1f} s."

    def _save(self) -> str:
        history, session = self._read_history(), self.session
        with self.saving:
            number = 1
            while (stem := self.folder / f"session_{number:03d}").with_suffix(".mcap").exists():
                number += 1
            inputs, gain = list(session.recorded.names), session.grasp_model.usual_gain
            meta = {"title": self.title, "inputs": inputs, "kappa": session.kappa}
            small = self.small_renderer
            paths = export_session(stem, history, self.renderer, meta, gain=gain, small_renderer=small)
        return "Saved " + ", ".join(path.name for path in paths) + f" in {self.folder}"


def _require_address(host: str) -> None:
    # viser would try a thousand ports in silence if the address cannot be bound
    try:
        family, _, _, _, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.bind(address)
    except OSError as error:
        raise OSError(f"viewer.host={host}: {error}; give an address of this machine: 127.0.0.1") from error
