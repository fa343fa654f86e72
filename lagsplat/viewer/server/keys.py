"""What keys do in the live view: arrows push where the object moves most, space pauses, R lets it rest."""

import threading
from collections.abc import Callable
from functools import partial

import numpy as np
import viser

from lagsplat.forces.grasp import Place, Point
from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.viewer.simulation.realtime_loop import RealtimeLoop
from lagsplat.viewer.simulation.session import Session

ARROWS = {"left": (-1.0, 0.0), "right": (1.0, 0.0), "up": (0.0, -1.0), "down": (0.0, 1.0)}
NUDGE = 0.2  # way of a push by an arrow key over the picture's width, as of the exported page
HOLD_S = 0.7  # after the last press; a key that is held down presses again sooner than that


class KeyPush:
    """Pushes the object where it moves most, until `HOLD_S` after the last press of a key."""

    def __init__(self, loop: RealtimeLoop, operating_point: OperatingPoint) -> None:
        self.loop, self.operating_point = loop, operating_point
        self.lever, _ = operating_point.find_lever()
        self.reach = NUDGE * operating_point.width
        self.timer: threading.Timer | None = None
        self.grasped: object | None = None

    def press(self, way: tuple[float, float]) -> None:
        """Push along ``way`` (right, down)."""
        if self.timer is not None:
            self.timer.cancel()
        self.loop.submit(lambda session: self._push(session, way))
        self.timer = threading.Timer(HOLD_S, lambda: self.loop.submit(self._let_go))
        self.timer.daemon = True
        self.timer.start()

    def find_target(self, session: Session) -> Point | Place:
        """Where the place that moves most is now."""
        place = self.operating_point.follow_matter_at(self.lever, session.q)
        return tuple(float(x) for x in place)  # type: ignore[return-value]

    def _push(self, session: Session, way: tuple[float, float]) -> None:
        if session.active_grasp is None:
            session.grasp(self.find_target(session))
        elif session.active_grasp.grasp_point is not self.grasped:
            return  # a hand holds it
        drag = np.zeros(self.operating_point.matter.space)
        drag[:2] = self.reach * np.array(way)
        session.pull(drag)
        self.grasped = session.active_grasp.grasp_point if session.active_grasp is not None else None

    def _let_go(self, session: Session) -> None:
        if session.active_grasp is not None and session.active_grasp.grasp_point is self.grasped:
            session.release()
        self.grasped = None


def bind_keys(gui: viser.GuiApi, loop: RealtimeLoop, operating_point: OperatingPoint) -> KeyPush:
    """Bind the keys of the exported page; they are also in the list of commands that Ctrl-K opens."""
    push = KeyPush(loop, operating_point)

    def toggle() -> None:
        loop.submit(lambda session: session.pause(session.status == "running"))

    def bind(label: str, hotkey: str, act: Callable[[], None]) -> None:
        command = gui.add_command(label, hotkey=hotkey)  # type: ignore[arg-type]
        command.on_trigger(lambda _: act())

    for name, way in ARROWS.items():
        bind(f"Push {name}", f"arrow{name}", partial(push.press, way))
    bind("Pause or run", "space", toggle)
    bind("Rest", "R", lambda: loop.submit(lambda session: session.to_rest()))
    return push
