"""One case on one seed: track a synthetic sequence and hold it against its truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from reproduce.cases import Case, Measure, Training
from reproduce.scenes.subjects import squats, walks_of_another
from twistcap.adjust.first_pose import fit_keypoints
from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.build import build
from twistcap.estimate import Estimate, Frame, Keypoints
from twistcap.evaluate import metrics
from twistcap.hindsight import Hindsight
from twistcap.priors import ParzenPrior
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Tracker


@dataclass(frozen=True)
class Outcome:
    """What one tracked sequence gave.

    Attributes:
        values: number by measure.
        angles_deg: (N, K) estimated angles of the coordinates of the KHE.
    """

    values: Mapping[Measure, float]
    angles_deg: Float

    @property
    def lost(self) -> bool:
        """Whether the sequence was lost."""
        return self.values["lost sequences"] > 0


class Pictures:
    """A scene's frames, rendered when first asked for and kept."""

    def __init__(self, scene: Capture) -> None:
        self.scene = scene
        self._rendered: dict[int, Frame] = {}

    def of(self, case: Case) -> Iterator[Frame]:
        """The frames that the tracker of a case may see."""
        return (self._frame(k) for k in range(0, case.frames or self.scene.config.frames, case.every))

    def _frame(self, index: int) -> Frame:
        if index not in self._rendered:
            self._rendered[index] = self.scene.frame(index)
        return self._rendered[index]


def run_scene(studio: StudioConfig, seed: int, cases: Sequence[Case]) -> list[Outcome]:
    """All cases that look at the same scene, which is rendered once."""
    pictures = Pictures(capture(replace(studio, seed=seed)))
    return [run_case(case, pictures) for case in cases]


def run_case(case: Case, pictures: Pictures) -> Outcome:
    """Track one sequence and measure it."""
    return measured(pictures.scene, *tracked(case, pictures))


def tracked(case: Case, pictures: Pictures) -> tuple[Body, Pose, list[Estimate], list[float]]:
    """Track one sequence: the body, its first pose, an estimate of every frame, and the milliseconds it took."""
    scene = pictures.scene
    body, pose = first_pose(case, scene)
    tracker = Tracker(build(body, scene.rig, case.tracker, prior_of(case.prior, scene)))
    tracker.start(pose)
    hindsight, estimates, times = Hindsight(tracker), list[Estimate](), list[float]()
    for frame in pictures.of(case):
        began = perf_counter()
        corrected, estimate = hindsight.step(frame)
        times.append(1000.0 * (perf_counter() - began))
        estimates[len(estimates) - len(corrected) :] = [*corrected, estimate]
    return body, pose, estimates, times


def prior_of(training: Training | None, scene: Capture) -> ParzenPrior | None:
    """The prior of somebody else than the person of the scene; None without training."""
    if training is None:
        return None
    body = humanoid(scene.config.variant)
    samples = walks_of_another(body, scene.config.seed + 1) if training == "another's walk" else squats(body)
    return ParzenPrior.trained(body.coordinate_names, samples)


def first_pose(case: Case, scene: Capture) -> tuple[Body, Pose]:
    """The body and the pose that the tracker of a case starts from."""
    if case.start == "given":
        return scene.body, scene.first_pose
    known, noise = case.start == "keypoints", case.keypoint_noise_px
    body = scene.body if known else humanoid(scene.config.variant)
    fit = fit_keypoints(body, scene.rig, noisy_keypoints(scene, noise), fit_lengths=not known, sigma_px=noise)
    return fit.body, fit.pose


def noisy_keypoints(scene: Capture, noise_px: float) -> Keypoints:
    """Keypoints of the first frame with Gaussian noise: all landmarks, projected."""
    pixels = np.stack([camera.project(scene.landmarks[0])[0] for camera in scene.true_rig])
    noise = np.random.default_rng((scene.config.seed, 3)).standard_normal(pixels.shape)
    return Keypoints(scene.true_body.landmarks.names, pixels + noise_px * noise, np.ones(pixels.shape[:2]))


def measured(
    scene: Capture, body: Body, start: Pose, estimates: Sequence[Estimate], times_ms: Sequence[float]
) -> Outcome:
    """The measures of one sequence; the first frame, which takes more alternations, does not count in the time."""
    angles, truth, sigma = khe_angles(scene, body, estimates)
    error = metrics.angle_differences_deg(angles, truth)
    joints = joint_errors_mm(scene, body, [e.pose for e in estimates], [e.index for e in estimates])
    values: dict[Measure, float] = {
        "KHE": metrics.mean_known(np.abs(error)),
        "joints": metrics.mean_known(joints),
        "joints at the start": metrics.mean_known(joint_errors_mm(scene, body, [start], [estimates[0].index])),
        "KHE within 2σ": metrics.within_sigmas(np.radians(error) / sigma, 2.0),
        "lost sequences": float(metrics.lost_sequence(joints)),
        "time per frame": float(np.mean(times_ms[1:] or times_ms)),
    }
    return Outcome(values, np.degrees(angles))


def khe_angles(scene: Capture, body: Body, estimates: Sequence[Estimate]) -> tuple[Float, Float, Float]:
    """Estimated and true angles (N, K) of the KHE, rad, and the estimates' standard deviations."""
    names = [name for name in metrics.KHE_COORDINATES if name in body.coordinate_names]
    ours, theirs = ([b.coordinate(name) for name in names] for b in (body, scene.true_body))
    found = np.stack([e.pose.q for e in estimates])[:, ours]
    true = np.stack([scene.true_poses[e.index].q for e in estimates])[:, theirs]
    variance = np.stack([np.diagonal(e.covariance) for e in estimates])[:, [6 + k for k in ours]]
    return found, true, np.sqrt(variance)


def khe_errors_deg(scene: Capture, body: Body, estimates: Sequence[Estimate]) -> Float:
    """(N, K) signed errors of the angles of the KHE, degrees."""
    angles, truth, _ = khe_angles(scene, body, estimates)
    return metrics.angle_differences_deg(angles, truth)


def joint_errors_mm(scene: Capture, body: Body, poses: Sequence[Pose], indices: Sequence[int]) -> Float:
    """(N, K) distances of the joint centres from their true places, mm."""
    names = [name for name in metrics.JOINT_CENTRES if name in body.landmarks.names]
    ours, theirs = ([b.landmarks.names.index(name) for name in names] for b in (body, scene.true_body))
    found = np.stack([Posed(body, pose).landmarks[ours] for pose in poses])
    return metrics.distances_mm(metrics.differences(found, scene.landmarks[list(indices)][:, theirs]))
