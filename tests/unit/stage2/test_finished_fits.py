"""Fits of a law that were stopped: they go on after the last finished one, and end with the same bits."""

import logging
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from lagsplat.stage2 import fit as dynamics_fit
from lagsplat.stage2.config import LikelihoodConfig, Stage2Config
from lagsplat.stage2.finished_fits import FinishedFits
from lagsplat.stage2.fit import FitReport, fit_dynamics
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.likelihood.multiple_shooting import MultipleShooting
from tests.stage2_problems import form
from tests.unit.stage2.test_fit import config
from tests.unit.stage2.test_likelihood import POLYNOMIAL, record_motion

SHORT = LikelihoodConfig(300, 3, 1.3, 2)
NETWORKS = form(matrix_width=4, potential_width=4, diffeo_width=4, actuation_width=4, map_degree=2)
MOTION = record_motion(hardening=0.15)


def fit(settings: Stage2Config, path: Path, identity: str = "a") -> tuple[Lagrangian, FitReport]:
    recall = FinishedFits(path, identity=identity)
    return fit_dynamics(
        MOTION.smoothed(1.5), np.eye(1), settings, 0, rest=np.zeros(1), measured=MOTION, recall=recall
    )


def assert_same(one: tuple[Lagrangian, FitReport], other: tuple[Lagrangian, FitReport]) -> None:
    for (name, a), (again, b) in zip(one[0].state_dict().items(), other[0].state_dict().items(), strict=True):
        assert name == again
        assert torch.equal(a, b), name
    rows, others = ([astuple(row)[:-1] for row in report.curve] for _, report in (one, other))
    np.testing.assert_equal(rows, others)  # a loss may be nan
    assert one[1].scores == other[1].scores
    np.testing.assert_array_equal(one[1].draws, other[1].draws)


def test_a_stopped_fit_goes_on_and_ends_with_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    settings, path = config(form=POLYNOMIAL, likelihood=SHORT), tmp_path / "checkpoint" / "state.pt"
    solve, begun, last = MultipleShooting.fit, [], 999

    def count(problem: MultipleShooting, *words: object, **more: object) -> object:
        begun.append(problem)
        if len(begun) > last:
            raise KeyboardInterrupt
        return solve(problem, *words, **more)

    monkeypatch.setattr(MultipleShooting, "fit", count)
    undisturbed = fit(settings, tmp_path / "whole.pt")
    steps, last = len(begun), 4
    begun.clear()
    with pytest.raises(KeyboardInterrupt):
        fit(settings, path)
    last = 999
    begun.clear()
    assert_same(fit(settings, path), undisturbed)
    assert "after 4 finished fits" in caplog.text
    assert len(begun) == steps - 4 > 0


def test_networks_that_were_stopped_go_on_as_well(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = config(form=NETWORKS, likelihood=SHORT)
    settings = replace(settings, start=replace(settings.start, source="likelihood"))
    undisturbed = fit(settings, tmp_path / "whole.pt")
    with monkeypatch.context() as patched:
        patched.setattr(dynamics_fit, "fit_networks", interrupt)
        with pytest.raises(KeyboardInterrupt):
            fit(settings, tmp_path / "state.pt")
    monkeypatch.setattr(dynamics_fit, "project_law", interrupt)  # which had finished
    assert_same(fit(settings, tmp_path / "state.pt"), undisturbed)


def interrupt(*_: object, **__: object) -> float:
    raise KeyboardInterrupt


def test_fits_of_another_identity_are_not_taken(tmp_path: Path) -> None:
    path, made = tmp_path / "state.pt", iter(range(9))
    for identity, expected in (("a", [0, 1]), ("a", [0, 1]), ("b", [2, 3])):
        finished = FinishedFits(path, identity=identity)
        assert [finished(lambda: {"x": next(made)})["x"] for _ in range(2)] == expected
