"""texture: two textures that grey values cannot tell apart; overlap of the segmentation with the truth.

Each arm starts from the same misplaced disc and moves under the same settings, one global Gaussian for each region and
channel. After Brox, Rosenhahn and Cremers, "Contours, Optic Flow, and Prior Knowledge", section 11.2.

    python -m reproduce texture --seeds 0-7 --out out/texture
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from reproduce.arms import Findings
from reproduce.running import Tell
from reproduce.scenes.textures import DIFFERENCES, Difference, texture_scene
from reproduce.segment import segment
from twistcap.evaluate import Row, row
from twistcap.evaluate.metrics import iou
from twistcap.features import Channels, Texture, feature_channels
from twistcap.region.models import RegionModel

MODEL = RegionModel("global")
CROP = (250, 150)  # px, a person of the studio
WITH, WITHOUT = "grey + texture", "grey"
ARMS: tuple[tuple[str, Channels, Texture], ...] = (
    (WITHOUT, "grey", Texture()),
    (WITH, "grey+texture", Texture()),
    ("grey + texture, as the papers", "grey+texture", Texture(resolution=1, blend=True)),
)
TIMED: tuple[tuple[str, Channels, Texture], ...] = (
    *ARMS,
    ("CIELAB", "lab", Texture()),
    ("CIELAB + texture", "lab+texture", Texture()),
)


@dataclass(frozen=True)
class Textures:
    """The experiment; see `Experiment`."""

    id: str = "texture"
    says: str = "a shape that differs from its background in texture alone, segmented with and without texture channels"

    def run(self, seeds: Sequence[int], progress: Tell, out: Path | None = None) -> Findings:
        """The worst overlap of each arm and kind of texture, and the time of the channels."""
        cv2.setNumThreads(1)
        rows: list[Row] = []
        for done, (name, channels, texture) in enumerate(ARMS, 1):
            for difference in DIFFERENCES:
                values = [_overlap(channels, texture, difference, seed) for seed in seeds]
                rows.append(_row(name, difference, values))
            progress(name, done, len(ARMS))
        rows += [
            row(f"{self.id} {name}", "time of a crop", _ms(channels, texture), "ms")
            for name, channels, texture in TIMED
        ]
        if out is not None:
            _picture(out / f"{self.id}.png", seeds[0])
        return Findings(rows, "", ())


def _row(arm: str, difference: Difference, values: Sequence[float]) -> Row:
    """Grey values are not to find the shape on any seed, texture is to find it on all."""
    case, metric = f"texture {arm}", f"IoU, {difference}"
    if arm == WITHOUT:
        return row(case, f"{metric}, best seed", max(values), "share", at_most=0.6, seeds=values)
    bar = 0.9 if arm == WITH else None
    return row(case, f"{metric}, worst seed", min(values), "share", at_least=bar, seeds=values)


def _overlap(channels: Channels, texture: Texture, difference: Difference, seed: int) -> float:
    """Intersection over union of the segmentation and the true shape."""
    scene = texture_scene(difference, seed)
    found = segment(feature_channels(scene.image, channels, texture), scene.start, MODEL)
    return iou(found, scene.region)


def _ms(channels: Channels, texture: Texture) -> float:
    """Median time of the channels of an RGB crop."""
    image = np.random.default_rng(0).integers(0, 256, (*CROP, 3), dtype=np.uint8)
    times = list[float]()
    for _ in range(41):
        began = perf_counter()
        feature_channels(image, channels, texture)
        times.append(1000.0 * (perf_counter() - began))
    return float(np.median(times[1:]))


def _picture(path: Path, seed: int) -> None:
    """Channels and contours of one seed: the truth red, the start yellow, what was found green."""
    figure = Figure(figsize=(24, 8), layout="tight")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(DIFFERENCES), 7)
    titles = ("image, truth, start", "grey", "J11", "J22", "J12", "scale", "found with texture, with grey (dashed)")
    for line, difference in zip(axes, DIFFERENCES, strict=True):
        scene = texture_scene(difference, seed)
        features = feature_channels(scene.image, "grey+texture")
        for axis, image in zip(line, (scene.image, *np.moveaxis(features, 2, 0), scene.image), strict=True):
            axis.imshow(image, cmap="gray")
            axis.axis("off")
        line[0].contour(scene.region, [0.5], colors="r")
        line[0].contour(scene.start, [0.5], colors="y")
        line[6].contour(scene.region, [0.5], colors="r")
        line[6].contour(segment(features, scene.start, MODEL), [0.5], colors="lime")
        alone = segment(feature_channels(scene.image, "grey"), scene.start, MODEL)
        line[6].contour(alone, [0.5], colors="cyan", linestyles="dashed")
    for axis, title in zip(axes[0], titles, strict=True):
        axis.set_title(title)
    figure.savefig(path, dpi=60)


TEXTURE = Textures()
