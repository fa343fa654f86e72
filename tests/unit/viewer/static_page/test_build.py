"""The page's own JavaScript against Python: the same motion, the same energies, the same grip."""

import re

import numpy as np
import pytest

from lagsplat.cli.main import main
from lagsplat.stage2.lagrangian import LawEdits
from lagsplat.stage2.numpy_lagrangian import NumpyLagrangian
from lagsplat.viewer.simulation.session import Session
from lagsplat.viewer.static_page.build import (
    LARGEST_BYTES,
    MECHANICS,
    pack_law,
    pack_page,
    render_page,
    save_page,
)
from tests.stage2_problems import random_lagrangian
from tests.unit.viewer.scripts import run_script
from tests.unit.viewer.sessions import session, strip, swing

SECONDS = 10.0
FORMS = {
    "default": {},
    "linear": {"mass": "constant", "damping": "constant", "potential": "quadratic", "actuation": "linear"},
    "convex": {"potential": "icnn", "actuation": "concave"},
    "signed": {"negative": 1.0},
    "polynomial": {"terms": "polynomial", "map_degree": 3},
}
LAW = """
const { law: data, q, v, u, loads, dt, edits } = JSON.parse(require("fs").readFileSync(0, "utf8"));
const law = lawOf(data);
Object.assign(law.edits, edits);
let state = [q, v];
const path = loads.map((load, i) => {
  const energies = [law.kinetic(...state), law.potential(state[0]), law.dissipatedPower(...state)];
  const before = [...state, energies];
  state = law.step(...state, u[i], load, dt);
  return before;
});
console.log(JSON.stringify(path));
"""
SESSION = """
const { run, at, drags } = JSON.parse(require("fs").readFileSync(0, "utf8"));
const session = new PageSession(run, lawOf(run.law), viewOf(run));
session.grasp(at);
const path = drags.map((drag) => {
  if (drag === null) session.release();
  else session.pull(drag);
  session.step();
  return session.q;
});
console.log(JSON.stringify({ path, unexplained: session.unexplained(), covered: uncovered(session.q,
run.coverage) }));
"""


@pytest.mark.parametrize(
    ("form", "d"),
    [("default", 1), ("default", 4), ("linear", 2), ("convex", 2), ("signed", 2), ("polynomial", 2)],
)
def test_ten_seconds_of_a_law_are_the_same_in_the_page(form: str, d: int) -> None:
    law = random_lagrangian(d, 2, 3, **FORMS[form])
    law.longest_step = 0.02 if d == 4 else 0.1  # these laws are stiff
    if law.energy is not None:
        law.energy.ball.mul_(0.1)  # so that the motion leaves it
    dt, edits = 1 / 30, LawEdits(damping=2.0, inertia=1.5, stiffness=0.8)
    steps, rng = round(SECONDS * 30), np.random.default_rng(d)
    loads = 0.3 * np.repeat(rng.normal(size=(steps // 30, d)), 30, axis=0)
    u = np.repeat(rng.uniform(size=(steps // 30, 2)), 30, axis=0) - 0.5 * (form == "signed")
    single = NumpyLagrangian(law, edits=edits)
    q, v = rng.normal(size=(2, d)) * 0.5
    data = {"law": pack_law(single), "q": q.tolist(), "v": v.tolist(), "u": u.tolist(), "dt": dt}
    data |= {"loads": loads.tolist(), "edits": vars(edits)}
    for got_q, got_v, energies in run_script(["law.js"], LAW, data):
        np.testing.assert_allclose(got_q, q, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(got_v, v, rtol=1e-7, atol=1e-7)
        wanted = [single.kinetic(q, v), single.potential(q), single.dissipated_power(q, v)]
        np.testing.assert_allclose(energies, wanted, rtol=1e-6, atol=1e-9)
        q, v = single.step(q, v, u[0], loads[0], dt_s=dt)
        u, loads = u[1:], loads[1:]


@pytest.mark.parametrize("make", [session, swing, strip], ids=["disc", "swing", "strip"])
def test_a_push_of_ten_seconds_is_the_same_in_the_page(make) -> None:
    one: Session = make()
    at, steps = (16.0, 8.0), round(SECONDS / one.dt_s)
    drags = [None if i > 0.6 * steps else [9.0 * np.sin(0.05 * i), 0.5] for i in range(steps)]
    data = {"run": pack_page(one), "at": at, "drags": drags}
    result = run_script(MECHANICS, SESSION, data)
    one.grasp(at)
    path = []
    for drag in drags:
        one.release() if drag is None else one.pull(np.array(drag))
        one.step()
        path.append(one.q)
    assert np.abs(path).max() > 0.01
    np.testing.assert_allclose(result["path"], path, atol=1e-9 * np.abs(path).max())
    assert result["unexplained"] == pytest.approx(one.snapshot().energy.error, rel=1e-6)
    assert result["covered"] == pytest.approx(one.snapshot().coverage_distance, rel=1e-6)


def test_the_page_loads_nothing_from_elsewhere(tmp_path) -> None:
    path = tmp_path / "push.html"
    save_page(path, session(), title="A <disc> & more", subtitle="</script><b>")
    page = path.read_text(encoding="utf-8")
    assert len(page) < LARGEST_BYTES
    assert "A &lt;disc&gt; &amp; more" in page
    assert "</script><b>" not in page
    assert re.findall(r"""(?:src|href)\s*=\s*["'](?!#)""", page) == []
    assert set(re.findall(r"https?://[^\s\"']*", page)) == {"http://www.w3.org/2000/svg"}
    assert "default-src 'none'" in page


def test_a_law_that_a_page_cannot_compute_is_refused() -> None:
    one = session()
    law = random_lagrangian(1, 1, 0, mass="induced")
    object.__setattr__(one.operating_point, "law", law)
    with pytest.raises(ValueError, match=r"push this (one )?with lagsplat view"):
        render_page(one, title="", subtitle="")


def test_the_export_command_names_what_is_missing(tmp_path, capsys) -> None:
    assert main(["export", str(tmp_path), "--html"]) == 2
    assert "no recording.safetensors there" in capsys.readouterr().err
    assert main(["export", str(tmp_path), "--pdf"]) == 2
    assert "unrecognized arguments: --pdf" in capsys.readouterr().err
