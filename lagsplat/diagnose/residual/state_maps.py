"""Positions and velocities at which the residual acts: maps, tested by flipping the signs of whole blocks."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float64, Int64
from scipy.ndimage import label

from lagsplat.diagnose.core.config import STATE_MAPS
from lagsplat.diagnose.residual.change_points import compute_sample_weights, number_blocks
from lagsplat.diagnose.residual.latent_force import (
    LatentForceEstimate,
    compute_relative_squares,
    join_signals,
)


@dataclass(frozen=True)
class StateRegion:
    """A connected set of bins of one coordinate in which the residual keeps its sign."""

    coordinate: int
    position: tuple[float, float]  # low, high
    velocity: tuple[float, float] | None  # low, high; None for a profile over position alone
    mean: float  # residual acceleration inside
    share: float  # of the coordinate's residual inside
    p: float  # chance of a cluster of as large a score in any map if blocks had random signs


@dataclass(frozen=True)
class StateMap:
    """Mean residual acceleration of one coordinate over bins; a profile has one velocity bin."""

    coordinate: int
    position_edges: np.ndarray
    velocity_edges: np.ndarray
    mean: np.ndarray  # (positions, velocities); NaN where fewer than two blocks went
    score: np.ndarray  # the same in standard errors; zero there


def find_state_regions(
    estimates: Sequence[LatentForceEstimate], *, period_s: float, seed: int = 0
) -> tuple[list[StateRegion], list[StateMap]]:
    """Find the regions of all coordinates, largest share first, and the maps in which they lie.

    Every coordinate with a kept force has a map over position and velocity and a profile over position. Each
    has its own distribution of the largest cluster; false findings are bounded by `STATE_MAPS.significance`
    over all of them together. With fewer than `STATE_MAPS.min_blocks` blocks no region is reported.
    ``period_s`` is the natural period [s], ``seed`` that of the signs.

    Source: Maris and Oostenveld (2007), cluster-based permutation.
    """
    block = number_blocks(estimates, period_s)
    n_blocks = int(block.max()) + 1
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (STATE_MAPS.sign_flips, n_blocks))
    weight = np.concatenate([compute_sample_weights(estimate) for estimate in estimates])
    square = np.concatenate(compute_relative_squares(estimates))
    q, v, residual = join_signals(estimates, "q", "v", "residual")
    coordinates = np.flatnonzero(estimates[0].active)
    shapes = ((STATE_MAPS.map_bins, STATE_MAPS.map_bins), (STATE_MAPS.profile_bins, 1))
    maps, regions = [], []
    for i, shape in product(coordinates, shapes):
        position_edges, row = _assign_bins(q[:, i], shape[0])
        velocity_edges, column = _assign_bins(v[:, i], shape[1])
        at, bins = row * shape[1] + column, shape[0] * shape[1]
        where = block * bins + at
        sums = np.bincount(where, weight * residual[:, i], minlength=n_blocks * bins).reshape(n_blocks, bins)
        visited = np.bincount(where, minlength=n_blocks * bins).reshape(n_blocks, bins) > 0
        enough = visited.sum(axis=0) >= 2
        spread = np.where(enough, np.maximum(np.sqrt(np.sum(sums**2, axis=0)), 1e-300), np.inf)
        time_s = np.bincount(at, weight, minlength=bins)
        mean = np.divide(sums.sum(axis=0), time_s, out=np.full(bins, np.nan), where=enough).reshape(shape)
        score = (sums.sum(axis=0) / spread).reshape(shape)
        maps.append(StateMap(int(i), position_edges, velocity_edges, mean, score))
        share = np.bincount(at, weight * square[:, i], minlength=bins).reshape(shape)
        if n_blocks >= STATE_MAPS.min_blocks:
            flipped = (signs @ sums / spread).reshape(-1, *shape)
            heaviest = np.array([_find_heaviest_cluster(scores) for scores in flipped])
            tests = len(coordinates) * len(shapes)
            regions += _select_regions(maps[-1], share / share.sum(), heaviest, tests)
    return sorted(regions, key=lambda region: -region.share), maps


def _assign_bins(
    values: np.ndarray, count: int
) -> tuple[Float64[np.ndarray, " edges"], Int64[np.ndarray, " n"]]:
    """Edges of even bins and the bin of each value.

    The bins lie between the 1 % and 99 % quantiles; the outermost are widened to hold the rest.
    """
    low, high = np.quantile(values, [0.01, 0.99])
    edges = np.linspace(low, high, count + 1)
    edges[0], edges[-1] = values.min(), values.max()
    return edges, np.clip(np.searchsorted(edges, values, side="right") - 1, 0, count - 1)


def _find_clusters(score: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """Connected bins of one sign whose scores are large, with their summed scores."""
    clusters = []
    for sign in (1.0, -1.0):
        numbers, count = label(sign * score > STATE_MAPS.cluster_standard_errors)
        if count:
            masses = np.bincount(numbers.ravel(), (sign * score).ravel())
            clusters += [(numbers == number, float(masses[number])) for number in range(1, count + 1)]
    return clusters


def _find_heaviest_cluster(score: np.ndarray) -> float:
    """Largest summed score of any cluster, zero without one."""
    return max((mass for _, mass in _find_clusters(score)), default=0.0)


def _select_regions(
    state_map: StateMap, share: np.ndarray, heaviest: np.ndarray, tests: int
) -> list[StateRegion]:
    """Clusters of a map that are larger than chance makes them.

    Args:
        state_map: the map.
        share: of the residual in each bin.
        heaviest: score of the largest cluster under each pattern of random signs.
        tests: number of maps tested, for Bonferroni's correction.
    """
    regions = []
    for inside, mass in _find_clusters(state_map.score):
        p = min(1.0, tests * (1.0 + np.sum(heaviest >= mass)) / (1.0 + len(heaviest)))
        if p > STATE_MAPS.significance:
            continue
        bounds = []
        for axis, edges in ((1, state_map.position_edges), (0, state_map.velocity_edges)):
            bins = np.flatnonzero(inside.any(axis=axis))
            bounds.append((float(edges[bins[0]]), float(edges[bins[-1] + 1])))
        position, velocity = bounds[0], None if len(state_map.velocity_edges) == 2 else bounds[1]
        mean, inner_share = float(np.mean(state_map.mean[inside])), float(share[inside].sum())
        region = StateRegion(state_map.coordinate, position, velocity, mean, inner_share, float(p))
        regions.append(region)
    return regions
