"""``twistcap refine``: a track refined, what goes on from there, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from support.commands import run
from twistcap.body import Pose
from twistcap.body.humanoid import humanoid
from twistcap.camera import Camera, Rig
from twistcap.estimate import Estimate
from twistcap.io.result import ResultWriter, read_result


@pytest.mark.usefixtures("drawn")
def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk, out = tmp_path / "walk", tmp_path / "out"
    assert run("studio", walk, "--size", "192x140", "--views", "2", "--frames", "6") == 0
    assert run("track", walk / "session.toml", "--out", out, "--set", "output.overlay=false") == 0
    capsys.readouterr()
    few = ("--set", "rounds=2", "--set", "points=100")
    assert run("refine", out, "--frames", "1:5", "--json", *few) == 0
    output = json.loads(capsys.readouterr().out)
    assert output["frames"] == 5 and len(output["moved_mm"]) == 2
    refined = read_result(output["result"])
    assert list(refined.indices) == [1, 2, 3, 4, 5] and "refined" in refined.config
    assert Path(output["result"]) == out / "refined" / "refined.h5" and (out / "refined" / "angles.png").is_file()
    assert run("refine", output["result"], "--out", tmp_path / "once more", *few) == 0
    capsys.readouterr()
    again = ("--again", "--out", tmp_path / "again", "--json")
    assert run("refine", out / "result.h5", "--frames", "1:5", *again, *few) == 0
    twice = json.loads(capsys.readouterr().out)
    assert twice["frames"] == 5 and twice["lengths"] != output["lengths"]  # against the same body, after more rounds
    assert run("view", output["result"], "--images", 0, "--save", tmp_path / "page.html") == 0
    assert run("export", output["result"], "--to", "mot") == 0
    assert run("evaluate", output["result"], "--reference", walk / "truth.npz", "--json") == 0
    walk.rename(tmp_path / "moved")
    capsys.readouterr()
    assert run("refine", out / "result.h5") == 2
    told = capsys.readouterr().err
    assert "does not exist; if the recording has moved, give --session." in told and "[videos]" not in told


def test_the_command_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("refine", tmp_path / "none.h5") == 2
    assert "does not exist" in capsys.readouterr().err
    assert run("refine", tmp_path, "--cameras") == 2
    assert f"folder {tmp_path} holds no result.h5; name the folder" in capsys.readouterr().err
    path, body = tmp_path / "result.h5", humanoid()
    with ResultWriter(path, body, Rig((Camera("c", np.eye(3), np.eye(4), (8, 8)),)), {}) as writer:
        writer.append(Estimate(0, 0.0, Pose.rest(body), np.eye(body.dof)))
    assert run("refine", path) == 2
    assert "names no videos; give a session with --session" in capsys.readouterr().err
    assert run("refine", path, "--set", "round=3") == 2
    assert "did you mean 'rounds'?" in capsys.readouterr().err
