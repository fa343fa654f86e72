"""What a run in space learned of a rocker's geometry, against the scene that it was simulated in.

Usage: ``python benchmarks/space_truth.py RUN SYSTEM``, such as
``results/quick/simulated/rainbow_rocker_3d/default-0/default-0 rainbow_rocker_3d``. Training is told nothing
of this: depths of the body's front and of the wall, how far motions leave the plane of motion, and how far
they are off their true direction. Medians over the Gaussians of the body, by their presence at rest.
"""

import sys
from pathlib import Path

import numpy as np

from lagsplat.config.compose import compose
from lagsplat.forces.operating_point import hold_at_load
from lagsplat.runs.run import open_run
from lagsplat.systems.video import make_space

PRESENT = 0.1
FLANK_M = 0.001


def main(folder: Path, system: str) -> None:
    """Print the comparison."""
    run, config = open_run(folder), compose(f"system={system}").release
    assert config is not None, "a system that is let go"
    assert config.rocker is not None, "a rocker"
    held, space = hold_at_load(run.autoencoder, run.chart, run.lagrangian), make_space(config)
    places = space.outside(held.kinematics.places(held.rest[None])[0].numpy())
    ways = held.kinematics.geometry.jacobian[:, :, 0].numpy() @ space.reference.rotation
    present = held.kinematics.presence(held.rest[None])[0].numpy()

    body, radius = config.bodies[0], config.rocker.radius
    half = 0.5 * body.thickness_m
    lever = np.hypot(places[:, 0], places[:, 1] + radius)
    ring = (lever < radius) & (lever > body.size_m[1]) & (places[:, 1] > -radius)
    on = ring & (np.abs(places[:, 2]) < 2 * half) & (present > PRESENT)
    wall = (places[:, 2] > 0.5 * (half + config.scene.behind)) & (present > PRESENT)
    front = on & (places[:, 2] < -half + 4 * FLANK_M)
    # A rolling body turns about the point of contact, which at rest is the world's origin.
    true = np.stack([-places[:, 1], places[:, 0], np.zeros(len(places))], axis=1)
    cosine = (ways * true).sum(1) / np.linalg.norm(ways, axis=1) / np.linalg.norm(true, axis=1)
    cosine *= np.sign(np.median(cosine[on]))
    out = np.degrees(np.arcsin(np.abs(ways[:, 2]) / np.linalg.norm(ways, axis=1)))
    off = np.degrees(np.arccos(np.clip(cosine, -1, 1)))

    print(f"{on.sum()} Gaussians on the body, {wall.sum()} on the wall")
    print(f"front: {1e3 * median(places[:, 2], present, front):+.1f} mm (true {-1e3 * half:+.1f})")
    print(
        f"wall: {1e3 * median(places[:, 2], present, wall):+.1f} mm (true {1e3 * config.scene.behind:+.1f})"
    )
    print(f"motion out of its plane: {median(out, present, on):.1f} degrees")
    print(f"motion off its true direction: {median(off, present, on):.1f} degrees")


def median(values: np.ndarray, weights: np.ndarray, where: np.ndarray) -> float:
    """Weighted median of some values."""
    order = np.argsort(values[where])
    total = np.cumsum(weights[where][order])
    return float(values[where][order][np.searchsorted(total, 0.5 * total[-1])])


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
