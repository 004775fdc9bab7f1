"""The first pose from the images alone: what stands out, where it is, stances, and whether a track is believed."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import cast

import numpy as np
import pytest

from twistcap import se3
from twistcap.adjust.unaided import (
    STANCES,
    Instant,
    Proof,
    ProofRule,
    Unaided,
    UnaidedRule,
    bundled,
    middle_of_sight,
    scenery_of,
    turned_round,
)
from twistcap.adjust.unaided.hull import height_of, places, share_explained
from twistcap.adjust.unaided.proof import Probe, Track, proof_of
from twistcap.adjust.unaided.search import Candidate
from twistcap.arrays import AnyArray
from twistcap.body import Body, Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.build import build
from twistcap.camera import Rig
from twistcap.errors import InputError
from twistcap.estimate import Frame
from twistcap.io.cameras.units import scaled
from twistcap.search.placing import PlacingRule
from twistcap.studio import Capture, StudioConfig, capture

QUICK = UnaidedRule(PlacingRule(turns=12, places=2, modes=8, draws=6), fitted=6, mended=(2, 1))


@cache
def _scene() -> tuple[Capture, list[Frame]]:
    scene = capture(StudioConfig(seed=1, views=4, frames=40, fps=30.0, size=(192, 140)))
    return scene, list(scene.frames())


def _unaided(frames: list[Frame], rig: Rig | None = None, every: list[Frame] | None = None) -> Unaided:
    scene, rig = _scene()[0], rig or _scene()[0].rig
    every = every or _scene()[1]
    pictures = list(zip(*(frame.images for frame in every[::2]), strict=True))
    model = build(scene.body, rig)
    scenery = scenery_of(rig, pictures, middle_of_sight(rig), model.channels)
    rule = ProofRule(QUICK, probes=(0.0, 0.3))
    return Unaided(rule, model, scenery, lambda at: frames[at.start : at.stop], len(frames), 30.0)


def test_the_middle_of_sight_is_where_a_ring_of_cameras_looks() -> None:
    rig = _scene()[0].rig
    middle = middle_of_sight(rig)
    for camera in rig:
        pixel, depth = camera.project(middle[None])
        assert depth[0] > 0
        np.testing.assert_allclose(pixel[0], (np.array(camera.size) - 1) / 2, atol=2.0)


def test_the_person_stands_out_and_is_placed() -> None:
    scene, frames = _scene()
    search = _unaided(frames)
    evidence = search.scenery.evidence(frames[0].images, scene.body)
    truth, aside = scene.true_poses[0], se3.transform(np.eye(3), np.array([0.5, 0.3, 0.0]))
    assert evidence.of(truth) > 2.0 * max(evidence.of(Pose(aside @ truth.root, truth.q)), 0.0) > -1.0
    found = places(evidence, middle_of_sight(scene.rig)[:2], 3.0, 0.0, 2)
    assert np.linalg.norm(found[0] - Posed(scene.body, truth).vertices.mean(axis=0)) < 0.25


def test_a_plate_tells_a_person_who_stands_still() -> None:
    scene, frames = _scene()
    still = [[frames[0].images[i]] * 6 for i in range(len(scene.rig))]
    rooms = [np.asarray(255 * room, np.uint8) for room in scene.rooms]
    middle, truth = middle_of_sight(scene.rig), scene.true_poses[0]
    with_plates = scenery_of(scene.rig, still, middle, "lab", rooms).evidence(frames[0].images, scene.body)
    without = scenery_of(scene.rig, still, middle, "lab").evidence(frames[0].images, scene.body)
    assert without.of(truth) == 0.0
    assert with_plates.of(truth) > 1000.0


def test_stances_are_within_limits_and_stand_on_the_floor() -> None:
    for body in (humanoid("full"), humanoid("legs")):
        stances = bundled(body)
        assert len(stances) >= len(STANCES)
        for stance in stances:
            assert np.all((stance.q >= body.limits[:, 0] - 1e-9) & (stance.q <= body.limits[:, 1] + 1e-9))
            low = Posed(body, stance.facing(np.eye(3))).vertices[:, 2].min()
            assert low == pytest.approx(0.0, abs=0.02)


def test_turned_round_faces_the_other_way_and_keeps_the_hands_in_place() -> None:
    body = humanoid("full")
    q = np.zeros(len(body.coordinate_names))
    for name, degrees in {"arm_add_r": -40, "arm_add_l": -70, "hip_flexion_r": 20, "hip_flexion_l": -15}.items():
        q[body.coordinate(name)] = np.deg2rad(degrees)
    pose = Pose(se3.transform(se3.exp_rotation(np.array([0.0, 0.0, 0.7])), np.array([0.4, -0.2, 0.9])), q)
    other = turned_round(body, pose)
    np.testing.assert_allclose(other.root[:3, 0], -pose.root[:3, 0], atol=1e-12)
    marks = body.landmarks.names
    here, there = Posed(body, pose).landmarks, Posed(body, other).landmarks
    for joint in ("wrist", "knee", "ankle"):
        for side, across in (("_r", "_l"), ("_l", "_r")):
            gap = here[marks.index(joint + side)] - there[marks.index(joint + across)]
            assert np.linalg.norm(gap) < 0.08


def test_a_walker_is_taken_up() -> None:
    scene, frames = _scene()
    proof = _unaided(frames).found()
    errors = np.linalg.norm(Posed(scene.body, proof.first).landmarks - scene.landmarks[0], axis=1)
    assert errors.mean() < 0.02
    assert proof.met == 2
    assert proof.agreement > 0.8


def test_an_empty_scene_is_refused_in_a_sentence() -> None:
    scene, frames = _scene()
    rooms = tuple(np.asarray(255 * room, np.uint8) for room in scene.rooms)
    with pytest.raises(InputError, match=r"auto: .*; click its joints with `twistcap init`"):
        _unaided([replace(frame, images=rooms) for frame in frames]).found()


@pytest.mark.parametrize("factor", [0.75, 1.0, 1.25])
def test_the_height_of_what_stands_out_needs_no_body(factor: float) -> None:
    scene, frames = _scene()
    search = _unaided(frames, scaled(scene.rig, factor))
    vertices = factor * Posed(scene.body, scene.true_poses[9]).vertices
    evidence = search.scenery.evidence(frames[9].images, scene.body)
    assert height_of(evidence, vertices.mean(axis=0), 0.0) == pytest.approx(np.ptp(vertices[:, 2]), abs=0.1)
    assert height_of(evidence, np.array([9.0, 9.0, 1.0]), 0.0) == 0.0


def test_a_calibration_of_wrong_scale_is_blamed() -> None:
    """By the height of what stands out, which knows of no body."""
    scene, frames = _scene()
    factor, blamed = 1.25, r"1\.2. times too large"
    search = _unaided(frames, scaled(scene.rig, factor))
    tall = factor * float(np.ptp(Posed(scene.body, scene.true_poses[0]).vertices[:, 2]))
    with pytest.raises(
        InputError, match=f"in calibration C.toml the person is .* lengths are probably {blamed}"
    ) as told:
        replace(search, calibration="calibration C.toml").found()
    found = re.search(r"about ([\d.]+) m tall, but \[body\] is ([\d.]+) m", str(told.value))
    assert found is not None
    assert float(found[1]) == pytest.approx(tall, abs=0.08)
    assert float(found[2]) == pytest.approx(float(np.ptp(scene.body.vertices[:, 2])), abs=0.01)


def _swapped(images: tuple[AnyArray | None, ...]) -> tuple[AnyArray | None, ...]:
    return images[1], images[0], *images[2:]


def _mirrored(images: tuple[AnyArray | None, ...]) -> tuple[AnyArray | None, ...]:
    return tuple(None if image is None else np.ascontiguousarray(image[:, ::-1]) for image in images)


@pytest.mark.parametrize("wrong", [_swapped, _mirrored])
def test_cameras_that_do_not_agree_do_not_blame_the_scale(wrong: Callable[..., tuple[AnyArray | None, ...]]) -> None:
    """Names that are swapped or pictures that are mirrored: what stands out has a height, but is no person."""
    frames = [replace(frame, images=wrong(frame.images)) for frame in _scene()[1]]
    with pytest.raises(
        InputError, match=r"auto is not clear .* agree on no person.* swapped.* mirrored.* click"
    ) as told:
        _unaided(frames, every=frames).found()
    assert "times" not in str(told.value)


@pytest.mark.parametrize("factor", [0.5, 1.0, 1.25])
def test_what_stands_out_is_explained_by_one_person_whatever_the_scale(factor: float) -> None:
    scene, frames = _scene()
    place = factor * Posed(scene.body, scene.true_poses[39]).vertices.mean(axis=0)
    rig = scaled(scene.rig, factor)
    shares = [
        share_explained(_unaided(e, rig, e).scenery.evidence(e[39].images, scene.body), place, factor * 1.75, 0.0)
        for e in (frames, [replace(frame, images=_swapped(frame.images)) for frame in frames])
    ]
    assert shares[0] > 0.9 and shares[1] < 0.75


def test_a_small_person_is_blamed_on_the_scale_only_if_seen_whole() -> None:
    scene, frames = _scene()
    search = _unaided(frames, scaled(scene.rig, 0.7))
    instants = [Instant(QUICK, search.model, f, search.scenery.evidence(f.images, scene.body)) for f in frames[:10:9]]
    proof = Proof(_track_of(0, [scene.first_pose]), 1, 0.9, (0.0,), 0.3)
    probes = [Probe(0, instant, ()) for instant in instants]
    sentence = search._refusal(proof, probes)  # pyright: ignore[reportPrivateUsage]
    assert re.search(r"are 1\.\d\d times too small if a whole person is seen: check its board", sentence)


def test_only_the_person_who_is_asked_for_is_looked_for() -> None:
    scene, frames = _scene()
    middle = Posed(scene.body, scene.true_poses[0]).vertices.mean(axis=0)
    asked = replace(_unaided(frames[:1]), asked=middle + np.array([0.2, -0.2, 0.1]))
    assert asked.found().met == 1
    with pytest.raises(InputError, match=r"\[first_pose\] auto: "):
        replace(asked, asked=middle + np.array([1.8, 0.0, 0.0])).found()


def test_a_missing_camera_is_no_evidence() -> None:
    scene, frames = _scene()
    search = _unaided(frames)
    gone = replace(frames[0], images=(None, *frames[0].images[1:]))
    assert len(search.scenery.evidence(gone.images, scene.body).views) == len(scene.rig) - 1
    instant = Instant(QUICK, search.model, gone, search.scenery.evidence((None,) * len(scene.rig), scene.body))
    assert instant.candidates(np.zeros(2), 0.0) == []


@pytest.mark.parametrize(
    ("met", "standing", "margins", "agreement", "believed"),
    [
        (2, 0.98, (0.12, 0.08), 0.9, True),
        (1, 0.98, (0.12, 0.08), 0.9, False),  # one search alone, and not clearly better
        (1, 0.98, (0.5, -0.02), 0.9, True),
        (1, 0.98, (0.5, -0.1), 0.9, False),  # in one frame something else is better
        (1, 0.98, (0.12, 0.08, 0.12, 0.08), 0.9, True),  # as clear in more frames
        (2, 0.98, (0.16, 0.02), 0.9, True),  # two searches: clear in the mean is enough
        (2, 0.98, (0.08, 0.02), 0.9, False),
        (3, 0.98, (0.08, 0.02), 0.9, True),  # three: the best is enough
        (3, 0.98, (0.08, -0.02), 0.9, False),
        (2, 0.9, (0.5, 0.08), 0.9, False),  # elsewhere something explains the images better
        (2, 0.98, (0.12, 0.08), 0.4, False),
    ],
)
def test_what_is_believed(
    met: int, standing: float, margins: tuple[float, ...], agreement: float, believed: bool
) -> None:
    scene, frames = _scene()
    track = Track(build(scene.body, scene.rig), frames[:1], 0, scene.first_pose)
    assert Proof(track, met, standing, margins, agreement).holds(ProofRule(), 4) is believed


@pytest.mark.parametrize(("apart_m", "met", "margin"), [(0.03, 2, 1.0), (0.1, 1, 0.5)])
def test_searches_whose_tracks_come_together_have_met(apart_m: float, met: int, margin: float) -> None:
    """What the second search has found is off by a limb, which its track finds on the way to the first frame: then it
    is no rival either.
    """
    scene, _ = _scene()
    right, aside = scene.true_poses[0], se3.transform(np.eye(3), np.array([apart_m, 0.0, 0.0]))
    off = Pose(se3.transform(np.eye(3), np.array([0.3, 0.0, 0.0])) @ right.root, right.q)
    tracks = [_track_of(0, [right, right]), _track_of(1, [Pose(aside @ right.root, right.q), off])]
    probes = [
        Probe(k, cast(Instant, _Alike(scene.body)), [Candidate(pose, 100.0, 0.9)])
        for k, pose in enumerate([right, off])
    ]
    proof = proof_of(tracks[0], probes, tracks, ProofRule())
    assert (proof.met, float(np.mean(proof.margins))) == (met, margin)


def _track_of(start: int, poses: list[Pose]) -> Track:
    track = object.__new__(Track)
    track.start, track.poses = start, poses
    return track


class _Alike:
    """A frame in which all poses have the same evidence."""

    def __init__(self, body: Body) -> None:
        self.body = body

    def measured(self, pose: Pose) -> Candidate:
        return Candidate(pose, 100.0, 0.9)

    def apart(self, one: Pose, other: Pose) -> float:
        a, b = (Posed(self.body, pose).landmarks for pose in (one, other))
        return float(np.linalg.norm(a - b, axis=1).max())


def test_a_track_goes_both_ways_and_on() -> None:
    scene, frames = _scene()
    track = Track(build(scene.body, scene.rig), frames[:6], 3, scene.true_poses[3])
    track.extend(frames[:9])
    assert len(track.poses) == 9
    for k in (0, 8):
        errors = np.linalg.norm(Posed(scene.body, track.poses[k]).landmarks - scene.landmarks[k], axis=1)
        assert errors.mean() < 0.02


@pytest.mark.parametrize("astray", [False, True])
def test_the_first_pose_is_that_to_which_the_track_comes_back(astray: bool) -> None:
    """The search in its own frame has missed an arm, the next ones have not; but a track that has gone astray since
    does not lead back.
    """
    scene, every = _scene()
    search, frames = _unaided(every), every[:3]
    track = Track(search.model, frames, 2, scene.true_poses[2])
    right, missed = track.poses[0], track.poses[0].q.copy()
    missed[scene.body.coordinate("elbow_flex_r")] += np.deg2rad(70.0)
    track.poses[0] = Pose(right.root, missed)
    evidence = search.scenery.evidence(every[0].images, scene.body)
    probe = Probe(0, Instant(QUICK, search.model, every[0], evidence), [])
    search = replace(search, rule=replace(search.rule, settling=0.3))
    if astray:
        away = se3.transform(np.eye(3), np.array([0.8, 0.5, 0.0])) @ right.root
        track.extend(every[:10])
        track.poses[9] = Pose(away, right.q)
    proof = search._settled(Proof(track, 2, 1.0, (0.3, 0.3), 0.9), probe, frames)
    assert len(frames) == 10 and proof.track.start == 2
    off = np.linalg.norm(Posed(scene.body, proof.first).landmarks - scene.landmarks[0], axis=1).max()
    assert (off > 0.15) if astray else (off < 0.03), off
