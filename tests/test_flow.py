"""Optic flow: known motions, the mask's boundary, motion edges, kernels against readable twins, Middlebury."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from twistcap._typing import Bool, Float, Float32
from twistcap.errors import InputError
from twistcap.flow import BROX_2004, CHAPTER, PRESETS, FlowSettings, flow_confidence, moved_mask, optical_flow
from twistcap.flow.data import derivative_maps, motion_tensors
from twistcap.flow.expansion import expand
from twistcap.flow.matching import block_cost, match_blocks, parting_of
from twistcap.flow.pyramid import filled, level_shapes, pyramid, resized_flow
from twistcap.flow.search import searched
from twistcap.flow.settings import SearchSettings
from twistcap.flow.solver import assemble, data_weights, diffusivity, relax

H, W = 96, 120
Y, X = np.mgrid[:H, :W].astype(float)
MIDDLE = np.array([(W - 1) / 2, (H - 1) / 2])


def texture(x: Float, y: Float, seed: int = 0) -> Float32:
    """Smooth analytic texture at any place, in [0, 1]: the same places give the same values."""
    rng = np.random.default_rng(seed)
    total = np.zeros_like(x)
    for _ in range(40):
        k = rng.normal(size=2) * rng.choice([0.12, 0.3, 0.6])
        total += rng.uniform(0.5, 1.0) * np.cos(k[0] * x + k[1] * y + rng.uniform(0, 2 * np.pi))
    return (0.5 + 0.035 * total).astype(np.float32)


def moved(matrix: Float, shift: Float) -> tuple[Float32, Float32, Float32]:
    """Two images and the flow (H, W, 2) of the affine motion x -> A (x - middle) + middle + shift."""
    place = np.stack([X, Y], axis=-1) - MIDDLE
    flow = place @ (matrix - np.eye(2)).T + shift
    back = (place - shift) @ np.linalg.inv(matrix).T + MIDDLE
    return texture(X, Y), texture(back[..., 0], back[..., 1]), flow.astype(np.float32)


def error(flow: Float32, truth: Float32, where: Bool | None = None) -> float:
    """Mean endpoint error, 6 px from the image's border."""
    inside = np.zeros(flow.shape[:2], bool)
    inside[6:-6, 6:-6] = True
    inside &= True if where is None else where
    return float(np.linalg.norm(flow - truth, axis=-1)[inside].mean())


def turn(degrees: float) -> Float:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, -s], [s, c]])


MOTIONS = {
    "whole pixels": (np.eye(2), np.array([3.0, -2.0])),
    "parts of a pixel": (np.eye(2), np.array([0.3, 0.45])),
    "far": (np.eye(2), np.array([11.0, 6.5])),
    "turn": (turn(3.0), np.zeros(2)),
    "zoom": (1.04 * np.eye(2), np.zeros(2)),
}


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize(("settings", "bound"), [("accurate", 0.05), ("fast", 0.12)])
def test_known_motion_of_a_smooth_texture(name: str, settings: str, bound: float) -> None:
    first, second, truth = moved(*MOTIONS[name])
    assert error(optical_flow(first, second, preset=settings), truth) < bound


@pytest.mark.parametrize("settings", [BROX_2004, CHAPTER], ids=["2004", "chapter"])
def test_published_forms_find_a_known_motion(settings: FlowSettings) -> None:
    first, second, truth = moved(turn(2.0), np.array([2.5, -1.5]))
    assert error(optical_flow(first, second, settings=settings), truth) < 0.1


def test_channels_decide_together_and_bytes_are_as_good_as_floats() -> None:
    """Each channel alone shows a grating and so half of the motion; both together show all of it."""
    shift = np.array([1.5, -1.0])
    channels = [np.stack([0.5 + 0.3 * np.sin(0.4 * (x - d[0])), 0.5 + 0.3 * np.sin(0.4 * (y - d[1]))], axis=-1)
                for x, y, d in ((X, Y, np.zeros(2)), (X, Y, shift))]  # fmt: skip
    truth = np.broadcast_to(shift, (H, W, 2)).astype(np.float32)
    both = optical_flow(channels[0], channels[1])
    assert error(both, truth) < 0.03
    assert error(optical_flow(channels[0][..., 0], channels[1][..., 0]), truth) > 0.5
    quantised = optical_flow(*(np.rint(255 * c).astype(np.uint8) for c in channels))
    assert error(quantised, truth) < 0.05


def test_a_change_of_light_is_survived_by_the_gradient_alone() -> None:
    first, second, truth = moved(np.eye(2), np.array([2.0, 1.0]))
    brighter = second + np.float32(0.08)
    assert error(optical_flow(first, brighter), truth) < 0.05
    blind = replace(PRESETS["accurate"], gamma=0.0)
    assert error(optical_flow(first, brighter, settings=blind), truth) > 0.3


def split_scene(apart: float = 4.0) -> tuple[Float32, Float32, Float32, Bool]:
    """Left half moves right by `apart` / 2, the right half left: the truth, and the mask of the left half."""
    left = X < W / 2
    flow = np.stack([np.where(left, apart / 2, -apart / 2), np.zeros((H, W))], axis=-1).astype(np.float32)
    seen = X < W / 2  # the middle closes up: what is left of it in the second image was left before
    second = np.where(seen, texture(X - apart / 2, Y), texture(X + apart / 2, Y, seed=1))
    return np.where(left, texture(X, Y), texture(X, Y, seed=1)), second.astype(np.float32), flow, left


def test_robust_smoothness_keeps_a_motion_edge_sharper() -> None:
    first, second, truth, _ = split_scene()
    band = (np.abs(X - W / 2) > 3) & (np.abs(X - W / 2) < 14)
    robust = replace(PRESETS["accurate"], median=0)
    homogeneous = replace(robust, smoothness="homogeneous", alpha=3.0)
    errors = [error(optical_flow(first, second, settings=s), truth, band) for s in (robust, homogeneous)]
    assert errors[0] < 0.15
    assert errors[1] > 3 * errors[0]


@pytest.mark.parametrize("smoothness", ["robust", "homogeneous"])
def test_motion_outside_the_mask_does_not_leak_in(smoothness: str) -> None:
    """The same left half beside a right half that moves otherwise, or as it does itself."""
    settings = replace(PRESETS["accurate"], smoothness=smoothness, search=None, alpha=3.0, median=0)
    first, second, truth, mask = split_scene()
    with_it = (
        np.where(mask, texture(X, Y), texture(X, Y, seed=1)),
        np.where(mask, texture(X - 2, Y), texture(X - 2, Y, seed=1)),
    )
    inner = mask & (X < W / 2 - 8)  # derivatives of the images themselves see a few pixels across
    far = inner & (X > W / 2 - 20)
    if smoothness == "homogeneous":
        settings = replace(settings, robust_data=False, alpha=300.0)  # smoothness reaches far
    against = optical_flow(first, second, mask=mask, settings=settings)
    along = optical_flow(*(i.astype(np.float32) for i in with_it), mask=mask, settings=settings)
    unmasked = optical_flow(first, second, settings=settings)
    assert error(against, along, far) < 0.1
    assert error(against, truth, inner) < 0.1
    if smoothness == "homogeneous":
        assert error(unmasked, truth, far) > 0.5


def test_the_linear_system_does_not_know_what_lies_off_the_mask() -> None:
    """One outer fixed point: exactly the same inside whatever flow and image lie outside."""
    rng = np.random.default_rng(0)
    mask = np.hypot(X - 60, Y - 48) < 30
    tensors = rng.normal(size=(H, 12, W)).astype(np.float32) ** 2
    flows = [rng.normal(size=(2, H, W)).astype(np.float32) for _ in range(2)]
    flows[1][:, mask] = flows[0][:, mask]
    out = []
    for u, v in flows:
        g = diffusivity(u, v, mask, 0.001)
        data = data_weights(tensors, np.zeros_like(u), np.zeros_like(v), 1.0, 0.001, True)
        relax(assemble(data, u, v, g, 1.0, mask), u, v, 7, 1.8)
        out.append((u[mask], v[mask]))
    np.testing.assert_array_equal(out[0], out[1])


def limb_scene(degrees: float) -> tuple[Float32, Float32, Float32, Bool]:
    """A textured bar of 11 px turns about its upper end before a still background."""
    hinge = np.array([60.0, 12.0])
    flow = (np.stack([X, Y], axis=-1) - hinge) @ (turn(degrees) - np.eye(2)).T
    mask = (np.abs(X - 60) <= 5) & (Y >= 12) & (Y <= 76)
    before = np.stack([X, Y], axis=-1) - hinge
    back = before @ turn(degrees) + hinge  # inverse turn
    there = (np.abs(back[..., 0] - 60) <= 5) & (back[..., 1] >= 12) & (back[..., 1] <= 76)
    behind = texture(X, Y, seed=2)
    second = np.where(there, texture(back[..., 0], back[..., 1]), behind)
    return np.where(mask, texture(X, Y), behind), second.astype(np.float32), flow.astype(np.float32), mask


@pytest.mark.parametrize(("preset", "degrees"), [("accurate", 22.0), ("fast", 14.0)])
def test_a_limb_may_move_farther_than_it_is_wide(preset: str, degrees: float) -> None:
    """A bar of 11 px whose end moves by 16 or 25 px."""
    first, second, truth, mask = limb_scene(degrees)
    assert np.linalg.norm(truth[mask], axis=-1).max() > 15
    flow = optical_flow(first, second, mask=mask, preset=preset)
    without = optical_flow(first, second, mask=mask, settings=replace(PRESETS[preset], search=None))
    tip = mask & (Y > 45)
    assert error(flow, truth, tip) < 1.5
    assert error(without, truth, tip) > 3.0
    np.testing.assert_array_equal(flow, optical_flow(first, second, mask=mask, preset=preset))


def test_an_initial_flow_is_a_start() -> None:
    first, second, truth = moved(np.eye(2), np.array([25.0, 0.0]))
    few = replace(PRESETS["accurate"], least_size=60, search=None)
    where = X < W - 40
    assert error(optical_flow(first, second, settings=few), truth, where) > 5.0
    assert error(optical_flow(first, second, settings=few, initial=truth + np.float32(0.7)), truth, where) < 0.05


def test_confidence_falls_where_the_second_image_hides_the_first() -> None:
    still, hidden = X < 40, (X > 70) & (X < 77)
    bar = [np.abs(X - 65 - d) < 5 for d in (0, 8)]  # it comes to cover what is hidden
    first, second = (np.where(b, texture(X - d, Y, seed=1), texture(X, Y)).astype(np.float32)
                     for b, d in zip(bar, (0, 8), strict=True))  # fmt: skip
    confidence = flow_confidence(optical_flow(first, second), optical_flow(second, first))
    assert confidence[still].mean() > 0.9
    assert confidence[hidden].mean() < 0.5 * confidence[still].mean()
    exact = np.broadcast_to(np.float32([2.0, 1.0]), (H, W, 2)).astype(np.float32)
    np.testing.assert_allclose(flow_confidence(exact, -exact)[: H - 2, : W - 3], 1.0)
    assert flow_confidence(exact, -exact)[:, -1].max() == 0.0


def test_moved_mask_follows_the_flow() -> None:
    mask = np.zeros((20, 20), bool)
    mask[5:10, 5:10] = True
    flow = np.zeros((20, 20, 2), np.float32)
    flow[...] = (3.0, -2.0)
    np.testing.assert_array_equal(moved_mask(mask, flow), np.roll(mask, (-2, 3), axis=(0, 1)))


# --- kernels against readable twins -------------------------------------------------------------------------------


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


# --- bad input ----------------------------------------------------------------------------------------------------


def test_bad_input_is_told() -> None:
    image = texture(X, Y)
    broken = image.copy()
    broken[3, 4] = np.nan
    mask = np.ones((H, W), bool)
    for kwargs, images, word in (
        ({}, (image, image[:-1]), "same size"),
        ({}, (broken, image), "first image has values that are not finite"),
        ({}, (image, broken), "second image has values that are not finite"),
        ({}, (image[:0], image[:0]), "size"),
        ({}, (image[0], image[0]), "size"),
        ({"mask": mask[:-1]}, (image, image), "the mask has size"),
        ({"mask": ~mask}, (image, image), "no pixel"),
        ({"preset": "best"}, (image, image), "preset is 'best'"),
        ({"initial": np.zeros((H, W))}, (image, image), "initial flow"),
        ({"initial": np.full((H, W, 2), np.inf)}, (image, image), "initial flow"),
        ({"settings": FlowSettings(alpha=0.0)}, (image, image), "alpha"),
        ({"settings": FlowSettings(median=4)}, (image, image), "median"),
        ({"settings": FlowSettings(omega=2.0)}, (image, image), "omega"),
    ):
        with pytest.raises(InputError, match=word):
            optical_flow(*images, **kwargs)
    with pytest.raises(InputError, match="same"):
        flow_confidence(np.zeros((4, 4, 2), np.float32), np.zeros((4, 5, 2), np.float32))


def test_images_without_texture_give_no_motion() -> None:
    flat = np.full((40, 50), 0.5, np.float32)
    mask = np.zeros((40, 50), bool)
    mask[10:30, 20:30] = True
    for kwargs in ({}, {"mask": mask}, {"mask": mask, "preset": "fast"}):
        assert np.abs(optical_flow(flat, flat, **kwargs)).max() < 1e-3


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (7, 5), (17, 200)])
def test_small_and_odd_sizes(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    first, second = rng.uniform(size=(2, *shape)).astype(np.float32)
    mask = np.zeros(shape, bool)
    mask[0, 0] = True
    for kwargs in ({}, {"mask": mask}):
        flow = optical_flow(first, second, **kwargs)
        assert flow.shape == (*shape, 2) and flow.dtype == np.float32 and np.isfinite(flow).all()


# --- real images --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "bar"), [("RubberWhale", 0.11), ("Venus", 0.29)])
def test_middlebury(shared_data: Path, name: str, bar: float) -> None:
    """Baker et al. 2011, average endpoint error over all known pixels."""
    folder = shared_data / "flow_middlebury" / name
    first, second = (cv2.imread(str(folder / f"frame1{k}.png"), cv2.IMREAD_GRAYSCALE) for k in (0, 1))
    width, height = np.fromfile(folder / "flow10.flo", np.int32, 3)[1:]
    truth = np.fromfile(folder / "flow10.flo", np.float32, offset=12).reshape(height, width, 2)
    known = np.abs(truth).max(axis=-1) < 1e9
    assert np.linalg.norm(optical_flow(first, second) - truth, axis=-1)[known].mean() <= bar
