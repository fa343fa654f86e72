"""What the interactive simulation costs: steps and pictures a second, and the time from a drag to its
picture.

Run as ``python benchmarks/viewer.py [RUN ...]``; without folders of fitted runs, on a law and a cloud of
Gaussians of the default form alone. Pictures have 256 x 256 pixels and 15 000 Gaussians, as in the paper's
mark of 80 pictures a second on a GPU; of a run in space they are seen from the side. Latency is from the
moment at which a drag reaches the server to its drawn and encoded picture, with both clocks running; in space
the first of them casts the ray.
"""

import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch

from benchmarks.forces import default_law
from lagsplat.config.compose import compose
from lagsplat.forces.loaded_lagrangian import make_fast_lagrangian
from lagsplat.forces.operating_point import OperatingPoint, hold_at_load
from lagsplat.report.figures.forces import turn_camera
from lagsplat.runs.run import open_run
from lagsplat.splat.cpu.slice import FrameRasterizer
from lagsplat.splat.gaussians import Gaussians
from lagsplat.viewer.rendering.renderer import ImageRenderer, open_renderer
from lagsplat.viewer.server.canvas import Drag, ImageDrag, RayDrag
from lagsplat.viewer.simulation.history import read_recorded_data
from lagsplat.viewer.simulation.realtime_loop import RealtimeLoop
from lagsplat.viewer.simulation.session import Session, Snapshot

SIDE, COUNT = 256, 15_000
DRAGS = 100
YAW_DEG, PITCH_DEG = 20.0, 10.0


def rate(action: Callable[[], object], seconds: float = 3.0) -> float:
    """How often a second."""
    action()
    began, times = time.perf_counter(), 0
    while time.perf_counter() < began + seconds:
        action()
        times += 1
    return times / (time.perf_counter() - began)


def big_cloud(d: int) -> Gaussians:
    """Gaussians over the whole picture, each as wide as it takes to cover it, gated as a decoder does it."""
    torch.manual_seed(0)
    cloud = Gaussians(COUNT, d)
    with torch.no_grad():
        cloud.center.uniform_(0.0, SIDE)
        cloud.latent_center.normal_()
        cloud.coupling.normal_(0.0, 4.0)
        cloud.shape_log_diagonal.uniform_(0.3, 0.9)
        cloud.opacity_logit.normal_(1.0)
        cloud.color_logit.normal_()
        cloud.precision_log_diagonal.fill_(-0.7)
    return cloud


def encoded(picture: np.ndarray) -> bytes:
    return cv2.imencode(".jpg", picture[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()


def in_turns(actions: dict[str, Callable[[], object]], rounds: int = 100) -> None:
    """How often a second each, taking turns so that other work on the machine hits all alike: by medians of
    the time on the clock, and of that of the processor, all threads together.
    """
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in actions}
    for turn in range(rounds + 1):
        for name, action in actions.items():
            began = time.perf_counter(), time.process_time()
            action()
            if turn:  # the first one compiles
                taken[name].append((time.perf_counter() - began[0], time.process_time() - began[1]))
    for name, times in taken.items():
        wall, processor = (statistics.median(each) for each in zip(*times, strict=True))
        print(f"{name}: {1 / wall:.0f}/s; by processor time {1 / processor:.0f}/s")


def parts(d: int, n_inputs: int) -> dict[str, Callable[[], object]]:
    """What a picture is made of, at one number of coordinates."""
    law = make_fast_lagrangian(default_law(d, n_inputs, compose().stage2.form))
    q, u, load = np.zeros(d), np.zeros(n_inputs), np.ones(d)
    drawer = FrameRasterizer(big_cloud(d), height=SIDE, width=SIDE, stretch=(1.0, 1.0))
    return {
        f"d = {d}, steps": lambda: law.step(q, q, u, load, dt_s=0.005),
        f"d = {d}, pictures": lambda: drawer.draw(q),
        f"d = {d}, a step, a picture and its JPEG": lambda: (
            law.step(q, q, u, load, dt_s=0.005),
            encoded(drawer.draw(q)),
        ),
    }


def object_at(operating_point: OperatingPoint) -> np.ndarray:
    """Where the matter is that moves most."""
    matter, rest = operating_point.matter, operating_point.rest
    most = matter.jacobian(rest).flatten(1).norm(dim=1).argmax()
    return matter.carry(rest[None])[0, most].numpy()


def hands_on(operating_point: OperatingPoint, side: int) -> tuple[Callable[[np.ndarray], np.ndarray], Drag]:
    """What draws a state, and a press on the object."""
    renderer, at = open_renderer(operating_point, side=side), object_at(operating_point)
    if isinstance(renderer, ImageRenderer):
        inside = at.clip(1.0, [operating_point.width - 1.0, operating_point.height - 1.0])
        return renderer.draw, ImageDrag(inside)
    turned = turn_camera(operating_point, YAW_DEG, PITCH_DEG)
    camera = replace(turned.resized(side, side), focal=(renderer.recording_camera.focal[0],) * 2)
    return lambda q: renderer.render_view(q, camera), RayDrag(
        operating_point, camera, camera.project(at[None])[0]
    )


def measure_run(folder: str) -> None:
    run, settings = open_run(Path(folder)), compose()
    operating_point = hold_at_load(run.autoencoder, run.chart, run.lagrangian, run.matter)
    recorded = read_recorded_data(run.chart, names=run.recording.input_names, units=run.recording.input_units)
    session = Session(operating_point, recorded, settings.viewer, settings.forces)
    draw, pull = hands_on(operating_point, settings.viewer.side)
    loopback_only = Session(operating_point, recorded, settings.viewer, settings.forces)
    steps, pictures = rate(loopback_only.step), rate(lambda: encoded(draw(loopback_only.q)))
    wide = ""
    if operating_point.matter.space == 3:
        draw_wide, side = hands_on(operating_point, settings.viewer.window)[0], settings.viewer.window
        wide = f" ({rate(lambda: encoded(draw_wide(loopback_only.q))):.0f} of {side} x {side})"
    taken: dict[float, float] = {}

    def show(snapshot: Snapshot) -> None:
        encoded(draw(snapshot.q))
        if snapshot.requested_s is not None:
            taken.setdefault(snapshot.requested_s, 1e3 * (time.perf_counter() - snapshot.requested_s))

    loop = RealtimeLoop(session, show, print)
    loop.start()
    began = time.perf_counter()
    loop.submit(lambda s: s.grasp(pull.find_target(s.q), requested_s=began))
    for i in range(DRAGS):
        pointer, now = pull.press + np.array([np.sin(0.3 * i), 0.0]), time.perf_counter()
        loop.submit(lambda s, pointer=pointer, now=now: s.pull(pull.displacement(pointer), requested_s=now))
        time.sleep(0.05)
    kept = loop.rates()
    loop.stop()
    latency = statistics.median(taken.values())
    print(
        f"{folder}: d = {operating_point.law.d}, {run.autoencoder.gaussians.n} Gaussians in "
        f"{operating_point.matter.space} dimensions, recording at {1 / session.dt_s:.0f} Hz: "
        f"up to {steps:.0f} "
        f"session steps/s, {pictures:.0f} pictures/s{wide}; live "
        f"{kept[0]:.0f} steps/s and {kept[1]:.0f} pictures/s, drag to picture {latency:.1f} ms median, "
        f"{max(taken.values()):.1f} ms at most of {len(taken)}"
    )


def main() -> None:
    torch.set_num_threads(1)
    in_turns(parts(1, 0) | parts(4, 4))
    for folder in sys.argv[1:]:
        measure_run(folder)


if __name__ == "__main__":
    main()
