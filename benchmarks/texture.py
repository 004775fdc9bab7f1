"""Two textures that grey values cannot tell apart: overlap of the segmentation with the truth, and what it costs.

    python benchmarks/texture.py [--seeds 8] [--out texture.png]

Each arm starts from the same misplaced disc and moves under the same settings, one global Gaussian per region and
channel. To reach: overlap of at least 0.9 with texture, at most 0.6 with grey, on every seed.
"""

from __future__ import annotations

import argparse
from time import perf_counter

import cv2
import matplotlib
import numpy as np

from reproduce.scenes.textures import DIFFERENCES, texture_scene
from reproduce.segment import segment
from twistcap.features import Texture, feature_channels
from twistcap.features.channels import Channels
from twistcap.region.models import GlobalGaussian

matplotlib.use("Agg")
import matplotlib.pyplot as plt

MODEL = GlobalGaussian(floor=4e-4)
CROP = (250, 150)  # px, a person of the studio
ARMS = (
    ("grey", "grey", Texture()),
    ("grey + texture", "grey+texture", Texture()),
    ("grey + texture, as the papers", "grey+texture", Texture(resolution=1, blend=True)),
)


def overlaps(channels: Channels, texture: Texture, difference: str, seeds: range) -> list[float]:
    """Intersection over union on every seed."""
    out = list[float]()
    for seed in seeds:
        scene = texture_scene(difference, seed)
        found = segment(feature_channels(scene.image, channels, texture), scene.start, MODEL)
        out.append(float((found & scene.region).sum() / (found | scene.region).sum()))
    return out


def milliseconds(channels: Channels, texture: Texture) -> float:
    """Median time of the channels of an RGB crop."""
    image = np.random.default_rng(0).integers(0, 256, (*CROP, 3), dtype=np.uint8)
    times = list[float]()
    for _ in range(41):
        began = perf_counter()
        feature_channels(image, channels, texture)
        times.append(1000.0 * (perf_counter() - began))
    return float(np.median(times[1:]))


def picture(path: str) -> None:
    """Channels and contours of the first seed: the truth red, the start yellow, what was found green."""
    figure, axes = plt.subplots(len(DIFFERENCES), 7, figsize=(24, 8))
    titles = ("image, truth, start", "grey", "J11", "J22", "J12", "scale", "found with texture, with grey (dashed)")
    for row, difference in zip(axes, DIFFERENCES, strict=True):
        scene = texture_scene(difference, 0)
        features = feature_channels(scene.image, "grey+texture")
        for axis, image in zip(row, (scene.image, *np.moveaxis(features, 2, 0), scene.image), strict=True):
            axis.imshow(image, cmap="gray")
            axis.axis("off")
        row[0].contour(scene.region, [0.5], colors="r")
        row[0].contour(scene.start, [0.5], colors="y")
        row[6].contour(scene.region, [0.5], colors="r")
        row[6].contour(segment(features, scene.start, MODEL), [0.5], colors="lime")
        alone = segment(feature_channels(scene.image, "grey"), scene.start, MODEL)
        row[6].contour(alone, [0.5], colors="cyan", linestyles="dashed")
    for axis, title in zip(axes[0], titles, strict=True):
        axis.set_title(title)
    figure.tight_layout()
    figure.savefig(path, dpi=60)


def main() -> None:
    cv2.setNumThreads(1)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--out", help="picture of the first seed")
    options = parser.parse_args()
    print(f"{'channels':32}{'difference':12}{'worst':>7}{'mean':>7}{'best':>7}")
    for name, channels, texture in ARMS:
        for difference in DIFFERENCES:
            values = overlaps(channels, texture, difference, range(options.seeds))
            print(f"{name:32}{difference:12}{min(values):7.3f}{np.mean(values):7.3f}{max(values):7.3f}", flush=True)
    print(f"\ntime of a {CROP[1]} x {CROP[0]} px RGB crop, 1 thread")
    for name, channels, texture in (
        *ARMS,
        ("CIELAB", "lab", Texture()),
        ("CIELAB + texture", "lab+texture", Texture()),
    ):
        print(f"{name:32}{milliseconds(channels, texture):7.2f} ms")
    if options.out:
        picture(options.out)


if __name__ == "__main__":
    main()
