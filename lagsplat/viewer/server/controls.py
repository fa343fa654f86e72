"""The control panel and the plots. A control submits a command to the loop and never calls the session."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import viser
from viser import uplot

from lagsplat.viewer.server.scene import SceneView
from lagsplat.viewer.simulation.realtime_loop import RealtimeLoop
from lagsplat.viewer.simulation.session import Session, Snapshot

HELP = Path(__file__).with_name("help.md")
REFRESH_S = 0.25  # time between two updates of plots and rates [s]
WIDEST = 0.2  # largest radius of the brush as a share of the image's width
THEME: Any = {
    "show_logo": False,
    "show_share_button": False,
    "control_width": "medium",
    "brand_color": (38, 120, 190),
}


@dataclass(frozen=True)
class SessionActions:
    """What the buttons of the tab Record do; each returns a line to show."""

    save: Callable[[], str]
    replay: Callable[[], str]


class ControlPanel:
    """The controls, the banner and the plots of a server."""

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        loop: RealtimeLoop,
        scene_view: SceneView,
        actions: SessionActions,
        *,
        title: str,
    ) -> None:
        self.server, self.loop, self.scene_view, self.actions = server, loop, scene_view, actions
        self.refreshed_s, self.banner_text, self.shows_latency = 0.0, "", False
        gui = server.gui
        gui.set_panel_label(title)
        gui.configure_theme(dark_mode=True, **THEME)
        gui.main_panel.dock_right()
        self.banner = gui.add_markdown("", visible=False)
        self._add_time_controls(gui, session)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Push"):
            self._add_push_controls(gui, session)
        with tabs.add_tab("Mechanics"):
            self._add_mechanics_controls(gui)
        if len(session.u):
            with tabs.add_tab("Inputs"):
                self._add_input_controls(gui, session)
        with tabs.add_tab("View"):
            self._add_view_controls(gui)
        with tabs.add_tab("Record"):
            self._add_record_controls(gui)
        self.plots = HistoryPlots(gui, d=len(session.q), span_s=session.config.history_s)
        self.status = gui.add_markdown("")
        with gui.add_folder("Help", expand_by_default=False):
            gui.add_markdown(HELP.read_text(encoding="utf-8"))

    def notify(self, text: str) -> None:
        """Show a line to every visitor for some seconds."""
        for client in self.server.get_clients().values():
            client.add_notification("LaGSplat", text, auto_close_seconds=8.0)

    def refresh(self, snapshot: Snapshot, now_s: float) -> None:
        """Add a snapshot to the plots; send plots, banner and rates every `REFRESH_S`."""
        self.plots.add(snapshot)
        if now_s < self.refreshed_s + REFRESH_S:
            return
        self.refreshed_s = now_s
        self.plots.send()
        if snapshot.banner != self.banner_text:
            self.banner_text = snapshot.banner
            self.banner.content = f"> **{self.banner_text}**" if self.banner_text else ""
            self.banner.visible = bool(self.banner_text)
        steps, frames = self.loop.rates()
        line = f"{snapshot.time_s:.1f} s · {steps:.0f} steps/s · {frames:.0f} frames/s"
        if self.shows_latency and self.scene_view.latencies_ms:
            line += f" · drag to frame {np.median(self.scene_view.latencies_ms):.0f} ms"
        if self.loop.clock.dropped_steps:
            line += f" · {self.loop.clock.dropped_steps} steps late"
        self.status.content = f"<sub>{line}</sub>"

    def _add_time_controls(self, gui: viser.GuiApi, session: Session) -> None:
        buttons = gui.add_button_group("Time", ("Pause", "Run", "Step", "Rest"))
        speed = gui.add_slider("Speed", min=0.1, max=4.0, step=0.1, initial_value=1.0)
        frame = gui.add_slider(
            "Frame", min=0, max=max(1, session.recorded.n_frames - 1), step=1, initial_value=0
        )

        @buttons.on_click
        def _(_: object) -> None:
            acts: dict[str, Callable[[Session], None]] = {
                "Pause": lambda s: s.pause(True),
                "Run": lambda s: s.pause(False),
                "Step": pause_and_step,
                "Rest": lambda s: s.to_rest(),
            }
            if buttons.value in acts:
                self.loop.submit(acts[buttons.value])

        @speed.on_update
        def _(_: object) -> None:
            value = clip_value(speed.value, 0.1, 4.0)
            self.loop.submit(lambda s: setattr(self.loop.clock, "speed", value))

        @frame.on_update
        def _(_: object) -> None:
            chosen = int(clip_value(frame.value, 0, session.recorded.n_frames - 1))
            self.loop.submit(lambda s: s.to_frame(chosen))

    def _add_push_controls(self, gui: viser.GuiApi, session: Session) -> None:
        strength = gui.add_slider(
            "Force scale",
            min=-1.0,
            max=1.0,
            step=0.05,
            initial_value=0.0,
            hint="Power of ten: 0 as chosen, 1 ten times as strong",
        )
        width = session.operating_point.kinematics.width
        radius = gui.add_slider(
            "Brush",
            min=0.005,
            max=WIDEST,
            step=0.005,
            initial_value=round(session.grasp_model.radius_px / width, 3),
            hint="Radius of the grasped matter, as a share of the image's width",
        )
        with gui.add_folder("Calibrate from one poke", expand_by_default=False):
            force = gui.add_number("True force", initial_value=1.0, min=1e-6, hint="in newtons, say")
            moved = gui.add_number(
                "It moved [px]",
                initial_value=5.0,
                min=1e-3,
                hint="along the push, in pixels of the training resolution; in space, in pixels at the pivot",
            )
            go = gui.add_button("Use my last push")
            scale = gui.add_markdown("kappa is not set: forces are in the law's own unit.")

        @strength.on_update
        def _(_: object) -> None:
            value = 10.0 ** clip_value(strength.value, -1.0, 1.0)
            self.loop.submit(lambda s: setattr(s, "strength", value))

        @radius.on_update
        def _(_: object) -> None:
            value = width * clip_value(radius.value, 0.005, WIDEST)
            self.loop.submit(lambda s: setattr(s.grasp_model, "radius_px", value))

        @go.on_click
        def _(_: object) -> None:
            known, distance = float(force.value), float(moved.value)

            def calibrate(s: Session) -> None:
                kappa = s.calibrate(force=known, moved_px=distance)
                scale.content = f"kappa = {kappa:.3g} of the law's energy per unit of force and pixel."

            self.loop.submit(calibrate)

    def _add_mechanics_controls(self, gui: viser.GuiApi) -> None:
        bounds = {"damping": (0.0, 5.0), "inertia": (0.2, 5.0), "stiffness": (0.2, 5.0)}
        sliders = {
            name: gui.add_slider(name.capitalize(), min=low, max=high, step=0.05, initial_value=1.0)
            for name, (low, high) in bounds.items()
        }
        restore = gui.add_button("As learned")

        def listen(name: str) -> None:
            @sliders[name].on_update
            def _(_: object) -> None:
                value = clip_value(sliders[name].value, *bounds[name])
                self.loop.submit(lambda s: s.edit(**{name: value}))

        for name in bounds:
            listen(name)

        @restore.on_click
        def _(_: object) -> None:
            for slider in sliders.values():
                slider.value = 1.0  # type: ignore[misc]
            self.loop.submit(lambda s: s.edit(damping=1.0, inertia=1.0, stiffness=1.0))

    def _add_input_controls(self, gui: viser.GuiApi, session: Session) -> None:
        recorded = session.recorded
        follow = gui.add_checkbox("As recorded", initial_value=False)
        low, high = recorded.u.min(0), recorded.u.max(0)
        sliders = [
            gui.add_slider(
                f"{name} [{unit}]",
                min=float(low[i]),
                max=float(max(high[i], low[i] + 1e-6)),
                step=float(max(high[i] - low[i], 1e-6)) / 100.0,
                initial_value=float(np.clip(session.u[i], low[i], high[i])),
            )
            for i, (name, unit) in enumerate(zip(recorded.names, recorded.units, strict=True))
        ]

        @follow.on_update
        def _(_: object) -> None:
            on = bool(follow.value)
            self.loop.submit(lambda s: s.follow(on))

        def hold(_: object) -> None:
            held = zip(sliders, low, high, strict=True)
            u = np.array([clip_value(slider.value, a, b) for slider, a, b in held])
            self.loop.submit(lambda s: s.set_inputs(u))
            follow.value = False  # type: ignore[misc]

        for slider in sliders:
            slider.on_update(hold)

    def _add_view_controls(self, gui: viser.GuiApi) -> None:
        names = {"Outline at rest": "outline", "Velocity field": "velocity"}
        names["Recorded frame beside"] = "recorded"
        if self.scene_view.residual is not None:
            names["Residual of the diagnosis"] = "residual"
        boxes = {key: gui.add_checkbox(label, initial_value=False) for label, key in names.items()}
        measure = gui.add_checkbox("Measure drag to frame", initial_value=False)
        dark = gui.add_checkbox("Dark", initial_value=True)
        front = gui.add_button(self.scene_view.canvas.reset_view_label)

        def listen(key: str) -> None:
            @boxes[key].on_update
            def _(_: object) -> None:
                on = bool(boxes[key].value)
                self.loop.submit(lambda s: setattr(self.scene_view.options, key, on))

        for key in boxes:
            listen(key)

        @measure.on_update
        def _(_: object) -> None:
            self.shows_latency = bool(measure.value)

        @dark.on_update
        def _(_: object) -> None:
            gui.configure_theme(dark_mode=bool(dark.value), **THEME)

        @front.on_click
        def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                self.scene_view.canvas.reset_view(event.client)

    def _add_record_controls(self, gui: viser.GuiApi) -> None:
        message = gui.add_markdown("The last minutes are kept; save them as MCAP, MP4 and GIF.")

        def offer(label: str, act: Callable[[], str]) -> None:
            button = gui.add_button(label)

            @button.on_click
            def _(_: object) -> None:
                message.content = "Working on it ..."
                try:
                    message.content = act()
                except (ValueError, OSError) as error:
                    message.content = f"**{error}**"

        offer("Save the session", self.actions.save)
        offer("Replay what I did", self.actions.replay)


def pause_and_step(session: Session) -> None:
    """Pause the session and take a single step."""
    session.pause(True)
    session.step()


def clip_value(value: float, low: float, high: float) -> float:
    """Clip a number from a client to its bounds; NaN becomes the lower bound."""
    return float(np.clip(np.nan_to_num(float(value), nan=low), low, high))


COLORS = ("#4c9be8", "#e8743b", "#3fb68b", "#c678dd", "#e5c07b", "#9aa0a6")
PLOT_HEIGHT_PX = 150
PLOT_POINTS = 300


class HistoryPlots:
    """Plots of state, energy and energy balance over the last ``span_s`` seconds of model time."""

    def __init__(self, gui: viser.GuiApi, *, d: int, span_s: float) -> None:
        self.span_s = span_s
        self.rows: deque[list[float]] = deque(maxlen=PLOT_POINTS)
        self.state = _add_plot(gui, "State q (whitened)", [f"q{i}" for i in range(d)])
        self.energy = _add_plot(gui, "Energy (law's unit)", ["kinetic", "potential", "total"])
        self.balance = _add_plot(gui, "Energy balance", ["hand", "inputs", "dissipated", "unexplained"])
        self.d = d

    def add(self, snapshot: Snapshot) -> None:
        """Add a snapshot unless it is close in time to the latest; clear the plots if time went back."""
        if self.rows and snapshot.time_s < self.rows[-1][0]:
            self.rows.clear()
        if self.rows and snapshot.time_s < self.rows[-1][0] + self.span_s / PLOT_POINTS:
            return
        energy = snapshot.energy
        row = [snapshot.time_s, *snapshot.q.tolist(), energy.kinetic, energy.potential, energy.total]
        self.rows.append([*row, energy.hand_work, energy.input_work, energy.dissipated, energy.error])
        while self.rows[0][0] < snapshot.time_s - self.span_s:
            self.rows.popleft()

    def send(self) -> None:
        """Send the collected rows to the browser."""
        if len(self.rows) < 2:
            return
        table = np.array(self.rows)
        time_s, columns = table[:, 0], table[:, 1:].T
        d = self.d
        for chart, part in (
            (self.state, columns[:d]),
            (self.energy, columns[d : d + 3]),
            (self.balance, columns[d + 3 :]),
        ):
            chart.data = (time_s, *(np.ascontiguousarray(row) for row in part))


def _add_plot(gui: viser.GuiApi, title: str, names: list[str]) -> viser.GuiUplotHandle:
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
        height=PLOT_HEIGHT_PX,
        scales={"x": uplot.Scale(time=False)},
        axes=axes,
        legend=uplot.Legend(show=True),
    )
