"""Cuts that nobody declared are found; knocks, stops, friction and lost frames are not taken for them."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.data_quality.checks import unwrap_angles
from lagsplat.diagnose.data_quality.discontinuities import cut_gaps, cut_jumps, drop_holds
from lagsplat.diagnose.data_quality.noise import measure_noise
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.motions import PERIOD_S, glued, swing


def cut(motion: Trajectory) -> tuple[Trajectory, list[str]]:
    sigma = measure_noise([motion], period_s=PERIOD_S).sigma
    found, findings = cut_jumps(motion, sigma=sigma, period_s=PERIOD_S)
    return found, [finding.check for finding in findings]


def stepped(force, *, seconds: float = 15.0, noise: float = 0.0, start: float = 1.0) -> Trajectory:
    """A unit mass under ``force(t, q, v)``, by small symplectic steps."""
    n, sub = round(seconds * 60.0), 40
    q, v, seen = start, 0.0, []
    for k in range(n):
        seen.append(q)
        for j in range(sub):
            v += force((k + j / sub) / 60.0, q, v) / (60.0 * sub)
            q += v / (60.0 * sub)
    values = np.array(seen)
    values = values + noise * values.std() * np.random.default_rng(0).normal(size=n)
    return Trajectory(time_s=np.arange(n) / 60.0, q=values[:, None], u=np.zeros((n, 0)), source="stepped.csv")


@pytest.mark.parametrize("noise", [0.0, 0.003, 0.03])
def test_glued_releases_are_cut_where_they_were_glued(noise: float) -> None:
    parts = [
        swing(seconds=5.0, start=(size,), noise=noise, seed=k) for k, size in enumerate((1.0, 0.7, -0.8))
    ]
    found, said = cut(glued(*parts))
    assert found.segments == ((0, 300), (300, 600), (600, 900))
    assert said == ["undeclared cut"]
    two = [swing(seconds=5.0, start=start, noise=noise) for start in ((1.0, 0.5), (-0.3, 0.9))]
    assert cut(glued(*two))[0].segments == ((0, 300), (300, 600))


@pytest.mark.parametrize("noise", [0.0, 0.003, 0.01, 0.03])
@pytest.mark.parametrize(
    "force",
    [
        lambda t, q, v: -33.0 * q - 0.3 * v,
        lambda t, q, v: -33.0 * q - 0.3 * v - 4000.0 * max(q - 0.4, 0.0),
        lambda t, q, v: -33.0 * q - 3.0 * np.tanh(v / 1e-3),
        lambda t, q, v: -33.0 * q - 0.6 * v + 300.0 * (abs(t - 6.0) < 0.02),
    ],
    ids=["decay", "end stop", "friction", "push"],
)
def test_how_things_move_is_no_cut(force, noise: float) -> None:
    motion = stepped(force, noise=noise)
    found, said = cut(motion)
    assert (found.segments, said) == (((0, motion.n),), [])


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_lost_frames_are_said_and_not_cut(noise: float) -> None:
    motion = swing(noise=noise, damping=0.005)
    fastest = 264 + int(np.argmax(np.abs(np.diff(motion.q[264:300, 0]))))
    kept = np.delete(np.arange(motion.n), np.arange(fastest, fastest + 4))
    lost = Trajectory(time_s=motion.time_s[: len(kept)], q=motion.q[kept], u=motion.u[kept])
    found, said = cut(lost)
    assert found.segments == ((0, len(kept)),)
    assert said == ["missing samples"]


def test_a_sensor_that_jumps_all_the_time_is_not_cut_to_shreds() -> None:
    parts = [swing(seconds=1.0, start=(1.0 + 0.1 * (k % 3),), damping=0.1, seed=k) for k in range(30)]
    found, said = cut(glued(*parts))
    assert (len(found.segments), said) == (1, ["frequent jumps"])


def test_a_fast_mode_is_no_cut() -> None:
    """Six samples a period, set off by a kick."""
    force = lambda t, q, v: -3900.0 * q - 5.0 * v + 3000.0 * (abs(t - 6.0) < 0.02)  # noqa: E731
    motion = stepped(force, noise=0.003, start=0.3)
    slow = swing(noise=0.0, damping=0.0)
    found, said = cut(replace(motion, q=0.5 * motion.q / motion.q.max() + slow.q))
    assert (found.segments, said) == (((0, motion.n),), [])


def test_gaps_are_cut_and_short_ones_are_not() -> None:
    motion = swing()
    late = np.where(np.arange(motion.n) < 500, 0.0, 0.5) + np.where(np.arange(motion.n) < 200, 0.0, 0.02)
    found, findings = cut_gaps(replace(motion, time_s=motion.time_s + late), period_s=PERIOD_S)
    assert found.segments == ((0, 500), (500, 900))
    assert [finding.check for finding in findings] == ["gap"]
    assert cut_gaps(motion, period_s=None) == (motion, ())


@pytest.mark.parametrize(("first", "cuts"), [(300, 0), (448, 1)])
def test_a_driven_motion_is_cut_where_its_input_bends_unseen(first: int, cuts: int) -> None:
    """Two samples are missing, of a slow sine or where the input steps."""
    motion = swing()
    slow = np.sin(0.5 * motion.time_s) + (np.arange(motion.n) >= 450)
    kept = np.delete(np.arange(motion.n), [first + 1, first + 2])
    driven = replace(motion, u=slow[:, None], u_names=())
    some = replace(driven, time_s=driven.time_s[kept], q=driven.q[kept], u=driven.u[kept], segments=())
    found, findings = cut_gaps(some, period_s=10.0 * PERIOD_S)
    assert len(found.segments) == 1 + cuts
    assert len(findings) == cuts


@pytest.mark.parametrize("turn", [2.0 * np.pi, 360.0])
def test_angles_are_continued_over_the_end_of_a_turn(turn: float) -> None:
    motion = swing(noise=0.001)
    about = replace(motion, q=turn / 2.0 + 0.3 * turn * motion.q)
    wrapped = replace(about, q=np.mod(about.q, turn))
    found, findings = unwrap_angles(wrapped)
    np.testing.assert_allclose(found.q, about.q, atol=1e-9 * turn)
    assert [finding.check for finding in findings] == (["wrapped"] if np.ptp(wrapped.q - about.q) else [])
    assert unwrap_angles(about)[1] == ()


@pytest.mark.parametrize("rate_hz", [15.0, 60.0])
@pytest.mark.parametrize("speed", [0.4, 5.0])
def test_an_angle_that_turns_fast_is_continued_and_a_cut_is_not(rate_hz: float, speed: float) -> None:
    """At 15 Hz a fast turn makes a third of a turn from one sample to the next."""
    time_s = np.arange(300) / rate_hz
    about = 2.0 * np.pi * speed * time_s + 0.2 * np.sin(4.0 * time_s)
    motion = Trajectory(time_s=time_s, q=np.mod(about, 2.0 * np.pi)[:, None], u=np.zeros((300, 0)))
    found, findings = unwrap_angles(motion)
    np.testing.assert_allclose(found.q[:, 0], about, atol=1e-9)
    assert len(findings) == 1
    torn = np.where(np.arange(300) < 150, 0.1, 4.5) + 0.1 * np.sin(4.0 * time_s)
    assert unwrap_angles(replace(motion, q=torn[:, None]))[1] == ()


def test_a_hand_that_holds_is_left_out_and_a_rest_is_not() -> None:
    swinging = swing(seconds=10.0, noise=0.003)
    noise = 0.001 * np.random.default_rng(1).normal(size=(120, 1))
    rest = replace(swinging, time_s=swinging.time_s[:120], u=swinging.u[:120], q=noise, segments=((0, 120),))
    sigma = measure_noise([swinging], period_s=PERIOD_S).sigma
    held, findings = drop_holds(glued(replace(rest, q=1.0 + noise), swinging), sigma=sigma, period_s=PERIOD_S)
    assert [finding.check for finding in findings] == ["hold"]
    assert held.n == pytest.approx(swinging.n, abs=12)
    assert len(held.segments) == 1
    pushed = stepped(
        lambda t, q, v: -33.0 * q - 0.6 * v + 200.0 * (abs(t - 3.0) < 0.02), start=0.0, noise=0.003
    )
    for motion in (glued(swinging, rest), pushed, swinging):
        assert drop_holds(motion, sigma=sigma, period_s=PERIOD_S) == (motion, ())
