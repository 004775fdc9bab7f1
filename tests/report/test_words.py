"""What a result says of itself: spans of lost frames with their limbs, and cameras that were not believed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.cameras import ring
from twistcap.arrays import Float
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.body.limbs import named_limbs
from twistcap.camera import Rig
from twistcap.commands.follow import Believed
from twistcap.commands.outputs import write_page
from twistcap.estimate import Estimate, Frame
from twistcap.io.result import Result, ResultWriter, read_result
from twistcap.report.overlay import LOST, draw_mosaic, mosaic_for
from twistcap.report.verdict import camera_rows, chosen_rows, verdict_of
from twistcap.report.words import (
    beside_in_words,
    camera_in_words,
    cameras_in_words,
    doubtful,
    doubtful_in_words,
    flickering,
    frame_in_words,
    result_in_words,
    state_in_words,
)

BODY, LIMBS = humanoid(), named_limbs(humanoid())


def parts(**probability: float) -> Float:
    """(S,) probability of each segment, 0.01 of limbs that are not named."""
    return np.max([np.where(LIMBS[name], value, 0.01) for name, value in probability.items()], axis=0)


def estimate(k: int, **about: object) -> Estimate:
    plain = Estimate(2 * k, k / 30, Pose.rest(BODY), np.eye(BODY.dof), part_probability=parts(head=0.02))
    return replace(plain, **about)


def result(path: Path, estimates: Sequence[Estimate], rig: Rig | None = None) -> Result:
    with ResultWriter(path, BODY, rig or ring(2), {}) as writer:
        for each in estimates:
            writer.append(each)
    return read_result(path)


def test_limbs_have_the_names_that_people_give_them() -> None:
    assert set(LIMBS) == {"head", "arm_r", "arm_l", "leg_r", "leg_l", "trunk"}
    assert np.sum(list(LIMBS.values()), axis=0).tolist() == [1] * len(BODY.segment_names)
    assert LIMBS["arm_l"][BODY.segment_names.index("ulna_l")] and LIMBS["trunk"][BODY.segment_names.index("pelvis")]


def test_the_most_doubtful_limbs_are_named() -> None:
    assert doubtful_in_words(LIMBS, parts(arm_l=0.9, head=0.3)) == "left arm"
    assert doubtful_in_words(LIMBS, parts(arm_l=0.9, head=0.6)) == "head, left arm"
    assert doubtful(LIMBS, parts(leg_r=0.3, head=0.2)) == ("leg_r",)  # none is probable
    assert doubtful_in_words(LIMBS, parts(head=0.9, arm_l=0.9, arm_r=0.8, trunk=0.6)) == "whole body"
    assert doubtful(LIMBS, np.full(len(BODY.segment_names), np.nan)) == ()


def test_a_limb_that_is_not_judged_is_named_where_that_lasts(tmp_path: Path) -> None:
    """A hand that is hidden for a moment is not worth a word."""
    hidden = np.where(LIMBS["leg_l"], np.nan, 0.02)
    frames = [estimate(k, part_probability=hidden if k in (2, *range(4, 11)) else parts(head=0.02)) for k in range(12)]
    words = result_in_words(result(tmp_path / "tracked.h5", frames))
    unjudged = "not whole in any image, or like what is behind it, and not judged"
    assert words[1:] == [f"left leg: {unjudged}, in 7 frames: 8–20"]


def test_a_result_tells_what_was_lost_and_which_cameras_were_not_believed(tmp_path: Path) -> None:
    """Every second frame of a recording."""
    frames = [estimate(k) for k in range(12)]
    astray = {"lost": True, "part_probability": parts(arm_l=0.9, leg_r=0.1), "left_out": (1,)}
    frames[1:4] = [estimate(k, **astray) for k in (1, 2, 3)]
    frames[5] = estimate(5, lost=True, part_probability=None, status="no_images", missing=(0, 1))
    frames[7] = estimate(7, lost=True, part_probability=None, status="not_found")
    frames[8] = estimate(8, missing=(0,))
    assert result_in_words(result(tmp_path / "a.h5", frames)) == [
        "5 of 12 frames lost: 2–6 (left arm), 10 (no images), 14 (not found)",
        "camera cam1 was left out in 3 frames: 2–6; it contradicts the others (bumped, frozen, late or swapped?)",
        "no camera showed anything new in 1 frame: 10 (a picture that is missing, blank, or the one before once more)",
        "camera cam0 showed nothing new in 1 frame: 16 (a picture that is missing, blank, or the one before once more)",
    ]
    assert result_in_words(result(tmp_path / "b.h5", [estimate(0)])) == ["none of 1 frame lost"]
    assert result_in_words(result(tmp_path / "c.h5", [])) == []
    many = [estimate(k, lost=k % 2 == 0) for k in range(40)]
    assert result_in_words(result(tmp_path / "d.h5", many))[0].endswith("44 (head), and 8 spans more")


def test_camera_names_are_only_names(tmp_path: Path) -> None:
    rig = Rig(tuple(replace(camera, name=name) for camera, name in zip(ring(2), ("{a}", "[b]%s"), strict=True)))
    told = result_in_words(result(tmp_path / "a.h5", [estimate(0, left_out=(0, 1))], rig))
    assert [sentence.split(" was")[0] for sentence in told[1:]] == ["camera {a}", "camera [b]%s"]


def test_a_frame_says_why_it_is_lost() -> None:
    assert state_in_words(estimate(0), LIMBS) == ""
    assert state_in_words(estimate(0, lost=True, part_probability=parts(leg_l=0.8)), LIMBS) == "lost: left leg"
    assert state_in_words(estimate(0, lost=True, part_probability=None, status="failed"), LIMBS) == "lost: failed"
    assert state_in_words(estimate(0, lost=True, part_probability=None), LIMBS) == "lost"
    out = estimate(0, left_out=(1,), missing=(1, 2, 3))
    assert [camera_in_words(out, c, c != 3) for c in range(4)] == ["", "left out", "nothing new", "no image"]


def test_a_bumped_camera_is_said_to_be(tmp_path: Path) -> None:
    bumps = np.zeros((2, 3))
    bumps[1] = np.radians([0.0, 2.0, 0.0])
    turned = estimate(3, bumps=bumps)
    assert [camera_in_words(turned, c) for c in range(2)] == ["", "bumped by 2.0°"]
    assert frame_in_words(turned, LIMBS, ("cam0", "cam1")) == "camera cam1 is bumped by 2.0°"
    made = result(tmp_path / "a.h5", [estimate(0), estimate(1, bumps=0.5 * bumps), turned, estimate(4)])
    (sentence,) = cameras_in_words(made)
    assert sentence.startswith(
        "camera cam1 was out of its place in 2 frames: 2–6 (turned by 2.0° at most; its pictures"
    )
    words = [statement.text for statement in verdict_of(made)]
    assert any("bumped or sway: cam1 by 2.0° from frame 2 on. Their pictures were" in text for text in words)
    believed = Believed(("cam0", "cam1"))
    told = [believed.news(e) for e in made.estimates]
    assert [len(sentences) for sentences in told] == [0, 1, 0, 1]
    assert told[1] == ["frame 2: camera cam1 was bumped, or sways; its pictures are turned back"]
    assert told[3] == ["frame 8: camera cam1 stands again as it was calibrated"]


def test_a_camera_that_gives_another_ones_pictures_is_said_to(tmp_path: Path) -> None:
    swapped = estimate(1, sources=(1, 0))
    assert [camera_in_words(swapped, c) for c in range(2)] == ["swapped", "swapped"]
    both = estimate(1, sources=(1, 0), bumps=np.radians([[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]]))
    assert camera_in_words(both, 1) == "swapped, bumped by 2.0°"
    said = "camera cam1 gives the picture of cam0; camera cam0 gives the picture of cam1"
    assert frame_in_words(swapped, LIMBS, ("cam0", "cam1")) == said
    made = result(tmp_path / "a.h5", [estimate(0), swapped, estimate(2, sources=(1, 0)), estimate(3)])
    assert [e.sources for e in made.estimates] == [(), (1, 0), (1, 0), ()]
    assert cameras_in_words(made) == [
        "camera cam0 gave the pictures of cam1 in 2 frames: 2–4 (they count as those)",
        "camera cam1 gave the pictures of cam0 in 2 frames: 2–4 (they count as those)",
    ]
    words = [statement.text for statement in verdict_of(made)]
    given = "gave the pictures of others: cam0 those of cam1 in 2–4, cam1 those of cam0 in 2–4. They"
    assert any(given in text for text in words)
    believed = Believed(("cam0", "cam1"))
    told = [believed.news(e) for e in made.estimates]
    assert [len(sentences) for sentences in told] == [0, 2, 0, 2]
    assert told[1][0] == "frame 2: camera cam0 gives the pictures of another one; they count as those"
    assert told[3][1] == "frame 6: camera cam1 gives its own pictures again"


def test_another_light_is_said(tmp_path: Path) -> None:
    relit = estimate(1, relit=True)
    assert frame_in_words(relit, LIMBS, ("cam0", "cam1")) == "another light?"
    made = result(tmp_path / "a.h5", [estimate(0), relit, estimate(2)])
    assert [e.relit for e in made.estimates] == [False, True, False]
    said = "all pictures changed at once in 1 frame: 2 (another light? The body's look was learned again)"
    assert cameras_in_words(made) == [said]


FLICKER = np.array([0.4, 0.4, 0.4, 0.55, 0.3, 0.5, 0.35, 0.4, 0.4, 0.4])


@pytest.mark.parametrize(
    ("brightness", "rows"),
    [
        (FLICKER, range(2, 8)),
        (FLICKER[2:8], range(6)),  # a short track
        (np.where(np.arange(10) < 5, 0.4, 0.7), []),  # a switched light
        (0.4 * 1.2 ** np.arange(5), []),  # an exposure that grows
        (0.4 + 0.01 * np.sin(np.arange(20)), []),  # somebody walks by
        (np.where(np.arange(10) % 2, np.nan, 0.4), []),  # pictures are missing
        (np.repeat(FLICKER[2:8], 2) * np.tile([1.0, np.nan], 6), range(11)),  # every other one is
        (np.full(3, np.nan), []),
        (np.zeros(0), []),
    ],
)
def test_pictures_flicker_where_they_get_brighter_and_darker_again_and_again(brightness: Float, rows: range) -> None:
    assert np.flatnonzero(flickering(brightness)).tolist() == [*rows]


def test_flicker_is_said_of_a_camera_or_of_all(tmp_path: Path) -> None:
    still = np.full(10, 0.4)

    def said(*each: Float) -> list[str]:
        estimates = [estimate(k, brightness=row) for k, row in enumerate(np.transpose(each))]
        return cameras_in_words(result(tmp_path / "a.h5", estimates, ring(len(each))))

    why = "of their mean; lamps that flicker, or automatic exposure?)"
    assert said(still, FLICKER) == [
        f"the pictures of camera cam1 got brighter and darker in 6 frames: 4–14 (by 32 % {why}"
    ]
    assert said(FLICKER, 0.9 * FLICKER) == [
        f"the pictures of all cameras got brighter and darker in 6 frames: 4–14 (by 32 % {why}"
    ]
    twice = np.concatenate([0.1 * FLICKER, np.repeat([0.04, 0.4], 6), FLICKER])  # and a switched light
    assert said(twice) == [
        f"the pictures of camera cam0 got brighter and darker in 12 frames: 4–14, 48–58 (by 32 % {why}"
    ]
    assert not said(still, still) and not said(np.full(10, np.nan), still)


def test_a_first_pose_beside_the_body_is_said() -> None:
    given = Pose.rest(BODY)
    root, q = given.root.copy(), given.q.copy()
    root[0, 3] += 0.3
    shifted, found = Pose(root, q), estimate(0)
    assert not beside_in_words(BODY, given, found)
    assert beside_in_words(BODY, shifted, found) == [
        "frame 0 shows the body 0.30 m from the first pose; it is tracked there"
    ]
    assert not beside_in_words(BODY, shifted, replace(found, lost=True))
    assert not beside_in_words(BODY, shifted, replace(found, status="not_found"))
    q[BODY.coordinate_names.index("arm_flex_l")] += 1.2
    for pose, start in ((Pose(given.root, q), "left arm"), (Pose(root, q), "the body 0.30 m, left arm")):
        (said,) = beside_in_words(BODY, pose, found)
        away = Posed(BODY, pose).segment_middles - Posed(BODY, given).segment_middles
        most = np.linalg.norm(away[LIMBS["arm_l"]], axis=1).max()
        assert said == f"frame 0 shows {start} {most:.2f} m from the first pose; it is tracked there"


def test_a_mosaic_shows_each_camera_s_own_picture() -> None:
    rig, posed = ring(2), Posed(BODY, Pose.rest(BODY))
    grey = [np.full((rig[c].size[1], rig[c].size[0], 3), level, np.uint8) for c, level in enumerate((60, 180))]
    frame, mosaic = Frame(2, 1 / 30, (grey[0], grey[1])), mosaic_for(rig)
    own = draw_mosaic(frame, posed, mosaic, estimate=estimate(1))
    given = draw_mosaic(replace(frame, images=(grey[1], grey[0])), posed, mosaic, estimate=estimate(1, sources=(1, 0)))
    differs = np.any(own != given, axis=2)
    assert 0 < differs.sum() < 0.02 * differs.size  # the notes beside the names


def test_what_only_the_run_knows_of_cameras_is_in_the_verdict(tmp_path: Path) -> None:
    """Not below a verdict that says that no camera was left out, and only there."""
    made, doubt = result(tmp_path / "a.h5", [estimate(k) for k in range(3)]), "Camera cam0 seems to stand elsewhere."
    page = write_page(tmp_path, "a", "", [], [], {}, made, statements=[*result_in_words(made), doubt]).read_text()
    verdict, below = page.split("Lost frames and cameras")
    assert doubt in verdict and doubt not in below and "none of 3 frames lost" in below


def test_the_first_time_that_a_camera_is_left_out_is_told() -> None:
    believed = Believed(("cam0", "cam1"))
    told = [believed.news(estimate(k, left_out=out)) for k, out in enumerate([(), (1,), (1,), (), (1,), ()])]
    assert [len(sentences) for sentences in told] == [0, 1, 0, 1, 0, 0]
    assert told[1][0].startswith("frame 2: camera cam1 is left out; it contradicts the others (bumped")
    assert told[3] == ["frame 6: camera cam1 is believed again"]


@pytest.mark.parametrize("camera", [0, 1])
def test_the_overlay_frames_what_is_not_to_be_trusted(camera: int) -> None:
    mosaic = mosaic_for(ring(2))
    grey = tuple(np.full((280, 384, 3), 128, np.uint8) for _ in range(2))

    def drawn(**about: object) -> Float:
        each = estimate(0, **about)
        return draw_mosaic(Frame(0, 0.0, grey), Posed(BODY, each.pose), mosaic, "", each).astype(float)

    def red(picture: Float) -> Float:
        return np.abs(picture - LOST).max(axis=-1) < 30

    fine, lost, out = drawn(), drawn(lost=True, part_probability=parts(arm_l=0.9)), drawn(left_out=(camera,))
    edge = np.r_[fine[0], fine[-1], fine[:, 0], fine[:, -1]]
    assert not red(edge).any() and red(np.r_[lost[0], lost[-1], lost[:, 0], lost[:, -1]]).all()
    tile = slice(mosaic.heading, None), slice(camera * mosaic.cell[0], (camera + 1) * mosaic.cell[0])
    other = slice(mosaic.heading, None), slice((1 - camera) * mosaic.cell[0], (2 - camera) * mosaic.cell[0])
    assert red(out[tile]).sum() > 2 * sum(mosaic.cameras[0].size) and not red(out[other]).any()
    inside = cv2.erode(np.any(lost != fine, axis=-1).astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    share = inside[tile].sum() / np.any(drawn(lost=True, part_probability=None) != fine, axis=-1)[tile].sum()
    assert 0.02 < share < 0.5  # one arm, not the body


def test_the_verdict_says_what_can_be_used(tmp_path: Path) -> None:
    sigma = np.full(BODY.dof, np.radians(1.0))
    for name, degrees in (("knee_angle_r", 3.0), ("pro_sup_r", 9.0), ("pro_sup_l", 7.0)):
        sigma[6 + BODY.coordinate(name)] = np.radians(degrees)
    sigma[3:6] = 0.004
    frames = [replace(estimate(k), covariance=np.diag(sigma**2)) for k in range(20)]
    frames[4] = replace(frames[4], lost=True, probability=0.9, part_probability=parts(arm_l=0.9), left_out=(1,))
    frames[7] = replace(frames[7], probability=0.3)
    made = result(tmp_path / "a.h5", frames)
    verdict = verdict_of(made)
    words = [s.text for s in verdict]
    assert words[0] == "19 of 20 frames can be used. Leave out those that are lost or unseen: 8."
    assert words[1].endswith("probability of 0.2 or more: 14.")
    by_grade = {text.split(",")[0]: (s.good, text) for s, text in zip(verdict, words, strict=True)}
    assert by_grade["Use with care"] == (None, "Use with care, σ of 2° to 5°: knee angle right (3.0°).")
    assert by_grade["Not reliable"] == (False, "Not reliable, σ above 5°: pro sup (9.0°).")
    assert by_grade["Reliable"][0] is True and "knee angle left (1.0°)" in by_grade["Reliable"][1]
    assert "cam1 in 5 % of the frames" in words[-2]
    assert [line["value"] for line in camera_rows(made)] == [0, 0, 0, 0, 1, 0, 0, 0]
    assert 4 in chosen_rows(made) and len(chosen_rows(made)) == 4
    away = [replace(e, status="no_images", probability=1.0) if 8 <= k < 19 else e for k, e in enumerate(frames)]
    assert chosen_rows(result(tmp_path / "d.h5", away)) == [1, 4, 7]  # nothing to see from row 8 to 18
    assert verdict_of(result(tmp_path / "b.h5", [])) == []
    unseen = [replace(e, lost=True, status="no_images", part_probability=None) for e in frames]
    assert verdict_of(result(tmp_path / "c.h5", unseen))[0].good is False
