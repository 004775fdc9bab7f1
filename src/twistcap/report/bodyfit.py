"""The page of ``twistcap body fit``: the body over the images before and after, and the numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from twistcap.adjust.body_fit.fit import Fitted, Take
from twistcap.arrays import AnyArray
from twistcap.body import Posed
from twistcap.evaluate.metrics import Row
from twistcap.report.overlay import draw_mosaic, mosaic_for
from twistcap.report.page import Figure, Headline, number, write_report


def draw_fit(fitted: Fitted, takes: Sequence[Take], folder: Path) -> list[Path]:
    """Write before.png and after.png: of every take the middle one of its fitted frames, in all views."""
    both = [sorted(a.keys() & b.keys()) or sorted(b) for a, b in zip(fitted.begun_poses, fitted.poses, strict=True)]
    shown = [frames[len(frames) // 2] for frames in both]
    arms = (("before", fitted.begun, fitted.begun_poses), ("after", fitted.body, fitted.poses))
    out: list[Path] = []
    for name, body, poses in arms:
        pictures: list[AnyArray] = []
        for take, frames, k, p in zip(takes, fitted.frames, shown, poses, strict=True):
            posed = Posed(body, p[k]) if p.get(k) else None  # bare where it was lost
            pictures.append(draw_mosaic(frames[k], posed, mosaic_for(take.rig), f"{take.name}, {name}"))
        width = max(p.shape[1] for p in pictures)
        padded = [cv2.copyMakeBorder(p, 0, 0, 0, width - p.shape[1], cv2.BORDER_CONSTANT) for p in pictures]
        path = folder / f"{name}.png"
        cv2.imwrite(str(path), np.concatenate(padded)[..., ::-1])
        out.append(path)
    return out


def write_page(
    folder: Path, title: str, rows: Sequence[Row], factors: Mapping[str, float], pictures: Sequence[Path],
    files: Sequence[Path],
) -> Path:  # fmt: skip
    """Write report.html."""
    after = {line["metric"] + line["unit"]: line for line in rows if line["case"] == f"{title}, after"}
    mean, iou = after["surface to silhouette, meanmm"], after["IoU with the segmentation"]
    changed = ", ".join(f"{name} {factor:.3f}" for name, factor in factors.items())
    headlines = [
        Headline("surface to silhouette, mean", number(mean["value"]), "mm"),
        Headline("IoU with the tracker's segmentation", number(iou["value"])),
    ]
    lead = "Lengths, girths, cross-sections and a smooth offset of the surface, fitted to the edges in all views."
    figures = [Figure(path, f"The body {path.stem} the fit.", photo=True) for path in pictures]
    texts = ("the fitted body", "the pose of the first frame", "the session with both")
    links, notes = dict(zip(files, texts, strict=False)), [f"Factors relative to the given body: {changed}."]
    heading = f"Body fitted to {title}"
    return write_report(
        folder, heading, rows, lead=lead, headlines=headlines, figures=figures, files=links, notes=notes
    )
