"""The control panel and the plots. A control submits a command to the loop and never calls the session."""

import itertools
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import viser
from viser import uplot

from lagsplat.chart.names import name_coordinates
from lagsplat.forces.grasp import SPACING_PX
from lagsplat.viewer.server.keys import bind_keys
from lagsplat.viewer.server.scene import OVERLAYS, SceneView
from lagsplat.viewer.simulation.realtime_loop import Command, RealtimeLoop
from lagsplat.viewer.simulation.session import Session, Snapshot

REFRESH_S = 0.25  # time between two updates of plots and rates [s]
LEAST_INPUT_RANGE = 1e-6  # of an input, in its unit: what changes less counts as constant
EDGE = 1e-6  # rounding error of a bound that is a multiple of its step [step]
DIGITS = 9  # behind the point, in which a multiple of a step is a short number
WIDEST = 20.0  # largest radius of the brush [percent of the image's width]
THEME: Any = {
    "show_logo": False,
    "show_share_button": False,
    "control_width": "medium",
    "brand_color": (38, 120, 190),
}


class ControlPanel:
    """The controls, the banner and the plots of a server.

    ``actions`` are the buttons of the tab Record with what they do; each returns a line to show.
    """

    def __init__(
        self, loop: RealtimeLoop, scene_view: SceneView, *, title: str, actions: dict[str, Callable[[], str]]
    ) -> None:
        self.server, self.loop, self.scene_view = scene_view.server, loop, scene_view
        self.refreshed_s, self.banner_text, self.shows_latency = 0.0, "", False
        gui, session = self.server.gui, loop.session
        gui.set_panel_label(title)
        gui.configure_theme(**THEME)
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
            self._add_record_controls(gui, actions)
        self.plots = HistoryPlots(gui, session)
        self.keys = bind_keys(gui, loop, session.operating_point)
        gui.add_command("Dark colours", hotkey="D").on_trigger(partial(_color, dark=True))
        gui.add_command("Light colours", hotkey="L").on_trigger(partial(_color, dark=False))
        self.status = gui.add_markdown("")
        with gui.add_folder("Help", expand_by_default=False):
            gui.add_markdown(Path(__file__).with_name("help.md").read_text(encoding="utf-8"))

    def notify(self, text: str) -> None:
        """Show a line to every visitor for some seconds."""
        for client in self.server.get_clients().values():
            client.add_notification("LaGSplat", text, auto_close_seconds=8.0)

    def refresh(self, snapshot: Snapshot, now_s: float) -> None:
        """Add a snapshot to the plots; send a new banner at once, plots and rates every `REFRESH_S`."""
        self.plots.add(snapshot)
        if snapshot.banner != self.banner_text:
            self.banner_text = snapshot.banner
            self.banner.content = f"> **{self.banner_text}**" if self.banner_text else ""
            self.banner.visible = bool(self.banner_text)
        if now_s < self.refreshed_s + REFRESH_S:
            return
        self.refreshed_s = now_s
        self.plots.send()
        steps, frames = self.loop.rates()
        line = f"{snapshot.time_s:.1f} s · {steps:.0f} steps/s · {frames:.0f} frames/s"
        if self.shows_latency and self.scene_view.latencies_ms:
            line += f" · drag to frame {np.median(self.scene_view.latencies_ms):.0f} ms"
        if self.loop.clock.dropped_steps:
            line += f" · {self.loop.clock.dropped_steps} steps late"
        self.status.content = f"<sub>{line}</sub>"

    def _add_slider(
        self,
        label: str,
        bounds: tuple[float, float, float] | tuple[int, int, int],
        value: float | int,
        act: Callable[[Session, float], Any],
        *,
        hint: str | None = None,
    ) -> viser.GuiSliderHandle[float]:
        """Add a slider with these bounds and step; ``act`` gets the session and the value."""
        low, high, step = bounds
        gui = self.server.gui
        slider = gui.add_slider(label, min=low, max=high, step=step, initial_value=value, hint=hint)

        @slider.on_update
        def _(_: object) -> None:
            chosen = clip_value(slider.value, low, high)
            self.loop.submit(lambda s: act(s, chosen))

        return slider

    def _add_checkbox(
        self, label: str, act: Callable[[bool], None], *, on: bool = False
    ) -> viser.GuiCheckboxHandle:
        box = self.server.gui.add_checkbox(label, initial_value=on)
        box.on_update(lambda _: act(bool(box.value)))
        return box

    def _add_time_controls(self, gui: viser.GuiApi, session: Session) -> None:
        acts: dict[str, Command] = {
            "Pause": lambda s: s.pause(True),
            "Run": lambda s: s.pause(False),
            "Step": pause_and_step,
            "Rest": lambda s: s.to_rest(),
        }
        buttons = gui.add_button_group("Time", tuple(acts))

        @buttons.on_click
        def _(_: object) -> None:
            if buttons.value in acts:
                self.loop.submit(acts[buttons.value])

        clock = self.loop.clock
        last = len(session.recorded.q) - 1
        self._add_slider("Speed (×)", (0.1, 4.0, 0.1), 1.0, lambda s, value: setattr(clock, "speed", value))
        first = session.frame or 0
        self._add_slider(
            "Frame", (0, max(1, last), 1), first, lambda s, value: s.to_frame(min(int(value), last))
        )

    def _add_push_controls(self, gui: viser.GuiApi, session: Session) -> None:
        def set_radius(s: Session, value: float) -> None:
            s.grasp_model.radius_px = max(SPACING_PX, 0.01 * width * value)

        width = session.operating_point.width
        hint = "Power of ten: 0 as chosen, 1 ten times as strong"
        self._add_slider(
            "Force scale (log10)",
            (-1.0, 1.0, 0.05),
            0.0,
            lambda s, x: setattr(s, "strength", 10.0**x),
            hint=hint,
        )
        radius = round(100.0 * session.grasp_model.radius_px / width, 1)
        hint = "Radius of the grasped matter, in percent of the image's width"
        self._add_slider("Brush (%)", (0.5, WIDEST, 0.5), radius, set_radius, hint=hint)
        with gui.add_folder("Calibrate from one poke", expand_by_default=False):
            force = gui.add_number("True force", initial_value=1.0, min=1e-6, hint="in newtons, say")
            hint = "along the push, in pixels of the training resolution; in space, in pixels at the pivot"
            moved = gui.add_number("It moved (px)", initial_value=5.0, min=1e-3, hint=hint)
            go = gui.add_button("Use my last push")
            scale = gui.add_markdown("kappa is not set: forces are in the law's own unit.")

        @go.on_click
        def _(_: object) -> None:
            known, distance = float(force.value), float(moved.value)

            def calibrate(s: Session) -> None:
                kappa = s.calibrate(force=known, moved_px=distance)
                scale.content = f"kappa = {kappa:.3g} of the law's energy per unit of force and pixel."

            self.loop.submit(calibrate)

    def _add_mechanics_controls(self, gui: viser.GuiApi) -> None:
        sliders = [
            self._add_slider("Damping (×)", (0.0, 5.0, 0.05), 1.0, lambda s, value: s.edit(damping=value)),
            self._add_slider("Inertia (×)", (0.2, 5.0, 0.05), 1.0, lambda s, value: s.edit(inertia=value)),
            self._add_slider(
                "Stiffness (×)", (0.2, 5.0, 0.05), 1.0, lambda s, value: s.edit(stiffness=value)
            ),
        ]
        restore = gui.add_button("As learned")

        @restore.on_click
        def _(_: object) -> None:
            for slider in sliders:
                slider.value = 1.0  # type: ignore[misc]
            self.loop.submit(lambda s: s.edit(damping=1.0, inertia=1.0, stiffness=1.0))

    def _add_input_controls(self, gui: viser.GuiApi, session: Session) -> None:
        recorded = session.recorded

        def replay_inputs(on: bool) -> None:
            self.loop.submit(lambda s: s.follow(on))

        follow = self._add_checkbox("As recorded", replay_inputs, on=session.following)
        bounds = [bound_input(*ends) for ends in zip(recorded.u.min(0), recorded.u.max(0), strict=True)]
        sliders = []
        for name, unit, (low, high, step), u in zip(
            recorded.names, recorded.units, bounds, session.u, strict=True
        ):
            shown = float(np.clip(round(step * round(u / step), DIGITS), low, high))
            label = f"{name} ({unit})"
            sliders.append(gui.add_slider(label, min=low, max=high, step=step, initial_value=shown))

        def set_inputs(_: object) -> None:
            pairs = zip(sliders, bounds, strict=True)
            u = np.array([clip_value(slider.value, low, high) for slider, (low, high, _) in pairs])
            self.loop.submit(lambda s: s.set_inputs(u))
            follow.value = False  # type: ignore[misc]

        for slider in sliders:
            slider.on_update(set_inputs)

    def _add_view_controls(self, gui: viser.GuiApi) -> None:
        for key, label in OVERLAYS.items():
            if key != "residual" or self.scene_view.residual is not None:
                self._add_checkbox(label, partial(self._show, key))

        def measure(on: bool) -> None:
            self.shows_latency = on

        self._add_checkbox("Measure drag to frame", measure)
        front = gui.add_button(self.scene_view.canvas.reset_view_label)

        @front.on_click
        def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                self.scene_view.canvas.reset_view(event.client)

    def _show(self, overlay: str, on: bool) -> None:
        self.loop.submit(lambda s: self.scene_view.shown.update({overlay: on}))

    def _add_record_controls(self, gui: viser.GuiApi, actions: dict[str, Callable[[], str]]) -> None:
        message = gui.add_markdown("The last minutes are kept; save them as MCAP, MP4 and GIF.")

        def run(act: Callable[[], str], _: object) -> None:
            message.content = "Working on it ..."
            try:
                message.content = act()
            except (ValueError, OSError) as error:
                message.content = f"**{error}**"

        for label, act in actions.items():
            gui.add_button(label).on_click(partial(run, act))


def _color(event: viser.CommandEvent, *, dark: bool) -> None:
    """Colour the page of the visitor who asks for it, as its script does for the browser."""
    if event.client is not None:
        event.client.gui.configure_theme(dark_mode=dark, **THEME)


def pause_and_step(session: Session) -> None:
    """Pause the session and take a single step."""
    session.pause(True)
    session.step()


def clip_value(value: float, low: float, high: float) -> float:
    """Clip a number from a client to its bounds; NaN becomes the lower bound."""
    return float(np.clip(np.nan_to_num(float(value), nan=low), low, high))


def bound_input(low: float, high: float) -> tuple[float, float, float]:
    """Bounds and step of a slider within what was recorded of an input, as numbers that are short to read.

    The step is a power of ten, from a thousandth to a hundredth of the range; bounds are multiples of it. An
    input that never changed keeps its value.

    Example:
        >>> bound_input(-0.00281, 0.853737)
        (-0.002, 0.853, 0.001)
    """
    if high - low < LEAST_INPUT_RANGE:
        return float(low), float(low) + LEAST_INPUT_RANGE, LEAST_INPUT_RANGE
    step = 10.0 ** (np.floor(np.log10(high - low)) - 2)
    first, last = np.ceil(low / step - EDGE), np.floor(high / step + EDGE)
    return round(float(first * step), DIGITS), round(float(last * step), DIGITS), float(step)


COLORS = ("#3d8fe0", "#d9642a", "#1f9a70", "#b765cf", "#a98414", "#808890")
DASHES = ((), (7, 3), (2, 2.5), (9, 3, 2, 3), (4, 2), (1.5, 4))  # so that lines differ without their colours
PLOT_HEIGHT_PX = 164
PLOT_POINTS = 300
LEAST_SPAN = (
    0.02  # of a plot over the range of the recording: what is less, as a rounding error, is a flat line
)


class HistoryPlots:
    """Plots of state, energy and energy balance over the last seconds of model time.

    Each spans at least `LEAST_SPAN` of the range that the recording has, about its value at rest.
    """

    def __init__(self, gui: viser.GuiApi, session: Session) -> None:
        self.span_s, self.is_driven = session.config.history_s, len(session.u) > 0
        self.rows: deque[list[float]] = deque(maxlen=PLOT_POINTS)
        rest, (states, energies) = session.operating_point.rest.numpy(), session.measure_ranges()
        at_rest = float(session.law.potential(rest))
        flows = ["hand", *["inputs"] * self.is_driven, "dissipated", "unexplained"]
        titles = ("State q (deviations)", "Energy (unit of the law)", "Energy balance (unit of the law)")
        kinds = (
            ([*name_coordinates(len(rest))], (float(rest.min()), float(rest.max())), states),
            (["kinetic", "potential", "total"], (min(at_rest, 0.0), max(at_rest, 0.0)), energies),
            (flows, (0.0, 0.0), energies),
        )
        self.plots = []
        for title, (names, (low, high), span) in zip(titles, kinds, strict=True):
            half = 0.5 * LEAST_SPAN * span
            self.plots.append((_add_plot(gui, title, names, (low - half, high + half)), len(names)))

    def add(self, snapshot: Snapshot) -> None:
        """Add a snapshot unless it is close in time to the latest; clear the plots if time went back."""
        if self.rows and snapshot.time_s < self.rows[-1][0]:
            self.rows.clear()
        if self.rows and snapshot.time_s < self.rows[-1][0] + self.span_s / PLOT_POINTS:
            return
        energy = snapshot.energy
        row = [snapshot.time_s, *snapshot.q.tolist(), energy.kinetic, energy.potential, energy.total]
        flows = [energy.hand_work, *[energy.input_work] * self.is_driven, energy.dissipated, energy.error]
        self.rows.append([*row, *flows])
        while self.rows[0][0] < snapshot.time_s - self.span_s:
            self.rows.popleft()

    def send(self) -> None:
        """Send the collected rows to the browser."""
        if len(self.rows) < 2:
            return
        time_s, *columns = np.array(self.rows).T.copy()
        for plot, count in self.plots:
            plot.data = (time_s, *columns[:count])
            del columns[:count]


def _add_plot(
    gui: viser.GuiApi, title: str, names: list[str], least: tuple[float, float]
) -> viser.GuiUplotHandle:
    """Add a plot over time that shows at least the values of ``least``."""
    looks = zip(itertools.cycle(COLORS), itertools.cycle(DASHES), strict=False)
    lines = [
        uplot.Series(label=name, stroke=color, width=1.6, dash=dash)
        for name, (color, dash) in zip(names, looks, strict=False)
    ]
    # a soft bound gives way to values beyond it
    low, high = ({"soft": bound, "mode": 1, "pad": 0.1} for bound in least)
    scales: Any = {"x": uplot.Scale(time=False), "y": {"range": {"min": low, "max": high}}}
    axes = (uplot.Axis(size=34, label="time (s)", labelSize=20), uplot.Axis(size=52))
    return gui.add_uplot(
        (np.array([0.0, 1.0]), *(np.zeros(2) for _ in names)),
        (uplot.Series(label="time (s)"), *lines),
        title=title,
        height=PLOT_HEIGHT_PX,
        scales=scales,
        axes=axes,
        legend=uplot.Legend(show=True, live=False),
        padding=(8, 24, 0, 0),
    )
