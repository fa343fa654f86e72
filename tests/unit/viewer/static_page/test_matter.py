"""The matter of a page against Python: places and ways of its points, grips, arcs, and the background."""

import numpy as np
import pytest
import torch

from lagsplat.forces.grasp import grasp_brush
from lagsplat.matter.body_motion import BodyMotion
from lagsplat.matter.field import MatterField
from lagsplat.monomials import list_exponents
from lagsplat.viewer.static_page.build import MECHANICS, pack_matter, pack_page
from tests.unit.forces.rocking import CONTACT, WIDTH
from tests.unit.viewer.scripts import run_script
from tests.unit.viewer.sessions import session, strip, swing, uncertain

MOVE = """
const data = JSON.parse(require("fs").readFileSync(0, "utf8"));
const { clicked, at, radius, force, rate, states } = data;
const matter = new Matter(data.matter);
const grip = Object.assign(matter.brush(clicked, at, radius), { force });
console.log(JSON.stringify(states.map((q) => ({
  places: matter.carry(q), rates: matter.rates(q, rate, matter.all), place: grip.place(q), load: grip.load(q)
}))));
"""
HOLD = """
const { run, at, drag, steps } = JSON.parse(require("fs").readFileSync(0, "utf8"));
const session = new PageSession(run, lawOf(run.law), viewOf(run));
const grip = session.grasp(at);
session.pull(drag);
const banners = new Set();
const path = Array.from({ length: steps }, () => {
  session.step();
  banners.add(session.banner());
  return [session.q[0], grip.place(session.q), grip.load(session.q)];
});
const { force, isBackground } = grip;
console.log(JSON.stringify({ path, force, isBackground, banners: Array.from(banners) }));
"""
SPREAD = """
const { run, at, drag } = JSON.parse(require("fs").readFileSync(0, "utf8"));
const session = new PageSession(run, lawOf(run.law), viewOf(run));
const grip = session.grasp(at);
session.pull(drag);
const covariance = grip.covariance();
const largest = largestEigenvalue(covariance);
console.log(JSON.stringify({ covariance, isUndetermined: grip.isUndetermined(), largest }));
"""


def random_body(points: torch.Tensor, *, bending: int, seed: int) -> BodyMotion:
    """A body of two coordinates that turns, or bends, by much more than a little."""
    generator, n = torch.Generator().manual_seed(seed), points.shape[1]
    wide = n * len(list_exponents(n, lowest=0, highest=bending)) if bending else n * (n + 1) // 2
    coefficients = 0.5 * torch.randn(9, wide, generator=generator, dtype=torch.float64)
    ball = torch.tensor([0.1, -0.2, 1.0], dtype=torch.float64)
    return BodyMotion(points.mean(0), 7.0, bending, 3, ball, coefficients)


@pytest.mark.parametrize("space", [2, 3])
def test_points_and_grips_of_a_page_move_as_in_python(space: int) -> None:
    generator = torch.Generator().manual_seed(space)
    points = 20.0 * torch.rand(60, space, generator=generator, dtype=torch.float64)
    body = torch.arange(60) % 3
    bodies = tuple(random_body(points[body == i], bending=i, seed=i) for i in range(3))
    matter = MatterField(bodies, points, body)
    clicked, rate = torch.tensor([[0.4, -0.3], [0.7, -1.1]]).double()
    at, force = tuple(matter.carry(clicked[None])[0, 7].tolist()), torch.arange(1.0, space + 1).double()
    states = torch.tensor([[0.0, 0.0], [0.1, -0.2], [1e-8, 0.0], [0.5, 0.6], [-2.0, 1.5]]).double()
    data = {"matter": pack_matter(matter), "clicked": clicked.tolist(), "at": at, "radius": 4.0}
    data |= {"force": force.tolist(), "rate": rate.tolist(), "states": states.tolist()}
    grasp = grasp_brush(matter, clicked, at, radius=4.0)
    for q, got in zip(states, run_script(["law.js", "matter.js"], MOVE, data), strict=True):
        np.testing.assert_allclose(got["places"], matter.carry(q[None])[0], atol=1e-10)
        np.testing.assert_allclose(got["rates"], matter.jacobian(q) @ rate, atol=1e-8)
        np.testing.assert_allclose(got["place"], grasp.place(q), atol=1e-10)
        np.testing.assert_allclose(got["load"], grasp.pull_back(force, q), atol=1e-8)


def hold(one, at: tuple[float, float], drag: tuple[float, float], *, steps: int) -> dict:
    """What a page does while matter is held by a drag."""
    data = {"run": pack_page(one), "at": at, "drag": drag, "steps": steps}
    result = run_script(MECHANICS, HOLD, data)
    assert isinstance(result, dict)
    return result


def test_a_grip_goes_on_an_arc_and_its_load_changes_with_the_state() -> None:
    arm, loads = np.array([0.0, -11.0]), []
    result = hold(swing(), (16.0, 8.0), (12.0, 6.0), steps=60)
    for angle, place, load in result["path"]:
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        np.testing.assert_allclose(place, CONTACT + turn @ arm, atol=1e-3)
        quarter = turn @ np.array([-arm[1], arm[0]])
        np.testing.assert_allclose(load, [quarter @ result["force"]], rtol=1e-4)
        loads.append(load[0])
    assert max(angle for angle, _, _ in result["path"]) > 0.5
    assert np.ptp(loads) > 0.1 * np.max(loads)


def test_a_grip_of_the_background_never_moves_anything() -> None:
    one = session()
    result = hold(one, (2.0, 3.0), (1e3, -1e3), steps=30)
    assert result["isBackground"]
    assert result["banners"] == [""]
    for q, place, load in result["path"]:
        assert (q, place, load) == (float(one.operating_point.rest), [2.0, 3.0], [0.0])


def test_a_drag_as_long_as_the_image_goes_beyond_the_recording_and_does_not_diverge() -> None:
    assert hold(session(), (16.0, 8.0), (0.3, 0.0), steps=120)["banners"] == [""]
    for make in (session, swing):
        at_rest, beyond = hold(make(), (16.0, 8.0), (WIDTH, 0.0), steps=120)["banners"]
        assert at_rest == ""
        assert "Beyond the recording" in beyond


@pytest.mark.parametrize("make", [session, swing, strip], ids=["disc", "swing", "strip"])
def test_the_force_of_a_drag_is_the_one_of_python(make) -> None:
    for y, drag in ((8.0, (0.3, 0.2)), (8.0, (0.0, 0.0)), (8.0, (32.0, 3.0)), (17.0, (2.0, -1.0))):
        one = make()
        result = hold(one, (16.0, y), drag, steps=0)
        one.grasp((16.0, y))
        one.pull(np.array(drag))
        np.testing.assert_allclose(result["force"], one.active_grasp.force, rtol=1e-9)


@pytest.mark.parametrize("deviation", [0.1, 3.0])
def test_the_spread_of_an_answer_is_the_one_of_python(deviation: float) -> None:
    one, at, drag = uncertain(deviation), (16.0, 20.0), (1.0, 8.0)
    result = run_script(MECHANICS, SPREAD, {"run": pack_page(one), "at": at, "drag": drag})
    one.grasp(at)
    one.pull(np.array(drag))
    np.testing.assert_allclose(result["covariance"], one.active_grasp.covariance, rtol=1e-9)
    assert result["isUndetermined"] == one.active_grasp.is_undetermined == (deviation > 1.0)
    assert result["largest"] == pytest.approx(np.linalg.eigvalsh(one.active_grasp.covariance)[-1])
