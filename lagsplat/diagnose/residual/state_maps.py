"""Positions and velocities at which the residual acts: maps, tested by flipping the signs of whole blocks."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float64, Int64
from scipy.ndimage import label

from lagsplat.diagnose.core.config import RESIDUAL_FEATURES, STATE_MAPS
from lagsplat.diagnose.residual.change_points import compute_sample_weights
from lagsplat.diagnose.residual.latent_force import LatentForceEstimate, compute_relative_squares


@dataclass(frozen=True)
class StateRegion:
    """A connected set of bins of one coordinate in which the residual keeps its sign.

    ``position`` and ``velocity`` (low, high) bound it (velocity is None for a profile over position alone);
    ``mean`` is the residual acceleration inside, ``share`` the part of the coordinate's residual inside, and
    ``p`` the chance of a cluster of as large a score in any map if blocks had random signs.
    """

    coordinate: int
    position: tuple[float, float]
    velocity: tuple[float, float] | None
    mean: float
    share: float
    p: float


@dataclass(frozen=True)
class StateMap:
    """Mean residual acceleration of one coordinate over bins; NaN where fewer than two blocks went.

    ``mean`` and ``score`` (in standard errors) are (positions, velocities) between ``position_edges`` and
    ``velocity_edges``; a profile has one velocity bin.
    """

    coordinate: int
    position_edges: np.ndarray
    velocity_edges: np.ndarray
    mean: np.ndarray
    score: np.ndarray


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
    block = _number_blocks(estimates, period_s)
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (STATE_MAPS.sign_flips, block.max() + 1))
    weight = np.concatenate([compute_sample_weights(estimate) for estimate in estimates])
    square = np.concatenate(compute_relative_squares(estimates))
    state = [
        np.concatenate([getattr(estimate, name) for estimate in estimates]) for name in ("q", "v", "residual")
    ]
    coordinates = np.flatnonzero(estimates[0].active)
    shapes = ((STATE_MAPS.map_bins, STATE_MAPS.map_bins), (STATE_MAPS.profile_bins, 1))
    maps, regions = [], []
    for i, shape in product(coordinates, shapes):
        q, v, r = (values[:, i] for values in state)
        edges = _compute_edges(q, shape[0]), _compute_edges(v, shape[1])
        at = np.ravel_multi_index([_assign_bins(q, edges[0]), _assign_bins(v, edges[1])], shape)
        sums, visits = _sum_blocks(block, at, weight * r, int(np.prod(shape)))
        spread = np.maximum(np.sqrt(np.sum(sums**2, axis=0)), 1e-300)
        spread[visits < 2] = np.inf
        time_s = np.bincount(at, weight, minlength=len(spread))
        mean = np.divide(sums.sum(axis=0), time_s, out=np.full(len(spread), np.nan), where=visits >= 2)
        score = sums.sum(axis=0) / spread
        maps.append(StateMap(int(i), *edges, mean.reshape(shape), score.reshape(shape)))
        share = np.bincount(at, weight * square[:, i], minlength=len(spread)).reshape(shape)
        if block.max() + 1 >= STATE_MAPS.min_blocks:
            heaviest = np.array(
                [
                    _find_heaviest_cluster(scores)
                    for scores in (signs @ sums / spread).reshape(STATE_MAPS.sign_flips, *shape)
                ]
            )
            regions += _select_regions(
                maps[-1], share / share.sum(), heaviest, len(coordinates) * len(shapes)
            )
    return sorted(regions, key=lambda region: -region.share), maps


def _number_blocks(estimates: Sequence[LatentForceEstimate], period_s: float) -> Int64[np.ndarray, " n"]:
    """Number of each sample's block; a block lies within one motion."""
    numbers, first = [], 0
    for estimate in estimates:
        blocks = (
            np.cumsum(compute_sample_weights(estimate)) / (RESIDUAL_FEATURES.block_periods * period_s)
        ).astype(np.int64)
        numbers.append(first + blocks)
        first += int(blocks[-1]) + 1
    return np.concatenate(numbers)


def _compute_edges(values: np.ndarray, count: int) -> Float64[np.ndarray, " bins"]:
    """Edges of even bins between the 1 % and 99 % quantiles, the outermost widened to hold the rest."""
    low, high = np.quantile(values, [0.01, 0.99])
    edges = np.linspace(low, high, count + 1)
    edges[0], edges[-1] = values.min(), values.max()
    return edges


def _assign_bins(values: np.ndarray, edges: np.ndarray) -> Int64[np.ndarray, " n"]:
    """Number of each value's bin."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)


def _sum_blocks(
    block: np.ndarray, at: np.ndarray, values: np.ndarray, bins: int
) -> tuple[Float64[np.ndarray, "B bins"], Int64[np.ndarray, " bins"]]:
    """Sums of ``values`` by block and bin, and how many blocks went through each bin."""
    count = int(block.max()) + 1
    where = block * bins + at
    sums = np.bincount(where, values, minlength=count * bins).reshape(count, bins)
    went = np.bincount(where, minlength=count * bins).reshape(count, bins) > 0
    return sums, went.sum(axis=0)


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
    if np.abs(score).max() <= STATE_MAPS.cluster_standard_errors:
        return 0.0
    return max(mass for _, mass in _find_clusters(score))


def _select_regions(
    state_map: StateMap, share: np.ndarray, heaviest: np.ndarray, tests: int
) -> list[StateRegion]:
    """Clusters of a map that are larger than chance makes them.

    Args:
        state_map: the map.
        share: share of the residual in each bin.
        heaviest: score of the largest cluster under each pattern of random signs.
        tests: number of maps tested, for Bonferroni's correction.
    """
    regions = []
    for inside, mass in _find_clusters(state_map.score):
        p = min(1.0, tests * (1.0 + np.sum(heaviest >= mass)) / (1.0 + len(heaviest)))
        if p > STATE_MAPS.significance:
            continue
        rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
        profile = len(state_map.velocity_edges) == 2
        velocity = (
            float(state_map.velocity_edges[columns[0]]),
            float(state_map.velocity_edges[columns[-1] + 1]),
        )
        regions.append(
            StateRegion(
                coordinate=state_map.coordinate,
                position=(
                    float(state_map.position_edges[rows[0]]),
                    float(state_map.position_edges[rows[-1] + 1]),
                ),
                velocity=None if profile else velocity,
                mean=float(np.mean(state_map.mean[inside])),
                share=float(share[inside].sum()),
                p=float(p),
            )
        )
    return regions
