"""Kernels of optic flow against readable twins, closed forms and finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from support.moving_texture import H, W, X, Y, limb_scene, moved, texture
from twistcap._typing import Bool, Float, Float32
from twistcap.flow import FlowSettings
from twistcap.flow.data import derivative_maps, motion_tensors
from twistcap.flow.expansion import expand
from twistcap.flow.matching import block_cost, match_blocks, parting_of
from twistcap.flow.pyramid import filled, level_shapes, pyramid, resized_flow
from twistcap.flow.search import searched
from twistcap.flow.settings import SearchSettings
from twistcap.flow.solver import assemble, data_weights, diffusivity, relax


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
        total += factor * np.sqrt(square + s.epsilon_data**2)[mask].sum()
    steps = np.zeros(mask.shape)
    for p, q in pairs_of(mask):
        square = (u[p] - u[q]) ** 2 + (v[p] - v[q]) ** 2
        steps[p] += 0.5 * square
        steps[q] += 0.5 * square
    smooth = np.sqrt(steps + s.epsilon_smooth**2) if s.smoothness == "robust" else steps
    return float(total + s.alpha * smooth[mask].sum())


@pytest.mark.parametrize("smoothness", ["robust", "homogeneous"])
def test_assembled_system_is_half_the_gradient_of_the_energy(smoothness: str) -> None:
    tensors, u0, v0, mask, step = random_problem()
    s = FlowSettings(smoothness=smoothness, alpha=0.7, gamma=2.0, epsilon_data=0.1, epsilon_smooth=0.1)
    u, v = u0 + step[0], v0 + step[1]
    g = diffusivity(u, v, mask, s.epsilon_smooth) if smoothness == "robust" else np.ones_like(u)
    data = data_weights(tensors, u - u0, v - v0, s.gamma, s.epsilon_data, True)
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


def sor_reference(coefficients: Float32, u: Float32, v: Float32, sweeps: int, omega: float) -> tuple[Float, Float]:
    """Readable twin of `relax`: whole red and black sweeps, one after the other."""
    u, v = u.astype(float), v.astype(float)
    for half in range(2 * sweeps):
        for r, c in np.ndindex(u.shape):
            here = coefficients[(r + c) & 1, r, :, c >> 1].astype(float)
            if (r + c) % 2 != half % 2 or here[2] == 0:
                continue
            s = here[:2].copy()
            for n, (i, j) in enumerate(((r, c - 1), (r, c + 1), (r - 1, c), (r + 1, c))):
                if here[5 + n] > 0:
                    s += here[5 + n] * np.array([u[i, j], v[i, j]])
            u[r, c] += omega * (here[2] * s[0] + here[3] * s[1] - u[r, c])
            v[r, c] += omega * (here[3] * s[0] + here[4] * s[1] - v[r, c])
    return u, v


@pytest.mark.parametrize("sweeps", [1, 4])
def test_relaxation_equals_whole_sweeps(sweeps: int) -> None:
    tensors, u, v, mask, _ = random_problem(1)
    data = data_weights(tensors, np.zeros_like(u), np.zeros_like(v), 1.0, 0.01, True)
    coefficients = assemble(data, u, v, diffusivity(u, v, mask, 0.01), 0.5, mask)
    expected = sor_reference(coefficients, u, v, sweeps, 1.7)
    relax(coefficients, u, v, sweeps, 1.7)
    np.testing.assert_allclose(u, expected[0], atol=2e-4)
    np.testing.assert_allclose(v, expected[1], atol=2e-4)


def cubic(image: Float, x: Float, y: Float) -> Float:
    """Readable twin of the look-up: Catmull and Rom in either direction, borders repeated."""

    def weights(t: Float) -> list[Float]:
        first, last = -0.5 * t + t**2 - 0.5 * t**3, -0.5 * t**2 + 0.5 * t**3
        return [first, 1 - 2.5 * t**2 + 1.5 * t**3, 0.5 * t + 2 * t**2 - 1.5 * t**3, last]

    i, j = np.floor(y).astype(int), np.floor(x).astype(int)
    out = np.zeros(x.shape)
    for a, wy in enumerate(weights(y - i)):
        for b, wx in enumerate(weights(x - j)):
            out += wy * wx * image[np.clip(i + a - 1, 0, H - 1), np.clip(j + b - 1, 0, W - 1)]
    return out


@pytest.mark.parametrize("zeta", [0.0, 0.01])
def test_motion_tensors_equal_their_twin(zeta: float) -> None:
    rng = np.random.default_rng(3)
    first, second = (derivative_maps(texture(X, Y, k)[..., None]) for k in (0, 1))
    u, v = rng.uniform(-9, 9, size=(2, H, W)).astype(np.float32)
    mask = rng.uniform(size=(H, W)) < 0.9
    tensors = motion_tensors(first, second, u, v, mask, 0, 0, zeta, 0.5)
    x, y = (X + u).astype(float), (Y + v).astype(float)
    seen = mask & (x >= 0) & (y >= 0) & (x <= W - 1) & (y <= H - 1)
    there = np.stack([cubic(second[0, ..., k].astype(float), x, y) for k in range(6)], axis=-1)
    here = first[0].astype(float)
    mean = 0.5 * (here + there)
    expected = np.zeros((H, 12, W))
    for term, gx, gy, t in ((0, 1, 2, 0), (6, 3, 4, 1), (6, 4, 5, 2)):
        row = np.stack([mean[..., gx], mean[..., gy], there[..., t] - here[..., t]], axis=-1)
        weight = seen / (row[..., 0] ** 2 + row[..., 1] ** 2 + zeta**2) if zeta else seen.astype(float)
        for n, (i, j) in enumerate([(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]):
            expected[:, term + n] += weight * row[..., i] * row[..., j]
    np.testing.assert_allclose(tensors, expected, atol=2e-4 * np.abs(expected).max())
    window = motion_tensors(
        np.ascontiguousarray(first[:, 20:60, 30:90]), second, u[20:60, 30:90].copy(), v[20:60, 30:90].copy(),
        mask[20:60, 30:90].copy(), 20, 30, zeta, 0.5,
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
        dy, dx = np.mgrid[-4:5:2, -4:5:2]
        inside = (r + dy >= 0) & (r + dy < H) & (c + dx >= 0) & (c + dx < W)
        dy, dx = dy[inside], dx[inside]
        dy, dx = dy[mask[r + dy, c + dx]], dx[mask[r + dy, c + dx]]
        x = np.floor(c + dx + u + label[2] * dx - label[3] * dy + 0.5).astype(int)
        y = np.floor(r + dy + v + label[3] * dx + label[2] * dy + 0.5).astype(int)
        seen = (x >= 0) & (y >= 0) & (x < W) & (y < H)
        d = np.clip(second[y[seen], x[seen], 0] - first[(r + dy)[seen], (c + dx)[seen], 0], -0.1, 0.1).astype(float)
        squares = (d**2).sum() - 0.9 * d.sum() ** 2 / max(len(d), 1e-6) + 0.01 * (~seen).sum()
        expected = np.sqrt(max(squares, 0.0) / 25)
        assert block_cost(first, second, mask, r, c, label, 2, 2, 0.1, 1e9) == pytest.approx(expected, abs=1e-4)


def total_energy(first: Float32, second: Float32, mask: Bool, nodes: Bool, labels: Float32) -> float:
    """Of all block costs and partings, as the search weighs them (step 4, half 2, spacing 2)."""
    places = [tuple(p) for p in np.argwhere(nodes)]
    data = sum(block_cost(first, second, mask, 4 * i, 4 * j, labels[i, j], 2, 2, 0.25, 1e9) for i, j in places)
    apart = sum(parting_of(labels[p], labels[q], q[1] - p[1], q[0] - p[0], 4, 0.01, 10.0) for p, q in pairs_of(nodes))
    return float(data + apart)


def test_expansion_and_matching_only_lower_the_energy() -> None:
    first, second, _, mask = limb_scene(22.0)
    a, b = first.astype(np.float32)[..., None], second[..., None]
    nodes = mask[::4, ::4].copy()
    rng = np.random.default_rng(0)
    table = rng.uniform(-0.7, 0.7, size=(997, 3)).astype(np.float32)
    blocks = (4, 2, 2, 40.0)

    def matched(start: Float32, apart: float, rounds: int) -> tuple[Float32, Float32]:
        return match_blocks(a, b, mask, nodes, start, table, *blocks, 0.5, 0.25, apart, 10.0, rounds, 8)

    start = np.zeros((*nodes.shape, 4), np.float32)
    labels, cost = matched(start, 0.01, 0)
    np.testing.assert_array_equal(labels, start)
    offered, _ = matched(labels, 0.0007, 3)
    before = total_energy(a, b, mask, nodes, labels)
    order = np.argwhere(nodes).astype(np.int32)
    assert expand(a, b, mask, nodes, labels, cost, offered, order, *blocks, 0.25, 0.01, 10.0, 10, 1.0) > 0
    between = total_energy(a, b, mask, nodes, labels)
    assert between < before - 0.01
    _, again = matched(labels, 0.01, 0)
    np.testing.assert_allclose(cost[nodes], again[nodes], atol=1e-6)
    polished, _ = matched(labels, 0.01, 2)
    assert total_energy(a, b, mask, nodes, polished) < between


def test_search_leaves_a_good_flow_alone() -> None:
    first, second, truth = moved(np.eye(2), np.array([6.0, -3.0]))
    mask = np.hypot(X - 60, Y - 48) < 25
    flow = searched(first[..., None], second[..., None], mask, truth, SearchSettings())
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
