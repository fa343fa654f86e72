"""The controls beside the picture. Each leaves a command with the loop; none touches the session itself.

Live plots beside the picture: the state, the energy, and what the books of energy cannot explain.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import viser
from viser import uplot

from lagsplat.viewer.server.scene import SceneView
from lagsplat.viewer.simulation.realtime_loop import RealtimeLoop
from lagsplat.viewer.simulation.session import Session, Snapshot

HELP = Path(__file__).with_name("help.md")
REFRESH_S = 0.25
WIDEST = 0.2


@dataclass(frozen=True)
class Keep:
    """What the buttons of the tab Record do, slow things that touch files: each answers with a line to
    show."""

    save: Callable[[], str]
    replay: Callable[[], str]


class ControlPanel:
    """All controls, the banner and the plots of one server."""

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        loop: RealtimeLoop,
        stage: SceneView,
        keep: Keep,
        *,
        title: str,
    ) -> None:
        self.server, self.loop, self.stage, self.keep = server, loop, stage, keep
        self.said_s, self.said, self.measured = 0.0, "", False
        gui = server.gui
        gui.set_panel_label(title)
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, control_width="medium",
                            brand_color=(38, 120, 190))  # fmt: skip
        gui.main_panel.dock_right()
        self.banner = gui.add_markdown("", visible=False)
        self._transport(gui, session)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Push"):
            self._pushes(gui, session)
        with tabs.add_tab("Mechanics"):
            self._mechanics(gui)
        if len(session.u):
            with tabs.add_tab("Inputs"):
                self._inputs(gui, session)
        with tabs.add_tab("View"):
            self._view(gui)
        with tabs.add_tab("Record"):
            self._record(gui)
        self.plots = HistoryPlots(gui, d=len(session.q), span_s=session.config.history_s)
        self.status = gui.add_markdown("")
        with gui.add_folder("Help", expand_by_default=False):
            gui.add_markdown(HELP.read_text(encoding="utf-8"))

    def tell(self, text: str) -> None:
        """Show a line to everyone for a while."""
        for client in self.server.get_clients().values():
            client.add_notification("LaGSplat", text, auto_close_seconds=8.0)

    def refresh(self, snapshot: Snapshot, now_s: float) -> None:
        """Take a snapshot into the plots, and now and then send them, the banner and the rates."""
        self.plots.add(snapshot)
        if now_s < self.said_s + REFRESH_S:
            return
        self.said_s = now_s
        self.plots.show()
        if snapshot.banner != self.said:
            self.said = snapshot.banner
            self.banner.content = f"> **{self.said}**" if self.said else ""
            self.banner.visible = bool(self.said)
        steps, pictures = self.loop.rates()
        line = f"{snapshot.time_s:.1f} s · {steps:.0f} steps/s · {pictures:.0f} pictures/s"
        if self.measured and self.stage.latencies_ms:
            line += f" · drag to picture {np.median(self.stage.latencies_ms):.0f} ms"
        if self.loop.clock.forgotten:
            line += f" · {self.loop.clock.forgotten} steps late"
        self.status.content = f"<sub>{line}</sub>"

    def _transport(self, gui: viser.GuiApi, session: Session) -> None:
        buttons = gui.add_button_group("Time", ("Pause", "Run", "Step", "Rest"))
        speed = gui.add_slider("Speed", min=0.1, max=4.0, step=0.1, initial_value=1.0)
        frame = gui.add_slider(
            "Frame", min=0, max=max(1, session.recorded.frames - 1), step=1, initial_value=0
        )

        @buttons.on_click
        def _(_: object) -> None:
            acts: dict[str, Callable[[Session], None]] = {
                "Pause": lambda s: s.pause(True),
                "Run": lambda s: s.pause(False),
                "Step": nudge_input,
                "Rest": lambda s: s.to_rest(),
            }
            if buttons.value in acts:
                self.loop.tell(acts[buttons.value])

        @speed.on_update
        def _(_: object) -> None:
            value = clip_input(speed.value, 0.1, 4.0)
            self.loop.tell(lambda s: setattr(self.loop.clock, "speed", value))

        @frame.on_update
        def _(_: object) -> None:
            chosen = int(clip_input(frame.value, 0, session.recorded.frames - 1))
            self.loop.tell(lambda s: s.to_frame(chosen))

    def _pushes(self, gui: viser.GuiApi, session: Session) -> None:
        strength = gui.add_slider("Force scale", min=-1.0, max=1.0, step=0.05, initial_value=0.0,
                                  hint="Power of ten: 0 as chosen, 1 ten times as strong")  # fmt: skip
        width = session.held.kinematics.width
        radius = gui.add_slider("Brush", min=0.005, max=WIDEST, step=0.005,
                                initial_value=round(session.touch.radius_px / width, 3),
                                hint="Radius of what a push grips, of the picture's width")  # fmt: skip
        with gui.add_folder("Calibrate from one poke", expand_by_default=False):
            force = gui.add_number("True force", initial_value=1.0, min=1e-6, hint="in newtons, say")
            moved = gui.add_number("It moved [px]", initial_value=5.0, min=1e-3,
                                   hint="along the push, in pixels of the training resolution; "
                                        "in space, of what one covers at the pivot")  # fmt: skip
            go = gui.add_button("Use my last push")
            scale = gui.add_markdown("kappa is not set: forces are in the law's own unit.")

        @strength.on_update
        def _(_: object) -> None:
            value = 10.0 ** clip_input(strength.value, -1.0, 1.0)
            self.loop.tell(lambda s: setattr(s, "strength", value))

        @radius.on_update
        def _(_: object) -> None:
            value = width * clip_input(radius.value, 0.005, WIDEST)
            self.loop.tell(lambda s: setattr(s.touch, "radius_px", value))

        @go.on_click
        def _(_: object) -> None:
            known, way = float(force.value), float(moved.value)

            def calibrate(s: Session) -> None:
                kappa = s.calibrate(force=known, moved_px=way)
                scale.content = f"kappa = {kappa:.3g} of the law's energy per unit of force and pixel."

            self.loop.tell(calibrate)

    def _mechanics(self, gui: viser.GuiApi) -> None:
        bounds = {"damping": (0.0, 5.0), "inertia": (0.2, 5.0), "stiffness": (0.2, 5.0)}
        sliders = {
            name: gui.add_slider(name.capitalize(), min=low, max=high, step=0.05, initial_value=1.0)
            for name, (low, high) in bounds.items()
        }
        restore = gui.add_button("As learned")

        def listen(name: str) -> None:
            @sliders[name].on_update
            def _(_: object) -> None:
                value = clip_input(sliders[name].value, *bounds[name])
                self.loop.tell(lambda s: s.edit(**{name: value}))

        for name in bounds:
            listen(name)

        @restore.on_click
        def _(_: object) -> None:
            for slider in sliders.values():
                slider.value = 1.0  # type: ignore[misc]
            self.loop.tell(lambda s: s.edit(damping=1.0, inertia=1.0, stiffness=1.0))

    def _inputs(self, gui: viser.GuiApi, session: Session) -> None:
        recorded = session.recorded
        follow = gui.add_checkbox("As recorded", initial_value=False)
        low, high = recorded.u.min(0), recorded.u.max(0)
        sliders = [
            gui.add_slider(
                f"{name} [{unit}]", min=float(low[i]), max=float(max(high[i], low[i] + 1e-6)),
                step=float(max(high[i] - low[i], 1e-6)) / 100.0,
                initial_value=float(np.clip(session.u[i], low[i], high[i])),
            )
            for i, (name, unit) in enumerate(zip(recorded.names, recorded.units, strict=True))
        ]  # fmt: skip

        @follow.on_update
        def _(_: object) -> None:
            on = bool(follow.value)
            self.loop.tell(lambda s: s.follow(on))

        def hold(_: object) -> None:
            u = np.array(
                [clip_input(slider.value, a, b) for slider, a, b in zip(sliders, low, high, strict=True)]
            )
            self.loop.tell(lambda s: s.set_inputs(u))
            follow.value = False  # type: ignore[misc]

        for slider in sliders:
            slider.on_update(hold)

    def _view(self, gui: viser.GuiApi) -> None:
        names = {"Outline at rest": "outline", "Velocity field": "velocity", "Filmed frame beside": "real"}
        if self.stage.residual is not None:
            names["Residual of the diagnosis"] = "residual"
        boxes = {key: gui.add_checkbox(label, initial_value=False) for label, key in names.items()}
        measure = gui.add_checkbox("Measure drag to picture", initial_value=False)
        dark = gui.add_checkbox("Dark", initial_value=True)
        front = gui.add_button(self.stage.board.face_label)

        def listen(key: str) -> None:
            @boxes[key].on_update
            def _(_: object) -> None:
                on = bool(boxes[key].value)
                self.loop.tell(lambda s: setattr(self.stage.shown, key, on))

        for key in boxes:
            listen(key)

        @measure.on_update
        def _(_: object) -> None:
            self.measured = bool(measure.value)

        @dark.on_update
        def _(_: object) -> None:
            gui.configure_theme(dark_mode=bool(dark.value), show_logo=False, show_share_button=False,
                                control_width="medium", brand_color=(38, 120, 190))  # fmt: skip

        @front.on_click
        def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                self.stage.board.face(event.client)

    def _record(self, gui: viser.GuiApi) -> None:
        said = gui.add_markdown("The last minutes are kept; save them as MCAP, MP4 and GIF.")

        def offer(label: str, act: Callable[[], str]) -> None:
            button = gui.add_button(label)

            @button.on_click
            def _(_: object) -> None:
                said.content = "Working on it ..."
                try:
                    said.content = act()
                except (ValueError, OSError) as error:
                    said.content = f"**{error}**"

        offer("Save the session", self.keep.save)
        offer("Replay what I did", self.keep.replay)


def nudge_input(session: Session) -> None:
    """Pause, and take a single step."""
    session.pause(True)
    session.step()


def clip_input(value: float, low: float, high: float) -> float:
    """A number that a client sent, within its bounds; what is none is the lower bound."""
    return float(np.clip(np.nan_to_num(float(value), nan=low), low, high))


COLORS = ("#4c9be8", "#e8743b", "#3fb68b", "#c678dd", "#e5c07b", "#9aa0a6")
HEIGHT = 150
POINTS = 300


class HistoryPlots:
    """Three charts of the last ``span_s`` seconds of model time; `add` collects, `show` sends."""

    def __init__(self, gui: viser.GuiApi, *, d: int, span_s: float) -> None:
        self.span_s = span_s
        self.rows: deque[list[float]] = deque(maxlen=POINTS)
        self.state = _chart(gui, "State q (whitened)", [f"q{i}" for i in range(d)])
        self.energy = _chart(gui, "Energy (law's unit)", ["kinetic", "potential", "total"])
        self.books = _chart(gui, "Energy balance", ["hand", "inputs", "dissipated", "unexplained"])
        self.d = d

    def add(self, snapshot: Snapshot) -> None:
        """Take a snapshot in, unless one of nearly the same instant is in; a leap back begins anew."""
        if self.rows and snapshot.time_s < self.rows[-1][0]:
            self.rows.clear()
        if self.rows and snapshot.time_s < self.rows[-1][0] + self.span_s / POINTS:
            return
        energy = snapshot.energy
        self.rows.append(
            [
                snapshot.time_s, *snapshot.q.tolist(),
                energy.kinetic, energy.potential, energy.total,
                energy.hand, energy.inputs, energy.dissipated, energy.error,
            ]
        )  # fmt: skip

        while self.rows[0][0] < snapshot.time_s - self.span_s:
            self.rows.popleft()

    def show(self) -> None:
        """Send what is collected."""
        if len(self.rows) < 2:
            return
        table = np.array(self.rows)
        time_s, columns = table[:, 0], table[:, 1:].T
        d = self.d
        for chart, part in (
            (self.state, columns[:d]),
            (self.energy, columns[d : d + 3]),
            (self.books, columns[d + 3 :]),
        ):
            chart.data = (time_s, *(np.ascontiguousarray(row) for row in part))


def _chart(gui: viser.GuiApi, title: str, names: list[str]) -> viser.GuiUplotHandle:
    series = (
        uplot.Series(label="t [s]"),
        *(
            uplot.Series(label=name, stroke=COLORS[i % len(COLORS)], width=1.6)
            for i, name in enumerate(names)
        ),
    )
    empty = np.zeros(2)
    axes = (uplot.Axis(size=28, stroke="#8a8f98"), uplot.Axis(size=46, stroke="#8a8f98"))
    return gui.add_uplot(
        (np.array([0.0, 1.0]), *(empty for _ in names)),
        series,
        title=title,
        height=HEIGHT,
        scales={"x": uplot.Scale(time=False)},
        axes=axes,
        legend=uplot.Legend(show=True),
    )
