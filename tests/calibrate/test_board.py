"""Boards: what they are called, that what is printed is what is found, and what cannot be."""

from __future__ import annotations

import re
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.commands import refusal, run
from twistcap.calibrate.board import Board, board_of, read_board
from twistcap.calibrate.calibrate import found_variant
from twistcap.calibrate.detect import Detector
from twistcap.errors import InputError
from twistcap.io.video import open_source
from twistcap.io.videowriter import VideoWriter
from twistcap.report.board import write_board

BOARDS = ["charuco:5x7:36:27:4X4_50", "charuco:6x6:30:20:5X5_100", "chessboard:8x5:25", "aruco:4x3:40:30:6X6_50"]


def photographed(board: Board, inverted: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """A picture (H, W) of a board seen obliquely on grey, and the true pixels (P, 2) of its points."""
    pixels = 60
    picture = board.image(pixels)
    picture = 255 - picture if inverted else picture
    height, width = picture.shape
    corners = np.array([[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]])
    seen = np.array([[120, 90], [640, 60], [680, 560], [90, 600]]) if width <= height else np.array(
        [[120, 90], [840, 60], [800, 560], [90, 500]]
    )  # fmt: skip
    H = cv2.getPerspectiveTransform(corners.astype(np.float32), seen.astype(np.float32))
    grey = 128 if inverted else 255
    image = cv2.warpPerspective(picture, H, (960, 720), flags=cv2.INTER_AREA, borderValue=grey)
    on_picture = board.points[:, :2] / board.square * pixels - 0.5
    return cv2.GaussianBlur(image, (0, 0), 0.8), cv2.perspectiveTransform(on_picture[None], H)[0]


def smaller(image: np.ndarray) -> np.ndarray:
    """Of half the width and height: where it is enough that a board is found."""
    return cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


@pytest.mark.parametrize("text", BOARDS)
def test_the_points_of_a_board_are_found_where_they_are(text: str) -> None:
    board = board_of(text)
    image, true = photographed(board)
    found = Detector(board)(image)
    assert found is not None and len(found) > 0.9 * len(true)
    error = np.linalg.norm(found.pixels - true[found.ids], axis=1)
    assert np.median(error) < (0.35 if board.kind == "aruco" else 0.1) and np.mean(error < 1.0) > 0.9
    assert 1.0 < found.blur < 6.0


@pytest.mark.parametrize("text", BOARDS)
def test_a_board_is_read_as_it_was_written(text: str, tmp_path: Path) -> None:
    board = board_of(text)
    (tmp_path / "board.toml").write_text(board.toml)
    assert read_board(tmp_path / "board.toml") == board == board_of(str(tmp_path / "board.toml"))


def test_an_inverted_board_is_noticed_and_a_mirrored_one_refused(tmp_path: Path) -> None:
    board = board_of(BOARDS[0])
    cv2.imwrite(str(tmp_path / "0.png"), photographed(board, inverted=True)[0])
    assert found_variant([open_source(tmp_path)], board).inverted
    mirrored = tmp_path / "mirrored"
    mirrored.mkdir()
    cv2.imwrite(str(mirrored / "0.png"), photographed(board)[0][:, ::-1])
    with pytest.raises(InputError, match="seen mirrored"):
        found_variant([open_source(mirrored)], board)
    blank = tmp_path / "blank"
    blank.mkdir()
    cv2.imwrite(str(blank / "0.png"), np.full((480, 640), 90, np.uint8))
    with pytest.raises(InputError, match="no picture shows the board, a charuco of 5 × 7 squares of 36 mm"):
        found_variant([open_source(blank)], board)


@pytest.mark.parametrize(
    ("said", "filmed", "told"),
    [
        ("chessboard:8x5:25", "charuco:5x7:36:27:4X4_50", "charuco:5x7:SQUARE_MM:MARKER_MM:4X4_50"),
        ("chessboard:5x7:36", "charuco:5x7:36:24:4X4_50", "charuco:5x7:SQUARE_MM:MARKER_MM:4X4_50"),  # by its corners
        ("charuco:5x7:36:27:4X4_50", "charuco:6x6:30:20:5X5_100", "charuco:6x6:SQUARE_MM:MARKER_MM:5X5_50"),
        ("charuco:5x7:36:27:4X4_50", "aruco:4x3:40:30:6X6_50", "KIND:COLUMNSxROWS:SQUARE_MM:MARKER_MM:6X6_50"),
    ],
)
def test_another_board_than_was_said_is_named(said: str, filmed: str, told: str, tmp_path: Path) -> None:
    picture = smaller(photographed(board_of(filmed), inverted="charuco" in filmed)[0])
    for k in range(3):  # as many are no chance
        cv2.imwrite(str(tmp_path / f"{k}.png"), picture)
    with pytest.raises(InputError, match=f"the board, a {board_of(said).kind} .*, but .*--board {told}"):
        found_variant([open_source(tmp_path)], board_of(said))


def test_tags_behind_a_chessboard_do_not_make_it_another(tmp_path: Path) -> None:
    board, behind = board_of("chessboard:8x5:25"), board_of("charuco:5x7:36:27:4X4_50")
    both = smaller(np.concatenate([photographed(board)[0], photographed(behind)[0]], axis=1))
    for k in range(3):  # as many are no chance
        cv2.imwrite(str(tmp_path / f"{k}.png"), both)
    assert found_variant([open_source(tmp_path)], board) == board


def test_a_chessboard_is_numbered_from_the_same_corner_whichever_way_up() -> None:
    board = board_of("chessboard:8x5:25")
    image, true = photographed(board)
    turned = Detector(board)(np.ascontiguousarray(image[::-1, ::-1]))
    assert turned is not None
    np.testing.assert_allclose(np.array([959, 719]) - turned.pixels, true[turned.ids], atol=0.5)


def test_the_pdf_is_of_true_size(tmp_path: Path) -> None:
    """The picture is placed by a matrix in points of 1/72 inch."""
    board = board_of("charuco:5x7:36:27:4X4_50")
    data = write_board(board, tmp_path / "board.pdf").read_bytes()
    streams = [zlib.decompress(raw) for raw in re.findall(rb"FlateDecode.*?stream\r?\n(.*?)\r?\nendstream", data, re.S)]
    drawing = next(s for s in streams if b" Do" in s)
    placed = re.search(rb"([\d.]+) 0 0\s+-([\d.]+) 0 [\d.]+ cm\s+/I1 Do", drawing)
    assert placed is not None
    size = [float(placed[1]), float(placed[2])]
    np.testing.assert_allclose(size, 1e3 * np.array(board.size) / 25.4 * 72, atol=0.1)
    box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", data)
    assert box is not None
    np.testing.assert_allclose([float(box[1]), float(box[2])], np.array([210, 297]) / 25.4 * 72, atol=0.1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("charuco", "cannot be read; write KIND"),
        ("dots:5x7:36", "kind is 'dots'; it must be one of charuco"),
        ("charuco:5x7:36:40", "tags of 40 mm do not fit squares of 36 mm"),
        ("charuco:2x7:36:20", "it needs 3 to 100 of each"),
        ("charuco:20x20:36:20:4X4_50", "it needs 200 tags, and the dictionary 4X4_50 has 50"),
        ("charuco:5x7:36:20:9X9_50", "dictionary is '9X9_50'"),
        ("chessboard:5x7:9000", "a square of 9000 mm cannot be"),
    ],
)
def test_boards_that_cannot_be_are_refused(text: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert message in refusal(capsys, "board", "x.pdf", "--board", text)


def test_the_command_writes_a_page_and_its_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("board", tmp_path / "b.pdf") == 0
    assert read_board(tmp_path / "b.toml").words.startswith("charuco of 5 × 7 squares of 36 mm")
    words = (tmp_path / "b.toml").read_text()
    other = ("board", tmp_path / "b.pdf", "--board", "chessboard:8x5:20")
    assert "b.pdf exists; choose another place, or replace it with --overwrite." in refusal(capsys, *other)
    (tmp_path / "b.pdf").unlink()
    assert "b.toml exists; choose another place" in refusal(capsys, *other)
    assert [*tmp_path.iterdir()] == [tmp_path / "b.toml"] and (tmp_path / "b.toml").read_text() == words
    assert run(*other, "--overwrite") == 0 and read_board(tmp_path / "b.toml").words.startswith("chessboard")
    assert "is smaller" in refusal(capsys, "board", tmp_path / "c.pdf", "--board", "charuco:5x4:80:60:5X5_100")
    assert run("board", tmp_path / "c.pdf", "--board", "charuco:5x4:80:60:5X5_100", "--paper", "fit") == 0


def test_a_board_that_is_the_same_upside_down_is_told_when_it_is_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for text, told in (("chessboard:8x6:20", True), ("chessboard:8x5:20", False), ("charuco:6x6:20:15:4X4_50", False)):
        assert run("board", tmp_path / "b.pdf", "--board", text, "--overwrite") == 0
        assert ("looks the same upside down" in capsys.readouterr().err) == told


def test_what_is_asked_in_vain_is_told_before_videos_are_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in "ab":
        with VideoWriter(tmp_path / f"{name}.mp4", fps=30) as writer:
            for _ in range(3):
                writer.write(np.full((64, 64, 3), 90, np.uint8))
    videos = ("--videos", tmp_path / "a.mp4", "--videos", tmp_path / "b.mp4")
    asked = ("calibrate", tmp_path / "rig", *videos, "--board")
    assert "the frames of camera a are 0 to 2; name one" in refusal(capsys, *asked, "chessboard:8x5:20", "--floor", "3")
    assert "use one of an even and an odd side" in refusal(capsys, *asked, "chessboard:8x6:20")
    there = tmp_path / "rig" / "Calib.toml"
    there.parent.mkdir(exist_ok=True)
    there.write_text("mine")
    told = "Calib.toml exists; choose another place, or replace it with --overwrite"
    assert told in refusal(capsys, *asked, "chessboard:8x5:20")
    assert told not in refusal(capsys, *asked, "chessboard:8x5:20", "--overwrite")
    assert there.read_text() == "mine"
