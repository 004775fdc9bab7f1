"""Kernels of optic flow against readable twins, closed forms and finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from support.moving_texture import H, W, X, Y, limb_scene, moved, texture
from support.twins import check_twin
from twistcap.arrays import Bool, Float, Float32
from twistcap.flow import FlowSettings
from twistcap.flow.data import derivative_maps, motion_tensors, motion_tensors_reference
from twistcap.flow.expansion import expand
from twistcap.flow.matching import BlockRule, block_cost, carried, is_node, match_blocks, parting_of, spread
from twistcap.flow.matching_reference import match_blocks_reference
from twistcap.flow.pyramid import filled, level_shapes, pyramid, resized_flow
from twistcap.flow.search import large_displacements
from twistcap.flow.settings import SearchSettings
from twistcap.flow.solver import assemble, data_weights, diffusivity, relax

EPSILON = 0.1


def random_problem(seed: int = 0) -> tuple[Float32, Float32, Float32, Bool, Float32]:
    rng = np.random.default_rng(seed)
    h, w = 13, 17
    tensors = np.zeros((h, 12, w), np.float32)
    for k in range(2):
        rows = rng.normal(size=(3, h, w, 3))
        J = np.einsum("nhwi,nhwj->hwij", rows, rows)
        for n, (i, j) in enumerate([(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]):
            tensors[:, 6 * k + n] = J[..., i, j]
    u, v = rng.normal(size=(2, h, w)).astype(np.float32)
    mask = rng.uniform(size=(h, w)) < 0.8
    return tensors, u, v, mask, rng.uniform(-0.5, 0.5, size=(2, h, w)).astype(np.float32)


def pairs_of(mask: Bool) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """All pairs of neighbours that both lie on the mask."""
    out = []
    for r, c in np.argwhere(mask):
        out += [
            ((r, c), q) for q in ((r + 1, c), (r, c + 1)) if q[0] < mask.shape[0] and q[1] < mask.shape[1] and mask[q]
        ]
    return out


def energy(tensors: Float, u0: Float, v0: Float, u: Float, v: Float, mask: Bool, s: FlowSettings) -> float:
    """Readable twin of the model on one warp."""
    w = np.stack([u - u0, v - v0, np.ones_like(u)], axis=-1)
    total = 0.0
    for k, factor in ((0, 1.0), (1, s.gamma)):
        J = tensors[:, 6 * k : 6 * k + 6].transpose(0, 2, 1)
        full = J[..., [0, 1, 3, 1, 2, 4, 3, 4, 5]].reshape(*J.shape[:2], 3, 3)
        square = np.einsum("hwi,hwij,hwj->hw", w, full, w)
        total += factor * np.sqrt(square + EPSILON**2)[mask].sum()
    steps = np.zeros(mask.shape)
    for p, q in pairs_of(mask):
        square = (u[p] - u[q]) ** 2 + (v[p] - v[q]) ** 2
        steps[p] += 0.5 * square
        steps[q] += 0.5 * square
    smooth = np.sqrt(steps + EPSILON**2)
    return float(total + s.alpha * smooth[mask].sum())


def test_assembled_system_is_half_the_gradient_of_the_energy() -> None:
    tensors, u0, v0, mask, step = random_problem()
    s = FlowSettings(alpha=0.7, gamma=2.0)
    u, v = u0 + step[0], v0 + step[1]
    g = diffusivity(u, v, mask, EPSILON)
    data = data_weights(tensors, u - u0, v - v0, s.gamma, EPSILON)
    coefficients = assemble(data, u0, v0, g, s.alpha, mask)
    args = [x.astype(float) for x in (tensors, u0, v0, u, v)]
    h = 1e-5
    for r, c in np.argwhere(mask):
        here = coefficients[(r + c) & 1, r, :, c >> 1].astype(float)
        block = np.linalg.inv([[here[2], here[3]], [here[3], here[4]]])
        around = sum(here[5 + n] * np.array([u[p], v[p]]) for n, p in
                     enumerate(((r, c - 1), (r, c + 1), (r - 1, c), (r + 1, c))) if here[5 + n] > 0)  # fmt: skip
        residual = block @ [u[r, c], v[r, c]] - here[:2] - around
        for k in range(2):
            plus, minus = [a.copy() for a in args], [a.copy() for a in args]
            plus[3 + k][r, c] += h
            minus[3 + k][r, c] -= h
            slope = (energy(*plus, mask, s) - energy(*minus, mask, s)) / (2 * h)
            assert residual[k] == pytest.approx(0.5 * slope, abs=2e-3)


@pytest.mark.parametrize("sweeps", [1, 4])
def test_relaxation_equals_whole_sweeps(sweeps: int) -> None:
    tensors, u, v, mask, _ = random_problem(1)
    data = data_weights(tensors, np.zeros_like(u), np.zeros_like(v), 1.0, 0.01)
    coefficients = assemble(data, u, v, diffusivity(u, v, mask, 0.01), 0.5, mask)
    check_twin(relax, coefficients, u, v, sweeps, 1.7, rtol=0, atol=2e-4)


@pytest.mark.parametrize("shape", [(13, 17), (1, 5), (6, 1)])
def test_the_system_is_that_of_the_twins(shape: tuple[int, int]) -> None:
    tensors, u, v, mask, step = random_problem(2)
    tensors, (u, v, mask, du, dv) = tensors[: shape[0], :, : shape[1]], (
        np.ascontiguousarray(x[: shape[0], : shape[1]]) for x in (u, v, mask, *step)
    )  # fmt: skip
    tensors = np.ascontiguousarray(tensors)
    g = diffusivity(u, v, mask, 0.1)
    for gamma in (2.0, 0.0):
        data = data_weights(tensors, du, dv, gamma, 0.1)
        check_twin(assemble, data, u, v, g, 0.7, mask, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("zeta", [0.0, 0.01])
def test_motion_tensors_equal_their_twin(zeta: float) -> None:
    rng = np.random.default_rng(3)
    first, second = (derivative_maps(texture(X, Y, k)[..., None]) for k in (0, 1))
    u, v = rng.uniform(-9, 9, size=(2, H, W)).astype(np.float32)
    mask = rng.uniform(size=(H, W)) < 0.9
    expected = motion_tensors_reference(first, second, u, v, mask, (0, 0), zeta, 0.5)
    check_twin(motion_tensors, first, second, u, v, mask, (0, 0), zeta, 0.5, rtol=0, atol=2e-4 * np.abs(expected).max())
    tensors = motion_tensors(first, second, u, v, mask, (0, 0), zeta, 0.5)
    window = motion_tensors(
        np.ascontiguousarray(first[:, 20:60, 30:90]), second, u[20:60, 30:90].copy(), v[20:60, 30:90].copy(),
        mask[20:60, 30:90].copy(), (20, 30), zeta, 0.5,
    )  # fmt: skip
    np.testing.assert_allclose(window, tensors[20:60, :, 30:90], atol=1e-6)


def test_derivatives_are_those_of_the_texture() -> None:
    maps = derivative_maps((0.5 + 0.4 * np.sin(0.3 * X + 0.2 * Y)).astype(np.float32)[..., None])[0, 8:-8, 8:-8]
    phase = (0.3 * X + 0.2 * Y)[8:-8, 8:-8]
    s, c = 0.4 * np.sin(phase), 0.4 * np.cos(phase)
    expected = [0.5 + s, 0.3 * c, 0.2 * c, -0.09 * s, -0.06 * s, -0.04 * s]
    np.testing.assert_allclose(maps, np.stack(expected, axis=-1), atol=2e-5)


def test_block_cost_equals_its_twin() -> None:
    rng = np.random.default_rng(4)
    first, second = (texture(X, Y, k)[..., None] for k in (0, 1))
    mask = rng.uniform(size=(H, W)) < 0.7
    for _ in range(50):
        r, c, angle = int(rng.integers(H)), int(rng.integers(W)), rng.uniform(-0.6, 0.6)
        u, v = rng.uniform(-12, 12, 2)
        label = np.float32([u, v, np.cos(angle) - 1, np.sin(angle)])
        check_twin(block_cost, first, second, mask, (r, c), label, (2, 2, 0.1), 1e9, atol=1e-4)


def test_motions_are_carried_and_compared_as_by_the_twins() -> None:
    rng = np.random.default_rng(6)
    for _ in range(20):
        labels, (x, y), bend = random_labels(rng, (2,)), rng.uniform(-9, 9, 2).astype(np.float32), rng.uniform(-1, 1)
        check_twin(parting_of, *labels, 1, 0, (4, 0.01, 10.0), atol=1e-6)
        check_twin(parting_of, *labels, 0, -1, (4, 1.0, 3.0), atol=1e-4)
        check_twin(carried, labels[0], x, y, np.float32(bend), np.zeros(4, np.float32), atol=1e-2)


def test_each_pixel_moves_with_its_nearest_node() -> None:
    labels = random_labels(np.random.default_rng(6), (3, 4))
    flow = spread(labels, 4, 13, 14)
    for (r, c), (i, j) in (((0, 0), (0, 0)), ((5, 6), (1, 2)), ((12, 13), (2, 3)), ((9, 1), (2, 0))):
        u, v, cosine, sine = labels[i, j]
        moved = np.array([[cosine, -sine], [sine, cosine]]) @ [c - 4 * j, r - 4 * i] + [u, v]
        np.testing.assert_allclose(flow[r, c], moved, atol=1e-4)


def test_nodes_are_told_from_places_off_the_grid() -> None:
    nodes = np.array([[True, False], [True, True]])
    for i, j in np.ndindex(4, 4):
        check_twin(is_node, nodes, i - 1, j - 1)


def random_labels(rng: np.random.Generator, shape: tuple[int, ...], size: float = 1.0) -> Float32:
    """Motions up to 12 px and 0.6 rad."""
    angle = size * rng.uniform(-0.6, 0.6, shape)
    shift = size * rng.uniform(-12, 12, (2, *shape))
    return np.stack([*shift, np.cos(angle) - 1.0, np.sin(angle)], axis=-1).astype(np.float32)


RULE = BlockRule(step=4, half=2, spacing=2, radius=40.0, turn=0.5, ceiling=0.25, apart=0.01, most_apart=10.0, draws=8)


def test_blocks_are_matched_and_limbs_expanded_as_by_the_twins() -> None:
    """Most scenes are alike, not all: a bend may leave each pixel where it is. Two motions are as good then, and
    rounding decides what follows.
    """
    assert sum(alike(seed) for seed in range(12)) >= 8


def alike(seed: int) -> bool:
    """Whether the kernels do the same as their twins in a scene."""
    rng, rule = np.random.default_rng(seed), RULE._replace(half=3, radius=8.0, draws=3)
    first, second = (texture(X, Y, k)[:16, :20, None].copy() for k in (0, 1))
    images = (first, second, rng.uniform(size=first.shape[:2]) < 0.9)
    nodes = rng.uniform(size=(4, 5)) < 0.8
    start, table = random_labels(rng, nodes.shape, 0.3), rng.uniform(-0.7, 0.7, (97, 3)).astype(np.float32)
    labels, cost = match_blocks(images, nodes, start, table, rule, 2)
    _, start_cost = match_blocks(images, nodes, start, table, rule, 0)
    assert np.abs(labels - start)[nodes].max() > 1.0
    order, proposed = np.argwhere(nodes).astype(np.int32)[rng.permutation(nodes.sum())], random_labels(rng, nodes.shape)
    proposed[::2] = labels[::2]
    expansion = (images, nodes, start, start_cost, proposed, order, rule, (2, 1.0))
    assert 0 < expand(*expansion[:2], start.copy(), start_cost.copy(), *expansion[4:]) < len(order)
    twin, twin_cost = match_blocks_reference(images, nodes, start, table, rule, 2)
    np.testing.assert_allclose(cost[nodes].sum(), twin_cost[nodes].sum(), rtol=0.1)
    if not np.allclose(labels, twin, 1e-3, 1e-3):
        return False
    np.testing.assert_allclose(cost, twin_cost, rtol=1e-3, atol=1e-3)
    check_twin(expand, *expansion, rtol=1e-3, atol=1e-3)
    return True


def total_energy(first: Float32, second: Float32, mask: Bool, nodes: Bool, labels: Float32) -> float:
    """Of all block costs and partings, as the search weighs them (step 4, half 2, spacing 2)."""
    places = [tuple(p) for p in np.argwhere(nodes)]
    data = sum(block_cost(first, second, mask, (4 * i, 4 * j), labels[i, j], (2, 2, 0.25), 1e9) for i, j in places)
    apart = sum(parting_of(labels[p], labels[q], q[1] - p[1], q[0] - p[0], (4, 0.01, 10.0)) for p, q in pairs_of(nodes))
    return float(data + apart)


def test_expansion_and_matching_only_lower_the_energy() -> None:
    first, second, _, mask = limb_scene(22.0)
    a, b = first.astype(np.float32)[..., None], second[..., None]
    nodes = mask[::4, ::4].copy()
    rng = np.random.default_rng(0)
    table = rng.uniform(-0.7, 0.7, size=(997, 3)).astype(np.float32)
    images = (a, b, mask)

    def matched(start: Float32, apart: float, rounds: int) -> tuple[Float32, Float32]:
        return match_blocks(images, nodes, start, table, RULE._replace(apart=apart), rounds)

    start = np.zeros((*nodes.shape, 4), np.float32)
    labels, cost = matched(start, 0.01, 0)
    np.testing.assert_array_equal(labels, start)
    proposed, _ = matched(labels, 0.0007, 3)
    before = total_energy(a, b, mask, nodes, labels)
    order = np.argwhere(nodes).astype(np.int32)
    assert expand(images, nodes, labels, cost, proposed, order, RULE, (10, 1.0)) > 0
    between = total_energy(a, b, mask, nodes, labels)
    assert between < before - 0.01
    _, again = matched(labels, 0.01, 0)
    np.testing.assert_allclose(cost[nodes], again[nodes], atol=1e-6)
    polished, _ = matched(labels, 0.01, 2)
    assert total_energy(a, b, mask, nodes, polished) < between


def test_search_leaves_a_good_flow_alone() -> None:
    first, second, truth = moved(np.eye(2), np.array([6.0, -3.0]))
    mask = np.hypot(X - 60, Y - 48) < 25
    flow = large_displacements(first[..., None], second[..., None], mask, truth, SearchSettings())
    assert np.linalg.norm(flow - truth, axis=-1)[mask].mean() < 0.6  # whole pixels are compared


def test_pyramid_keeps_places() -> None:
    """An affine image stays affine, at pixel centres (CONVENTIONS.md), and a flow its vectors."""
    image = (0.004 * X + 0.002 * Y).astype(np.float32)[..., None]
    shapes = level_shapes((H, W), 0.5, 16)
    assert shapes == [(96, 120), (48, 60), (24, 30)]
    for level in pyramid(image, shapes, 0.6):
        h, w = level.shape[:2]
        y, x = np.mgrid[:h, :w]
        expected = 0.004 * ((x + 0.5) * W / w - 0.5) + 0.002 * ((y + 0.5) * H / h - 0.5)
        np.testing.assert_allclose(level[4:-4, 4:-4, 0], expected[4:-4, 4:-4], atol=1e-3)
    flow = np.broadcast_to(np.float32([4.0, 2.0]), (H, W, 2)).astype(np.float32)
    np.testing.assert_allclose(resized_flow(flow, (48, 60)), 0.5 * flow[:48, :60], rtol=1e-6)


def test_filled_takes_the_nearest() -> None:
    mask = np.zeros((9, 9), bool)
    mask[4, 2] = mask[4, 6] = True
    flow = np.zeros((9, 9, 2), np.float32)
    flow[4, 2], flow[4, 6] = (1, 2), (3, 4)
    out = filled(flow, mask)
    np.testing.assert_array_equal(out[:, :4], np.broadcast_to(np.float32([1, 2]), (9, 4, 2)))
    np.testing.assert_array_equal(out[:, 5:], np.broadcast_to(np.float32([3, 4]), (9, 4, 2)))
