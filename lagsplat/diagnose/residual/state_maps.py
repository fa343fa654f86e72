"""Positions and velocities at which the residual acts: maps, tested by flipping the signs of whole blocks."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float64, Int64
from scipy.ndimage import generate_binary_structure, label

from lagsplat.diagnose.core.config import STATE_MAPS
from lagsplat.diagnose.residual.change_points import compute_sample_weights, number_blocks
from lagsplat.diagnose.residual.latent_force import (
    LatentForceEstimate,
    compute_relative_squares,
    join_signals,
)

WITHIN_MAP = generate_binary_structure(2, 1)[None] & np.array([False, True, False])[:, None, None]
"""Bins that touch each other, for `scipy.ndimage.label` of a stack of maps."""


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
        edges = _place_edges(q[:, i], shape[0]), _place_edges(v[:, i], shape[1])
        samples, bins = (block, q[:, i], v[:, i]), (np.arange(n_blocks + 1), *edges)
        sums = np.histogramdd(samples, bins, weights=weight * residual[:, i])[0]
        enough = np.sum(np.histogramdd(samples, bins)[0] > 0, axis=0) >= 2
        spread = np.where(enough, np.maximum(np.sqrt(np.sum(sums**2, axis=0)), 1e-300), np.inf)
        time_s, share = (
            np.histogram2d(q[:, i], v[:, i], edges, weights=x)[0] for x in (weight, weight * square[:, i])
        )
        mean = np.divide(sums.sum(axis=0), time_s, out=np.full(shape, np.nan), where=enough)
        maps.append(StateMap(int(i), *edges, mean, sums.sum(axis=0) / spread))
        if n_blocks >= STATE_MAPS.min_blocks:
            flipped = np.tensordot(signs, sums, 1) / spread
            tests = len(coordinates) * len(shapes)
            regions += _select_regions(maps[-1], share / share.sum(), flipped, tests)
    return sorted(regions, key=lambda region: -region.share), maps


def _place_edges(values: np.ndarray, count: int) -> Float64[np.ndarray, " edges"]:
    """Edges of even bins between the 1 % and 99 % quantiles; the outermost are widened to hold the rest."""
    low, high = np.quantile(values, [0.01, 0.99])
    edges = np.linspace(low, high, count + 1)
    edges[0], edges[-1] = values.min(), values.max()
    return edges


def _find_clusters(
    scores: Float64[np.ndarray, "M P V"],
) -> tuple[Int64[np.ndarray, "M P V"], Float64[np.ndarray, " clusters"]]:
    """Number of each bin's cluster in M maps, 0 outside of any, and the summed size of scores by number.

    A cluster is connected bins of one map and one sign whose scores are large.
    """
    numbers = np.zeros(scores.shape, dtype=np.int64)
    for sign in (1.0, -1.0):
        found, _ = label(sign * scores > STATE_MAPS.cluster_standard_errors, WITHIN_MAP)
        numbers += np.where(found > 0, found + numbers.max(), 0)
    mass = np.bincount(numbers.ravel(), np.abs(scores).ravel())
    mass[0] = 0.0
    return numbers, mass


def _select_regions(
    state_map: StateMap, share: np.ndarray, flipped: Float64[np.ndarray, "M P V"], tests: int
) -> list[StateRegion]:
    """Clusters of a map that are larger than chance makes them.

    Args:
        state_map: the map.
        share: of the residual in each bin.
        flipped: scores under each pattern of random signs.
        tests: number of maps tested, for Bonferroni's correction.
    """
    chance, masses = _find_clusters(flipped)
    heaviest = masses[chance].max(axis=(1, 2))
    numbers, masses = _find_clusters(state_map.score[None])
    regions = []
    for number in range(1, len(masses)):
        inside = numbers[0] == number
        p = min(1.0, tests * (1.0 + np.sum(heaviest >= masses[number])) / (1.0 + len(heaviest)))
        if p > STATE_MAPS.significance:
            continue
        bins = zip((state_map.position_edges, state_map.velocity_edges), np.nonzero(inside), strict=True)
        position, velocity = ((float(edges[at.min()]), float(edges[at.max() + 1])) for edges, at in bins)
        kept = None if len(state_map.velocity_edges) == 2 else velocity
        mean, inner_share = float(np.mean(state_map.mean[inside])), float(share[inside].sum())
        regions.append(StateRegion(state_map.coordinate, position, kept, mean, inner_share, float(p)))
    return regions
