"""Four texture channels beside grey or colour: structure tensor and local scale, smoothed without crossing edges.

After T. Brox and J. Weickert, "A TV flow based local scale estimate and its application to texture discrimination",
J. Visual Communication and Image Representation 17(5), 2006, doi:10.1016/j.jvcir.2005.06.001, and M. Rousson, T. Brox
and R. Deriche, "Active unsupervised texture segmentation on a diffusion based feature space", CVPR 2003. The channels
measure a texture's strength, direction and scale.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from twistcap.arrays import AnyArray, Float, Float32
from twistcap.errors import InputError
from twistcap.features.tvflow import tv_step
from twistcap.ranges import Checked, Count, Positive

_STRENGTH = 0.2  # largest value of the structure tensor's channels: their weight beside grey
_FLOW_STEPS, _FLOW_GROWTH = 6, 1.25  # of the TV flow, and from each to the next: fine structures need short steps
_WINDOW = 4.0  # px, standard deviation over which the flow's changes and their times are summed


@dataclass(frozen=True)
class Texture(Checked):
    """How texture is measured. No value depends on the range of an image, so that crops and frames agree.

    Attributes:
        resolution: px of the image in each step of the grid of smoothing: 1 in the papers; 2 takes half the time.
        blend: whether grey or colours are smoothed too, as in the papers; otherwise they only steer the smoothing.
        knee: gradient (brightness/px) at which half the strength is reached; a lone strong edge is no strong texture.
        largest: size (px) of the structures at which the local scale is 1; those of 1 px have 0.
        flow_time: duration of the TV flow that measures the scale, brightness · px; a structure of size m and height h
            vanishes after m h / 2.
        steps, tau: steps of the joint smoothing, and their size, brightness · px.
        epsilon: gradient (brightness per px of the grid) below which TV flow turns into linear diffusion.

    Raises InputError for numbers that are not positive and finite, or structures of 1 px or less.
    """

    resolution: Count = 2
    blend: bool = False
    knee: Positive = 0.1
    largest: float = 16.0
    flow_time: Positive = 0.5
    steps: int = 3
    tau: Positive = 0.12
    epsilon: Positive = 0.01

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.largest) and self.largest > 1.0):
            raise InputError(f"texture: largest is {self.largest} px; it must be more than 1.")


def with_texture(colours: Float32, light: Float32, how: Texture) -> Float32:
    """(H, W, C + 4): colours (H, W, C), then J₁₁ (along x), J₂₂ (along y), J₁₂ and the local scale of `light` (H, W).

    J is ∇I∇Iᵀ/|∇I|, saturating at `_STRENGTH`. The scale is logarithmic. All channels diffuse together with one
    diffusivity from all their gradients, the inverse scale (the flow's speed) in place of the scale.
    """
    height, width, C = colours.shape
    planes = np.concatenate([
        grid_planes([*cv2.split(colours), *structure_tensor(light, _STRENGTH, how.knee)], how.resolution),
        flow_speed(light, how)[None],
    ])  # fmt: skip
    for _ in range(how.steps):
        planes = tv_step(planes, how.tau / how.resolution, how.epsilon)
    planes[-1] = np.log(2.0 / planes[-1]).clip(0.0, math.log(how.largest)) / math.log(how.largest)
    sharp, planes = ([], planes) if how.blend else (cv2.split(colours), planes[C:])
    size = (how.resolution * planes.shape[2], how.resolution * planes.shape[1])
    large = [cv2.resize(p, size, interpolation=cv2.INTER_LINEAR)[:height, :width] for p in planes]
    return np.asarray(cv2.merge([*sharp, *large]), dtype=np.float32)


def flow_speed(light: Float32, how: Texture) -> Float32:
    """(h, w) mean speed |∂_t I| (1/px) of the pixels of `light` (H, W) under TV flow while they change, on the grid.

    A bump of m px changes by 2/m: the local scale is 2 over the speed, at least that of structures of `largest` px.
    """
    before, slowest = light[None], 2.0 / how.largest
    moved, time = np.zeros_like(light), np.zeros_like(light)
    growth = _FLOW_GROWTH ** np.arange(_FLOW_STEPS)
    for tau in (how.flow_time / growth.sum() * growth).tolist():
        after = tv_step(before, tau, how.epsilon)
        _add_changes(before[0], after[0], tau, slowest, moved, time)
        before = after
    sums, sigma = grid_planes((moved, time), how.resolution), _WINDOW / how.resolution
    moved, time = (cv2.GaussianBlur(x, (0, 0), sigma, borderType=cv2.BORDER_REFLECT) for x in sums)
    rest = np.float32(1e-3 * how.flow_time)  # of the slowest change, added to every pixel
    return (moved + rest * np.float32(slowest)) / (time + rest)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "arcp"})
def _add_changes(before: Float32, after: Float32, tau: float, slowest: float, moved: Float32, time: Float32) -> None:
    """Add each pixel's change in a step of `tau`, and the time, where it is faster than `slowest`."""
    passed, zero, enough = np.float32(tau), np.float32(0.0), np.float32(slowest * tau)
    for r in range(before.shape[0]):
        old, new, way, spent = before[r], after[r], moved[r], time[r]
        for c in range(len(old)):
            change = abs(new[c] - old[c])
            on = change > enough
            way[c] += change if on else zero
            spent[c] += passed if on else zero


def grid_planes(channels: Sequence[AnyArray], block: int) -> Float32:
    """(C, h, w) means over blocks of pixels of channels (H, W); last rows and columns repeat to fill the last block."""
    height, width = channels[0].shape
    h, w = -(-height // block), -(-width // block)
    out = np.empty((len(channels), h, w), dtype=np.float32)
    for channel, plane in zip(channels, out, strict=True):
        whole = cv2.copyMakeBorder(channel, 0, h * block - height, 0, w * block - width, cv2.BORDER_REPLICATE)
        cv2.resize(whole, (w, h), dst=plane, interpolation=cv2.INTER_AREA)
    return out


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "arcp"})
def structure_tensor(light: Float32, strength: float, knee: float) -> Float32:
    """(3, H, W) J₁₁, J₂₂, J₁₂ of ``strength · ∇I∇Iᵀ / (|∇I| (|∇I| + knee))``.

    Gradients are central differences; the image (H, W) is mirrored at its border.
    """
    height, width = light.shape
    out, x = np.empty((3, height, width), dtype=np.float32), np.empty(width, dtype=np.float32)
    half, top, bend, tiny = np.float32(0.5), np.float32(strength), np.float32(knee), np.float32(1e-9)
    near = min(1, width - 1)
    for r in range(height):
        up, here, down = light[max(r - 1, 0)], light[r], light[min(r + 1, height - 1)]
        for c in range(1, width - 1):
            x[c] = half * (here[c + 1] - here[c - 1])
        x[0], x[width - 1] = half * (here[near] - here[0]), half * (here[width - 1] - here[width - 1 - near])
        xx, yy, xy = out[0, r], out[1, r], out[2, r]
        for c in range(width):
            y = half * (down[c] - up[c])
            slope = np.sqrt(x[c] * x[c] + y * y)
            weight = top / ((slope + tiny) * (slope + bend))
            xx[c] = weight * x[c] * x[c]
            yy[c] = weight * y * y
            xy[c] = weight * x[c] * y
    return out


def structure_tensor_reference(light: Float32, strength: float, knee: float) -> Float:
    """Readable twin of `structure_tensor`."""
    padded = np.pad(light.astype(float), 1, mode="edge")
    x, y = (padded[1:-1, 2:] - padded[1:-1, :-2]) / 2, (padded[2:, 1:-1] - padded[:-2, 1:-1]) / 2
    slope = np.hypot(x, y)
    weight = strength / np.maximum(slope * (slope + knee), 1e-18)
    return np.stack([weight * x * x, weight * y * y, weight * x * y])
