# %% [markdown]
# # A cue of your own
# A cue is evidence in images. This one pulls points of the body to where the image is as bright as it was there in the
# first frame. ARCHITECTURE.md has the protocol: `start`, `measure`, `learn`.

# %%
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

import twistcap as tc
from twistcap.camera import pinhole
from twistcap.cues import Evidence, Fit, Level, Sight
from twistcap.render import SurfacePoints
from twistcap.terms import PointTerm, Rows

# %% [markdown]
# The term: a residual for each surface point, and its gradient by the point's place. Its Jacobian by the pose comes
# with `PointTerm`.


# %%
@dataclass(frozen=True)
class BrightnessTerm(PointTerm):
    points: SurfacePoints
    weight: np.ndarray  # (N,) 1 / brightness²
    P: np.ndarray  # (3, 4)
    image: np.ndarray  # (H, W)
    expected: np.ndarray  # (N,)
    name: str = "mean brightness"

    def at(self, pixels):
        return map_coordinates(self.image, pixels[:, ::-1].T, order=1, mode="nearest")

    def rows(self, posed):
        pixels, _, by_world = pinhole(self.P, self.points.at(posed))
        residual = self.at(pixels) - self.expected
        by_pixel = [(self.at(pixels + h) - self.at(pixels - h)) / 2e-3 for h in 1e-3 * np.eye(2)]
        gradient = sum(rate[:, None] * by_world[:, k] for k, rate in enumerate(by_pixel))
        return 0.5 * float(np.sum(self.weight * residual**2)), self.points, Rows(gradient, residual, self.weight)


# %% [markdown]
# The cue: its memory is the mean brightness of each part in each camera.


# %%
@dataclass(frozen=True)
class Memory:
    mean: np.ndarray  # (cameras, parts), NaN where a part has not been seen


def grey(sight):
    image = np.asarray(sight.view.image, float) / 255.0
    return gaussian_filter(image if image.ndim == 2 else image.mean(axis=2), 2.0)


@dataclass(frozen=True)
class MeanBrightness:
    sigma: float = 0.1
    name: str = field(default="mean brightness", init=False)

    def start(self, body: tc.Body, rig: tc.Rig) -> Memory:
        return Memory(np.full((len(rig), len(body.segment_names)), np.nan))

    def measure(self, sight: Sight, memory: Memory, level: Level) -> Evidence | None:
        part = sight.seen.part
        known = np.isfinite(memory.mean[sight.camera_index])
        rows, columns = (found[::16] for found in np.nonzero((part >= 0) & known[part]))
        if not len(rows):
            return None
        points = sight.seen.surface_points(rows.astype(np.int32), columns.astype(np.int32))
        expected = memory.mean[sight.camera_index, part[rows, columns]]
        weight = np.full(len(rows), 0.02 / self.sigma**2)  # one sample in fifty is independent
        return Evidence(BrightnessTerm(points, weight, sight.view.camera.P, grey(sight), expected), len(rows), None)

    def learn(self, memory: Memory, fit: Fit, lesson: int) -> Memory:
        mean = memory.mean.copy()
        for sight in fit.sights if lesson else ():
            part, image = sight.seen.part, grey(sight)
            for k in np.unique(part[part >= 0]):
                if np.isnan(mean[sight.camera_index, k]):
                    mean[sight.camera_index, k] = image[part == k].mean()
        return Memory(mean)


# %% [markdown]
# It is given to `track` beside the model's own cues, and its energy stands in each estimate.

# %%
walk = tc.capture(tc.StudioConfig(seed=1, views=2, size=(256, 188), frames=8))
frames, model = list(walk.frames()), tc.build.build(walk.body, walk.rig)


def joint_error_mm(estimates):
    posed = [tc.Posed(walk.body, e.pose).landmarks for e in estimates]
    return 1000 * float(np.mean([np.linalg.norm(p - t, axis=1) for p, t in zip(posed, walk.landmarks, strict=True)]))


without = list(tc.tracked(frames, model, walk.first_pose))
with_it = list(tc.tracked(frames, model, walk.first_pose, cues=[MeanBrightness()]))
print(f"joints: {joint_error_mm(without):.1f} mm off without the cue, {joint_error_mm(with_it):.1f} mm with it")
print(sorted(with_it[-1].energies))
assert with_it[-1].energies["mean brightness"] > 0.0 and "mean brightness" not in without[-1].energies
assert joint_error_mm(with_it) < 25.0
