"""`twistcap sync` and `refine --cameras` on sessions that are wrong about clocks and calibration."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from support.cameras import ring
from support.commands import document, refusal, run
from twistcap import se3
from twistcap.adjust.clocks import Signal
from twistcap.arrays import Bool, Float
from twistcap.camera import Rig
from twistcap.commands import cameras, sync
from twistcap.commands.cameras import _doubt, _since, mend_cameras, mend_in_words, places_and_clocks  # pyright: ignore[reportPrivateUsage]
from twistcap.errors import InputError
from twistcap.estimate import Estimate
from twistcap.io.calibration import read_rig, write_rig
from twistcap.io.clocks import Clock
from twistcap.io.recording import _shown_from, rig_of, views_of  # pyright: ignore[reportPrivateUsage]
from twistcap.io.session import load_session
from twistcap.io.synthetic import write_session
from twistcap.studio import StudioConfig, capture

FRAMES, FPS = 36, 60.0


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A walk in four cameras that were triggered together."""
    folder = tmp_path_factory.mktemp("walk")
    scene = capture(StudioConfig(seed=3, size=(256, 188), frames=FRAMES, fps=FPS))
    write_session(scene, folder, "png", masks=False)
    return folder / "session.toml"


def test_a_wrong_clock_is_put_right(walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    session = walk.with_name("late.toml")
    session.write_text(walk.read_text() + "\n[clocks.cam02]\noffset = 0.025  # 1.5 frames; in truth 0\n")
    found = document(capsys, "sync", session, "--start", "given", "--frames", 24)
    rows = {row["camera"]: row for row in found["cameras"]}
    assert found["written"] and rows["cam02"]["before_s"] == 0.025
    for row in rows.values():
        assert abs(row["after_s"]) * FPS < 0.25
    clocks = load_session(session).clocks
    assert clocks["cam02"].offset == rows["cam02"]["after_s"]


def test_frames_that_clocks_on_trial_take_from_a_camera_do_not_end_it(walk: Path) -> None:
    """All frames of the file are looked at for a first pose, as far as all cameras have them by these clocks."""
    path = walk.with_name("whole.toml")
    late = "".join(f"\n[clocks.cam0{c}]\noffset = 0.05  # three frames\n" for c in (2, 3, 4))
    path.write_text("frames = [0, 35]\n" + walk.read_text() + late)
    session, together = sync._window(load_session(path), 12)  # pyright: ignore[reportPrivateUsage]
    rig = rig_of(session)
    with pytest.raises(InputError, match="images of"):
        views_of(session.whole, rig)
    shown = _shown_from(session, rig, views_of(session, rig))
    assert (shown.indices[0], shown.indices[-1]) == together == (3, 35)


@pytest.mark.parametrize("start", ["auto", "given"])
def test_one_camera_has_no_other_clock(walk: Path, start: str, capsys: pytest.CaptureFixture[str]) -> None:
    session = walk.with_name("one.toml")
    session.write_text(walk.read_text().replace("[cameras]", '[cameras]\nuse = ["cam01"]'))
    assert "one.toml: [videos]: sync compares" in refusal(capsys, "sync", session, "--start", start)


def test_only_clocks_that_are_sure_are_written(
    walk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first camera that is sure keeps its clock; where none is, nothing is written. A rough clock is sure enough
    where the session's is far off.
    """
    text = walk.read_text() + "\n[clocks.cam01]\noffset = 0.5\n[clocks.cam04]\noffset = 0.5\n"
    session = walk.with_name("unsure.toml")
    late, sigma, lost = np.array([0.0, 0.25, -0.125, 0.0]), np.array([0.3, 0.02, 0.2, 0.0]), 0.0

    def one_pass(_: object, clocks: dict[str, Clock], count: int) -> Any:
        steps = late - [clock.offset - 0.5 for clock in clocks.values()]
        estimates = [SimpleNamespace(lost=k < lost * count, left_out=()) for k in range(count)]
        doubts = sync._doubts(tuple(clocks), cast(Any, estimates))  # pyright: ignore[reportPrivateUsage]
        return sync._Pass(steps, sigma / FPS, 1 / FPS, 24, doubts, (0, 35), None)  # pyright: ignore[reportPrivateUsage]

    monkeypatch.setattr(sync, "_one_pass", one_pass)
    session.write_text(text)
    found = document(capsys, "sync", session, "--start", "given")
    assert found["written"] and [row["sure"] for row in found["cameras"]] == [False, True, True, True]
    offsets = {name: clock.offset for name, clock in load_session(session).clocks.items()}
    assert offsets == {"cam01": 0.5, "cam02": 0.0, "cam03": -0.375, "cam04": -0.25}
    assert "offset = 0.5\n" in session.read_text()  # which is not by sync
    session.write_text(text)
    assert run("sync", session, "--start", "given") == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "The clocks stay of cam01; to take what was found, write it as offset in [clocks.cam01]" in said
    session.write_text(text)
    lost = 0.5
    found = document(capsys, "sync", session, "--start", "given")
    assert not found["written"] and not any(row["sure"] for row in found["cameras"])
    assert session.read_text() == text and "the body was lost in 50 % of the frames" in found["unsure"]


@pytest.mark.parametrize("doubts", [("it fits at several offsets",), ()])
def test_where_no_track_begins_with_clocks_that_are_not_clear_the_sessions_are_tried(
    walk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], doubts: tuple[str, ...]
) -> None:
    rough = {f"cam0{c}": Clock(0.1 * c) for c in range(1, 5)}

    def one_pass(_: object, clocks: dict[str, Clock], count: int) -> Any:
        if clocks == rough:
            raise InputError("the cameras agree on no person.")
        return sync._Pass(np.zeros(4), np.full(4, 0.01) / FPS, 1 / FPS, 24, (), (0, 35), None)  # pyright: ignore[reportPrivateUsage]

    monkeypatch.setattr(sync, "_one_pass", one_pass)
    monkeypatch.setattr(sync, "_coarse", lambda *_: (rough, "motion", doubts))
    if not doubts:  # then it is not the clocks' fault
        assert "agree on no person" in refusal(capsys, "sync", walk)
        return
    assert run("sync", walk, "--dry-run") == 0
    assert "by motion, which are not clear" in " ".join(capsys.readouterr().err.split())
    found = document(capsys, "sync", walk)
    assert (found["began_with"], found["written"]) == ("the session's clocks", False)
    assert found["unsure"] == list(doubts) and all(row["after_s"] == 0.0 for row in found["cameras"])


def test_what_a_clock_moves_in_the_last_pass_is_part_of_its_claim_and_much_is_not_sure(
    walk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    step, sigma = np.array([0.0, 0.12, 0.08, 0.0]) / FPS, np.array([0.0, 0.05, 0.06, 0.05]) / FPS
    monkeypatch.setattr(sync, "_one_pass", lambda *_: sync._Pass(step, sigma, 1 / FPS, 24, (), (0, 35), None))  # pyright: ignore[reportPrivateUsage]
    found = document(capsys, "sync", walk, "--start", "given", "--dry-run")
    assert [row["sure"] for row in found["cameras"]] == [True, False, True, True]
    assert found["unsure"] == ["the clock of cam02 still moved by 0.12 frames in the last pass"]
    np.testing.assert_allclose([row["sigma_frames"] for row in found["cameras"]], [0.0, 0.13, 0.1, 0.05])


def test_track_names_a_camera_that_is_late(walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By as much as the offset that mends it; clocks that agree are not looked at a second time."""
    late = walk.with_name("late2.toml")
    late.write_text(walk.read_text() + "\n[clocks.cam02]\noffset = 0.025  # 1.5 frames; in truth 0\n")
    few = ("--set", "output.overlay=false", "--set", "output.report=false")
    sentences = document(capsys, "track", late, "--out", tmp_path / "late", *few)["statements"]
    (about,) = [s for s in sentences if "disagrees with the others'" in s]
    assert "clock of camera cam02" in about and "twistcap sync" in about
    assert abs(float(about.split("offset = ")[1].split()[0])) * FPS < 0.5
    sentences = document(capsys, "track", walk, "--out", tmp_path / "in step", *few)["statements"]
    assert not any("clock" in s for s in sentences)


def test_a_walk_in_step_tells_that_it_is_not_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    """A regular walk of three seconds that all cameras share looks alike after each step."""
    rng, late = np.random.default_rng(0), np.array([0.0, 2.5, 1.2, 0.4])
    names = tuple(f"cam{c}" for c in range(len(late)))

    def signals(*_: object) -> list[Signal]:
        times = np.arange(0.0, 5.5, 1 / 60)
        return [
            Signal(times, np.sin(2 * np.pi * (times + o) / 0.55) + 0.15 * rng.normal(size=len(times))) for o in late
        ]

    monkeypatch.setattr(sync, "_signals", signals)
    for given in (0.0, 0.55 / 2):  # also where the session's clocks are as good as the best
        clocks, _, doubts = sync._coarse(None, names, {n: Clock(given) for n in names}, "motion")  # pyright: ignore[reportPrivateUsage]
        found = np.array([clocks[n].offset - clocks[names[0]].offset for n in names])
        assert np.abs(found - late).max() > 0.1  # it is wrong, and says so
        assert any("fits that of the others at several offsets" in doubt for doubt in doubts)


def test_what_mends_a_camera_is_said_where_it_is_left_out_to_the_end() -> None:
    rig, out = ring(), np.zeros((30, 4), np.bool_)
    out[5:, 1], out[5:20, 2] = True, True  # the other one is believed again
    still = np.zeros((30, 4, 3))
    result = SimpleNamespace(rig=rig, left_out=out, bumps=still)
    (said,) = mend_in_words(result, Path("out/result.h5"))
    mend = "finds its new place; if late, twistcap sync its offset."
    refine = "twistcap refine out/result.h5"
    assert said == f"Camera cam1 was left out to the end. If it was bumped, {refine} --cameras {mend}"
    (said,) = mend_in_words(SimpleNamespace(rig=rig, left_out=out, bumps=still), Path("a walk/result.h5"))
    assert "twistcap refine 'a walk/result.h5' --cameras" in said
    bumped = still.copy()
    bumped[20:, 3] = 0.02
    alone = SimpleNamespace(rig=rig, left_out=np.zeros_like(out), bumps=bumped)
    (said,) = mend_in_words(alone, Path("out/result.h5"))
    assert said == f"Camera cam3 still stands bumped. {refine} --cameras finds its new place."
    assert mend_in_words(SimpleNamespace(rig=rig, left_out=np.zeros_like(out), bumps=still), Path("x.h5")) == []


@pytest.mark.parametrize(
    ("cameras", "elsewhere", "again", "mend"),
    [
        (4, (1, 3), (), "If they were bumped, twistcap refine x.h5 --cameras finds their new places; if late"),
        (
            4,
            (1, 3),
            (2,),
            "If they were bumped, twistcap refine x.h5 --camera cam1 --camera cam3 finds their new places",
        ),
        (
            3,
            (1, 2),
            (),
            "If one alone was bumped, name it, as twistcap refine x.h5 --camera cam1; if more were, calibr",
        ),
        (4, (0, 1, 2, 3), (), "If one alone was bumped, name it, as twistcap refine x.h5 --camera cam0; if more were"),
        (2, (1,), (), "If it was bumped, calibrate again: two others must be right to find its new place; if late"),
    ],
)
def test_what_mends_several_cameras_is_what_refine_can_do(
    cameras: int, elsewhere: tuple[int, ...], again: tuple[int, ...], mend: str
) -> None:
    """`again` were left out for long, and are believed again: `--cameras` takes them for wrong."""
    rig, out = replace(ring(), cameras=ring().cameras[:cameras]), np.zeros((30, cameras), np.bool_)
    out[5:20, list(again)] = True
    result = SimpleNamespace(rig=rig, left_out=out, bumps=np.zeros((30, cameras, 3)))
    (said,) = mend_in_words(result, Path("x.h5"), elsewhere)
    facts = [f"Camera {rig.names[c]} seems to stand elsewhere than it was calibrated." for c in elsewhere]
    assert said.startswith(f"{' '.join(facts)} {mend}")


def test_two_cameras_must_be_right_to_mend_others() -> None:
    rig = replace(ring(), cameras=ring().cameras[:3])
    result = SimpleNamespace(rig=rig, left_out=np.zeros((30, 3), np.bool_), bumps=np.zeros((30, 3, 3)))
    mend = "two must be right to mend the others: name one alone with --camera, or calibrate again"
    with pytest.raises(InputError, match=f"of 3 cameras cam0, cam2 are wrong; {mend}"):
        cameras._wrong(result, [], [0, 2], Path("x.h5"))  # pyright: ignore[reportPrivateUsage]


def test_places_are_found_before_clocks() -> None:
    """A camera that was bumped seems late."""
    assert places_and_clocks([], ["late"]) == ["late"] and places_and_clocks(["bumped"], []) == ["bumped"]
    place, order, clock = places_and_clocks(["bumped"], ["late"])
    assert (place, clock) == ("bumped", "late") and order.endswith("find the places first.")


def test_a_bumped_camera_is_mended(walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    true = read_rig(walk.with_name("Calib.toml"), "m")
    turn = np.r_[np.deg2rad(2.0) * np.array([0.6, -0.8, 0.0]), 0.0, 0.0, 0.0]
    off = replace(true[1], T_cam_world=se3.exp(turn) @ true[1].T_cam_world)
    given = tmp_path / "Calib.toml"
    write_rig(replace(true, cameras=(true[0], off, *true.cameras[2:])), given)
    bad = ("--set", f"cameras.calibration={given}")
    assert run("track", walk, "--out", tmp_path, *bad, "--set", "output.overlay=false") == 0
    assert run("refine", tmp_path / "result.h5", "--camera", "nobody") == 2
    assert run("refine", tmp_path / "result.h5", "--cameras", "--out", tmp_path) == 2  # over the user's own
    capsys.readouterr()
    before, found = given.read_text(), document(capsys, "refine", tmp_path / "result.h5", "--camera", off.name)
    (row,) = found["cameras"]
    assert row["sure"] and row["camera"] == off.name and given.read_text() == before
    assert row["turned_deg"] == pytest.approx(2.0, abs=0.6) and row["agreed_after"] > row["agreed_before"] + 0.3
    mended = read_rig(Path(found["calibration"]), "m")
    np.testing.assert_allclose(mended[0].T_cam_world, true[0].T_cam_world, atol=1e-9)
    body = np.array([[x, y, z] for x in (-0.3, 0.3) for y in (-0.3, 0.3) for z in (0.2, 1.0, 1.6)])
    apart = mended[1].project(body)[0] - true[1].project(body)[0]
    assert (
        np.linalg.norm(apart, axis=1).max()
        < 2.5
        < np.linalg.norm(off.project(body)[0] - true[1].project(body)[0], axis=1).min()
    )


@dataclass(frozen=True)
class Mended:
    """What `mend_cameras` reads of a result."""

    rig: Rig
    left_out: Bool
    bumps: Float
    estimates: list[Estimate]


@pytest.mark.parametrize(("unit", "up"), [("m", None), ("mm", None), (None, "y"), ("mm", "y")])
def test_a_mended_calibration_is_in_the_world_and_unit_of_the_session(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unit: str | None, up: str | None
) -> None:
    """So that the session needs no other change than the new file's name."""
    true = read_rig(walk.with_name("Calib.toml"), "m")
    lying = np.eye(4)  # from a world in which y is up to the one in which z is
    lying[:3, :3] = np.eye(3) if up is None else [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    given = replace(true, cameras=tuple(replace(c, T_cam_world=c.T_cam_world @ lying) for c in true))
    file = tmp_path / "Calib.toml"
    write_rig(given, file, "mm" if unit == "mm" else "m")
    table = f'calibration = "{file}"\n' + (f'unit = "{unit}"\n' if unit else "") + (f'up = "{up}"\n' if up else "")
    text = walk.read_text().replace('calibration = "Calib.toml"\nunit = "m"\n', table)
    for name, calibration in (("given.toml", file), ("mended.toml", tmp_path / "out" / "Calib.toml")):
        walk.with_name(name).write_text(text.replace(str(file), str(calibration)))
    session = load_session(walk.with_name("given.toml"))
    rig = rig_of(session)
    place = se3.exp(np.r_[0.03, 0.01, 0.0, 0.02, 0.0, 0.01]) @ rig[1].T_cam_world
    few = [Estimate(k, k / FPS, cast(Any, None), np.zeros((0, 0))) for k in range(5)]  # poses are not looked at
    result = Mended(rig, np.ones((5, 4), np.bool_), np.zeros((5, 4, 3)), few)
    monkeypatch.setattr("twistcap.io.result.read_result", lambda path: result)
    monkeypatch.setattr("twistcap.io.recording.views_of", lambda *_: None)
    monkeypatch.setattr(cameras, "_suspected", lambda *_: {})
    real = cameras._mended  # pyright: ignore[reportPrivateUsage]

    def mended(result: Any, views: Any, session: Any, camera: int, *more: Any) -> Any:
        row, found = real(result, views, session, camera, *more)
        return (row | {"sure": True}, place) if camera == 1 else (row, found)

    monkeypatch.setattr(cameras, "_mended", mended)
    found = mend_cameras(tmp_path / "result.h5", tmp_path / "out", session, rig.names[1:3])
    assert found["calibration"].is_absolute() and [row["sure"] for row in found["cameras"]] == [True, False]
    assert "only 5 good frames" in found["cameras"][1]["reason"]  # and what is mended is kept
    cameras.show({**found, "cameras": found["cameras"][1:]})
    again = rig_of(load_session(walk.with_name("mended.toml")))
    for k, (now, before) in enumerate(zip(again, rig, strict=True)):
        np.testing.assert_allclose(now.T_cam_world, place if k == 1 else before.T_cam_world, atol=1e-8)


@pytest.mark.parametrize("sure", [True, False])
def test_the_camera_that_had_to_be_turned_as_well_is_mended_instead(
    monkeypatch: pytest.MonkeyPatch, sure: bool
) -> None:
    """All others are believed then, also those that the tracker had left out."""
    rig, asked = ring(), list[tuple[int, bool]]()
    out = np.zeros((30, 4), np.bool_)
    out[5:, [0, 3]] = True
    result, place = Mended(rig, out, np.zeros((30, 4, 3)), []), se3.exp(np.full(6, 0.01)) @ rig[2].T_cam_world
    name, instead = rig.names[2], {"camera": rig.names[0], "instead": rig.names[2]}

    def mended(result: Any, views: Any, session: Any, camera: int, others: Any, since: int) -> Any:
        asked.append((since, result.left_out.any()))
        return {"camera": rig.names[camera], "instead": None, "sure": sure}, place

    monkeypatch.setattr("twistcap.io.recording.views_of", lambda *_: None)
    monkeypatch.setattr(cameras, "_mended", mended)
    rows = [instead, {"camera": rig.names[3], "instead": None}]
    found = cameras._one_instead(result, None, rows, {})  # pyright: ignore[reportPrivateUsage]
    assert asked == [(5, False)]
    assert (found is not None) == sure
    if found is not None:
        assert found[0] == [2] and [row["camera"] for row in found[1]] == [name]
        np.testing.assert_array_equal(found[2][2].T_cam_world, place)


def test_why_a_calibration_stays() -> None:
    assert _doubt(0.3, 0.8, 0.85) == ""
    assert "as it is calibrated (82 %)" in _doubt(0.82, 0.83, 0.85)
    assert "late, frozen or swapped" in _doubt(0.3, 0.4, 0.85)


def test_two_cameras_that_hold_two_others_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    numbers = (
        "off_px",
        "turned_deg",
        "turned_sigma_deg",
        "moved_mm",
        "moved_sigma_mm",
        "agreed_before",
        "agreed_after",
    )
    some: dict[str, Any] = {**dict.fromkeys(numbers, 0.5), "frames": 99, "sure": True}
    rows = [{"camera": "c", "from_frame": 0, **some}, {"camera": "d", "from_frame": None, **some}]
    for mended, told in ((rows, True), (rows[:1], False)):
        cameras.show({"cameras": mended, "held_by": ["a", "b"], "calibration": Path("Calib.toml")})
        said = "Only a and b hold the world. If one of these was bumped instead, this is wrong"
        printed = " ".join(capsys.readouterr().err.split())
        assert (said in printed) == told
        assert "Camera c: the new calibration holds from frame 0 on" in printed
        assert ("Camera d: the new calibration is that of 99 frames; since when it holds," in printed) == told


def test_frames_since_a_camera_is_mostly_left_out() -> None:
    out = np.zeros(300, np.bool_)
    out[[3, 90, 91]] = True  # the body was hidden
    assert _since(out) == 0
    out[40:80] = True  # it was pushed, and pushed back
    assert _since(out) == 40
    out[200::3] = out[201::3] = True
    assert _since(out) == 200


def test_where_nothing_is_clear_the_clearer_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """One weak clap against a regular walk: the sound is right, and it is said that neither is sure."""
    names, late = ("cam0", "cam1", "cam2"), np.array([0.0, 1.3, 0.7])

    def signals(_session: object, _names: object, _given: object, way: str) -> list[Signal]:
        rng, times = np.random.default_rng(4), np.arange(0.0, 6.0, 1 / 60)
        if way == "motion":
            return [Signal(times, np.sin(2 * np.pi * (times + o) / 0.55)) for o in (0.0, 0.2, 0.4)]
        fine = np.arange(0.0, 6.0, 0.002)
        claps = [0.25 * np.exp(-(((fine + o - 3.0) / 0.004) ** 2)) for o in late]
        return [Signal(fine, clap + 0.02 * rng.normal(size=len(fine))) for clap in claps]

    monkeypatch.setattr(sync, "_signals", signals)
    clocks, way, doubts = sync._coarse(None, names, {n: Clock() for n in names}, "auto")  # pyright: ignore[reportPrivateUsage]
    assert way == "sound" and np.allclose([clocks[n].offset for n in names], late, atol=0.005)
    assert any("neither sound nor motion is clear" in doubt for doubt in doubts)
